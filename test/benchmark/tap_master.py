# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""A master that uses pyserial and knows nothing of a tap; usage: tap_master.py PORT."""

from statistics import median
import sys
from time import perf_counter_ns

import serial

from rigs.harness import print_json

PACKET = bytes.fromhex('fffffd0001030001194e')


def main(path):
    """For each number that comes write and read so many packets; say the median times (us)."""
    with serial.Serial(path, 1_000_000, timeout=5.0) as port:
        print_json({'open': True})
        for line in sys.stdin:
            print_json(_calls(port, int(line)))


def _calls(port, count):
    wrote, got = [], []
    for _ in range(count):
        before = perf_counter_ns()
        port.write(PACKET)
        between = perf_counter_ns()
        port.read(len(PACKET))                 # it is there already
        behind = perf_counter_ns()
        wrote.append(between - before)
        got.append(behind - between)
    return {'write': median(wrote) / 1e3, 'read': median(got) / 1e3}


if __name__ == '__main__':
    main(*sys.argv[1:])
