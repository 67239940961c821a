# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""
Records the history: what of the reports is kept for a day, and the thread that writes it.

Of each value a window of 10 s keeps the lowest and the highest. An event is a change of level or
state, a finding that came or went, an error of a bus. What has one cause is one event: that of
the bus where all of its devices share it, that of a lost device in place of its findings and
missed answers. A disk may stop for seconds, so the server never waits for it. An SD card wears
out: a window is written once, in one transaction with the others when they have ended; an event
without waiting for that, at most every EVENT_FLUSH_S. So kill -9 or a power failure costs the
window that runs.
"""
from __future__ import annotations

from collections.abc import Iterator
from contextlib import suppress
from dataclasses import dataclass
from dataclasses import field
import fcntl
import math
import os
from pathlib import Path
import queue
import sqlite3
import threading
import time

from mecarover_dashboard import rows
from mecarover_dashboard.history import DamagedError
from mecarover_dashboard.history import Event
from mecarover_dashboard.history import HistoryWriter
from mecarover_dashboard.history import set_aside
from mecarover_dashboard.history import Subject
from mecarover_dashboard.history import VALUES
from mecarover_dashboard.history import widened
from mecarover_dashboard.history import Window
from mecarover_dashboard.history import WINDOW_S
from mecarover_dashboard.robot_parts import is_lost
from mecarover_dashboard.robot_parts import level_of
from mecarover_dashboard.robot_parts import place_of
from mecarover_dashboard.robot_parts import RobotPart
from mecarover_dashboard.robot_parts import spelt
from mecarover_dashboard.rows import Row
from mecarover_dashboard.state import RowReport
from mecarover_dashboard.state import State
from msg_defs.diagnostics import Level
from msg_defs.diagnostics import worst

EVENT_FLUSH_S = 5.0
LIMIT_S = 300.0                 # between two looks at the size
END_S = 5.0                     # a disk that takes nothing for so long is not waited for
_MOST_WAITING = 24              # batches, at least two minutes: what comes later is lost
NAME = 'history.sqlite'
MOST_ERRORS = 20                # for one bus in one window; noise would fill the file

_Batch = tuple[list[Window], list[Event]]


@dataclass(slots=True)
class _SourceLog:
    """What was seen of a source last, and what there is to keep; `events` are those of all."""

    events: list[Event]
    error_until_s: float        # Unix s: its errors until then are recorded
    subject: Subject
    arrived: float = -1.0
    state: tuple[int, str] | None = None
    logged_text: str = ''       # the text of its last state that was recorded
    findings: dict[str, bool] = field(default_factory=dict)     # rules; whether it was recorded
    row: Row = field(default_factory=dict)
    windows: dict[int, Window] = field(default_factory=dict)    # not yet written, by their times
    ran_s: float = 0.0          # for how long the monitor of this bus had been running
    errors: int = 0             # in this window
    error_s: float | None = None    # monotonic s of the last one that was recorded

    def is_restarted(self, bus: RowReport) -> bool:
        """Tell whether the monitor runs for much less time than before: it is another one."""
        if bus.row['started'] is None:
            return False
        before, self.ran_s = self.ran_s, bus.arrived - bus.row['started']
        return self.ran_s < before / 2

    def _add_event(self, at: float, kind: str, level: int, text: str) -> None:
        self.events.append(Event(at, self.subject, kind, level, text))

    def judge_part(self, part: RobotPart, row: Row | None, unix_s: float) -> None:
        """Record what became of a bridge or a bus as a whole, unless a finding says it."""
        is_whole = bool(part.of_part) and part.of_part not in _texts(row)
        now = (part.level, part.problem) if is_whole else (Level.OK, '')
        if now != (self.state or (Level.OK, '')):
            text = part.text if is_whole or not part.problem \
                else f'{part.live} of {part.total} devices answer'
            self._add_event(unix_s, 'state', part.level, text)
        self.state = now

    def judge_row(self, row: Row, bus: Row | None, unix_s: float) -> None:
        """Record what changed of a device or a bus; bus: that of a device."""
        if row is self.row:
            return
        self.row = row
        if self.subject.kind == 'devices':
            self._judge_device(row, bus, unix_s)
        elif self.subject.kind == 'buses':
            self._judge_findings(row, None, unix_s)

    def _judge_device(self, row: Row, bus: Row | None, unix_s: float) -> None:
        """Record a change of level or state; what a finding says is recorded as that."""
        now = level_of(row), row['state']
        before = self.state or (Level.OK, now[1])
        is_of_finding = row['message'] in _texts(row) and not is_lost(row)
        if now != before and not (is_of_finding and now[1] == before[1]):
            self._add_event(unix_s, 'state', now[0], row['message'])
            self.state, self.logged_text = now, row['message']
        self.state = self.state or before
        if not is_lost(row):
            self._judge_findings(row, bus, unix_s)

    def _judge_findings(self, row: Row, bus: Row | None, unix_s: float) -> None:
        found = {rule for rule, _, _ in row['findings']}
        # What another one accounts for is not reported any more, and not over either.
        causes = set() if bus is None else {rule for rule, _, _ in bus['findings']}
        is_explained = not found <= self.findings.keys()
        for rule, text, severity in row['findings']:
            if rule not in self.findings:
                self.findings[rule] = text != self.logged_text
                if text != self.logged_text:
                    level = Level.ERROR if severity == 'error' else Level.WARN
                    self._add_event(unix_s, 'finding', level, f'{spelt(rule)}: {text}')
        for rule in self.findings.keys() - found:
            if self.findings.pop(rule) and not (is_explained or rule in causes):
                self._add_event(unix_s, 'over', Level.OK, spelt(rule))

    def forget_findings(self, unix_s: float) -> None:
        """Record that a new monitor, which has read nothing yet, does not clear what was found."""
        for rule, is_recorded in self.findings.items():
            if is_recorded:
                self._add_event(unix_s, 'finding', Level.STALE, f'{spelt(rule)}: not known since '
                                'the monitor was started again')
        self.findings.clear()

    def add_values(self, level: Level, values: tuple[float | None, ...], unix_s: float) -> None:
        """Put what was reported into the window of this time."""
        at = _window_at(unix_s)
        ranges = tuple(None if value is None else (value, value) for value in values)
        old = self.windows.get(at)
        if old is None:
            self.windows[at], self.errors = Window(at, self.subject, level, ranges), 0
            return
        self.windows[at] = Window(at, self.subject, worst((old.level, level)),
                                  tuple(map(widened, old.ranges, ranges)))

    def add_errors(self, row: Row, offset_s: float, lost: set[str]) -> None:
        """Record the errors that are new, the oldest first, but for those of lost devices."""
        if self.error_s is None:
            self.error_s = self.error_until_s - offset_s + rows.JITTER_S
        new = [(at_s, text) for at_s, text in row['errors']
               if at_s is not None and at_s > self.error_s]
        for at_s, text in sorted(new):
            self.error_s = at_s                 # the two clocks tremble: one judges
            if text.partition(': ')[0] in lost:
                continue
            self.errors += 1
            if self.errors == MOST_ERRORS:
                text += f'; more errors in these {WINDOW_S} s are not listed'
            if self.errors <= MOST_ERRORS:
                self._add_event(at_s + offset_s, 'error', Level.ERROR, text)


class HistorySampler:
    """Looks at a State again and again; `take_batch` gives what there is to keep since then."""

    def __init__(self, errors_until: dict[str, float] | None = None) -> None:
        self._sources: dict[str, _SourceLog] = {}
        self._events: list[Event] = []
        self._until = dict(errors_until or {})      # for each bus Unix s of its last error
        self._flushed_s = 0.0       # monotonic s
        self._flushed_at = 0        # the window that ran then

    def sample_state(self, state: State, now_s: float, unix_s: float) -> None:
        """Take in what was reported since the last time."""
        parts = {part.place: part for part in state.parts()}
        buses = list(state.reports('buses'))
        rows_of = {report.row_name: report.row for report in buses}
        for part in parts.values():
            subject = Subject(part.row_name, 'bridge' if part.bus is None else 'buses', part.robot)
            self._source(subject).judge_part(part, rows_of.get(part.row_name), unix_s)
        restarted = {place_of(report.row) for report in buses
                     if self._source(_subject(report, 'buses')).is_restarted(report)}
        for kind in VALUES:
            for report in state.reports(kind):
                row, place = report.row, place_of(report.row)
                source = self._source(_subject(report, kind))
                if place in restarted:
                    source.forget_findings(unix_s)
                part = parts[place]
                if part.is_known and not (kind == 'devices' and part.hides_devices):
                    source.judge_row(row, rows_of.get(part.row_name), unix_s)
                if report.arrived == source.arrived:
                    continue
                source.arrived = report.arrived
                source.add_values(row['level'], tuple(_values(kind, report, state)), unix_s)
                if kind == 'buses':
                    source.add_errors(row, unix_s - now_s, {
                        f'{one.row["id"]:03}' for one in state.reports('devices')
                        if is_lost(one.row) and place_of(one.row) == place})

    def _source(self, subject: Subject) -> _SourceLog:
        source = self._sources.get(subject.name)
        if source is None:
            source = self._sources[subject.name] = _SourceLog(
                self._events, self._until.get(subject.name, 0.0), subject)
        source.subject = subject
        return source

    def is_due(self, now_s: float, unix_s: float) -> bool:
        """Tell whether to write now: windows have ended, or there are events."""
        at = _window_at(unix_s)
        if at == self._flushed_at and not (
                self._events and now_s - self._flushed_s >= EVENT_FLUSH_S):
            return False
        self._flushed_s, self._flushed_at = now_s, at
        return True

    def take_batch(self, unix_s: float = math.inf) -> _Batch:
        """Return what to write: windows that ended until then, and events."""
        events = list(self._events)
        self._events.clear()
        return [source.windows.pop(at) for source in self._sources.values()
                for at in list(source.windows) if at + WINDOW_S <= unix_s], events


def _subject(report: RowReport, kind: str) -> Subject:
    return Subject(report.row_name, kind, report.row['robot'], report.values.unit,
                   report.values.position_unit)


def _window_at(unix_s: float) -> int:
    """Return when the window of a time begins."""
    return int(unix_s) // WINDOW_S * WINDOW_S


def _texts(row: Row | None) -> set[str]:
    """Return what the findings of a row say."""
    return set() if row is None else {text for _, text, _ in row['findings']}


def _values(kind: str, report: RowReport, state: State) -> Iterator[float | None]:
    if kind == 'devices' and report.row['level'] != Level.STALE:
        for text in (*report.values[:4], report.row['loss'], report.row['latency']):
            yield rows.finite(text)
    elif kind == 'buses' and report.row['live']:
        node, bus = report.row['node'], report.row['bus']
        yield from (state.figure(node, bus, metric) for metric in VALUES['buses'])
    else:
        yield from (None for _ in VALUES[kind])


class HistoryError(Exception):
    """One line why nothing can be recorded: the file, the reason, the remedy."""


def default_path() -> Path:
    """Return where the history is: in the state folder of the service, or of the user."""
    folder = os.environ.get('STATE_DIRECTORY', '').partition(':')[0]
    if folder:
        return Path(folder) / NAME
    state = os.environ.get('XDG_STATE_HOME') or Path.home() / '.local' / 'state'
    return Path(state) / 'mecarover_serial' / NAME


class ReadOnlyHistory:
    """A history in a folder that one may only read: shown, and nothing is recorded."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self.notice = self.problem = f'{path}: its folder may only be read, so nothing is recorded'

    def sample_state(self, state: State, now_s: float, unix_s: float) -> None:
        """Record nothing."""

    def close(self) -> None:
        """Have nothing open."""


class HistoryRecorder:
    """Records a State until it is closed; `path` can be read meanwhile."""

    def __init__(self, path: Path) -> None:
        """Open the file, set a damaged one aside; raise HistoryError where that fails."""
        self.path = path
        self.notice = ''        # what became of a file that was there
        self.problem = ''       # why nothing is written now
        try:
            path.parent.mkdir(mode=0o700, parents=True, exist_ok=True)
            self._lock_file(path.with_name(f'{path.name}.lock'))
            self._writer = self._open()
        except (OSError, sqlite3.Error) as error:
            raise HistoryError(f'{path}: {_reason(error)}; give another file with --history '
                                 'FILE, or --history none') from error
        self._sampler = HistorySampler(self._writer.errors_until())
        self._batches: queue.Queue[_Batch | None] = queue.Queue(_MOST_WAITING)
        self._thread = threading.Thread(target=self._run, name='history', daemon=True)
        self._thread.start()

    def _lock_file(self, path: Path) -> None:
        """Lock a file and leave what is in it; a link is not followed, it may lead anywhere."""
        flags = os.O_RDWR | os.O_CREAT | os.O_NOFOLLOW | os.O_CLOEXEC
        try:
            self._lock = os.open(path, flags, 0o600)
        except OSError as error:
            raise OSError(error.errno, f'{path.name}: {error.strerror}') from error
        try:
            fcntl.flock(self._lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            os.close(self._lock)
            raise OSError('another dashboard writes to it') from None

    def _open(self) -> HistoryWriter:
        try:
            return HistoryWriter(self.path)
        except DamagedError as error:
            aside = set_aside(self.path, time.time())
            self.notice = (f'{self.path}: this history cannot be read ({error}); it was renamed '
                           f'to {aside.name}')
            return HistoryWriter(self.path)

    def sample_state(self, state: State, now_s: float, unix_s: float) -> None:
        """Take in what was reported; never waits."""
        self._sampler.sample_state(state, now_s, unix_s)
        if self._sampler.is_due(now_s, unix_s):
            self._hand_over(unix_s)

    def _hand_over(self, unix_s: float = math.inf) -> None:
        try:
            self._batches.put_nowait(self._sampler.take_batch(unix_s))
        except queue.Full:
            self.problem = f'{self.path}: the disk is too slow, so part of the history is lost'

    def close(self) -> None:
        """Write what is known and end."""
        self._hand_over()
        with suppress(queue.Full):
            self._batches.put(None, timeout=END_S)
        self._thread.join(END_S)
        os.close(self._lock)

    def _run(self) -> None:
        limited_s = time.monotonic()
        while (batch := self._batches.get()) is not None:
            self._write(batch)
            if time.monotonic() - limited_s > LIMIT_S:
                limited_s = time.monotonic()
                self._limit()
        self._limit()
        self._writer.close()

    def _limit(self) -> None:
        with suppress(sqlite3.Error):
            self._writer.limit(time.time())

    def _write(self, batch: _Batch) -> None:
        try:
            self._writer.write(*batch)
            self.problem = ''
        except sqlite3.Error as error:
            self.problem = f'{self.path}: {_reason(error)}; the history has a gap'


History = HistoryRecorder | ReadOnlyHistory


def _reason(error: BaseException) -> str:
    if isinstance(error, OSError) and error.strerror:
        return error.strerror.lower()
    return str(error)
