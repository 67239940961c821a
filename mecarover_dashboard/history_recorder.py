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

from collections.abc import Callable
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
from mecarover_dashboard.history import Window
from mecarover_dashboard.history import WINDOW_S
from mecarover_dashboard.robot_parts import is_lost
from mecarover_dashboard.robot_parts import level_of
from mecarover_dashboard.robot_parts import RobotPart
from mecarover_dashboard.rows import Row
from mecarover_dashboard.state import RowReport
from mecarover_dashboard.state import State
from msg_defs.reports import Level
from msg_defs.reports import SEVERITY

EVENT_FLUSH_S = 5.0
LIMIT_S = 300.0                 # between two looks at the size
_MOST_WAITING = 24              # batches, at least two minutes: what comes later is lost
NAME = 'history.sqlite'
MOST_ERRORS = 20                # for one bus in one window; noise would fill the file

_Batch = tuple[list[Window], list[Event]]


@dataclass(slots=True)
class _LastSeen:
    """What was seen of a source last."""

    arrived: float = -1.0
    state: tuple[int, str] | None = None
    logged_text: str = ''              # the text of its last state that was noted
    findings: dict[str, bool] = field(default_factory=dict)     # rules; whether it was noted
    row: Row = field(default_factory=dict)
    window: Window | None = None
    is_new: bool = False        # the window is not written as it is now
    ran_s: float = 0.0          # for how long the monitor of this bus had been running
    errors: int = 0             # in this window
    error_s: float | None = None    # monotonic s of the last one that was noted

    def is_restarted(self, bus: RowReport) -> bool:
        """Tell whether the monitor runs for much less time than before: it is another one."""
        if bus.row['started'] is None:
            return False
        before, self.ran_s = self.ran_s, bus.arrived - bus.row['started']
        return self.ran_s < before / 2


class HistorySampler:
    """Looks at a State again and again; `take_batch` gives what there is to keep since then."""

    def __init__(self, errors_until: dict[str, float] | None = None) -> None:
        self._seen: dict[str, _LastSeen] = {}
        self._done: list[Window] = []
        self._events: list[Event] = []
        self._until = dict(errors_until or {})      # for each bus Unix s of its last error
        self._flushed_s = 0.0       # monotonic s
        self._flushed_at = 0        # the window that ran then

    def sample_state(self, state: State, now_s: float, unix_s: float) -> None:
        """Take in what was reported since the last look."""
        offset_s = unix_s - now_s
        parts = {(part.node, part.bus): part for part in state.parts()}
        buses = list(state.reports('buses'))
        own = {report.row_name: report.row for report in buses}
        restarted = {(one.row['node'], one.row['bus']) for one in buses
                     if self._last(one.row_name).is_restarted(one)}
        for part in parts.values():
            self._judge_part(part, own.get(part.row_name), unix_s)
        away: dict[tuple[str, str], set[str]] = {}
        for one in state.reports('devices'):
            if is_lost(one.row):
                away.setdefault((one.row['node'], one.row['bus']), set()).add(
                    f'{one.row["id"]:03}')
        for kind in VALUES:
            for report in state.reports(kind):
                row = report.row
                last = self._last(report.row_name)
                source = Subject(report.row_name, kind, row['robot'], report.values.unit)
                part = parts[row['node'], row.get('bus')]
                is_of_part = (kind == 'devices' and part.hides_devices) or not part.is_known
                if (row['node'], row.get('bus')) in restarted:
                    self._forget_findings(last, source, unix_s)
                if row is not last.row and not is_of_part:
                    last.row = row
                    if kind == 'devices':
                        self._judge_device(last, source, row, own.get(part.row_name), unix_s)
                    elif kind == 'buses':
                        self._judge_findings(last, source, row, None, unix_s)
                if report.arrived == last.arrived:
                    continue
                last.arrived = report.arrived
                self._add(last, source, report, state, unix_s)
                if kind == 'buses':
                    self._add_errors(last, source, row, offset_s,
                                      away.get((row['node'], row['bus']), set()))

    def _last(self, name: str) -> _LastSeen:
        last = self._seen.get(name)
        if last is None:
            last = self._seen[name] = _LastSeen()
        return last

    def is_due(self, now_s: float, unix_s: float) -> bool:
        """Tell whether to write now: windows have ended, or there are events."""
        at = _window_at(unix_s)
        if at == self._flushed_at and not (
                self._events and now_s - self._flushed_s >= EVENT_FLUSH_S):
            return False
        self._flushed_s, self._flushed_at = now_s, at
        return True

    def take_batch(self, unix_s: float = math.inf) -> tuple[list[Window], list[Event]]:
        """Return what to write: windows that ended until then, and events."""
        windows, events = self._done, self._events
        self._done, self._events = [], []
        for last in self._seen.values():
            if last.is_new and last.window is not None and last.window.at + WINDOW_S <= unix_s:
                windows.append(last.window)
                last.is_new = False
        return windows, events

    def _add(self, last: _LastSeen, source: Subject, report: RowReport, state: State,
             unix_s: float) -> None:
        at = _window_at(unix_s)
        values = tuple(_values(source.kind, report, state))
        level = report.row['level']
        old, is_written, last.is_new = last.window, not last.is_new, True
        if old is None or old.at != at:
            if old is not None and not is_written:
                self._done.append(old)
            last.window, last.errors = Window(at, source, level, values, values), 0
            return
        last.window = Window(
            at, source, max(old.level, level, key=SEVERITY.index),
            tuple(_extremes(min, old.lows, values)), tuple(_extremes(max, old.highs, values)))

    def _judge_part(self, part: RobotPart, row: Row | None, unix_s: float) -> None:
        """Note what became of a bridge or a bus as a whole; what a finding says is noted there."""
        last, source = self._last(part.row_name), Subject(part.row_name, 'bridge', part.robot)
        now = part.level, part.problem
        if not part.of_part or part.of_part in _texts(row):
            now = Level.OK, ''
        if now != (last.state or (Level.OK, '')):
            text = part.text if now == (part.level, part.problem) \
                else f'{part.live} of {part.total} devices answer'
            if part.bus is not None:
                source = source._replace(kind='buses')
            self._events.append(Event(unix_s, source, 'state', part.level, text))
        last.state = now

    def _judge_device(self, last: _LastSeen, source: Subject, row: Row, bus: Row | None,
                      unix_s: float) -> None:
        """Note a change of level or state; what a finding says is noted as that."""
        now = level_of(row), row['state']
        before = last.state or (Level.OK, now[1])
        is_of_finding = row['message'] in _texts(row) and not is_lost(row)
        if now != before and not (is_of_finding and now[1] == before[1]):
            self._events.append(Event(unix_s, source, 'state', now[0], row['message']))
            last.state, last.logged_text = now, row['message']
        last.state = last.state or before
        if not is_lost(row):
            self._judge_findings(last, source, row, bus, unix_s)

    def _judge_findings(self, last: _LastSeen, source: Subject, row: Row, bus: Row | None,
                        unix_s: float) -> None:
        found = {rule: (Level.ERROR if severity == 'error' else Level.WARN, text)
                 for rule, text, severity in row['findings']}
        # What another one accounts for is not reported any more, and not over either.
        causes = set() if bus is None else {rule for rule, _, _ in bus['findings']}
        is_explained = any(rule not in last.findings and severity != 'ok'
                           for rule, _, severity in row['findings'])
        for rule, (level, text) in found.items():
            if rule not in last.findings:
                last.findings[rule] = text != last.logged_text
                if text != last.logged_text:
                    self._events.append(
                        Event(unix_s, source, 'finding', level, f'{_words(rule)}: {text}'))
        for rule in last.findings.keys() - found.keys():
            if last.findings.pop(rule) and not (is_explained or rule in causes):
                self._events.append(Event(unix_s, source, 'over', Level.OK, _words(rule)))

    def _forget_findings(self, last: _LastSeen, source: Subject, unix_s: float) -> None:
        """Note that a new monitor, which has read nothing yet, does not clear what was found."""
        self._events += [Event(unix_s, source, 'finding', Level.STALE,
                               f'{_words(rule)}: not known since the monitor was started again')
                         for rule, is_noted in last.findings.items() if is_noted]
        last.findings.clear()

    def _add_errors(self, last: _LastSeen, source: Subject, row: Row, offset_s: float,
                     away: set[str]) -> None:
        """Note the errors that are new, the oldest first, but for those of devices away."""
        if last.error_s is None:
            last.error_s = self._until.get(source.name, 0.0) - offset_s + rows.JITTER_S
        new = [(at_s, text) for at_s, text in row['errors']
               if at_s is not None and at_s > last.error_s]
        for at_s, text in sorted(new):
            last.error_s, at = at_s, at_s + offset_s      # the two clocks tremble: one judges
            if text.partition(': ')[0] in away:
                continue
            last.errors += 1
            if last.errors < MOST_ERRORS:
                self._events.append(Event(at, source, 'error', Level.ERROR, text))
            elif last.errors == MOST_ERRORS:
                self._events.append(Event(at, source, 'error', Level.ERROR,
                                          f'{text}; more errors in these {WINDOW_S} s are not '
                                          'listed'))


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


def _extremes(choose: Callable[[list[float]], float], old: tuple[float | None, ...],
              new: tuple[float | None, ...]) -> Iterator[float | None]:
    """Return the lowest (min) or the highest (max) of each value, as far as it is known."""
    for both in zip(old, new, strict=True):
        known = [one for one in both if one is not None]
        yield choose(known) if known else None


def _words(rule: str) -> str:
    return rule.replace('_', ' ')


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
        self._batches.put(None)
        self._thread.join(5.0)
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
