# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""
python -m fuzz.volume_1 --bytes N: N bytes of hostile input on a bus with `protocols` auto.

A quarter each: random bytes, bytes that look like headers of the 1.0 family, the traffic of a
robot of Protocol 2.0 and that of one of Feetech, both with bytes lost, turned, doubled and torn
apart. Two readers: Dxl1Framer takes each right sum for a packet, and of what looks like a frame
and was not sent that is one of 256; the monitor wants more evidence. Exit code 1 when an exception
comes, a byte is counted twice or not at all, memory grows, Dxl1Framer finds more than chance
gives, or the monitor shows a device that is not on that bus.
"""

import argparse
import random
import sys
import time

from benchmark.traffic import KINDS_1
from benchmark.traffic import packets
from benchmark.traffic import packets_1
from dxl_monitor.bus.decoder import BusDecoder
from dxl_monitor.bus.decoder import Settings
from dxl_monitor.model.models import Models
from dxl_monitor.monitor import Monitor
from fuzz.framer_1 import TRICKY
from fuzz.volume import BLOCK
from fuzz.volume import chunks
from fuzz.volume import GROWTH_MB
from fuzz.volume import limit
from fuzz.volume import mutated
from fuzz.volume import random_bytes
from mecarover_serial.process import resident_memory_mb
from msg_defs import dxl1_packet
from msg_defs.dxl1_packet import Dxl1Framer
from msg_defs.dxl1_packet import HEADER
from msg_defs.dxl_mixed import MixedFramer
from msg_defs.frame import is_good

SUMS = 256                          # one of so many candidates has the right sum by chance
FEETECH, = (kind for kind, (dialect, _) in KINDS_1.items() if dialect == 'feetech')
PING = b'\x01\x02\x01'              # which two pieces of TRICKY make when they meet
BAUD = 1_000_000
BYTE_NS = 10_000


class Watched(MixedFramer):
    """The framer of both families; it keeps what was claimed to be a packet of the 1.0 family."""

    def __init__(self, family):
        super().__init__(family)
        self.good = []

    def claim(self, frame):
        super().claim(frame)
        self.good.append(content(frame))


def content(frame):
    """Return ID, LEN, code and parameters, as on the wire."""
    return dxl1_packet.content(*frame[3:6])


def good_in(stream):
    framer = Dxl1Framer()
    frames = framer.frames(stream) + framer.flush_frames()
    return [content(frame) for frame in frames if is_good(frame)]


def look_alikes(chance, _):
    """Headers with small LEN, runs of FF, and what is between."""
    out = bytearray()
    while len(out) < BLOCK:
        out += chance.choice(TRICKY)
        if chance.random() < 0.5:
            out += HEADER + bytes([chance.randrange(256), chance.randrange(12)])
        out += chance.randbytes(chance.randrange(12))
    return bytes(out)


def main():
    options = _parser().parse_args()
    of_2, of_1 = packets('moving robot'), packets_1(FEETECH)
    of_1_sent = set(good_in(b''.join(of_1)))
    kinds = {'random': (random_bytes, [], set()), 'look-alikes': (look_alikes, [], {PING}),
             'mutated 2.0': (mutated, of_2, set()),
             f'mutated {FEETECH}': (mutated, of_1, of_1_sent)}
    failed = False
    for kind, (make, traffic, sent) in kinds.items():
        begin = time.process_time()
        there = {packet[4 if traffic is of_2 else 2] for packet in traffic}
        found = run(make, options.bytes // len(kinds), random.Random(options.seed), traffic, sent)
        made_up = sorted(found['devices'] - there)
        print(f'{kind:16} {found["bytes"]:>11,} B  right sums by chance {found["by chance"]} '
              f'({found["tried"] / SUMS:.1f} expected of {found["tried"]:,} candidates), '
              f'{found["packets"]:,} packets of the 1.0 family, {found["false"]} false, '
              f'devices made up {made_up}, memory {found["growth_mb"]:+.1f} MB, '
              f'{time.process_time() - begin:.0f} s CPU', flush=True)
        failed |= bool(made_up) or found['growth_mb'] > GROWTH_MB \
            or found['by chance'] > limit(found['tried'] / SUMS)
    return int(failed)


def run(make, size, chance, traffic, sent):
    """Feed so many bytes in chunks of all sizes; check the accounts at every chunk."""
    decoder = BusDecoder(Models(), Settings(baud=BAUD))
    decoder.framer = framer = Watched(decoder.detector)
    monitor = Monitor('bus', Models(), decoder=decoder)
    alone = Dxl1Framer()
    total, packets_found, false, by_chance, tried, memory = 0, 0, 0, 0, 0, None
    while total < size:
        for chunk in chunks(chance, make(chance, traffic)):
            total += len(chunk)
            monitor.feed(chunk, 1_000_000_000 + BYTE_NS * total)
            counted = framer.packet_bytes + framer.noise_bytes + framer.pending
            assert framer.bytes == total == counted, (total, counted)
            packets_found += len(framer.good)
            false += sum(body not in sent for body in framer.good)
            framer.good.clear()
            for frame in alone.frames(chunk):
                if not is_good(frame):
                    tried += frame[6].reason != 'length'
                elif content(frame) not in sent:
                    by_chance += 1
                    tried += 1
        report = monitor.report(1_000_000_000 + BYTE_NS * total)
        memory = memory or resident_memory_mb()
    assert framer.claimed == packets_found
    return {'bytes': total, 'packets': packets_found, 'false': false, 'tried': tried,
            'by chance': by_chance, 'devices': {device.id for device in report.devices},
            'growth_mb': resident_memory_mb() - memory}


def _parser():
    parser = argparse.ArgumentParser(prog='python -m fuzz.volume_1', description=(
        'Feed hostile bytes to a bus whose protocol is not set, and count what comes out.'))
    add = parser.add_argument
    add('--bytes', type=int, default=4_000_000, help='in all (default %(default)s)')
    add('--seed', type=int, default=1, help='(default %(default)s)')
    return parser


if __name__ == '__main__':
    sys.exit(main())
