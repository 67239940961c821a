# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""
python -m fuzz.volume --bytes N: N bytes of hostile input through Framer, tracker and report.

A third each: random bytes, bytes that look like headers and lengths, and the traffic of a robot
(or --trace FILE) with bytes lost, turned, doubled and torn apart. Exit code 1 when an exception
comes, a byte is counted twice or not at all, memory grows, or more false packets are found than
the 16 bits of a CRC let pass: of 65536 candidates one. A false packet is one that was not sent, a
candidate what looks like a frame and is none of the packets that were sent.
"""

import argparse
import math
from pathlib import Path
import random
import re
import sys
import time

from benchmark.traffic import packets
from benchmark.traffic import trace_packets
from dxl_monitor.bus.decoder import BusDecoder
from dxl_monitor.model.models import Models
from dxl_monitor.monitor import Monitor
from fuzz.framer import Watched
from fuzz.script import TRICKY
from mecarover_serial.process import resident_memory_mb
from msg_defs.dxl_packet import HEADER

BLOCK = 1 << 18
GROWTH_MB = 30.0                    # more resident memory, from the first block on
CANDIDATE = re.compile(rb'(?=\xff\xfd\x00(.(..)))', re.DOTALL)


def random_bytes(chance, _):
    return chance.randbytes(BLOCK)


def look_alikes(chance, _):
    """Headers with small Lengths, runs of FF and FD, and what is between."""
    out = bytearray()
    while len(out) < BLOCK:
        out += chance.choice(TRICKY)
        if chance.random() < 0.5:
            out += HEADER + bytes([chance.randrange(256), chance.randrange(40), 0])
        out += chance.randbytes(chance.randrange(12))
    return bytes(out)


def mutated(chance, traffic):
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


KINDS = {'random': random_bytes, 'look-alikes': look_alikes, 'mutated traffic': mutated}


def main():
    options = _parser().parse_args()
    traffic = trace_packets(options.trace) if options.trace else packets('moving robot')
    sent = {one for piece in [*traffic, b''.join(traffic)] for one in good_in(piece)}
    failed = False
    for kind, make in KINDS.items():
        begin = time.process_time()
        found = run(make, options.bytes // len(KINDS), random.Random(options.seed), traffic, sent)
        print(f'{kind:16} {found["bytes"]:>11,} B  {found["packets"]:>9,} packets, '
              f'{found["false"]} false ({found["expected"]:.1f} expected of {found["tried"]:,} '
              f'candidates), memory {found["growth_mb"]:+.1f} MB, '
              f'{time.process_time() - begin:.0f} s CPU', flush=True)
        failed |= found['false'] > limit(found['expected']) or found['growth_mb'] > GROWTH_MB
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


def chunks(chance, block):
    """Yield a block in chunks of 1 to 4096 bytes."""
    at = 0
    while at < len(block):
        size = chance.choice((chance.randrange(1, 64), 512, 4096))
        yield block[at:at + size]
        at += size


def run(make, size, chance, traffic, sent):
    """Feed so many bytes in chunks of all sizes; check the accounts at every chunk."""
    decoder = BusDecoder(Models())
    decoder.framer = framer = Watched()
    monitor = Monitor('bus', Models(), decoder=decoder)
    now, total, false, packets_found, tried, memory = 1_000_000_000, 0, 0, 0, 0, None
    while total < size:
        block = make(chance, traffic)
        tried += candidates(block, sent)
        for chunk in chunks(chance, block):
            total += len(chunk)
            now += 5_000 * len(chunk)
            monitor.feed(chunk, now)
            packets_found += len(framer.good)
            in_counters = framer.accounted + framer.noise_bytes + framer.pending
            assert framer.bytes == total == in_counters, (total, in_counters)
            false += sum(frame[2:6] not in sent for frame in framer.good)
            framer.good.clear()
        monitor.report(now)
        memory = memory or resident_memory_mb()
    assert framer.packets == packets_found
    return {'bytes': total, 'packets': packets_found, 'false': false, 'tried': tried,
            'expected': tried / 65536, 'growth_mb': resident_memory_mb() - memory}


def _parser():
    parser = argparse.ArgumentParser(prog='python -m fuzz.volume', description=(
        'Feed hostile bytes through Framer, tracker and report, and count what comes out.'))
    add = parser.add_argument
    add('--bytes', type=int, default=3_000_000, help='in all (default %(default)s)')
    add('--seed', type=int, default=1, help='(default %(default)s)')
    add('--trace', type=Path, metavar='FILE', help='raw bytes of a real bus, to mutate')
    return parser


if __name__ == '__main__':
    sys.exit(main())
