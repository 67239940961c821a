# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""
The black box at work: takes what the recorder saw to the file, in a thread of its own.

A disk may stop for seconds, so the server never waits for it. Every FLUSH_S all that is known goes
to the file, windows that still run included: this is what kill -9 or a power failure can cost.
"""
from __future__ import annotations

from contextlib import suppress
import fcntl
import os
from pathlib import Path
import queue
import sqlite3
import threading
import time

from mecarover_dashboard.history import DamagedError
from mecarover_dashboard.history import HistoryWriter
from mecarover_dashboard.history import set_aside
from mecarover_dashboard.recorder import Event
from mecarover_dashboard.recorder import HistoryRecorder
from mecarover_dashboard.recorder import Window
from mecarover_dashboard.state import State

FLUSH_S = 5.0
LIMIT_S = 300.0                 # between two looks at the size
_MOST_WAITING = 24              # batches, two minutes: a disk that hangs longer costs the rest
NAME = 'history.sqlite'

_Batch = tuple[list[Window], list[Event]]


class RecordingError(Exception):
    """One line why nothing can be recorded: the file, the reason, the remedy."""


def default_path() -> Path:
    """Return where the history is: in the state folder of the service, or of the user."""
    folder = os.environ.get('STATE_DIRECTORY', '').partition(':')[0]
    if folder:
        return Path(folder) / NAME
    state = os.environ.get('XDG_STATE_HOME') or Path.home() / '.local' / 'state'
    return Path(state) / 'mecarover_serial' / NAME


class Recording:
    """Records a State until it is closed; `path` can be read meanwhile."""

    def __init__(self, path: Path) -> None:
        """Open the file, set a damaged one aside; raise RecordingError where that fails."""
        self.path = path
        self.notice = ''        # what became of a file that was there
        self.problem = ''       # why nothing is written now
        try:
            path.parent.mkdir(mode=0o700, parents=True, exist_ok=True)
            self._take_lock(path.with_name(f'{path.name}.lock'))
            self._writer = self._open()
        except (OSError, sqlite3.Error) as error:
            raise RecordingError(f'{path}: {_reason(error)}; give another file with --history '
                                 'FILE, or --history none') from error
        self._recorder = HistoryRecorder(self._writer.errors_until())
        self._batches: queue.Queue[_Batch | None] = queue.Queue(_MOST_WAITING)
        self._flushed_s = time.monotonic()
        self._thread = threading.Thread(target=self._run, name='history', daemon=True)
        self._thread.start()

    def _take_lock(self, path: Path) -> None:
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

    def look(self, state: State, now_s: float, unix_s: float) -> None:
        """Take in what was reported; never waits."""
        self._recorder.look(state, now_s, unix_s)
        if now_s - self._flushed_s >= FLUSH_S:
            self._flushed_s = now_s
            self._hand_over()

    def _hand_over(self) -> None:
        try:
            self._batches.put_nowait(self._recorder.taken())
        except queue.Full:
            self.problem = f'{self.path}: the disk is too slow, so part of the history is lost'

    def close(self) -> None:
        """Write what is known and end."""
        self._hand_over()
        self._batches.put(None)
        self._thread.join(5.0)
        os.close(self._lock)

    def _run(self) -> None:
        limited_s = 0.0
        while (batch := self._batches.get()) is not None:
            self._write(batch)
            if time.monotonic() - limited_s > LIMIT_S:
                limited_s = time.monotonic()
                with suppress(sqlite3.Error):
                    self._writer.limit(time.time())
        self._writer.close()

    def _write(self, batch: _Batch) -> None:
        try:
            self._writer.write(*batch)
            self.problem = ''
        except sqlite3.Error as error:
            self.problem = f'{self.path}: {_reason(error)}; the history has a gap'


def _reason(error: BaseException) -> str:
    if isinstance(error, OSError) and error.strerror:
        return error.strerror.lower()
    return str(error)
