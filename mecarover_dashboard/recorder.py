# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""
What of the reports is worth keeping for a day: key values by windows of 10 s, and events.

Pure; both clocks are arguments (monotonic s of the state, Unix s of the record). A window holds
the lowest and the highest of each value. An event is a change of level or state, a finding that
came or went, an error of a bus.
"""
from __future__ import annotations

from collections.abc import Iterator
from typing import Any
from typing import NamedTuple

from mecarover_dashboard import rows
from mecarover_dashboard.rows import Row
from mecarover_dashboard.state import RowReport
from mecarover_dashboard.state import State
from msg_defs.reports import Level

WINDOW_S = 10
MOST_ERRORS = 20                # for one bus in one window; noise would fill the file
VALUES = {                      # what is kept of each kind, in this order
    'devices': ('position', 'temperature', 'voltage', 'load', 'loss', 'latency'),
    'buses': ('bus_load', 'packet_rate', 'error_rate'),
    'bridge': (),
}
_SEVERITY = (Level.OK, Level.WARN, Level.STALE, Level.ERROR)


class Subject(NamedTuple):
    """What a record is about: the status of this name."""

    name: str
    kind: str                   # a key of VALUES
    robot: str
    unit: str = ''              # `load` is in: % or A


class Window(NamedTuple):
    """What a source was in the 10 s that begin at `at` (Unix s); None where nothing is known."""

    at: int
    source: Subject
    level: int                  # the worst
    lows: tuple[float | None, ...]
    highs: tuple[float | None, ...]


class Event(NamedTuple):
    """Something that happened to a source; kind: 'state', 'finding', 'over' or 'error'."""

    at: float                   # Unix s
    source: Subject
    kind: str
    level: int
    text: str


class _LastSeen:
    """What was seen of a source last."""

    __slots__ = ('arrived', 'error_s', 'errors', 'findings', 'is_new', 'row', 'state', 'window')

    def __init__(self) -> None:
        self.arrived = -1.0
        self.state: tuple[int, str] | None = None
        self.findings: dict[str, tuple[int, str]] = {}
        self.row: Row = {}
        self.window: Window | None = None
        self.is_new = False     # the window is not written as it is now
        self.errors = 0         # in this window
        self.error_s: float | None = None   # monotonic s of the last one that was noted


class HistoryRecorder:
    """Looks at a State again and again; `taken` gives what there is to keep since then."""

    def __init__(self, errors_until: dict[str, float] | None = None) -> None:
        self._known: dict[str, _LastSeen] = {}
        self._done: list[Window] = []
        self._events: list[Event] = []
        self._until = dict(errors_until or {})      # for each bus Unix s of its last error

    def look(self, state: State, now_s: float, unix_s: float) -> None:
        """Take in what was reported since the last look."""
        offset_s = unix_s - now_s
        for kind in VALUES:
            for report in state.reports(kind):
                known = self._known.get(report.row_name)
                if known is None:
                    known = self._known[report.row_name] = _LastSeen()
                source = Subject(report.row_name, kind, report.row['robot'], report.values.unit)
                if report.row is not known.row:
                    known.row = report.row
                    self._judge(known, source, report.row, unix_s)
                if report.arrived == known.arrived:
                    continue
                known.arrived = report.arrived
                self._add(known, source, report, state, unix_s)
                if kind == 'buses':
                    self._take_errors(known, source, report.row, offset_s)

    def taken(self) -> tuple[list[Window], list[Event]]:
        """Return what to write: ended windows, those that still run, and events."""
        windows, events = self._done, self._events
        self._done, self._events = [], []
        for known in self._known.values():
            if known.is_new and known.window is not None:
                windows.append(known.window)
                known.is_new = False
        return windows, events

    def _add(self, known: _LastSeen, source: Subject, report: RowReport, state: State,
             unix_s: float) -> None:
        at = int(unix_s) // WINDOW_S * WINDOW_S
        values = tuple(_values(source.kind, report, state))
        level = report.row['level']
        old, known.is_new = known.window, True
        if old is None or old.at != at:
            if old is not None:
                self._done.append(old)
            known.window, known.errors = Window(at, source, level, values, values), 0
            return
        known.window = Window(
            at, source, max(old.level, level, key=_SEVERITY.index),
            tuple(map(_least, old.lows, values)), tuple(map(_most, old.highs, values)))

    def _judge(self, known: _LastSeen, source: Subject, row: Row, unix_s: float) -> None:
        """Note changes of level, state and findings."""
        now = _state_of(row)
        if now[:2] != (known.state or (Level.OK, '')) and (known.state or now[0] != Level.OK):
            self._events.append(Event(unix_s, source, 'state', now[0], now[2]))
        known.state = now[:2]
        found: dict[str, tuple[int, str]] = {
            rule: (Level.ERROR if severity == 'error' else Level.WARN, text)
                 for rule, text, severity in row.get('findings', ())}
        for rule in found.keys() - known.findings.keys():
            level, text = found[rule]
            self._events.append(Event(unix_s, source, 'finding', level, f'{_words(rule)}: {text}'))
        for rule in known.findings.keys() - found.keys():
            self._events.append(Event(unix_s, source, 'over', Level.OK, _words(rule)))
        known.findings = found

    def _take_errors(self, known: _LastSeen, source: Subject, row: Row, offset_s: float) -> None:
        """Note the errors that are new, the oldest first, as many as there is room for."""
        if known.error_s is None:
            known.error_s = self._until.get(source.name, 0.0) - offset_s + rows.JITTER_S
        new = [(at_s, text) for at_s, text in row['errors']
               if at_s is not None and at_s > known.error_s]
        for at_s, text in sorted(new):
            known.error_s, at = at_s, at_s + offset_s      # the two clocks tremble: one judges
            known.errors += 1
            if known.errors < MOST_ERRORS:
                self._events.append(Event(at, source, 'error', Level.ERROR, text))
            elif known.errors == MOST_ERRORS:
                self._events.append(Event(at, source, 'error', Level.ERROR,
                                          f'{text}; more errors in these {WINDOW_S} s are not '
                                          'listed'))


def _state_of(row: Row) -> tuple[int, str, str]:
    """Return (level, state, message); what counts as a change is level or state."""
    if 'quiet_since' in row:
        return Level.STALE, 'no report', f'no report; last: {row["message"]}'
    return row['level'], row.get('state', ''), row['message']


def _values(kind: str, report: RowReport, state: State) -> Iterator[float | None]:
    if kind == 'devices':
        values: Any = report.values
        for text in (values.position, values.temperature, values.voltage, values.load,
                     report.row['loss'], report.row['latency']):
            yield rows.finite(text)
    elif kind == 'buses':
        node, bus = report.row['node'], report.row['bus']
        yield from (state.figure(node, bus, metric) for metric in VALUES['buses'])


def _least(one: float | None, other: float | None) -> float | None:
    return min(one, other) if one is not None and other is not None else (
        other if one is None else one)


def _most(one: float | None, other: float | None) -> float | None:
    return max(one, other) if one is not None and other is not None else (
        other if one is None else one)


def _words(rule: str) -> str:
    return rule.replace('_', ' ')
