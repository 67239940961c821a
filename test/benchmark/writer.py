# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""
The bus of a benchmark: a process that writes prepared packets to a pty, on schedule.

It never waits for its reader: what is not taken while 4096 bytes are outstanding is an overrun.
Without a gap it hands over each millisecond what a UART would have received by then; with one it
writes packet by packet and waits busily, because a sleep of 100 us takes 150 to 200.
"""

from itertools import cycle
import json
from pathlib import Path
import sys
import time

from benchmark.traffic import packets
from benchmark.traffic import TRACE
from benchmark.traffic import trace_packets
from mecarover_fakes.line import wire_ns
from mecarover_fakes.virtual_uart import VirtualUart
from rigs.harness import print_json
from rigs.harness import quantile

TICK_S = 0.001
LATE_BYTES = 2048               # when this process is later than that, the bus stands still


def steady(outlet, traffic, baud):
    """Write without gaps; yield how long nothing was written (ns), after each write."""
    stream = b''.join(traffic)
    before = time.monotonic_ns()
    owed = at = 0
    while True:
        time.sleep(TICK_S)
        now = time.monotonic_ns()
        owed += (now - before) * baud
        count = min(owed // 10_000_000_000, LATE_BYTES)
        owed %= 10_000_000_000
        piece = stream[at:at + count]
        at = (at + len(piece)) % len(stream)
        outlet.write(piece)
        yield now - before
        before = now


def spaced(outlet, traffic, baud, gap):
    """Write packet by packet; yield the gap that there really was on the line (ns)."""
    end = time.monotonic_ns()
    for packet in cycle(traffic):
        due = end + gap
        while (now := time.monotonic_ns()) < due:
            pass
        outlet.write(packet)
        yield now - end
        end = now + wire_ns(len(packet), baud)


def _write_for(seconds, gaps):
    begin = time.monotonic_ns()
    end = begin + round(seconds * 1e9)
    taken = []
    for gap in gaps:
        taken.append(gap)
        if (now := time.monotonic_ns()) >= end:
            return (now - begin) * 1e-9, taken
    raise AssertionError('traffic is endless')


def main():
    order = json.loads(sys.stdin.readline())
    traffic = trace_packets(Path(order['trace'])) if order['kind'] == TRACE else \
        packets(order['kind'], devices=tuple(order['devices']))
    outlet = VirtualUart()
    print_json({'port': outlet.path})
    duration = json.loads(sys.stdin.readline())
    baud, gap = order['baud'], order['gap_us'] * 1000
    gaps = spaced(outlet, traffic, baud, gap) if gap else steady(outlet, traffic, baud)
    _write_for(duration['settle'], gaps)
    before = outlet.totals()
    print_json({'measuring': True})
    seconds, taken = _write_for(duration['seconds'], gaps)
    after = outlet.totals()
    print_json({
        'seconds': seconds, 'gap_us': [quantile(taken, share) / 1000 for share in (0.5, 0.99)],
        **{name: after[name] - before[name] for name in after}})
    sys.stdin.readline()        # the port stays until the other end has said all it knows


if __name__ == '__main__':
    main()
