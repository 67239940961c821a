# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""
How many calls, and changes from file to file, one packet and one report take.

A person who follows a packet reads these files in this order. `back`: how often a call goes into a
file that was left before. Packets of a robot that moves, once it is known; of each kind of packet
(it takes the same calls) one line, and how many there were.
usage: python -m benchmark.calls [--list TEXT]
"""

import argparse
from collections import Counter
from pathlib import Path
import sys
from typing import NamedTuple

from benchmark.traffic import BAUD
from benchmark.traffic import BAUD_1
from benchmark.traffic import packets
from benchmark.traffic import packets_1
from dxl_monitor.bus.decoder import Settings
from dxl_monitor.model.models import Models
from dxl_monitor.monitor import Monitor
from mecarover_serial.cli import run_tool
from rigs.harness import REPOSITORY

KNOWN_AFTER = 500                  # packets
COUNTED = 200
GAP_NS = 300_000
NAME_WIDTH = 40


class Calls(NamedTuple):
    """The functions of this repository that were called, in order: file and name."""

    made: tuple[tuple[str, str], ...]

    @property
    def files(self):
        """Return the files in order, each as often as a call goes from another one into it."""
        names = [file for file, _ in self.made]
        return [name for before, name in zip(['', *names], names, strict=False) if name != before]

    def __str__(self):
        files = self.files
        return (f'{len(self.made):5} calls {len(files) - 1:5} changes {len(set(files)):5} files '
                f'{len(files) - len(set(files)):5} back')


def calls_of(function):
    """Return what a call leads to."""
    made = []

    def hook(frame, event, _):
        path = Path(frame.f_code.co_filename)
        if event == 'call' and path.is_relative_to(REPOSITORY) and path != Path(__file__):
            made.append((path.relative_to(REPOSITORY).as_posix(), frame.f_code.co_name))

    sys.setprofile(hook)
    try:
        function()
    finally:
        sys.setprofile(None)
    return Calls(tuple(made))


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


def main(arguments):
    options = _parser().parse_args(arguments)
    count = KNOWN_AFTER + COUNTED
    rows = {
        '2.0, protocols auto': (packets('moving robot', count), Settings(baud=BAUD)),
        'Feetech, protocols auto': (packets_1('Feetech', count), Settings(baud=BAUD_1)),
        'Feetech, protocols feetech': (packets_1('Feetech', count),
                                       Settings(baud=BAUD_1, protocol='feetech')),
        '1.0, protocols auto': (packets_1('Protocol 1.0', count), Settings(baud=BAUD_1)),
    }
    for name, (pieces, settings) in rows.items():
        for calls, times in of_packets(pieces, settings).most_common():
            print(f'{name:28}{calls}  x {times}')
            _list(name, calls, options.list)
    report = of_a_report()
    print(f'{"report of one device":28}{report}')
    _list('report of one device', report, options.list)


def _list(name, calls, wanted):
    if wanted is not None and wanted in name:
        for file, function in calls.made:
            print(f'    {file:{NAME_WIDTH}} {function}')


def _parser():
    parser = argparse.ArgumentParser(prog='python -m benchmark.calls', description=(
        'Count the calls and the changes of file of one packet, and of one report.'))
    parser.add_argument('--list', metavar='TEXT', help='list the calls of rows with this in '
                        'their name')
    return parser


if __name__ == '__main__':
    sys.exit(run_tool('calls', main))
