# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""
Statuses to the lines of mecarover_status: one per bridge, per bus and per sick device.

Pure; times are monotonic seconds of arrival. What is not a status of ours is left out.
"""
from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

from mecarover_dashboard import rows
from mecarover_dashboard.cdr import CdrError
from mecarover_dashboard.cdr import RawStatus
from mecarover_dashboard.cdr import statuses
from mecarover_serial.plain import printable
from msg_defs.reports import Level
from msg_defs.reports import worst

QUIET_S = 4.0                   # reports come once a second
FORGET_S = 60.0                 # a status that stays away while its node reports is no more
MOST_NAMES = 3000               # what is published cannot fill the memory
HEALTHY, NOTHING, WARNING, FAILED = 0, 1, 3, 4      # exit codes; 2 is wrong usage
_CODES = {Level.OK: HEALTHY, Level.WARN: WARNING, Level.STALE: WARNING, Level.ERROR: FAILED}
_WORDS = {Level.OK: 'ok', Level.WARN: 'WARN', Level.ERROR: 'ERROR', Level.STALE: 'silent'}
_ORDER = {'bridge': 0, 'buses': 1, 'devices': 2}


class _LastStatus(NamedTuple):
    """What a status said last; `what` is the column that names it."""

    section: str
    node: str
    robot: str
    what: str
    level: Level
    message: str
    arrived: float


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


class Board:
    """
    The newest status of each name; one thread uses it.

    In a `namespace` only the robots below it count. `changed` is when the last new name came.
    """

    def __init__(self, namespace: str = '', every_device: bool = False) -> None:
        self.changed = 0.0
        self.namespace = namespace
        self._every_device = every_device
        self._heard: dict[str, _LastStatus] = {}

    def take(self, message: bytes, now_s: float) -> None:
        """Take a serialised DiagnosticArray; nothing raises."""
        try:
            found = statuses(message)
        except CdrError:
            return
        for status in found:
            section = rows.section(status)
            if section in _ORDER and self._is_ours(status) and (
                    status.name in self._heard or len(self._heard) < MOST_NAMES):
                if status.name not in self._heard:
                    self.changed = now_s
                self._heard[status.name] = _heard(section, status, now_s)

    def _is_ours(self, status: RawStatus) -> bool:
        return not self.namespace or status.name.startswith(f'{self.namespace}/')

    def lines(self, now_s: float) -> list[StatusLine]:
        """Return the lines, by robot, then bridge, buses and devices."""
        self._forget(now_s)
        shown = [one for one in _one_per_bridge(list(self._judged(now_s)))
                 if one.section != 'devices' or self._every_device or one.level is not Level.OK]
        shown.sort(key=lambda one: (one.robot, _ORDER[one.section], one.what))
        return [StatusLine(one.level, printable(one.robot, 40), printable(one.what, 60),
                           printable(one.message)) for one in shown]

    def code(self, now_s: float) -> int:
        """Return the exit code: 0 well, 1 nothing heard, 3 warning, 4 error."""
        if not self._heard:
            return NOTHING
        return _CODES[worst(one.level for one in self._judged(now_s))]

    def _judged(self, now_s: float) -> Iterator[_LastStatus]:
        for one in self._heard.values():
            quiet_s = now_s - one.arrived
            if quiet_s <= QUIET_S:
                yield one
            else:
                yield one._replace(level=Level.STALE, message=(
                    f'no report for {quiet_s:.0f} s; last: {one.message}'))

    def _forget(self, now_s: float) -> None:
        newest: dict[str, float] = {}
        for one in self._heard.values():
            newest[one.node] = max(newest.get(one.node, 0.0), one.arrived)
        self._heard = {name: one for name, one in self._heard.items()
                       if now_s - one.arrived <= FORGET_S or now_s - newest[one.node] > QUIET_S}


def _heard(section: str, status: RawStatus, now_s: float) -> _LastStatus:
    node, what = rows.split(status)
    row = rows.row(section, status)
    return _LastStatus(section, node, row['robot'], what, Level(row['level']), row['message'],
                       now_s)


def _one_per_bridge(heard: list[_LastStatus]) -> list[_LastStatus]:
    """Make one line of the link and the commands of a bridge: the one that is worse off."""
    bridges: dict[str, _LastStatus] = {}
    for one in sorted(heard, key=lambda one: one.what):     # when both are well: its commands
        if one.section == 'bridge':
            other = bridges.get(one.node, one)
            worse = one if worst((one.level, other.level)) != other.level else other
            bridges[one.node] = worse
    return [*(one._replace(what='bridge') for one in bridges.values()),
            *(one for one in heard if one.section != 'bridge')]


def screen(lines: list[StatusLine]) -> list[str]:
    """Return the lines as text, their columns in line; the robot only where one has a name."""
    robots = max((len(line.robot) for line in lines), default=0)
    what = max((len(line.what) for line in lines), default=0)
    return [line.text(robots, what) for line in lines]
