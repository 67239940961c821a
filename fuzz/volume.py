# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""
python -m fuzz.volume --bytes N: N bytes of hostile input through framer, tracker and report.

On a bus of Protocol 2.0 and on one with `protocols` auto: random bytes, bytes that look like
headers and lengths, and the traffic of robots (or --trace FILE) with bytes lost, turned, doubled
and torn apart. Exit code 1 when an exception comes, a byte is counted twice or not at all, memory
grows, more false packets pass a checksum than chance lets pass, or the monitor of `auto` shows a
device that is not on that bus. A candidate is what looks like a frame and was not sent; if its
checksum is right it is a false packet. Of candidates, one of 65536 passes the CRC of 2.0, one of
256 the sum of the 1.0 family; that is counted with a framer alone, as the monitor wants more
evidence.
"""

import argparse
from functools import partial
import math
from pathlib import Path
import random
import re
import sys
import time

from benchmark.traffic import KINDS_1
from benchmark.traffic import packets
from benchmark.traffic import packets_1
from benchmark.traffic import trace_packets
from dxl_monitor.bus.decoder import BusDecoder
from dxl_monitor.bus.decoder import Settings
from dxl_monitor.model.models import Models
from dxl_monitor.monitor import Monitor
from fuzz.framer import Watched
from fuzz.framer import Watched1
from fuzz.script import TRICKY
from fuzz.script import TRICKY_1
from mecarover_serial.process import resident_memory_mb
from msg_defs import dxl1_packet
from msg_defs.dxl_mixed import MixedFramer
from msg_defs.dxl_packet import HEADER
from msg_defs.frame import is_good

BLOCK = 1 << 18
GROWTH_MB = 30.0                    # more resident memory, from the first block on
CANDIDATE = re.compile(rb'(?=\xff\xfd\x00(.(..)))', re.DOTALL)
FEETECH, = (kind for kind, (dialect, _) in KINDS_1.items() if dialect == 'feetech')
PING = b'\x01\x02\x01'              # which two pieces of TRICKY_1 make when they meet
BYTE_NS = 10_000


def random_bytes(chance):
    return chance.randbytes(BLOCK)


def look_alikes(tricky, header, longest, end, chance):
    """Headers with small lengths, runs of what headers are made of, and what is between."""
    out = bytearray()
    while len(out) < BLOCK:
        out += chance.choice(tricky)
        if chance.random() < 0.5:
            out += header + bytes([chance.randrange(256), chance.randrange(longest)]) + end
        out += chance.randbytes(chance.randrange(12))
    return bytes(out)


def mutated(traffic, chance):
    out = bytearray()
    while len(out) < BLOCK:
        packet = chance.choice(traffic)
        out += packet if chance.random() < 0.9 else _damaged(chance, packet)
    return bytes(out)


def _damaged(chance, packet):
    at, bit = chance.randrange(len(packet)), 1 << chance.randrange(8)
    return chance.choice((
        packet[:at] + packet[at + 1:], packet[:at],
        packet[:at] + bytes([packet[at] ^ bit]) + packet[at + 1:],
        packet[:at] + chance.randbytes(chance.randrange(8)) + packet[at:], packet + packet))


class Bus2:
    """A bus of Protocol 2.0: what its framer finds good."""

    one_of = 65536

    def __init__(self, sent):
        self.decoder = BusDecoder(Models())
        self.decoder.framer = self.framer = Watched()
        self.sent = {one for piece in [*sent, b''.join(sent)] for one in good_in(piece)}
        self.tried = self.by_chance = 0

    def look_at(self, block):
        self.tried += candidates(block, self.sent)

    def take(self, chunk):
        """Count the packets since the last chunk; return those that were not sent."""
        false = sum(frame[2:6] not in self.sent for frame in self.framer.good)
        self.by_chance += false
        return len(self.framer.good), false

    def counted(self):
        return self.framer.accounted + self.framer.noise_bytes + self.framer.pending

    def found(self):
        return self.framer.packets


class Claiming(MixedFramer):
    """The framer of both families; it keeps what was claimed to be a packet of the 1.0 family."""

    def __init__(self, family):
        super().__init__(family)
        self.good = []

    def claim(self, frame):
        super().claim(frame)
        self.good.append(content(frame))


class BusAuto:
    """A bus with `protocols` auto: what is claimed of the 1.0 family, and what a framer alone."""

    one_of = 256

    def __init__(self, sent):
        self.decoder = BusDecoder(Models(), Settings(baud=10**10 // BYTE_NS))
        self.decoder.framer = self.framer = Claiming(self.decoder.detector)
        alone = Watched1()
        alone.frames(b''.join(sent))
        alone.flush_frames()
        self.sent = {PING, *map(content, alone.good)}
        self.tried = self.by_chance = 0
        self._alone = Watched1()

    def look_at(self, block):
        pass

    def take(self, chunk):
        for frame in self._alone.frames(chunk):
            by_chance = is_good(frame) and content(frame) not in self.sent
            self.by_chance += by_chance
            self.tried += by_chance or (not is_good(frame) and frame[6].reason != 'length')
        return len(self.framer.good), sum(one not in self.sent for one in self.framer.good)

    def counted(self):
        return self.framer.packet_bytes + self.framer.noise_bytes + self.framer.pending

    def found(self):
        return self.framer.claimed


def main():
    options = _parser().parse_args()
    of_2 = trace_packets(options.trace) if options.trace else packets('moving robot')
    of_1 = packets_1(FEETECH)
    alike = partial(look_alikes, TRICKY, HEADER, 40, b'\0')
    alike_1 = partial(look_alikes, TRICKY_1, dxl1_packet.HEADER, 12, b'')
    kinds = (       # name, kind of bus, what makes the bytes, packets of it that are sent, IDs
        ('2.0, random', Bus2, random_bytes, of_2, None),
        ('2.0, look-alikes', Bus2, alike, of_2, None),
        ('2.0, mutated traffic', Bus2, partial(mutated, of_2), of_2, None),
        ('auto, random', BusAuto, random_bytes, (), set()),
        ('auto, look-alikes', BusAuto, alike_1, (), set()),
        ('auto, mutated 2.0', BusAuto, partial(mutated, of_2), (), {one[4] for one in of_2}),
        (f'auto, mutated {FEETECH}', BusAuto, partial(mutated, of_1), of_1,
         {one[2] for one in of_1}))
    failed = False
    for name, kind, make, sent, there in kinds:
        begin, bus = time.process_time(), kind(sent)
        found = run(make, options.bytes // len(kinds), random.Random(options.seed), bus)
        expected = bus.tried / bus.one_of
        made_up = sorted(found['devices'] - there) if there is not None else []
        print(f'{name:22} {found["bytes"]:>11,} B  right checksums by chance {bus.by_chance} '
              f'({expected:.1f} expected of {bus.tried:,} candidates), {found["packets"]:,} '
              f'packets, {found["false"]} false, devices made up {made_up}, memory '
              f'{found["growth_mb"]:+.1f} MB, {time.process_time() - begin:.0f} s CPU', flush=True)
        failed |= bool(made_up) or found['growth_mb'] > GROWTH_MB \
            or bus.by_chance > limit(expected)
    return int(failed)


def limit(expected):
    """Return what chance hardly ever exceeds."""
    return expected + 5 * math.sqrt(expected) + 3


def candidates(block, sent):
    """Count what the Framer may take for a frame and is nothing that was sent."""
    found = 0
    for one in CANDIDATE.finditer(block):
        length = int.from_bytes(one[2], 'little')
        found += (2 < length <= 1024
                  and block[one.start(1):one.start(1) + length + 1] not in sent)
    return found


def good_in(stream):
    """Return the packets of a stream: from the ID to the last parameter, and as frames say it."""
    framer = Watched()
    framer.frames(stream)
    framer.flush_frames()
    return [one for frame in framer.good
            for one in (stream[frame[0] + 4:frame[1] - 2], frame[2:6])]


def content(frame):
    """Return ID, LEN, code and parameters of a packet of the 1.0 family, as on the wire."""
    return dxl1_packet.content(*frame[3:6])


def chunks(chance, block):
    """Yield a block in chunks of 1 to 4096 bytes."""
    at = 0
    while at < len(block):
        size = chance.choice((chance.randrange(1, 64), 512, 4096))
        yield block[at:at + size]
        at += size


def run(make, size, chance, bus):
    """Feed so many bytes in chunks of all sizes; check the accounts at every chunk."""
    monitor, framer = Monitor('bus', Models(), decoder=bus.decoder), bus.framer
    total, packets_found, false, memory = 0, 0, 0, None
    while total < size:
        block = make(chance)
        bus.look_at(block)
        for chunk in chunks(chance, block):
            total += len(chunk)
            monitor.feed(chunk, 1_000_000_000 + BYTE_NS * total)
            assert framer.bytes == total == bus.counted(), (total, bus.counted())
            some, wrong = bus.take(chunk)
            packets_found += some
            false += wrong
            framer.good.clear()
        report = monitor.report(1_000_000_000 + BYTE_NS * total)
        memory = memory or resident_memory_mb()
    assert bus.found() == packets_found
    return {'bytes': total, 'packets': packets_found, 'false': false,
            'devices': {device.id for device in report.devices},
            'growth_mb': resident_memory_mb() - memory}


def _parser():
    parser = argparse.ArgumentParser(prog='python -m fuzz.volume', description=(
        'Feed hostile bytes through framer, tracker and report, and count what comes out.'))
    add = parser.add_argument
    add('--bytes', type=int, default=7_000_000, help='in all (default %(default)s)')
    add('--seed', type=int, default=1, help='(default %(default)s)')
    add('--trace', type=Path, metavar='FILE', help='raw bytes of a real bus, to mutate')
    return parser


if __name__ == '__main__':
    sys.exit(main())
