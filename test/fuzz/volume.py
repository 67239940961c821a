# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""
scripts/python -m fuzz.volume --bytes N: N bytes of hostile input on a bus with `protocols` auto.

Random bytes, bytes that look like headers and lengths, and the traffic of robots with bytes lost,
turned, doubled and torn apart. Exit code 1 when an exception comes, a byte is counted twice or not
at all, memory grows, or the monitor shows a device that is not on that bus.
"""

import argparse
from functools import partial
import random
import sys
import time

from benchmark.traffic import packets
from benchmark.traffic import packets_1
from fuzz.script import TRICKY_1
from mecarover_serial.process import resident_memory_mb
from msg_defs.dxl1_packet import HEADER
from rigs.damage import cut_end
from rigs.damage import flip_bit
from rigs.damage import lose_byte
from rigs.damage import replace_bytes
from servobus.bus.decoder import BusDecoder
from servobus.bus.decoder import Settings
from servobus.model.models import Models
from servobus.monitor import Monitor

BLOCK = 1 << 18
GROWTH_MB = 30.0                    # more resident memory, from the first block on
BYTE_NS = 10_000
DAMAGES = (flip_bit, lose_byte, replace_bytes, cut_end, lambda chance, packet: packet + packet)


def random_bytes(chance):
    return chance.randbytes(BLOCK)


def look_alikes(chance):
    """Headers with small lengths, runs of what headers are made of, and what is between."""
    out = bytearray()
    while len(out) < BLOCK:
        out += chance.choice(TRICKY_1)
        if chance.random() < 0.5:
            out += HEADER + bytes([chance.randrange(256), chance.randrange(12)])
        out += chance.randbytes(chance.randrange(12))
    return bytes(out)


def mutated(traffic, chance):
    out = bytearray()
    while len(out) < BLOCK:
        packet = chance.choice(traffic)
        out += packet if chance.random() < 0.9 else chance.choice(DAMAGES)(chance, packet)
    return bytes(out)


def main():
    options = _parser().parse_args()
    of_2, of_1 = packets('moving robot'), packets_1('Feetech')
    kinds = (       # name, what makes the bytes, IDs of the devices
        ('random', random_bytes, set()), ('look-alikes', look_alikes, set()),
        ('mutated 2.0', partial(mutated, of_2), {one[4] for one in of_2}),
        ('mutated Feetech', partial(mutated, of_1), {one[2] for one in of_1}))
    failed = False
    for name, make, there in kinds:
        begin = time.process_time()
        size, shown, growth_mb = run(make, options.bytes // len(kinds),
                                     random.Random(options.seed))
        made_up = sorted(shown - there)
        print(f'{name:16} {size:>11,} B, devices made up {made_up}, memory {growth_mb:+.1f} MB, '
              f'{time.process_time() - begin:.0f} s CPU', flush=True)
        failed |= bool(made_up) or growth_mb > GROWTH_MB
    return int(failed)


def run(make, size, chance):
    """Feed so many bytes in chunks of all sizes; return how many, the devices, more memory."""
    decoder = BusDecoder(Models(), Settings(baud=10**10 // BYTE_NS))
    monitor, framer = Monitor('bus', Models(), decoder=decoder), decoder.framers['']
    total, memory = 0, None
    while total < size:
        block = make(chance)
        while block:
            chunk = block[:chance.choice((chance.randrange(1, 64), 512, 4096))]
            block = block[len(chunk):]
            total += len(chunk)
            monitor.feed(chunk, 1_000_000_000 + BYTE_NS * total)
            assert framer.bytes == total
            assert framer.packet_bytes + framer.noise_bytes + framer.pending == total
        report = monitor.report(1_000_000_000 + BYTE_NS * total)
        memory = memory or resident_memory_mb()
    return total, {device.id for device in report.devices}, resident_memory_mb() - memory


def _parser():
    parser = argparse.ArgumentParser(prog='scripts/python -m fuzz.volume', description=(
        'Feed hostile bytes through framer, tracker and report, and count what comes out.'))
    parser.add_argument('--bytes', type=int, default=7_000_000, help='(default %(default)s)')
    parser.add_argument('--seed', type=int, default=1, help='(default %(default)s)')
    return parser


if __name__ == '__main__':
    sys.exit(main())
