# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""
How many calls, and changes from file to file, one packet and one report take.

`back`: how often a call goes into a file that was left before. Packets of a robot that moves, once
it is known; of each kind of packet (it takes the same calls) one line, and how many there were.
usage: python -m benchmark.calls
"""

from collections import Counter
from itertools import groupby
from pathlib import Path
import sys

from benchmark.traffic import BAUD
from benchmark.traffic import BAUD_1
from benchmark.traffic import packets
from benchmark.traffic import packets_1
from dxl_monitor.bus.decoder import Settings
from dxl_monitor.model.models import Models
from dxl_monitor.monitor import Monitor
from rigs.harness import REPOSITORY

KNOWN_AFTER = 500                  # packets
COUNTED = 200
GAP_NS = 300_000


def calls_of(function):
    """Return the files of this repository that a call leads into, one for each call."""
    made = []

    def hook(frame, event, _):
        path = Path(frame.f_code.co_filename)
        if event == 'call' and path.is_relative_to(REPOSITORY) and path != Path(__file__):
            made.append(path.relative_to(REPOSITORY))

    sys.setprofile(hook)
    try:
        function()
    finally:
        sys.setprofile(None)
    return tuple(made)


def line(calls):
    """Count calls, changes from file to file, and files."""
    changes, files = len([*groupby(calls)]) - 1, len(set(calls))
    return (f'{len(calls):5} calls {changes:5} changes {files:5} files '
            f'{changes + 1 - files:5} back')


def of_packets(pieces, settings):
    """Return the calls of each packet, and how many have the same; the monitor is warm."""
    monitor = Monitor('bus', Models(), settings)
    now = 1_000_000_000
    found = Counter()
    for number, piece in enumerate(pieces):
        now += GAP_NS + len(piece) * 10_000_000_000 // settings.baud
        if number < KNOWN_AFTER:
            monitor.feed(piece, now)
        else:
            found[calls_of(lambda piece=piece, now=now: monitor.feed(piece, now))] += 1
    return found


def of_a_report():
    """Return the calls of one report of a bus with one device."""
    monitor = Monitor('bus', Models(), Settings(baud=BAUD))
    pieces = packets('read/write', KNOWN_AFTER, ('1:MX-64',))
    for number, piece in enumerate(pieces, 1):
        monitor.feed(piece, number * 1_000_000)
    now = (len(pieces) + 300) * 1_000_000
    monitor.report(now)
    return calls_of(lambda: monitor.report(now + 500_000_000))


def main():
    count = KNOWN_AFTER + COUNTED
    for name, pieces, protocol in (('2.0', packets('moving robot', count), 'auto'),
                                   ('Feetech', packets_1('Feetech', count), 'auto'),
                                   ('Feetech', packets_1('Feetech', count), 'feetech'),
                                   ('1.0', packets_1('Protocol 1.0', count), 'auto')):
        settings = Settings(baud=BAUD if name == '2.0' else BAUD_1, protocol=protocol)
        for calls, times in of_packets(pieces, settings).most_common():
            print(f'{name}, protocols {protocol}'.ljust(28) + f'{line(calls)}  x {times}')
    print('report of one device'.ljust(28) + line(of_a_report()))


if __name__ == '__main__':
    main()
