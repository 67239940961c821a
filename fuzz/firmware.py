# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""
python -m fuzz.firmware --bytes N: the receiver of firmware/ and its reader in Python, on one line.

The C source runs with sanitizers; the other is mecarover_fakes/guarded_receiver.py. They hear N
bytes of frames that are good, damaged, cut, joined, of another CRC, or not allowed, and noise, in
pieces with pauses. Exit code 1 unless they say the same of each byte (whether it ends a frame, and
which), of each turn of the wheels and in each report, and take no frame that was not sent, but
ones and zeros, which is a stop.
"""

import argparse
from collections import Counter
import math
from pathlib import Path
import random
import struct
import sys
import tempfile
import time

from mecarover_fakes.guarded_receiver import GuardedReceiver
from mecarover_fakes.receiver import LOOP
from msg_defs.crc import CRC_INPUTS
from msg_defs.vel2d import encode
from msg_defs.vel2d import Vel2d
from rigs.mcu.host import compiled
from rigs.mcu.host import Host

BLOCK = 1 << 16                     # bytes of a receiver's life
MS = 1_000_000
BAUD = 10**10                       # a byte takes a ns, so a piece has one time in ms
PAUSES_MS = (0, 0, 0, 1, 3, 6, 20, 33, 250, 299, 300, 301, 400)
# A CRC that begins with ones takes this, and 4 more zeros, for a frame: 2e-314 m/s, so a stop.
ONES_AND_ZEROS = b'\xff' * 4 + bytes(20)
ODD = (math.nan, math.inf, -math.inf, 1.0000001e6, -2e6, 1e300)
START_MS = (0, 2**31 - 5_000, 2**32 - 5_000)    # the counter of an MCU wraps around


class Line:
    """One life of both receivers; `sent` holds the frames that may be taken."""

    def __init__(self, chance):
        self._chance = chance
        self._words = chance.random() < 0.5
        self._crc = CRC_INPUTS['words' if self._words else 'bytes']
        self._start = chance.choice(START_MS)
        self._reader = GuardedReceiver(baud=BAUD, crc=self._crc)
        self._host = Host(words=self._words)
        self._now = 0
        self._expected = []
        self.sent = {ONES_AND_ZEROS}
        self.counts = Counter()

    def live(self, program):
        """Let both hear a block; compare."""
        while self.counts['bytes'] < BLOCK:
            if piece := self._piece():
                self._feed(piece)
                self._pause()
        answers = self._host.run(program)
        assert len(answers) == len(self._expected)
        for number, pair in enumerate(zip(answers, self._expected, strict=True)):
            assert pair[0] == pair[1], f'answer {number}: {pair[0]} in C, {pair[1]} in Python'
        totals = self._reader.totals
        self.counts.update(frames=totals.frames, bad=totals.crc_err, refused=totals.refused,
                           stops=totals.stops)
        return self.counts

    def _feed(self, data):
        reader, ms = self._reader, self._start + self._now // MS
        reader.feed(data, self._now)
        reader.advance(reader.line_free)
        self._host.feed(data, ms)
        frames = [(one.stamp - self._now - 1, struct.pack('<3d', *one.velocity))
                  for one in reader.arrivals]
        reader.arrivals.clear()
        self.counts['wrong'] += sum(frame not in self.sent for _, frame in frames)
        self._expected.append((frames, reader.totals.crc_err, reader.totals.refused))
        self.counts['bytes'] += len(data)
        if self._chance.random() < 0.1:
            self._report(ms)

    def _report(self, ms):
        self._host.report(ms)
        report = self._reader.report(self._now // MS * MS)
        self._expected.append(report.line() + '\r\n' if report else '')

    def _pause(self):
        """Let time pass: the next ms at least, so that it is the same for all bytes of a piece."""
        pause = self._chance.choice(PAUSES_MS)
        if not pause:
            self._now = self._reader.line_free
            if self._now % MS < MS // 2:
                return
            pause = 1
        end = (self._now // MS + pause) * MS
        if pause <= 5 or self._chance.random() < 0.5:
            self._host.idle()           # else the receiver sees for itself that time has passed
        for turn in range((self._now // LOOP + 1) * LOOP, end + 1, LOOP):
            self._reader.advance(turn)
            self._host.turn(self._start + turn // MS)
            wheels = self._reader.wheels
            self._expected.append((
                struct.pack('<3d', wheels.x / 1000, wheels.y / 1000, wheels.omega),
                self._reader.state, self._reader.totals.stops))
        self._reader.advance(end)
        self._now = end

    def _piece(self):
        chance = self._chance
        if chance.random() < 0.1:
            return chance.choice((chance.randbytes(chance.randrange(80)), bytes(40),
                                  b'\xff' * 40))
        frame = self._frame()
        return frame if chance.random() < 0.5 else self._damaged(frame)

    def _frame(self):
        chance = self._chance
        # whole 1/8: their product with 1000, of the simulated MCU, can be divided again
        values = [chance.randrange(-800, 800) / 8 for _ in range(3)]
        if chance.random() < 0.05:
            values[chance.randrange(3)] = chance.choice(ODD)
        if chance.random() < 0.05:
            return encode(Vel2d(*values), CRC_INPUTS['bytes' if self._words else 'words'])
        frame = encode(Vel2d(*values), self._crc)
        self.sent.add(frame[:24])
        return frame

    def _damaged(self, frame):
        chance = self._chance
        at, bit = chance.randrange(len(frame)), 1 << chance.randrange(8)
        return chance.choice((
            frame[:at] + frame[at + 1:], frame[:at], frame[at:],
            frame[:at] + bytes([frame[at] ^ bit]) + frame[at + 1:],
            frame[:at] + chance.randbytes(chance.randrange(8)) + frame[at:],
            frame + self._frame(), chance.randbytes(chance.randrange(5)) + frame,
            frame[:at] + self._frame(), frame * 3))


def main():
    options = _parser().parse_args()
    chance, total, begin = random.Random(options.seed), Counter(), time.process_time()
    with tempfile.TemporaryDirectory(prefix='firmware_') as folder:
        program = compiled(Path(folder))
        while total['bytes'] < options.bytes:
            total += Line(chance).live(program)
    print(f'{total["bytes"]:,} B, {time.process_time() - begin:.0f} s of CPU: the same verdict on '
          f'each; {total["frames"]:,} frames, {total["wrong"]} wrong, {total["bad"]:,} damaged, '
          f'{total["refused"]:,} refused, {total["stops"]:,} stops')
    return int(total['wrong'] > 0)


def _parser():
    parser = argparse.ArgumentParser(
        prog='python -m fuzz.firmware',
        description='Compare the receiver of firmware/ with its reader in Python.')
    parser.add_argument('--bytes', type=int, default=1_000_000, help='(default %(default)s)')
    parser.add_argument('--seed', type=int, default=1, help='(default %(default)s)')
    return parser


if __name__ == '__main__':
    sys.exit(main())
