# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""
The statuses in a serialised DiagnosticArray, without ROS: read what is looked at, skip the rest.

A dashboard looks at one table out of 253; leaving the others as bytes costs a seventh of letting
rclpy make objects of them. And text that is not UTF-8 is shown with U+FFFD: rclpy would raise in
the executor. So are control codes: texts go on to terminals and files. Source: OMG CDR (XCDR1),
alignment counted from the byte after the first four.
"""
from __future__ import annotations

from collections.abc import Sequence
from contextlib import suppress
from struct import error as StructError
from struct import Struct
from typing import NamedTuple

from msg_defs.diagnostics import Pairs
from msg_defs.diagnostics import Status
from servobus.printable_text import printable

TEXT_LIMIT = 500            # characters of one text that reach the page
PAIRS_LIMIT = 4096          # in a status: the longest control table has a few hundred
STATUSES_READ_MAX = 5000       # in a message: ten full buses have half of it
_BYTES_OF_PAIR = 40           # about
_FRONT = 4                  # representation and options
_STAMP = 8


class CdrError(ValueError):
    """Bytes that are no DiagnosticArray."""


class RawStatus(NamedTuple):
    """
    A status with values that are still bytes: `count` pairs in `data` from `at` on.

    `data` are its own: a status that is kept must not keep the message it came in.
    """

    level: int
    name: str
    message: str
    hardware_id: str
    data: bytes
    at: int
    count: int  # type: ignore[assignment]      # the field's name, not tuple.count

    @property
    def size(self) -> int:
        return len(self.data)

    def pairs(self, first: int | None = None, limit: int = TEXT_LIMIT) -> Pairs:
        """Return the first so many (key, value) pairs, by default all, long texts cut."""
        count = self.count if first is None else min(first, self.count)
        texts = iter(_Cursor(self.data, self.at).texts(2 * count, limit))
        return list(zip(texts, texts, strict=True))

    def find(self, start: bytes) -> tuple[str, str] | None:
        """Return the first pair with a key that begins with ASCII text; None if there is none."""
        data, at = self.data, self.at
        while (at := data.find(start, at)) >= 0:
            if at % 4 == 0:                     # a text begins after its aligned length
                with suppress(StructError, IndexError):
                    key, value = _Cursor(data, at - 4).texts(2)
                    if key.startswith(start.decode()):
                        return key, value
            at += 1
        return None


class HandedStatus(NamedTuple):
    """The same of a status that was never serialised: its values as they were handed over."""

    level: int
    name: str
    message: str
    hardware_id: str
    values: Sequence[tuple[str, str]]

    @property
    def count(self) -> int:  # type: ignore[override]
        return len(self.values)

    @property
    def size(self) -> int:
        return _BYTES_OF_PAIR * len(self.values)

    def pairs(self, first: int | None = None, limit: int = TEXT_LIMIT) -> Pairs:
        """Return the first so many (key, value) pairs, by default all, long texts cut."""
        return [(printable(key, limit), printable(value, limit))
                for key, value in self.values[:first]]

    def find(self, start: bytes) -> tuple[str, str] | None:
        """Return the first pair with a key that begins with ASCII text; None if there is none."""
        text = start.decode()
        return next(((printable(key, TEXT_LIMIT), printable(value, TEXT_LIMIT))
                     for key, value in self.values if key.startswith(text)), None)


AnyStatus = RawStatus | HandedStatus
Message = bytes | Sequence[Status]


def statuses(message: Message) -> Sequence[AnyStatus]:
    """Return the statuses of a DiagnosticArray; raise CdrError if what is serialised is none."""
    if not isinstance(message, bytes):
        return [HandedStatus(one.level, printable(one.name, TEXT_LIMIT),
                             printable(one.message, TEXT_LIMIT),
                             printable(one.hardware_id, TEXT_LIMIT), one.values)
                for one in message]
    try:
        reader = _Cursor(message, _FRONT + _STAMP)
        reader.skip(1)                          # frame_id
        return [reader.status() for _ in range(min(reader.number(), STATUSES_READ_MAX))]
    except (StructError, IndexError) as error:
        raise CdrError(f'no DiagnosticArray: {error}') from error


class _Cursor:
    """Walks through serialised data; `at` is the offset of what comes next."""

    __slots__ = ('_number', 'at', 'data')

    def __init__(self, data: bytes, at: int) -> None:
        self.data = data
        self.at = at
        self._number = Struct('<I' if data[1] & 1 else '>I').unpack_from

    def number(self) -> int:
        at = (self.at + 3) & -4
        self.at = at + 4
        return int(self._number(self.data, at)[0])

    def texts(self, count: int, limit: int = TEXT_LIMIT) -> list[str]:
        """Return the next so many texts; this is the hot loop, and so is skip."""
        number, data, at = self._number, self.data, self.at
        found = []
        for _ in range(count):
            at = (at + 3) & -4                  # _FRONT is a multiple of 4 itself
            size = number(data, at)[0]
            at += 4
            if size <= limit:
                found.append(printable(str(data[at:at + size - 1], 'utf-8', 'replace')))
            else:
                found.append(_cut(data[at:at + min(size - 1, 4 * limit)], size - 1, limit))
            at += size
        if at > len(data):
            raise IndexError('text goes beyond the end of the message')
        self.at = at
        return found

    def skip(self, texts: int) -> None:
        """Skip so many texts."""
        number, data, at = self._number, self.data, self.at
        for _ in range(texts):
            at = (at + 3) & -4
            at += 4 + number(data, at)[0]
        if at > len(data):
            raise IndexError('text goes beyond the end of the message')
        self.at = at

    def status(self) -> RawStatus:
        level = self.data[self.at]
        self.at += 1
        name, message, hardware_id = self.texts(3)
        count = self.number()
        at = self.at
        self.skip(2 * count)
        begin = at & -4                     # alignment goes on as it was
        return RawStatus(level, name, message, hardware_id,
                         self.data[:_FRONT] + self.data[begin:self.at],
                         at - begin + _FRONT, min(count, PAIRS_LIMIT))


def _cut(data: bytes, size: int, limit: int) -> str:
    """Decode the beginning of a text of `size` bytes and say so where there is more."""
    text = printable(data.decode('utf-8', 'replace'))
    if len(text) <= limit and len(data) >= size:
        return text
    return f'{text[:limit]}\u2026 ({size} bytes)'
