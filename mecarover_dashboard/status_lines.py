# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""
What is known to the lines of mecarover_status: per bridge, bus and device.

Pure; times are monotonic seconds of arrival.
"""
from __future__ import annotations

from collections.abc import Container
from collections.abc import Iterator
from itertools import groupby
from typing import NamedTuple

from mecarover_dashboard import rows
from mecarover_dashboard.robot_parts import level_of
from mecarover_dashboard.robot_parts import place_of
from mecarover_dashboard.state import RowReport
from mecarover_dashboard.state import State
from msg_defs.diagnostics import CONNECTED
from msg_defs.diagnostics import Level
from msg_defs.diagnostics import SEVERITY
from msg_defs.diagnostics import worst
from servobus.printable_text import printable

HEALTHY, NOTHING, WARNING, FAILED = 0, 1, 3, 4      # exit codes; 2 is wrong usage
_CODES = {Level.OK: HEALTHY, Level.WARN: WARNING, Level.STALE: WARNING, Level.ERROR: FAILED}
_WORDS = {Level.OK: 'ok', Level.WARN: 'WARN', Level.ERROR: 'ERROR', Level.STALE: 'silent'}


class StatusLine(NamedTuple):
    """One line: level, robot ('' at the root), what it is about, what to act on."""

    level: Level
    robot: str
    what: str
    message: str

    def text(self, robot_width: int, what_width: int) -> str:
        """Return the line with its columns so wide; the robot is left out at width 0."""
        robot = f'{self.robot:{robot_width}}  ' if robot_width else ''
        return f'{_WORDS[self.level]:6}  {robot}{self.what:{what_width}}  {self.message}'


def status_lines(state: State, now_s: float,
                 every_device: bool | None = False) -> list[StatusLine]:
    """
    Return the lines: the worst robot first, and of each robot what is worst.

    every_device: also those that are well; None: no device.
    """
    state.expire(now_s)
    found = sorted((line._replace(robot=printable(line.robot, 40), what=printable(line.what, 60))
                    for line in _lines(state, now_s, every_device)), key=lambda line: line.robot)
    robots = [sorted(some, key=_urgency) for _, some in groupby(found, lambda line: line.robot)]
    return [line for some in sorted(robots, key=lambda some: _urgency(some[0])) for line in some]


class DeviceLine(NamedTuple):
    """A device with its values, as text; '' is not known. Without any, its model is shown."""

    level: Level
    name: str
    model: str
    values: tuple[str, ...]             # in the order of VALUE_COLUMNS
    cause: str

    def text(self, name_width: int) -> str:
        *cells, loss = (f'  {value or "-":>{width}}' for value, (_, width) in zip(
            self.values, VALUE_COLUMNS, strict=True))
        values = ''.join(cells)
        if not any(self.values[:-1]):
            values = f'  {self.model[:len(values) - 2]:{len(values) - 2}}'
        name = self.name if len(self.name) <= name_width else f'{self.name[:name_width - 1]}\u2026'
        return f'{_WORDS[self.level]:6}  {name:{name_width}}{values}{loss}'


INDENT = ' ' * 8             # second and further rows
VALUE_COLUMNS = (('rad', 7), ('\u00b0C', 3), ('V', 5), ('load', 7), ('loss %', 6))
SORTS = {'w': 'worst first', 'i': 'ID', 'p': 'position', 't': 'temperature', 'v': 'voltage',
         'l': 'load', 'm': 'missed'}
_VALUES = 'ptvlm'                       # the columns, by the key that sorts by them


def table(state: State, now_s: float, sort: str = 'w', width: int = 200,
          left_out: Container[str] = ()) -> list[str]:
    """
    Return a heading and a line for each device, in an order of SORTS; nothing for none.

    A state that does not fit into `width` is after a line feed.
    """
    found = [_device_line(report, now_s) for report in state.reports('devices')
             if report.row_name not in left_out]
    if not found:
        return []
    found.sort(key=lambda line: line.name)
    if sort in _VALUES:
        at = _VALUES.index(sort)
        found.sort(key=lambda line: -abs(rows.finite(line.values[at].partition(' ')[0]) or 0.0))
    elif sort == 'w':
        found.sort(key=lambda line: -SEVERITY.index(line.level))
    heads = ''.join(f'  {name:>{size}}' for name, size in VALUE_COLUMNS)
    names = min(max(len(line.name) for line in found), max(8, width - len(INDENT + heads)))
    return [_joined(f'{INDENT}{"device":{names}}{heads}', f'state ({SORTS[sort]})', width),
            *(_joined(line.text(names), line.cause, width) for line in found)]


def _joined(line: str, cause: str, width: int) -> str:
    if len(line) + 2 + len(cause) <= width:
        return f'{line}  {cause}'
    return line if cause == CONNECTED else f'{line}\n{INDENT}{cause}'


def _device_line(report: RowReport, now_s: float) -> DeviceLine:
    row, values = report.row, report.values.calm()
    load = f'{rows.rounded(values.load, 2)} {values.unit}'.strip()
    position = values.position
    if values.position_unit != 'rad':
        position = f'{position} {values.position_unit}'.strip()
    name = '/'.join(filter(None, (row['robot'], rows.split_name(report.row_name)[1])))
    return DeviceLine(level_of(row), printable(name, 40), row['model'], (
        position, values.temperature, values.voltage, load,
        '' if 'quiet_since' in row else row['loss']), _message(row, now_s))


def _message(row: rows.Row, now_s: float) -> str:
    if 'quiet_since' not in row:
        return str(row['message'])
    return f'no report for {now_s - row["quiet_since"]:.0f} s; last: {row["message"]}'


def _lines(state: State, now_s: float, every_device: bool | None) -> Iterator[StatusLine]:
    hiding = set()
    for part in state.parts():
        yield StatusLine(part.level, part.robot, part.name, part.sentence(now_s))
        if part.hides_devices:
            hiding.add(part.place)
    for report in () if every_device is None else state.reports('devices'):
        row, level = report.row, level_of(report.row)
        is_shown_above = level is Level.OK or place_of(row) in hiding
        if every_device or not is_shown_above:
            yield StatusLine(level, row['robot'], rows.split_name(report.row_name)[1],
                             _message(row, now_s))


def _urgency(line: StatusLine) -> int:
    return -SEVERITY.index(line.level)


def exit_code(state: State) -> int:
    """Return the exit code: 0 well, 1 nothing heard, 3 warning, 4 error."""
    levels = [*(part.level for part in state.parts()),
              *(level_of(report.row) for report in state.reports('devices'))]
    return _CODES[worst(levels)] if levels else NOTHING


def screen(lines: list[StatusLine]) -> list[str]:
    """Return the lines as text, their columns in line; the robot only where one has a name."""
    robots = max((len(line.robot) for line in lines), default=0)
    what = max((len(line.what) for line in lines), default=0)
    return [line.text(robots, what) for line in lines]
