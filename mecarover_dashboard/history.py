# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""
The history of the last day: its SQLite file of windows and events, its writer and its reader.

A value is stored in thousandths, as an integer of few bytes, and only where it differs from the
window before: what is missing is carried forward. Each source has a whole window every 10 minutes,
so that reading can begin anywhere. WAL with synchronous=FULL: what is committed survives kill -9
and a power failure (sqlite.org, "Write-Ahead Logging", "PRAGMA synchronous").
"""
from __future__ import annotations

from collections.abc import Iterable
from collections.abc import Iterator
from contextlib import suppress
import os
from pathlib import Path
import sqlite3
from typing import NamedTuple

from msg_defs.diagnostics import Level
from servobus.printable_text import printable

VERSION = 1
WINDOW_S = 10
GAP_S = 30                      # so long without a window: nothing was recorded
VALUES = {                      # what is kept of each kind, in this order
    'devices': ('position', 'temperature', 'voltage', 'load', 'loss', 'latency'),
    'buses': ('bus_load', 'packet_rate', 'error_rate'),
    'bridge': (),
}
KEPT_S = 24 * 3600
MOST_BYTES = 200_000_000
WHOLE_S = 600                   # a window at a multiple of this is stored whole
_ROOM = 0.9                     # share of MOST_BYTES that stays when the oldest had to go
_WIDTH = max(map(len, VALUES.values()))
_COLUMNS = [f'{end}{at}' for at in range(_WIDTH) for end in ('low', 'high')]
_SCHEMA = f"""
    CREATE TABLE sources(id INTEGER PRIMARY KEY, name TEXT UNIQUE NOT NULL, kind TEXT NOT NULL,
                         robot TEXT NOT NULL, unit TEXT NOT NULL);
    CREATE TABLE windows(at INTEGER NOT NULL, source INTEGER NOT NULL, level INTEGER NOT NULL,
                         {', '.join(f'{name} INTEGER' for name in _COLUMNS)},
                         PRIMARY KEY(at, source)) WITHOUT ROWID;
    CREATE TABLE events(at REAL NOT NULL, source INTEGER NOT NULL, kind TEXT NOT NULL,
                        level INTEGER NOT NULL, text TEXT NOT NULL);
    CREATE INDEX events_at ON events(at);
    PRAGMA user_version = {VERSION};
"""
_FAR = 1e12                     # beyond this a value is not a measurement
_UNKNOWN = (1, 0)               # low above high: the value is not known, and not carried forward
_Pairs = tuple[tuple[int | None, int | None], ...]
Range = tuple[float, float]     # the lowest and the highest


class Subject(NamedTuple):
    """What a record is about: the status of this name."""

    name: str
    kind: str                   # a key of VALUES
    robot: str
    unit: str = ''              # `load` is in: % or A
    position_unit: str = ''     # rad or m


class Window(NamedTuple):
    """What a source was in the 10 s that begin at `at` (Unix s)."""

    at: int
    source: Subject
    level: Level                # the worst
    ranges: tuple[Range | None, ...]    # one for each of VALUES; None: nothing is known


class Event(NamedTuple):
    """Something that happened to a source; kind: 'state', 'finding', 'over' or 'error'."""

    at: float                   # Unix s
    source: Subject
    kind: str
    level: int
    text: str


class Question(NamedTuple):
    """
    What is asked of a history; times in Unix s.

    of: names of sources, none = all. points: of each source, about, where values are thinned out.
    """

    from_s: float
    to_s: float
    of: tuple[str, ...] = ()
    robot: str | None = None
    points: int = 1


class DamagedError(Exception):
    """The file is not a history that this version can read."""


class HistoryWriter:
    """The one that writes a history; used by one thread."""

    def __init__(self, path: Path) -> None:
        """Open or make the file; raise DamagedError, or sqlite3.Error where it cannot be."""
        self._database = sqlite3.connect(path, isolation_level=None, check_same_thread=False)
        try:
            self._prepare()
        except (sqlite3.DatabaseError, DamagedError) as error:
            self._database.close()
            if isinstance(error, sqlite3.OperationalError):
                raise
            raise DamagedError(str(error)) from error
        self._sources: dict[str, tuple[int, tuple[str, ...]]] = {}     # numbers and units
        self._written: dict[int, tuple[int, _Pairs]] = {}      # the last window of each source

    def _prepare(self) -> None:
        run = self._database.execute
        version = run('PRAGMA user_version').fetchone()[0]
        tables = run('SELECT count(*) FROM sqlite_master').fetchone()[0]
        if version > VERSION or (tables and not version):
            raise DamagedError(f'version {version} of the format is not known here')
        run('PRAGMA journal_mode = WAL')
        run('PRAGMA synchronous = FULL')
        run('PRAGMA journal_size_limit = 4000000')
        if not tables:
            self._database.executescript(f'BEGIN; {_SCHEMA} COMMIT;')
        elif (found := run('PRAGMA quick_check(1)').fetchone()[0]) != 'ok':
            raise DamagedError(found)
        if 'position_unit' not in {name for _, name, *_ in run('PRAGMA table_info(sources)')}:
            run("ALTER TABLE sources ADD COLUMN position_unit TEXT NOT NULL DEFAULT ''")

    def close(self) -> None:
        """Close the file."""
        self._database.close()

    def errors_until(self) -> dict[str, float]:
        """Return by source when its last recorded error was (Unix s)."""
        return dict(self._database.execute(
            "SELECT name, max(at) FROM events JOIN sources ON sources.id = source "
            "WHERE events.kind = 'error' AND typeof(at) IN ('real', 'integer') GROUP BY source"))

    def write(self, windows: Iterable[Window], events: Iterable[Event]) -> None:
        """Write and commit; raise sqlite3.Error where the disk does not take it."""
        run = self._database.execute
        run('BEGIN')
        try:
            marks = ', '.join('?' * (3 + len(_COLUMNS)))
            for window in windows:
                run(f'INSERT OR REPLACE INTO windows VALUES ({marks})', self._row(window))
            self._database.executemany('INSERT INTO events VALUES (?, ?, ?, ?, ?)', (
                (round(event.at, 2), self._number(event.source), event.kind, event.level,
                 event.text) for event in events))
            run('COMMIT')
        except BaseException:
            with suppress(sqlite3.Error):
                run('ROLLBACK')
            self._sources.clear()           # those that were new are not in the file
            self._written.clear()
            raise

    def _number(self, source: Subject) -> int:
        """Return the number of a source, a new one where it has none."""
        number, known = self._sources.get(source.name, (0, ()))
        units = source[3:]
        if not number or (any(units) and units != known):
            [[number]] = self._database.execute(
                'INSERT INTO sources(name, kind, robot, unit, position_unit) '
                "VALUES (?, ?, ?, ?, ?) ON CONFLICT(name) DO UPDATE "
                "SET unit = coalesce(nullif(excluded.unit, ''), unit), position_unit = "
                "coalesce(nullif(excluded.position_unit, ''), position_unit) RETURNING id", source)
            self._sources[source.name] = number, units
        return number

    def _row(self, window: Window) -> list[int | None]:
        """Return what is stored of a window: what differs from the one before."""
        number = self._number(window.source)
        at, before = self._written.get(number, (0, ()))
        if window.at < at:
            self._make_room(number, window.at)
        new = tuple(map(_stored, window.ranges))
        self._written[number] = window.at, new
        if at != window.at - WINDOW_S or window.at % WHOLE_S == 0:
            before = ((None, None),) * len(new)         # it is stored whole
        row = [None if pair == old else end
               for pair, old in zip(new, before, strict=True) for end in pair]
        return [window.at, number, window.level, *row, *[None] * (len(_COLUMNS) - len(row))]

    def _make_room(self, number: int, at: int) -> None:
        """If the clock was set back: drop values stored relative to a window that changes."""
        self._database.execute('DELETE FROM windows WHERE source = ? AND at BETWEEN ? AND ?',
                               (number, at, (at // WHOLE_S + 1) * WHOLE_S - 1))

    def limit(self, now_s: float) -> None:
        """Drop what is older than a day, and the oldest where the file is too large."""
        run = self._database.execute
        until = now_s - KEPT_S
        if self.bytes() > MOST_BYTES:
            oldest = run('SELECT min(at) FROM windows').fetchone()[0] or now_s
            until = max(until, oldest + (1 - _ROOM) * (now_s - oldest))
        run('DELETE FROM windows WHERE at < ?', (until,))
        run('DELETE FROM events WHERE at < ?', (until,))

    def bytes(self) -> int:
        """Return how much of the file is in use."""
        size, pages, free = (self._database.execute(f'PRAGMA {name}').fetchone()[0]
                             for name in ('page_size', 'page_count', 'freelist_count'))
        return int(size * (pages - free))


class HistoryReader:
    """Reads a history that another connection may write; made for one question."""

    def __init__(self, path: Path) -> None:
        # SQLite would make files beside one with a write-ahead log that it opens first.
        is_alone = is_read_only(path) and not path.with_name(f'{path.name}-shm').exists()
        self._database = sqlite3.connect(
            f'{path.absolute().as_uri()}?mode=ro{"&immutable=1" * is_alone}', uri=True,
            check_same_thread=False)
        self._database.text_factory = lambda text: printable(text.decode(errors='replace'))
        self._sources = {number: Subject(*rest) for number, *rest in self._database.execute(
            'SELECT * FROM sources')}       # an old file has no unit of positions

    def close(self) -> None:
        """Close the file."""
        self._database.close()

    def count(self, question: Question) -> int:
        """Return how many sources a question is about."""
        return len(self._numbers(question))

    def events(self, question: Question, most: int = 1000) -> list[Event]:
        """Return the newest events, the newest first."""
        marks = ', '.join(map(str, self._numbers(question)))
        return [Event(at, self._sources[source], kind, level, text)
                for at, source, kind, level, text in self._database.execute(
                    f'SELECT * FROM events WHERE at BETWEEN ? AND ? AND source IN ({marks}) '
                    'ORDER BY at DESC LIMIT ?', (question.from_s, question.to_s, most))]

    def gaps(self, from_s: float, to_s: float) -> list[tuple[float, float]]:
        """Return the spans of time in which nothing was recorded, of any source."""
        found, until = [], from_s
        for (at,) in self._database.execute(
                'WITH RECURSIVE times(t) AS (SELECT min(at) FROM windows WHERE at > ?1 - ?3 '
                'UNION ALL SELECT (SELECT min(at) FROM windows WHERE at > t) FROM times '
                'WHERE t IS NOT NULL) SELECT t FROM times WHERE t <= ?2',
                (from_s, to_s, WINDOW_S)):
            if at - until >= GAP_S:
                found.append((until, float(at)))
            until = at + WINDOW_S
        return [*found, (until, to_s)] if to_s - until >= GAP_S else found

    def windows(self, question: Question) -> Iterator[Window]:
        """Return the windows in the order of time."""
        from_s = int(question.from_s)
        held: dict[int, tuple[int, ...]] = {}
        [[last]] = self._database.execute('SELECT max(at) FROM windows')
        marks = ', '.join(map(str, self._numbers(question)))
        # To look each window up is as fast as to go through all, and faster where few are wanted.
        for at, number, level, *stored in self._database.execute(
                'WITH RECURSIVE times(t) AS (SELECT min(at) FROM windows WHERE at >= ?1 UNION ALL '
                'SELECT (SELECT min(at) FROM windows WHERE at > t) FROM times WHERE t < ?2) '
                f'SELECT windows.* FROM times CROSS JOIN windows ON at = t AND t <= ?2 '
                f'AND source IN ({marks})',
                (from_s // WHOLE_S * WHOLE_S, min(int(question.to_s), last or 0))):
            source = self._sources[number]
            count = len(VALUES[source.kind])
            before = held.get(number, _UNKNOWN * count)
            pairs = held[number] = tuple(
                old if new is None else new
                for new, old in zip(stored[:2 * count], before, strict=True))
            if at >= from_s // WINDOW_S * WINDOW_S:
                yield Window(at, source, Level(level), tuple(
                    (low / 1000, high / 1000) if low <= high else None
                    for low, high in zip(pairs[::2], pairs[1::2], strict=True)))

    def _numbers(self, question: Question) -> list[int]:
        names = set(question.of)
        return [number for number, source in self._sources.items()
                if (not names or source.name in names)
                and question.robot in (None, source.robot)]


def _stored(ends: Range | None) -> tuple[int, int]:
    """Return a range in thousandths."""
    if ends is None or max(map(abs, ends)) > _FAR:
        return _UNKNOWN
    return round(1000 * ends[0]), round(1000 * ends[1])


def widened(old: Range | None, new: Range | None) -> Range | None:
    """Return the range of both, as far as they are known."""
    return (min(old[0], new[0]), max(old[1], new[1])) if old and new else old or new


def is_read_only(path: Path) -> bool:
    """Tell whether there is a history that nothing can be added to: its folder is not writable."""
    return os.access(path, os.R_OK) and not os.access(path.parent, os.W_OK)


def set_aside(path: Path, now_s: float) -> Path:
    """Rename a damaged history, and what belongs to it; return its new name."""
    aside = path.with_name(f'{path.name}.damaged-{int(now_s)}')
    for end in ('', '-wal', '-shm'):
        with suppress(FileNotFoundError):
            path.with_name(path.name + end).rename(aside.with_name(aside.name + end))
    return aside
