# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""
Where a tool gets its bytes from: what all sources have in common, and files.

All give Chunks, in order; a live source (live.py) gives None too whenever nothing came for a
moment, so that a screen can be painted and time can end. opening.py opens one by its name.
"""
from __future__ import annotations

from collections.abc import Iterator
from io import BufferedReader
import os

from msg_defs.event import BAUD
from msg_defs.event import Chunk
from msg_defs.event import IN
from msg_defs.event import OUT
from msg_defs.event import UNKNOWN
from msg_defs.uart import IDLE_S
from servobus.printable_text import printable
from servobus.sources.byte_sides import ByteText
from servobus.sources.capture import BAD_TEXT_MAX_LENGTH
from servobus.sources.capture import ClockReading
from servobus.sources.capture import lines
from servobus.sources.capture import Reader
from servobus.sources.capture import Wire
from servobus.sources.source_name import DEFAULT_BAUD

READ_SIZE = 65_536
_BYTE_NS = 10_000_000_000          # over the baud rate
_PAUSE_NS = int(1.25e9 * IDLE_S)
Chunks = Iterator[Chunk | None]    # None: nothing came for a moment


class Source:
    """
    What all sources have in common, and a silent one.

    began: a moment on the wall-clock and on that of the stamps (wall 0: unknown). is_timed: the
    stamps are of a clock; else they count bytes at the baud rate. total: bytes, 0: unknown. ended:
    stamp of the end of a recording, 0: unknown.
    """

    is_live = False
    is_timed = True
    total = ended = 0

    def __init__(self) -> None:
        self.began = ClockReading(0, 0)
        self.wires: dict[str, Wire] = {}

    def chunks(self) -> Chunks:
        """Yield what comes; ends at the end of a file."""
        return iter(())

    def wire(self, bus: str) -> Wire:
        """Return what is known of a bus."""
        return self.wires.get(bus) or Wire(bus, DEFAULT_BAUD)

    def position(self) -> int:
        """Return how many bytes of `total` were read."""
        return 0

    def problems(self) -> list[str]:
        """Return what a person should know at the end."""
        return []

    def close(self) -> None:
        """Give up the port or the file."""


def keeps_rate(chunk: Chunk) -> bool:
    """Tell whether a chunk says nothing of the rate."""
    return chunk.change is None or chunk.change.what != BAUD


class File(Source):
    """A file or a pipe; baud overrides what it says, from the first chunk to the last."""

    def __init__(self, name: str, file: BufferedReader, baud: int | None) -> None:
        super().__init__()
        self._name = name
        self._file = file
        self._baud = baud
        self.total = os.fstat(file.fileno()).st_size if file.seekable() else 0
        self._begin()

    def _begin(self) -> None:
        """Say what is known before the first chunk."""

    def _add_bus(self, baud: int) -> None:
        """Say that there is one bus, named as the file."""
        self.wires[self._bus] = Wire(self._bus, baud, port=self._name)

    @property
    def _bus(self) -> str:
        return 'stdin' if self._name == '-' else os.path.basename(self._name).partition('.')[0]

    def chunks(self) -> Chunks:
        return (chunk for chunk in self._read() if self._baud is None or keeps_rate(chunk))

    def _read(self) -> Iterator[Chunk]:
        """Yield all that is in it."""
        raise NotImplementedError

    def wire(self, bus: str) -> Wire:
        wire = super().wire(bus)
        return wire if self._baud is None else wire._replace(baud=self._baud)

    def problems(self) -> list[str]:
        return [f'{self._name}: {problem}' for problem in self._problems()]

    def _problems(self) -> list[str]:
        """Return the problems of the file, without its name."""
        return []

    def learn_buses(self, chunks: Iterator[Chunk]) -> None:
        """Read on to the end, for what is known of all buses; chunks: those that are left."""
        for _ in chunks:
            pass

    def position(self) -> int:
        return self._file.tell() if self.total else 0

    def close(self) -> None:
        self._file.close()


class CaptureFile(File):
    """A capture."""

    def _begin(self) -> None:
        self._reader = Reader(lines(self._file))
        self.wires = self._reader.wires

    def _read(self) -> Iterator[Chunk]:
        for chunk in self._reader:
            self.began = self._reader.began
            yield chunk
        self.ended = self._reader.ended

    def learn_buses(self, chunks: Iterator[Chunk]) -> None:
        """Read the headers alone: the lines of chunks take 15 times as long."""
        headers = Reader(line for line in lines(self._file) if line.startswith(b'#'))
        list(headers)
        self.wires.update(headers.wires)

    def _problems(self) -> list[str]:
        return self._reader.problems()


class RawFile(File):
    """Bytes as they were on the wire, taken as sent without a pause."""

    is_timed = False
    read_size = READ_SIZE

    def _begin(self) -> None:
        self._add_bus(DEFAULT_BAUD)

    def _read(self) -> Iterator[Chunk]:
        name, baud, *_ = self.wire(self._bus)
        received = 0
        while data := self._file.read1(self.read_size):
            received += len(data)
            yield Chunk(1 + received * _BYTE_NS // baud, name, data)


class TextFile(File):
    """
    Bytes that a text shows; without exact times they are taken as sent without a pause.

    But before a question the line was idle: what is left of an answer then does not come.
    """

    def __init__(self, name: str, file: BufferedReader, baud: int | None, text: ByteText) -> None:
        self._text = text
        self.is_timed = text.is_timed
        super().__init__(name, file, baud)

    def _begin(self) -> None:
        self.total = 0
        self._add_bus(self._text.baud)         # most texts do not say it

    def _read(self) -> Iterator[Chunk]:
        name, baud = self._bus, self._baud or self._text.baud or DEFAULT_BAUD
        first = self._text.parts[0].time or 0
        sent, paused, last = 0, 0, UNKNOWN
        for data, side, time, change, _ in self._text.parts:
            before, sent = sent, sent + len(data)
            paused += _PAUSE_NS * (side == OUT and last == IN)
            last = side
            at = 1 + paused + (before if side == OUT else sent) * _BYTE_NS // baud
            if self.is_timed and time is not None:
                at = 1 + _BYTE_NS // baud + time - first       # its first bit is not before 0
            if data:
                yield Chunk(at, name, data, side)
            if change is not None:
                yield Chunk(at, name, change=change)

    def _problems(self) -> list[str]:
        """Say what the text was taken for, and what of it was not used."""
        text = f'read as {self._text.shape}: {len(self._text.data)} bytes'
        text += '' if self.is_timed else '; exact times are not known'
        text += f'; {self._text.flawed} of them have errors' * bool(self._text.flawed)
        text += self._text.cut + ''.join(f'; {one}' for one in self._text.notes)
        if unused := self._text.unused:
            number, line = next(iter(unused.items()))
            text += (f'; {len(unused)} line{"s" * (len(unused) > 1)} not used, the first is line '
                     f'{number}: {printable(line.strip(), BAD_TEXT_MAX_LENGTH)}')
        return [text]
