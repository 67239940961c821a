# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""
The recorder of a running monitor: chunks of any bus to a capture that rotates by size.

Writing is done by a thread of its own, so that a slow disk never holds up a port; what waits is
bounded, and what had to be left out is said in the file. An error ends the capture, no more.
"""
from __future__ import annotations

from collections.abc import Callable
from contextlib import suppress
import os
import sys
import threading
import time

from msg_defs.event import Chunk
from servobus.errors import ParameterError
from servobus.sources.capture import check_new
from servobus.sources.capture import ClockReading
from servobus.sources.capture import ENDED
from servobus.sources.capture import open_new
from servobus.sources.capture import seconds
from servobus.sources.capture import Wire
from servobus.sources.capture import Writer
from servobus.worker import Worker

FLUSH_EVERY_S = 0.2
STOP_PATIENCE_S = 3.0               # the end waits no longer for what takes nothing
WAITING_MAX_BYTES = 16_000_000      # bytes: more than a minute of a busy bus


def read_clocks() -> ClockReading:
    """Return the time on both clocks."""
    return ClockReading(time.time_ns(), time.monotonic_ns())


class Recorder:
    """
    Records to `path`; a file of `size` bytes becomes `path`.1, that one `path`.2, up to `kept`.

    A capture that is there already is moved on likewise. Raises ParameterError when the file
    cannot be made. `problem` says why it stopped, '' while it records.
    """

    def __init__(self, path: str, size: int, kept: int,
                 now: Callable[[], ClockReading] = read_clocks,
                 waiting_limit: int = 0) -> None:
        self.path = path
        self.problem = ''
        self.left_out = 0           # bytes, since the disk was too slow
        self._size = size
        self._kept = kept
        self._now = now
        self._waiting_limit = waiting_limit or WAITING_MAX_BYTES
        self._remarks: list[str] = []
        self._lock = threading.Lock()
        self._waiting: list[tuple[Wire, Chunk]] = []
        self._waiting_bytes = 0
        self._gap: int | None = None            # stamp of the first chunk left out
        self._is_stopping = threading.Event()
        self._begin_file()
        if not os.path.isfile(path):
            self._size = sys.maxsize            # a pipe has no older files
        self._done = threading.Event()          # nothing is being written
        self._done.set()

    @property
    def words(self) -> str:
        """What it does, or why it does not, for a person."""
        return self.problem or f'recording to {self.path}'

    def start(self, worker: Worker | None = None) -> None:
        """Begin to write, in the thread of a worker; None: of a new one."""
        worker = worker or Worker('recorder')
        worker.start()
        self._done = worker.call(self._run)

    def remark(self, text: str) -> None:
        """Record a line for people."""
        with self._lock:
            self._remarks.append(text)

    def record_chunk(self, wire: Wire, chunk: Chunk) -> None:
        """Record a chunk; from any thread, and without waiting."""
        if self.problem:
            return
        with self._lock:
            if self._waiting_bytes > self._waiting_limit:
                self.left_out += len(chunk.data)
                self._gap = self._gap or chunk.stamp
            else:
                self._waiting_bytes += len(chunk.data)
                self._waiting.append((wire, chunk))

    def stop(self) -> None:
        """Write what is left and close the file; give up what is not taken, as a full pipe."""
        self._is_stopping.set()
        size = -1
        while not self._done.is_set() and size != self._writer.size:     # it still gets on
            size = self._writer.size
            self._done.wait(STOP_PATIENCE_S)
        if not self._done.is_set():
            self.problem = (f'capture stopped: {self.path}: no data could be written; what was '
                            'not written yet is lost')

    def _run(self) -> None:
        try:
            while not self._is_stopping.wait(FLUSH_EVERY_S):
                self._write()
            self._write()
            self._writer.remark(f'{ENDED}{seconds(self._now().stamp)}')
        except (OSError, ParameterError, MemoryError) as error:
            reason = error.strerror if isinstance(error, OSError) else None
            self.problem = (f'capture stopped: {self.path}: {reason or error or "no memory"}; '
                            'make room and restart the node')
        with suppress(OSError):     # what could not be written before
            self._file.close()

    def _write(self) -> None:
        with self._lock:
            waiting, self._waiting = self._waiting, []
            remarks, self._remarks = self._remarks, []
            gap, self._gap = self._gap, None
            self._waiting_bytes = 0
        for wire, chunk in waiting:
            self._writer.write_chunk(wire, chunk)
            if self._writer.size >= self._size:
                self._file.close()
                self._begin_file()
        for text in remarks:
            self._writer.remark(text)
        if gap is not None:
            self._writer.remark(f'gap: the disk was too slow from {seconds(gap)} on, '
                                f'{self.left_out} bytes left out so far')
        self._file.flush()

    def _begin_file(self) -> None:
        check_new(self.path)
        self._make_room()
        self._file = open_new(self.path, waits=False)
        self._writer = Writer(self._file, self._now())

    def _make_room(self) -> None:
        """Rename the file and the older ones; what is not a file (a pipe, /dev/null) stays."""
        if not os.path.isfile(self.path) or not os.path.getsize(self.path):
            return
        for number in range(self._kept, 0, -1):
            newer = self.path if number == 1 else f'{self.path}.{number - 1}'
            with suppress(FileNotFoundError):
                os.replace(newer, f'{self.path}.{number}')
