# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""
What the dashboard knows, and what of it changed since the last update of a client.

Pure: serialised messages in, plain values out; time is an argument (monotonic s, of arrival:
what a bag plays back has old stamps). Each row carries the version at which it changed, so that
a client gets the same changes whether it lags, reconnects or is new (version 0).
"""
from __future__ import annotations

from collections import deque
from collections.abc import Iterator
from dataclasses import dataclass
from dataclasses import field
from typing import Any
from typing import NamedTuple

from mecarover_dashboard import rows
from mecarover_dashboard.cdr import AnyStatus
from mecarover_dashboard.cdr import CdrError
from mecarover_dashboard.cdr import Message
from mecarover_dashboard.cdr import statuses
from mecarover_dashboard.robot_parts import parts_of
from mecarover_dashboard.robot_parts import RobotPart
from mecarover_dashboard.rows import RegisterTable
from mecarover_dashboard.rows import Row
from msg_defs.diagnostics import status_name

TABLES, TIMING = 'dxl/diagnostics', 'dxl/timing'
OVERVIEW = '/diagnostics'
TOPICS = (TABLES, OVERVIEW, TIMING, 'vel2d/timing')
SECTIONS = ('devices', 'buses', 'bridge', 'timing')
QUIET_S = 4.0                # without a report for so long, or 2.5 times the usual: old values
TABLE_S = 30.0               # after so long without a whole table the short form has to do
FORGET_S = 60.0              # ... while its node reports others: it is no more
MOST_ROWS = 3000             # all kinds together: what is published cannot fill the memory
MOST_BYTES = 128_000_000     # ... however long it is; six full buses at which somebody looked
MOST_OF_MESSAGE = 16_000_000         # bytes; a full bus takes 3 million
MOST_OF_STATUS = 4_000_000   # bytes; a full table takes 20 000
HISTORY = 300                # points kept of each timing metric
_ROW = 2000                  # about what a row takes in itself, and in the list of removed ones
_PAIR = 200                  # ... and each of its pairs, besides their bytes
_POINTS = 60_000             # ... and its history

_ONLY_LONG: Row = {'errors': [], 'started': None}

Point = list[float | None]


@dataclass(slots=True)
class _Row:
    """One row; `arrived` is when it was reported last, `whole` its last status with a table."""

    row: Row = field(default_factory=dict)
    version: int = 0
    cost: int = 0               # bytes, about
    arrived: float = 0.0
    period_s: float = 0.0       # between reports: the longest of late
    whole: AnyStatus | None = None
    whole_arrived: float = 0.0
    values: rows.Values = rows.NOTHING
    points: list[tuple[int, Point]] = field(default_factory=list)   # a metric's, with versions
    latencies: list[Point] = field(default_factory=list)            # a device's
    table: tuple[AnyStatus | None, RegisterTable | None] = None, None   # what it was made of


class RowReport(NamedTuple):
    """A row as it was reported last; `values` only of a device that answers now."""

    row_name: str
    row: Row
    values: rows.Values
    arrived: float


class State:
    """
    Rows by section and name. One thread uses it.

    In a `namespace` only the robots below it are taken from /diagnostics, which all robots share.
    """

    def __init__(self, namespace: str = '') -> None:
        self.namespace = namespace
        self.version = 0
        self._messages = dict.fromkeys(TOPICS, (0, 0.0))    # how many, when the last one came
        self.malformed = 0
        self.refused = 0                            # what would be too much to keep
        self.bytes = 0                              # about, of all that is kept
        self._entries: dict[str, dict[str, _Row]] = {name: {} for name in SECTIONS}
        self._removed: deque[tuple[int, str, str]] = deque(maxlen=MOST_ROWS)
        self._heard: dict[str, float] = {}          # by node
        self._parts: tuple[int, list[RobotPart]] = -1, []      # and their version
        self.grown_s = 0.0                          # when the last new row came

    def store_message(self, topic: str, message: Message, now_s: float) -> None:
        """Take a DiagnosticArray, serialised or as its statuses; no content makes this raise."""
        if len(message) > MOST_OF_MESSAGE:
            self.refused += 1
            return
        try:
            found = statuses(message)
        except CdrError:
            self.malformed += 1
            return
        self._messages[topic] = self._messages[topic][0] + 1, now_s
        self.version += 1
        if self._is_full(_ROW + 2 * _POINTS):
            self._forget_the_silent(now_s)
        for status in found if topic != OVERVIEW else filter(self._is_ours, found):
            section = rows.section(status)
            if section == 'timing' and (device := self._device_of(status)):
                self._store_latency(device, status, now_s)
            elif section:
                self._store_status(topic, section, status, now_s)

    def _is_ours(self, status: AnyStatus) -> bool:
        return not self.namespace or status.name.startswith(f'{self.namespace}/')

    def _device_of(self, status: AnyStatus) -> str:
        """Return the name of the device that a timing status is about, '' if it is none."""
        node, of = rows.split_name(status.name)[0], rows.metric_of(status)
        is_device = rows.is_device(of) and f'{node}: bus {of}' not in self._entries['buses']
        return f'{node}: {of}' if is_device else ''

    def _store_latency(self, name: str, status: AnyStatus, now_s: float) -> None:
        entry = self._entries['devices'].get(name)
        if entry is None:
            return
        if not entry.latencies:
            if self._is_full(_POINTS, is_row=False):
                self.refused += 1
                return
            self.bytes += _POINTS
        entry.latencies.append([round(now_s, 2), *rows.figures(status.pairs())])
        del entry.latencies[:-HISTORY]

    def _store_status(self, topic: str, section: str, status: AnyStatus, now_s: float) -> None:
        entry = self._entry(section, status)
        if entry is None:
            return
        row = rows.row(section, status)
        if entry.arrived:
            entry.period_s = max(now_s - entry.arrived, entry.period_s / 2)
        else:
            self.grown_s = now_s
        entry.arrived = self._heard[row['node']] = now_s
        if section == 'devices' and (topic == TABLES or entry.whole is None
                                     or now_s - entry.whole_arrived > TABLE_S):
            entry.whole, entry.whole_arrived = status, now_s
            if topic == TABLES:
                entry.values = rows.values(status)
        if section == 'buses':
            row |= rows.errors(status, now_s, entry.row) if topic == TABLES else {
                name: entry.row.get(name, empty)        # the short form has none
                for name, empty in _ONLY_LONG.items()}
        if section == 'timing':
            entry.points.append((self.version, [round(now_s, 2), *rows.figures(row['values'])]))
            del entry.points[:-HISTORY]
        if row != entry.row or section == 'timing':
            entry.row, entry.version = row, self.version

    def _entry(self, section: str, status: AnyStatus) -> _Row | None:
        """Return the row of a status, None where there is no room for it."""
        entry = self._entries[section].get(status.name) or _Row()
        # A short form does not take the room of the table that is kept with it.
        more = max(0, _cost(section, status) - entry.cost)
        if status.size > MOST_OF_STATUS or self._is_full(more, is_row=not entry.cost):
            self.refused += 1
            return None
        self._entries[section][status.name] = entry
        entry.cost += more
        self.bytes += more
        return entry

    def _is_full(self, more: int, is_row: bool = True) -> bool:
        """Tell whether so many more bytes, for one more row or not, are too much."""
        return self.bytes + more > MOST_BYTES or (
            is_row and sum(map(len, self._entries.values())) >= MOST_ROWS)

    def _forget_the_silent(self, now_s: float) -> None:
        """Make room: drop what was not reported for long, whether its node lives or not."""
        for section, entries in self._entries.items():
            for name, entry in list(entries.items()):
                if now_s - entry.arrived > FORGET_S:
                    self._remove(section, name)
        self._heard = {node: at for node, at in self._heard.items() if now_s - at <= FORGET_S}

    def _remove(self, section: str, name: str) -> None:
        self.version += 1
        entry = self._entries[section].pop(name)
        self.bytes -= entry.cost + _POINTS * bool(entry.latencies)
        self._removed.append((self.version, section, name))

    def expire(self, now_s: float) -> None:
        """Mark what is no longer reported; drop what its own node does not know any more."""
        for section, entries in self._entries.items():
            for name, entry in list(entries.items()):
                quiet_s = now_s - entry.arrived
                if quiet_s <= max(QUIET_S, 2.5 * entry.period_s):
                    continue
                if 'quiet_since' not in entry.row:
                    self.version += 1
                    entry.version = self.version
                    entry.row = entry.row | {'quiet_since': round(entry.arrived, 2), 'live': False}
                if quiet_s > FORGET_S and now_s - self._heard[entry.row['node']] < QUIET_S:
                    self._remove(section, name)

    def changes(self, since: int) -> dict[str, Any]:
        """Return rows that changed after a version, None for removed ones; 0 = everything."""
        changed: dict[str, dict[str, Row | None]] = {name: {} for name in SECTIONS}
        if since:
            for version, section, name in self._removed:
                if version > since and name not in self._entries[section]:
                    changed[section][name] = None
        for section, entries in self._entries.items():
            for name, entry in entries.items():
                if entry.version > since:
                    changed[section][name] = _with_points(entry, since)
        return {section: found for section, found in changed.items() if found}

    def parts(self) -> list[RobotPart]:
        """Return the bridges and buses, the worst first, as they are now."""
        if self._parts[0] != self.version:
            self._parts = self.version, parts_of(*(
                [entry.row for entry in self._entries[section].values()]
                for section in ('devices', 'buses', 'bridge')))
        return self._parts[1]

    def table(self, name: str) -> RegisterTable | None:
        """Return the table of a device as last reported; None if there is no such device."""
        entry = self._entries['devices'].get(name)
        if entry is None or entry.whole is None:
            return None
        status, before = entry.table
        if status is not entry.whole:
            entry.table = entry.whole, rows.table(entry.whole, entry.whole_arrived, before)
        return entry.table[1]

    def whole(self) -> dict[str, tuple[AnyStatus, float]]:
        """Return the last status with registers of each device, and when it came."""
        return {name: (entry.whole, entry.whole_arrived)
                for name, entry in self._entries['devices'].items() if entry.whole is not None}

    def reports(self, section: str) -> Iterator[RowReport]:
        """Return the rows of a section as they were reported last."""
        for name, entry in self._entries[section].items():
            yield RowReport(name, entry.row, _values_now(entry), entry.arrived)

    def figure(self, node: str, of: str, metric: str) -> float | None:
        """Return the newest figure of a timing metric: p50, or its value; None if unknown."""
        entry = self._entries['timing'].get(status_name(node, 'timing', of, metric))
        return entry.points[-1][1][1] if entry is not None and entry.points else None

    def fact(self, name: str, key: str) -> str:
        """Return a value in the newest status of a device; '' if there is none."""
        entry = self._entries['devices'].get(name)
        found = entry.whole.find(key.encode()) if entry is not None and entry.whole else None
        return found[1] if found is not None and found[0] == key else ''

    def values(self) -> dict[str, rows.Values]:
        """Return what is shown of all devices with values, empty where they are not of now."""
        return {name: _values_now(entry).calm() for name, entry in self._entries['devices'].items()
                if entry.values is not rows.NOTHING}

    def latency(self, name: str, after_s: float) -> list[Point]:
        """Return the points [s, p50, p95, max] of a device's reply latency after a time."""
        entry = self._entries['devices'].get(name)
        return [point for point in entry.latencies if (point[0] or 0) > after_s] if entry else []

    def keep_tables(self, names: set[str]) -> None:
        """Forget the decoded tables of devices that no page shows."""
        for name, entry in self._entries['devices'].items():
            if name not in names:
                entry.table = None, None

    def topics(self, now_s: float) -> dict[str, Any]:
        """Return by topic how many messages came, and how long ago the last one, in s."""
        return {topic: [count, round(now_s - at_s, 1) if count else None]
                for topic, (count, at_s) in self._messages.items()}


def _cost(section: str, status: AnyStatus) -> int:
    """Return about how many bytes a row takes; texts are kept as bytes and decoded."""
    pairs = min(status.count, rows.HEAD) if section == 'devices' else status.count
    return (_ROW + 2 * status.size + _PAIR * pairs
            + (_POINTS if section == 'timing' else 0))


def _values_now(entry: _Row) -> rows.Values:
    return entry.values if entry.row.get('live') else rows.NOTHING


def _with_points(entry: _Row, since: int) -> Row:
    if not entry.points:
        return entry.row
    return entry.row | {'points': [point for version, point in entry.points if version > since]}
