# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""
The receiver of firmware/ and its reader in Python, on one line.

usage: scripts/python -m fuzz.firmware --bytes N

The C source runs with sanitizers (rigs/mcu/host.c); the other is GuardedReceiver. They hear
frames that are good, damaged, cut, joined, of another CRC, or not allowed, and noise, with pauses.
Exit code 1 unless they say the same of each byte (whether it ends a frame, and which), of each
turn of the wheels and in each report, and take no frame that was not sent.
"""

import argparse
from pathlib import Path
import struct
import subprocess
import sys
import tempfile

from mecarover_fakes.guarded_receiver import GuardedReceiver
from msg_defs.crc import CRC_BY_INPUT
from rigs.mcu.host import compiled
from rigs.mcu.host import HERE

MS = 1_000_000
BAUD = 10**10                       # a byte takes a ns: all of a piece come in the same ms
STATES = ('waiting', 'running', 'stopped')
HEADER = struct.Struct('<cII')


def records(stream):
    while header := stream.read(HEADER.size):
        what, number, size = HEADER.unpack(header)
        yield what, number, stream.read(size)


def verdicts(reader, what, ms, data):
    """Return the records that the reader in Python would write; in C they follow this one."""
    if what == b'B':
        begin = max(ms * MS, reader.line_free)
        reader.feed(data, begin)
        reader.advance(reader.line_free)
        found = [(b'F', one.stamp - begin - 1, struct.pack('<3d', *one.velocity))
                 for one in reader.arrivals]
        reader.arrivals.clear()
        totals = reader.totals
        return [*found, (b'C', 0, struct.pack('<2I', totals.crc_err, totals.refused))]
    if what == b'N':
        reader.advance(ms * MS)
        _, x, y, omega = reader.wheels              # mm/s
        return [(b'W', ms, struct.pack('<3d2I', x / 1000, y / 1000, omega,
                                       STATES.index(reader.state), reader.totals.stops))]
    return [(b'T', ms, reader.text_to_host(ms * MS).encode())]


def main():
    parser = argparse.ArgumentParser(
        prog='scripts/python -m fuzz.firmware',
        description='Compare the receiver of firmware/ with its reader in Python.')
    parser.add_argument('--bytes', type=int, default=1_000_000, help='(default %(default)s)')
    parser.add_argument('--seed', type=int, default=1, help='(default %(default)s)')
    options = parser.parse_args()
    with tempfile.TemporaryDirectory(prefix='firmware_') as folder:
        program = compiled(Path(folder), HERE / 'host.c')
        with subprocess.Popen([program, str(options.bytes), str(options.seed)],
                              stdout=subprocess.PIPE) as process:
            return compare(records(process.stdout))


def compare(said):
    for what, number, data in said:
        if what == b'E':
            print(f'{data.decode()}; the same verdicts in C and Python')
            return int(number > 0)
        if what == b'S':
            reader = GuardedReceiver(
                baud=BAUD, crc=CRC_BY_INPUT['words' if number else 'bytes'])
            continue
        for mine in verdicts(reader, what, number, data):
            other = next(said)
            assert other == mine, f'{what} {number}: {other} in C, {mine} in Python'
    return 1                        # it ended too early, and has said why


if __name__ == '__main__':
    sys.exit(main())
