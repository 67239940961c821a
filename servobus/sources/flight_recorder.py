# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""
Flight recorder: the last minute of all buses in memory, and in a file when something goes wrong.

A file is a capture: what came before the fault, what came for half a minute after it, and as
remarks what the doctor said. One of a finding and device in ten minutes; the oldest files go.
"""
from __future__ import annotations

from collections import deque
from collections.abc import Callable
from contextlib import suppress
from datetime import datetime
from datetime import timezone
import os
from pathlib import Path
import re
import stat
import sys
import threading

from msg_defs.diagnostics import Level
from msg_defs.event import Chunk
from msg_defs.nanoseconds import NS_PER_S
from servobus.bus.report import BusReport
from servobus.bus.report import DISCONNECTED
from servobus.errors import ParameterError
from servobus.printable_text import printable
from servobus.sources.capture import ClockReading
from servobus.sources.capture import seconds
from servobus.sources.capture import Wire
from servobus.sources.capture_recorder import read_clocks
from servobus.sources.capture_recorder import Recorder
from servobus.worker import Worker

BEFORE_NS, AFTER_NS = 60 * NS_PER_S, 30 * NS_PER_S
REPEAT_NS = 600 * NS_PER_S         # the same finding of one device makes no file for so long
MEMORY_MAX_BYTES = 32_000_000      # bytes in memory, for each bus
CHUNK_OVERHEAD_BYTES = 250         # bytes of memory that a chunk takes besides its data
WAITING_MAX_BYTES = 1 << 30
_NAME, _NAME_SIZE = 'flight_', 80      # and the characters that follow the time
_NOT_IN_NAMES = re.compile(r'[^\w.-]')

Cause = tuple[str, str, int | None]        # bus, finding, device


class FlightRecorder:
    """
    Keeps what all buses said; `record_report` begins a file, and ends it when it is time.

    Raises ParameterError if the folder cannot be written to. `size`: of the folder, in bytes.
    All methods may be called from any thread.
    """

    def __init__(self, folder: str, size: int, buses: int,
                 now: Callable[[], ClockReading] = read_clocks) -> None:
        self.problem = ''
        self.path = ''                     # where the newest file is
        self._folder = Path(folder)
        self._size = size
        self._limit = buses * MEMORY_MAX_BYTES
        self._now = now
        self._lock = threading.Lock()               # for what is kept
        self._deciding = threading.RLock()          # whether a file begins or ends
        self._chunks: deque[tuple[Wire, Chunk]] = deque()
        self._kept = 0
        self._file: Recorder | None = None
        self._worker = Worker('flight recorder')    # one file at a time
        self._until = 0
        self._causes: dict[Cause, int] = {}         # when each began last
        self._standing: set[Cause] = set()
        try:
            self._folder.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise ParameterError(f'flight_recorder: {folder}: {error.strerror}; give another '
                                 'folder') from error
        if not os.access(self._folder, os.W_OK | os.X_OK):
            raise ParameterError(f'flight_recorder: {folder}: may not be written to; give another '
                                 'folder, or change its rights')

    @property
    def words(self) -> str:
        """What it does, for a person."""
        if self.problem:
            return self.problem
        return f'flight recorder: {"wrote" if self._file is None else "writing"} {self.path}' \
            if self.path else f'flight recorder: ready, {self._folder}'

    def start(self) -> None:
        """Have a thread for the files: when something happens, none may be left."""
        self._worker.start()

    def record_chunk(self, wire: Wire, chunk: Chunk) -> None:
        """Keep a chunk; without waiting."""
        with self._lock:
            self._chunks.append((wire, chunk))
            self._kept += len(chunk.data) + CHUNK_OVERHEAD_BYTES
            oldest = chunk.stamp - BEFORE_NS
            while self._kept > self._limit or self._chunks[0][1].stamp < oldest:
                self._kept -= len(self._chunks.popleft()[1].data) + CHUNK_OVERHEAD_BYTES
            if self._file is not None:
                self._file.record_chunk(wire, chunk)

    def record_report(self, bus: str, report: BusReport) -> None:
        """Begin a file for what is new and WARN or worse, or a lost device; end one in time."""
        with self._deciding:
            found: dict[Cause, str] = {
                (bus, one.rule, one.device): f'{one.level.name} {one.message}'
                for one in report.findings if one.level > Level.OK}
            for one in report.devices:
                if one.state == DISCONNECTED:
                    found[bus, 'lost', one.id] = f'{one.level.name} {one.message}'
            now = self._now()
            for cause, text in found.items():
                if cause not in self._standing:
                    self._began(cause, text, now)
            self._standing = {one for one in self._standing if one[0] != bus} | set(found)
            if self._file is not None:
                self.problem = self._file.problem
                if now.stamp > self._until:
                    self.stop()

    def _began(self, cause: Cause, text: str, now: ClockReading) -> None:
        bus, rule, device = cause
        words = f'{bus} {"bus" if device is None else f"{device:03}"} {rule}: {text}'
        is_new = now.stamp - self._causes.get(cause, -REPEAT_NS) >= REPEAT_NS
        if self._file is None and is_new:
            self._causes[cause] = now.stamp
            self.save(f'{bus}_{rule}' + ('' if device is None else f'_{device:03}'), now)
        if self._file is not None:
            self._causes.setdefault(cause, now.stamp)
            self._file.remark(f'finding at {seconds(now.stamp)}: {printable(words.strip())}')

    def save(self, why: str, now: ClockReading | None = None) -> str:
        """Begin a file, if none is being written; return its path, '' if it cannot be made."""
        with self._deciding:
            if self._file is not None:
                return self.path
            now = now or self._now()
            self.problem = ''
            self._make_room()
            time = datetime.fromtimestamp(now.wall / 1e9, timezone.utc).strftime('%Y%m%dT%H%M%SZ')
            name = _NOT_IN_NAMES.sub('_', why)[:_NAME_SIZE].strip('_')
            self.path = str(self._folder / f'{_NAME}{time}_{name}.txt')
            try:
                file = Recorder(self.path, sys.maxsize, 0, self._now, WAITING_MAX_BYTES)
            except (ParameterError, OSError) as error:
                self.problem = f'flight recorder: {error}'
                return ''
            with self._lock:
                for wire, chunk in self._chunks:
                    file.record_chunk(wire, chunk)
                first = self._chunks[0][1].stamp if self._chunks else now.stamp
                self._file = file
            file.remark(f'flight recorder: recording of {why}, with the '
                        f'{(now.stamp - first) / NS_PER_S:.1f} s before it')
            self._until = now.stamp + AFTER_NS
            file.start(self._worker)
            return self.path

    def _make_room(self) -> None:
        """Delete the oldest files, by the time in their names, until the others fit the folder."""
        total = 0
        for one in sorted(self._folder.glob(f'{_NAME}*.txt'), reverse=True):
            with suppress(OSError):             # somebody has just deleted it, or it is not ours
                status = one.lstat()
                if stat.S_ISREG(status.st_mode):        # a link to one of them is not ours
                    total += status.st_size
                    if total > self._size:
                        one.unlink()

    def stop(self) -> None:
        """End the file that is being written."""
        with self._deciding:
            with self._lock:
                file, self._file = self._file, None
            if file is not None:
                file.stop()
                self.problem = file.problem
