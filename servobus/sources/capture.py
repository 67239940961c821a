# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""
The capture file: every chunk of bytes as it was read, with its stamp, one line of text each.

    # dxl_capture 2 began 2026-09-21T14:13:20.123456Z at 12345.678901234
    # bus ttyUSB0 baud 2000000 latency_timer_ms 1 port /dev/ttyUSB0
    (12345.690172411) ttyUSB0 fffffd0001030001194e
    (12345.701230000) left out fffffd0001030001194e
    (12345.801230000) left baud 1000000

docs/captures.md is the reference. Stamps are monotonic ns, kept exactly, as are the borders of the
chunks: a replay leads to the same report.
"""
from __future__ import annotations

from collections.abc import Callable
from collections.abc import Iterable
from collections.abc import Iterator
from datetime import datetime
from datetime import timedelta
from datetime import timezone
import errno
import os
import stat
from typing import BinaryIO
from typing import NamedTuple
from urllib.parse import quote
from urllib.parse import unquote

from msg_defs.event import BAUD
from msg_defs.event import Change
from msg_defs.event import CHANGES
from msg_defs.event import Chunk
from msg_defs.event import IN
from msg_defs.event import LATENCY_TIMER
from msg_defs.event import OUT
from msg_defs.event import UNKNOWN
from msg_defs.nanoseconds import NS_PER_S
from servobus.errors import ParameterError
from servobus.printable_text import printable

MAGIC = b'# dxl_capture '            # a number follows: 1 is 2 without sides and changes
ENDED = 'ended at '                # begins the remark at the end of a recording
VERSIONS = (b'1', b'2')
_EPOCH = datetime(1970, 1, 1, tzinfo=timezone.utc)
_WALL = '%Y-%m-%dT%H:%M:%S.%fZ'
_UNQUOTED = '/:._-+@'               # stay as they are in a bus name, as letters and digits do
STAMP_END = 1 << 63                 # ns: 292 years; longer than any time since a boot
BAUD_MAX = 100_000_000
LATENCY_MAX_MS = 10_000
BUSES_MAX = 256
VALUE_MAX_DIGITS = 18               # in the value of a change
LINE_MAX_BYTES = 1 << 20            # bytes: many times the longest line that is ever written
BEGIN_SIZE = 8192                   # bytes that show what a file is
BAD_TEXT_MAX_LENGTH = 60            # characters of a bad line in a message


class Wire(NamedTuple):
    """
    What a capture says about a bus.

    baud: 0 while it is to be learned. latency_timer_ms: of its adapter, 0 where it has none.
    """

    name: str
    baud: int
    latency_timer_ms: int = 0
    port: str = ''

    def changed(self, change: Change | None) -> Wire:
        """Return what is known of the bus after a change; a file may begin at any chunk."""
        if change is not None and change.what == BAUD:
            return self._replace(baud=change.value)
        if change is not None and change.what == LATENCY_TIMER:
            return self._replace(latency_timer_ms=change.value)
        return self


class ClockReading(NamedTuple):
    """One moment on two clocks, ns: since 1970, and monotonic."""

    wall: int
    stamp: int


def seconds(stamp: int) -> str:
    """Spell ns as seconds with all nine decimals: exact, and of one width."""
    return f'{stamp // NS_PER_S}.{stamp % NS_PER_S:09}'


def chunk_line(chunk: Chunk) -> bytes:
    stamp, bus, data, side, change = chunk
    words = [f'({seconds(stamp)})', _word(bus)]
    words += [change.what, str(change.value)] if change else [side] * bool(side) + [data.hex()]
    return f'{" ".join(words)}\n'.encode()


def _word(name: str) -> str:
    """Spell the name of a bus without blanks; '-' if it has none."""
    return '%2D' if name == '-' else quote(name, _UNQUOTED) or '-'


class Writer:
    """Writes to a file that somebody else opened, and flushes and closes."""

    def __init__(self, file: BinaryIO, now: ClockReading) -> None:
        self.size = 0
        self._file = file
        self._described: set[str] = set()     # buses
        wall = (_EPOCH + timedelta(microseconds=now.wall // 1000)).strftime(_WALL)
        self._put(MAGIC + f'2 began {wall} at {seconds(now.stamp)}\n'.encode())

    def write_chunk(self, wire: Wire, chunk: Chunk) -> None:
        """Write a chunk of a bus, and before its first one what is known of that."""
        if wire.name not in self._described:
            self._described.add(wire.name)
            self._put(f'# bus {_word(wire.name)} baud {wire.baud} latency_timer_ms '
                      f'{wire.latency_timer_ms} port {quote(wire.port, _UNQUOTED)}\n'.encode())
        self._put(chunk_line(chunk))

    def remark(self, text: str) -> None:
        """Write a line for people."""
        self._put(f'# {text}\n'.encode())

    def _put(self, line: bytes) -> None:
        self._file.write(line)
        self.size += len(line)


class Reader:
    """
    The chunks of a capture, from its lines. Other lines are left out and counted.

    Several captures in a row are one: where the clock began again (another boot), stamps
    go on by the wall-clock. `began` is of the first header. `is_cut`: the last line has no end.
    """

    def __init__(self, lines: Iterable[bytes]) -> None:
        self.began = ClockReading(0, 0)
        self.wires: dict[str, Wire] = {}
        self.bad_lines = 0
        self._first_bad = ''
        self.is_cut = False
        self.ended = 0             # stamp, 0: unknown
        self._lines = lines
        self._names: dict[bytes, str] = {}
        self._shift = 0
        self._last = 0

    def __iter__(self) -> Iterator[Chunk]:
        for number, line in enumerate(self._lines, 1):
            chunk = self._parse(line, number)
            if chunk is not None:
                yield chunk

    def _parse(self, line: bytes, number: int) -> Chunk | None:
        """Return the chunk of a line, None for any other line."""
        try:
            if line[:1] == b'(':
                stamp, bus, *words = line.split()
                if stamp[-1:] != b')':
                    raise ValueError(line)
                chunk = Chunk(_bounded(_stamp(stamp[1:-1]) + self._shift), self._name(bus),
                              *_content(words))
                self._last = chunk.stamp
                self.is_cut = line[-1:] != b'\n'
                return chunk
            if line.strip():
                self._header(line)
        except (ValueError, LookupError):
            self.bad_lines += 1
            text = printable(line.decode(errors='replace').strip(), BAD_TEXT_MAX_LENGTH)
            self._first_bad = self._first_bad or f'line {number}: {text}'
        return None

    def problems(self) -> list[str]:
        """Return what a person should know at the end, a line each."""
        found = []
        if self.bad_lines:
            found.append(f'{self.bad_lines} lines do not belong in a capture and were left out, '
                         f'the first is {self._first_bad}')
        if self.is_cut:
            found.append('the last line has no end: the capture is cut off or still being written')
        return found

    def _name(self, word: bytes) -> str:
        name = self._names.get(word)
        if name is None:
            if len(self._names) >= BUSES_MAX:
                raise ValueError(word)
            name = self._names[word] = '' if word == b'-' else printable(
                unquote(word.decode()))
        return name

    def _header(self, line: bytes) -> None:
        """Take in a line that starts with '#'; one that we do not know is a remark."""
        sign, *words = line.split()
        if sign != b'#':
            raise ValueError(line)
        if line.startswith(MAGIC):
            if words[1] not in VERSIONS:
                raise ValueError(line)
            now = ClockReading(_wall(words[3].decode()), _stamp(words[5]))
            if not self.began.wall:
                self.began = now
            if now.stamp + self._shift < self._last:
                since = now.wall - self.began.wall + self.began.stamp
                if since < self._last - NS_PER_S:       # the wall-clock was set back
                    since = self._last
                self._shift = _bounded(since) - now.stamp
        elif line.startswith(f'# {ENDED}'.encode()):
            self.ended = _bounded(_stamp(words[2]) + self._shift)
        elif words[:1] == [b'bus']:
            name = self._name(words[1])
            facts = dict(zip(words[2::2], words[3::2], strict=False))
            baud = int(facts[b'baud'])
            latency_ms = int(facts.get(b'latency_timer_ms', 0))
            if not (0 <= baud <= BAUD_MAX and 0 <= latency_ms <= LATENCY_MAX_MS):
                raise ValueError(line)
            self.wires[name] = Wire(name, baud, latency_ms,
                                    printable(unquote(facts.get(b'port', b'').decode())))


def _content(words: list[bytes]) -> tuple[bytes, str, Change | None]:
    """Return the bytes, the side and the change of a chunk's line, from what follows its bus."""
    if len(words) == 1:
        return bytes.fromhex(words[0].decode()), UNKNOWN, None
    name, value = (word.decode() for word in words)
    if name in (OUT, IN):
        return bytes.fromhex(value), name, None
    return b'', UNKNOWN, change_of(name, value)


def change_of(name: str, value: str) -> Change:
    """Return the change that a file spells so; raise ValueError where it is none."""
    if name not in CHANGES or not value.isdecimal() or len(value) > VALUE_MAX_DIGITS:
        raise ValueError(name)
    return Change(name, int(value))


def lines(file: BinaryIO) -> Iterator[bytes]:
    """Yield the lines of a file; one that is too long to be a line of a capture as a '?'."""
    while line := file.readline(LINE_MAX_BYTES):
        if len(line) == LINE_MAX_BYTES and line[-1:] != b'\n':
            while line and line[-1:] != b'\n':
                line = file.readline(LINE_MAX_BYTES)
            line = b'?\n'
        yield line


def _stamp(text: bytes) -> int:
    whole, fraction = text.split(b'.')
    if not (whole.isdigit() and fraction.isdigit()):       # int takes -1, and 1_0
        raise ValueError(text)
    return _bounded(int(whole) * NS_PER_S + int(fraction.ljust(9, b'0')[:9]))


def _bounded(stamp: int) -> int:
    if not 0 <= stamp < STAMP_END:
        raise ValueError(stamp)
    return stamp


def _wall(text: str) -> int:
    since = datetime.strptime(text, _WALL).replace(tzinfo=_EPOCH.tzinfo) - _EPOCH
    return since // timedelta(microseconds=1) * 1000


def is_capture(begin: bytes) -> bool:
    """Tell whether a file that begins so is a capture."""
    return begin.startswith(MAGIC)


def check_new(path: str, is_ours: Callable[[bytes], bool] = is_capture, what: str = 'capture',
              name: str = 'capture') -> None:
    """
    Raise ParameterError for what must not be written to.

    That is a port, above all, and any other file than ours: `what`, which `is_ours` knows by its
    begin. name: of the parameter or option that has the path.
    """
    try:
        mode = os.stat(path).st_mode
        if stat.S_ISDIR(mode):
            raise OSError('is a directory')
        if stat.S_ISCHR(mode) and _is_port(path):
            raise OSError('is a port, and this tool never sends')
        if stat.S_ISREG(mode):
            with open(path, 'rb') as file:
                begin = file.read(BEGIN_SIZE)
            if begin and not is_ours(begin):
                raise OSError(f'exists, is not a {what}, and is kept')
    except FileNotFoundError:
        pass
    except OSError as error:
        raise _refusal(name, path, error) from error


def open_new(path: str, waits: bool = True) -> BinaryIO:
    """
    Open a file to write a recording to; an older one of that name is lost.

    waits: for somebody to read, where it is a pipe; else that is a ParameterError.
    """
    try:
        return open(path, 'wb', opener=None if waits else _without_waiting)
    except OSError as error:
        if error.errno == errno.ENXIO:
            error = OSError('is a pipe that no program reads')
        raise _refusal('capture', path, error) from error


def _without_waiting(path: str, flags: int) -> int:
    descriptor = os.open(path, flags | os.O_NONBLOCK, 0o666)
    os.set_blocking(descriptor, True)
    return descriptor


def _is_port(path: str) -> bool:
    descriptor = os.open(path, os.O_RDONLY | os.O_NOCTTY | os.O_NONBLOCK)
    try:
        return os.isatty(descriptor)
    finally:
        os.close(descriptor)


def _refusal(name: str, path: str, error: OSError) -> ParameterError:
    return ParameterError(f'{name}: {path}: {error.strerror or error}; give another file name')
