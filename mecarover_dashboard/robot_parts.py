# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""
The parts of a robot, its bridge and its buses: the problem of each, and how it is said.

Pure. The nodes judge; here is chosen what of it comes first, once for the page, its tab, a screen
reader, the history, /metrics, the alerts and mecarover_status. What is not reported is not known.
"""
from __future__ import annotations

from collections.abc import Iterable
from collections.abc import Mapping
from collections.abc import Sequence
import re
from textwrap import shorten
from typing import NamedTuple

from mecarover_dashboard.rows import Row
from msg_defs import status_keys as keys
from msg_defs.diagnostics import DRIVING
from msg_defs.diagnostics import Level
from msg_defs.diagnostics import namespace_of
from msg_defs.diagnostics import SEVERITY
from msg_defs.diagnostics import status_name
from msg_defs.diagnostics import worst

# What is wrong with a part, in the words of /metrics.
NO_REPORT, PORT_CLOSED, NONE_ANSWERS = 'no report', 'port closed', 'no device answers'
SILENT, FAULT, LOST, WARNING = 'silent', 'error', 'lost', 'warning'
UNKNOWN = (NO_REPORT, PORT_CLOSED)
_OF_ALL = (*UNKNOWN, NONE_ANSWERS)      # the problem of each of its devices
HARDWARE = 'hardware_error'
CUT = 'broken_cable'                   # what is after it is lost with it
_AWAY = ('disconnected', 'expected')
_LEVEL_WORDS = {Level.ERROR: FAULT, Level.STALE: SILENT, Level.WARN: WARNING}
_MOST_NAMED = 4                              # devices in a sentence
_BEGINNING_MAX = 40                          # characters of a message in a tab


class RobotPart(NamedTuple):
    """
    The bridge or a bus.

    | field | what |
    |---|---|
    | row_name | the status prefix history has its events |
    | bus | None: it is the bridge |
    | problems | of the words above, the first one first in the text; none if it is well |
    | mark, number | for the headline and the tab: '007 silent; 003 too hot'; how many these are |
    | headline | for its bar, where each device says itself what to do |
    | text | all sentences about it: one problem does not hide another |
    | ids | the devices that are named |
    | of_part | what is said of the part as a whole, '' where only devices have a problem |
    | since | monotonic s of its last report, None while it reports |
    | live, total | devices that answer now, and all |
    """

    row_name: str
    robot: str
    node: str
    bus: str | None
    level: Level
    problems: tuple[str, ...]
    mark: str
    headline: str
    text: str
    ids: tuple[int, ...] = ()
    of_part: str = ''
    number: int = 0
    since: float | None = None
    live: int = 0
    total: int = 0

    @property
    def place(self) -> tuple[str, str | None]:
        return self.node, self.bus

    @property
    def name(self) -> str:
        return 'bridge' if self.bus is None else f'bus {self.bus}'.strip()

    @property
    def problem(self) -> str:
        return self.problems[0] if self.problems else ''

    @property
    def is_known(self) -> bool:
        """Whether what is shown of it is of now."""
        return self.problem not in UNKNOWN

    @property
    def hides_devices(self) -> bool:
        """Whether its problem is that of all of its devices."""
        return self.problem in _OF_ALL or (self.problem == SILENT and not self.live)

    @property
    def key(self) -> str:
        """What differs when somebody who listens has to hear of it: no number that changes."""
        return f'{self.row_name} {self.ids} {re.sub(r"[0-9]+", "", self.text)}'

    def sentence(self, now_s: float) -> str:
        """Return the sentence, with the time since the last report."""
        return self.text if self.since is None else \
            f'{self.text}; last report {now_s - self.since:.0f} s ago'

    def shown(self) -> Row:
        """Return what the page gets."""
        return self._asdict() | {'name': self.name, 'is_known': self.is_known, 'key': self.key}


def parts_of(devices: Iterable[Row], buses: Iterable[Row],
             bridge: Iterable[Row]) -> list[RobotPart]:
    """Return the parts of all robots, the worst first."""
    own = {(row['node'], row['bus']): row for row in buses}
    rows: dict[tuple[str, str], list[Row]] = {place: [] for place in own}
    for row in devices:
        rows.setdefault((row['node'], row['bus']), []).append(row)
    found = [_bus(*place, own.get(place) or _without_status(some),
                  sorted(some, key=lambda one: int(one['id']))) for place, some in rows.items()]
    bridges: dict[str, dict[str, Row]] = {}
    for row in bridge:
        bridges.setdefault(row['node'], {})[row['part']] = row
    found += [_bridge(node, some) for node, some in bridges.items()]
    return sorted(found, key=lambda one: (-SEVERITY.index(one.level), one.robot,
                                          one.bus is not None, one.node, one.bus or ''))


def level_of(row: Row) -> Level:
    """Return the level of a row: what is not reported is silent."""
    return Level.STALE if 'quiet_since' in row else Level(row['level'])


def place_of(row: Row) -> tuple[str, str | None]:
    """Return the node and the bus of a row, which are those of its part."""
    return row['node'], row.get('bus')


def spelt(rule: str) -> str:
    """Return the name of a rule as people write it."""
    return rule.replace('_', ' ')


def is_lost(row: Row) -> bool:
    """Tell whether a device should answer and does not."""
    return level_of(row) is Level.ERROR and row['state'] in _AWAY


def device_name(row: Row) -> str:
    """Return '007 left_knee'."""
    return f'{row["id"]:03} {row["joint"]}'.rstrip()


class _Problem(NamedTuple):
    """What is wrong with a bus, or with some of its devices."""

    word: str
    text: str
    devices: Sequence[Row] = ()


def _without_status(devices: list[Row]) -> Row:
    """Return the row of a bus of which only the devices are reported."""
    row: Row = {'level': Level.OK, 'message': '', 'live': True, 'findings': []}
    times = [one['quiet_since'] for one in devices if 'quiet_since' in one]
    return row | {'quiet_since': max(times)} if len(times) == len(devices) else row


def _bus(node: str, bus: str, row: Row, devices: list[Row]) -> RobotPart:
    live = sum(bool(one['live']) for one in devices)
    message, since = str(row['message']), row.get('quiet_since')
    if since is not None:
        level, found = Level.STALE, [_Problem(
            NO_REPORT, f'No report from {node}: nothing is known of its {_counted(devices)}; '
                       'start it again')]
    elif not row['live']:
        level, found = Level.ERROR, [_Problem(PORT_CLOSED, message)]
    else:
        level, found = _judged(level_of(row), message, devices, live)
    well = '' if found else _well(devices, message)
    rules = {text: spelt(rule) for rule, text, _ in row['findings']}
    count, mark = _mark(found, rules, len(devices))
    prefix = bus if bus or since is None else node.rpartition('/')[2]
    general = [one.text for one in found if not one.devices]
    number, sick = _mark([one for one in found if one.devices], rules, len(devices))
    headline = '; '.join(filter(None, (
        *general, f'{number} problems: {sick}' if number > 1 else sick)))
    return RobotPart(
        status_name(node, f'bus {bus}'.strip()), namespace_of(node), node, bus, level,
        tuple(dict.fromkeys(one.word for one in found)),
        f'{prefix}: {mark}' if prefix and mark else mark, headline or well,
        '; '.join(one.text for one in found) or well,
        tuple(device['id'] for one in found for device in one.devices),
        general[0] if general else '', count, since, live, len(devices))


def _mark(found: list[_Problem], rules: Mapping[str, str], total: int) -> tuple[int, str]:
    """Return how many problems there are, and '007 silent; noise'; rules: names of texts."""
    ids: dict[str, list[str]] = {}
    for one in found:
        if not one.devices:
            ids[one.word if one.word in _OF_ALL else rules.get(
                one.text, 'bus silent' if one.word == SILENT else _beginning(one.text))] = ['']
        for device in one.devices:
            ids.setdefault(_trouble(device), []).append(f'{device["id"]:03}')
    return sum(map(len, ids.values())), '; '.join(
        f'{_list(some, total)} {word}'.strip() for word, some in ids.items())


def _trouble(row: Row) -> str:
    """Return what a device has, in a word or two."""
    rules = [rule for rule, _, severity in row['findings'] if severity == FAULT] \
        or [rule for rule, *_ in row['findings']]
    if is_lost(row) and CUT not in rules:
        return SILENT
    if rules and HARDWARE not in rules:
        return spelt(rules[0])
    return _beginning(str(row['message']))     # which error it is


def _beginning(text: str) -> str:
    return shorten(re.split('[:;(]', text, maxsplit=1)[0], _BEGINNING_MAX, placeholder=' \u2026')


def _list(names: list[str], total: int) -> str:
    if _MOST_NAMED < len(names) == total:
        return f'all {total}'
    more = f' and {len(names) - _MOST_NAMED} more' if len(names) > _MOST_NAMED else ''
    return ', '.join(names[:_MOST_NAMED]) + more


def _judged(of_all: Level, message: str, devices: list[Row],
            live: int) -> tuple[Level, list[_Problem]]:
    """Return the level of a bus that is heard, and what is wrong: with it as a whole first."""
    level = worst((of_all, *map(level_of, devices)))
    if level is Level.OK:
        return level, []
    lost = _without_cut_off([one for one in devices if is_lost(one)])
    sick = [one for one in devices if level_of(one) is Level.ERROR and not is_lost(one)]
    found = []
    if of_all is Level.STALE:
        found, lost = [_Problem(SILENT, message)], []
    elif message and devices and not live and (lost or of_all is Level.ERROR):
        found, lost, level = [_Problem(NONE_ANSWERS, message)], [], Level.ERROR
    elif message and (not live or level is of_all):
        found = [_Problem(_LEVEL_WORDS[level], message)]
    if found:
        # What the bus has explains its devices, but for what was found of a device itself.
        lost, sick = ([one for one in some if any(severity == 'error' and text not in message
                                                  for _, text, severity in one['findings'])]
                      for some in (lost, sick))
    found += [_Problem(word, f'{word.capitalize()}: {_names(some, len(devices))}', some)
              for word, some in ((LOST, lost), (FAULT, sick)) if some]
    if not found:
        some, word = [one for one in devices if level_of(one) is level], _LEVEL_WORDS[level]
        found = [_Problem(word, f'{word.capitalize()}: {_names(some, len(devices))}' if some
                          else message, some)]
    return level, found


def _without_cut_off(lost: list[Row]) -> list[Row]:
    """Leave out the devices after a broken cable, which the first of them names."""
    is_cut = any(rule == CUT for one in lost for rule, *_ in one['findings'])
    return [one for one in lost if one['findings']] if is_cut else lost


def _well(devices: list[Row], message: str) -> str:
    notes = [one for one in devices if one['message'] != one['state']]
    if len(notes) == 1:
        return f'{device_name(notes[0])}: {notes[0]["message"]}'
    if notes:
        return message
    return f'All {_counted(devices)} connected' if devices else 'No device found yet'


def _counted(devices: list[Row]) -> str:
    return f'{len(devices)} device{"s" if len(devices) != 1 else ""}'


def _bridge(node: str, rows: dict[str, Row]) -> RobotPart:
    """Return the part of a bridge; of its link and its commands the worse one is said."""
    worse = max((rows[part] for part in ('commands', 'link') if part in rows),
                key=lambda row: SEVERITY.index(level_of(row)))
    level, text, since = level_of(worse), str(worse['message']), worse.get('quiet_since')
    mark = problem = _LEVEL_WORDS.get(level, '')
    if since is not None:
        mark = problem = NO_REPORT
        did = dict(rows.get('commands', worse)['values']).get(keys.STATE, 'unknown')
        text = f'No report from {node}: nothing is known of the rover; its last state: {did}'
        if did == DRIVING:
            level, mark = Level.ERROR, f'{NO_REPORT}, rover may be driving'
            text = f'No report from {node}, and the rover was driving: it may be driving on; ' \
                'look at it, switch its motors off, restart the bridge'
    elif 'link' in rows and not rows['link']['live']:
        mark = problem = LOST if level is Level.ERROR else problem
    return RobotPart(status_name(node, 'link'), worse['robot'], node, None, level,
                     (problem,) if problem else (), mark and f'bridge: {mark}', text,
                     text, of_part=text, number=bool(mark), since=since)


def _names(some: list[Row], total: int) -> str:
    names = _list([device_name(one) for one in some], total)
    if len(some) == 1:
        return f'{names}, {some[0]["message"]}'
    found = next((one for one in some if one['findings']), None)
    return names if found is None else f'{names}; {found["id"]:03}: {found["findings"][0][1]}'

