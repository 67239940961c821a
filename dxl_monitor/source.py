# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""
Where a tool gets its bytes from: a port, a pyserial URL, a capture, a file of bytes, or stdin.

Captures and raw bytes are told apart by content. All give Chunks, in order; a live source gives
None too whenever nothing came for a moment, so that a screen can be painted and time can end.
"""
from __future__ import annotations

from collections.abc import Iterator
from io import BufferedReader
from itertools import chain
import os
import queue
import stat
import sys
import time

from dxl_monitor.capture import Chunk
from dxl_monitor.capture import lines
from dxl_monitor.capture import MAGIC
from dxl_monitor.capture import Moment
from dxl_monitor.capture import Reader
from dxl_monitor.capture import Wire
from dxl_monitor.recorder import moment
from dxl_monitor.tap import Tap
from mecarover_serial.cli import UsageError
from mecarover_serial.port import PortError
from mecarover_serial.preflight import why_not

DEFAULT_BAUD = 2_000_000
TICK_S = 0.1
READ_SIZE = 65_536
QUEUED_LIMIT = 100_000             # chunks that wait because our output is not taken
_BYTE_NS = 10_000_000_000          # over the baud rate
_PACKED = {b'\x1f\x8b\x08': 'gzip', b'\xfd7zXZ': 'xz', b'\x28\xb5\x2f\xfd': 'zstd',
           b'BZh': 'bzip2', b'PK\x03\x04': 'zip'}


class Source:
    """
    What all sources have in common, and a silent one.

    began: a moment on the wall-clock and on that of the stamps (wall 0: unknown). is_timed: the
    stamps are of a clock; else they count bytes at the baud rate. total: bytes, 0: unknown.
    """

    is_live = False
    is_timed = True
    total = 0

    def __init__(self) -> None:
        self.began = Moment(0, 0)
        self.wires: dict[str, Wire] = {}

    def chunks(self) -> Iterator[Chunk | None]:
        """Yield what comes; ends at the end of a file."""
        return iter(())

    def wire(self, bus: str) -> Wire:
        """Return what is known of a bus."""
        return self.wires.get(bus) or Wire(bus, DEFAULT_BAUD)

    def position(self) -> int:
        """Return how many bytes of `total` are behind us."""
        return 0

    def problems(self) -> list[str]:
        """Return what a person should know at the end."""
        return []

    def close(self) -> None:
        """Give up the port or the file."""


class File(Source):
    """A file or a pipe, of whatever is in it; `head` was read of it already."""

    def __init__(self, name: str, file: BufferedReader, head: bytes) -> None:
        super().__init__()
        self._name = name
        self._file = file
        self._head = head
        status = os.fstat(file.fileno())
        self.total = status.st_size if stat.S_ISREG(status.st_mode) else 0

    def position(self) -> int:
        return self._file.tell() if self.total else 0

    def close(self) -> None:
        self._file.close()


class CaptureFile(File):
    """A capture; baud overrides what it says."""

    def __init__(self, name: str, file: BufferedReader, head: bytes, baud: int | None) -> None:
        super().__init__(name, file, head)
        self._baud = baud
        self._reader = Reader(chain((head + file.readline(READ_SIZE),), lines(file)))
        self.wires = self._reader.wires

    def chunks(self) -> Iterator[Chunk | None]:
        for chunk in self._reader:
            self.began = self._reader.began
            yield chunk

    def wire(self, bus: str) -> Wire:
        wire = super().wire(bus)
        return wire if self._baud is None else wire._replace(baud=self._baud)

    def problems(self) -> list[str]:
        return [f'{self._name}: {problem}' for problem in self._reader.problems()]


class RawFile(File):
    """Bytes as they were on the wire, taken as sent without a pause."""

    is_timed = False
    read_size = READ_SIZE

    def __init__(self, name: str, file: BufferedReader, head: bytes, baud: int | None) -> None:
        super().__init__(name, file, head)
        bus = 'stdin' if name == '-' else os.path.basename(name).partition('.')[0]
        self._wire = self.wires[bus] = Wire(bus, baud or DEFAULT_BAUD, port=name)

    def chunks(self) -> Iterator[Chunk | None]:
        name, baud, *_ = self._wire
        received = 0
        head, self._head = self._head, b''
        while data := head or self._file.read1(self.read_size):
            head = b''
            received += len(data)
            yield Chunk(1 + received * _BYTE_NS // baud, name, data)


class LivePort(Source):
    """A port, listened to by a thread, so that a slow terminal loses nothing."""

    is_live = True

    def __init__(self, name: str, baud: int) -> None:
        super().__init__()
        self.began = moment()
        self._bus = os.path.basename(name.rstrip('/')) or name
        self._queue: queue.SimpleQueue[Chunk] = queue.SimpleQueue()
        self._lost = 0
        self._words = ''
        self._tap = Tap(name, baud, self._take)
        self._tap.start()
        while self._tap.state.kind == 'starting':
            time.sleep(0.005)
        if not self._tap.state.is_open:
            words = self._tap.state.text
            self._tap.stop()
            raise ConnectionError(words)
        self.wires[self._bus] = Wire(self._bus, baud, self._tap.latency_timer_ms or 0, name)

    def _take(self, data: bytes, stamp: int) -> None:
        if self._queue.qsize() > QUEUED_LIMIT:
            self._lost += len(data)
        else:
            self._queue.put(Chunk(stamp, self._bus, data))

    def chunks(self) -> Iterator[Chunk | None]:
        while True:
            yield self._next()

    def _next(self) -> Chunk | None:
        try:
            return self._queue.get(timeout=TICK_S)
        except queue.Empty:
            self._tell_state()
            return None

    def problems(self) -> list[str]:
        errors = self._tap.counters.line_errors
        lost = errors.buf_overrun + errors.overrun if errors is not None else 0
        return [text for count, text in (
            (self._lost, f'{self._lost} bytes were not shown: the output was too slow'),
            (lost, f'the driver lost bytes {lost} times (overrun)')) if count]

    def close(self) -> None:
        self._tap.stop()

    def _tell_state(self) -> None:
        words = '' if self._tap.state.is_open else self._tap.state.text
        if words != self._words:
            print(f'dxl_dump: {words or "the port is open again"}', file=sys.stderr)
            self._words = words


def open_source(name: str, baud: int | None) -> Source:
    """Return the source of this name, open; raise PortError, OSError or UsageError."""
    if name == '-':
        if sys.stdin.isatty():
            raise UsageError('-: nothing comes from a terminal; pipe bytes or a capture into it')
        return _file(name, open(sys.stdin.fileno(), 'rb', closefd=False), baud)
    if '://' in name or _is_device(name):
        return LivePort(name, DEFAULT_BAUD if baud is None else baud)
    return open_file(name, baud)


def open_file(name: str, baud: int | None) -> File:
    """Return a capture or a file of bytes as a source."""
    return _file(name, open(name, 'rb'), baud)


def _is_device(name: str) -> bool:
    try:
        mode = os.stat(name).st_mode
    except OSError as error:
        if isinstance(error, FileNotFoundError) and not name.startswith('/dev/'):
            raise FileNotFoundError(error.errno, 'no such file or port; check the name',
                                    name) from error
        raise PortError(name, why_not(name, error)) from error
    if stat.S_ISDIR(mode):
        raise UsageError(f'{name}: a directory; give a port, a capture or a file of bytes')
    return stat.S_ISCHR(mode)


def _file(name: str, file: BufferedReader, baud: int | None) -> File:
    head = b''
    # A pipe gives what is there, at least a byte: that is too few to tell.
    while MAGIC.startswith(head) and (more := file.read1(len(MAGIC) - len(head))):
        head += more
    packed = next((kind for front, kind in _PACKED.items() if head.startswith(front)), None)
    if packed is not None:
        file.close()
        raise UsageError(f'{name}: packed with {packed}; unpack it first')
    return (CaptureFile if head == MAGIC else RawFile)(name, file, head, baud)
