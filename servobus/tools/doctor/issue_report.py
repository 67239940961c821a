# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""
The report of a run, to attach to an issue: text for people, a verdict and a capture for us.

It is made of parts, each after a line that begins with a mark. report_file.py reads it.
"""

from __future__ import annotations

from collections.abc import Sequence
import json
import os
from typing import Any
from typing import NamedTuple

from servobus.doctor.finding_log import BusSummary
from servobus.errors import UsageError
from servobus.plain import printable
from servobus.sources.opening import REPORT
from servobus.tools.doctor.answer_screen import screen
from servobus.tools.doctor.error_window import packed
from servobus.tools.doctor.verdict import as_json
from servobus.tools.doctor.verdict import Verdict

VERSION = 1
VERDICT, CAPTURE, END = '# verdict', '# capture', '# end'
_ABOUT = ('# Attach this file to an issue. `dxl_doctor FILE` shows it again.',
          '# It holds what is on the servo bus, and no host or user name, path, serial number or',
          '# command line, unless it was made with --with-host.')


NOTHING = ('no byte of a bus; the reasons that were shown name ports and programs, so they are '
           'not in a report')


class Maker(NamedTuple):
    """What a report says of the machine and the command line."""

    system: Sequence[str]
    adapters: Sequence[str]
    host: Sequence[str]                # what is personal; empty unless it was asked for
    devices: Sequence[str]             # as given by --devices
    protocol: str


def check_report(path: str | None) -> None:
    """Raise UsageError for a file that must not be written over."""
    if path is None:
        return
    folder = os.path.dirname(path) or '.'
    if not os.access(folder, os.W_OK):
        raise UsageError(f'--report {path}: cannot write to {folder}; give another name')
    if not os.path.exists(path):
        return
    if not os.path.isfile(path):
        raise UsageError(f'--report {path}: is not a file; give another name')
    with open(path, 'rb') as file:
        head = file.read(len(REPORT))
    if head and head != REPORT.encode():
        raise UsageError(f'--report {path}: exists and is not a report; give another name')


def anonymous(buses: Sequence[BusSummary]) -> list[BusSummary]:
    """Return buses with names that say nothing: a name may hold a path or a serial number."""
    names = new_names(buses)
    return [bus._replace(name=bus.name and names[bus.report.name],
                         report=bus.report._replace(name=names[bus.report.name]))
            for bus in buses]


def new_names(buses: Sequence[BusSummary]) -> dict[str, str]:
    """Return what each bus is called in a report."""
    return {bus.report.name: f'bus{number}' for number, bus in enumerate(buses, 1)}


def report(verdict: Verdict, buses: Sequence[BusSummary], seconds: float, maker: Maker,
           capture: bytes) -> str:
    """Return the text of a report; verdict and buses are those of the names in it."""
    stored = {'verdict': verdict._asdict(), 'json': as_json(verdict, buses, seconds),
              'devices': list(maker.devices), 'protocol': maker.protocol}
    lines = [f'{REPORT} {VERSION}', *_ABOUT, '', *screen(verdict, height=1000), '', 'System:']
    lines += [f'  {printable(text)}' for text in (*maker.system, *maker.adapters, *maker.host)]
    for bus in buses:
        lines += ['', *_figures(bus)]
    lines += ['', VERDICT, json.dumps(stored), '', CAPTURE, *packed(capture), END]
    return '\n'.join(lines) + '\n'


def _figures(bus: BusSummary) -> list[str]:
    counted: dict[str, Any] = bus.report.counters
    lines = [f'{bus.report.name}: {bus.report.baud} baud; '
             + ', '.join(f'{name} {count}' for name, count in counted.items() if count)]
    for device in bus.report.devices:
        totals = ', '.join(f'{name} {count}' for name, count in device.totals.published().items()
                           if count)
        firmware = '' if device.firmware is None else f', firmware {device.firmware}'
        lines.append(f'  {printable(device.name)} {device.model_name}{firmware}, {device.state}: '
                     f'{totals}')
    return lines
