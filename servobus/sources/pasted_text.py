# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""
Text that shows bytes, as people paste it: lines in, bytes out, with times and sides where known.

Hex or decimal numbers, with or without TX and RX, arrows and times; xxd, hexdump, od; socat -x;
what strace prints with other options than ours; CSV of a logic analyser is in byte_csv.py.
"""
from __future__ import annotations

from collections.abc import Callable
from collections.abc import Iterator
from collections.abc import Sequence
from itertools import chain
import re
from typing import NamedTuple

from msg_defs.event import Change
from msg_defs.event import IN
from msg_defs.event import LOST
from msg_defs.event import OUT
from msg_defs.event import UNKNOWN
from msg_defs.nanoseconds import NS_PER_S
from servobus.printable_text import printable
from servobus.sources.byte_sides import ByteText
from servobus.sources.byte_sides import settle_sides
from servobus.sources.byte_sides import TextBytes
from servobus.sources.hex_dump import HexDump
from servobus.sources.strace_text import StraceText
from servobus.sources.strace_text import unescaped

DAY_NS = 86_400 * NS_PER_S
TIME_MIN_DIGITS = 3                # decimals of a second: coarser times say nothing of a bus
LINE_MIN_NUMBERS = 4               # among words: fewer may be words, or a date
LINE_MAX_COUNTS = 2                # a question's and its answer's; in `[FF] [01]` each is a byte
BROKEN_MAX_LENGTH = 60             # characters shown of a line
_NUMBER = (r'(?:(?:0x|\\x)[0-9a-f]{1,2}(?=0x)|(?:(?:0x|\\x)[0-9a-f]{1,2}|[0-9a-f]{2}h|'
           r'[0-9a-f]{1,2}|[12]\d\d)(?![0-9a-z.]))')
_NUMBERS = re.compile(rf"""(?<![0-9a-z.])(?:{_NUMBER}[\s,;:|\[\](){{}}'"-]*)+""", re.IGNORECASE)
_WORD = r'(?:0x)?((?:[0-9a-f]{2}){6,})(?![0-9a-z])'
_JOINED = re.compile(rf'(?<![0-9a-z])(?:{_WORD}[\s,;|]*)+', re.IGNORECASE)
_WORDS = re.compile(_WORD, re.IGNORECASE)
_PAIRS = re.compile(r'(?<![0-9a-z])ffff(?: (?:[0-9a-f]{2}){1,2}(?![0-9a-z]))+', re.IGNORECASE)
# A letter in a byte, as in `FF FF O2`; `x3` and `3x` count something.
_BROKEN = re.compile(r'[0-9a-f]{2}[\s,]{1,2}((?:\d[g-wyz]|[g-wyz]\d))(?![0-9a-z.])', re.IGNORECASE)
# A count or an ID next to the bytes: `(8 bytes)`, `[8]:`, `len=8`, `id 1:`.
_COUNT = re.compile(r'[\[(] ?\d{1,4} ?(?:bytes?)?[])]:?'
                    r'|\b(?:len|length|size|id) ?[=:]? ?\d{1,4}\b:?', re.IGNORECASE)
_DIGITS = re.compile(r'[0-9a-f]{1,3}(?![0-9a-fx])', re.IGNORECASE)
_TIME = re.compile(r'(?<![\w.:])(?:(\d{1,2}):(\d\d):(\d\d)|(?<![-+])(\d{1,10})(?=\.\d{3}))'
                   r'(?:[.,:](\d{1,9}))?(?![\d:])(?: ?s\b)?')
_DATE = re.compile(r'\b\d{4}[-/.]\d\d[-/.]\d\d[T ]?|\b\d\d[-/.]\d\d[-/.]\d{4}[T ]?')
_SERVO = re.compile(r'servo|motor|dxl|device|slave', re.IGNORECASE)
_SIDE = re.compile(r'\b(?:(tx|sent|sending|send|writ|wrote|request|out\b)'
                   r'|(?:rx|recv|receiv|respon|repl|answer|in\b))|(->|>|\u2192)|<-?|\u2190',
                   re.IGNORECASE)
_SOCAT = re.compile(r'(?m)^[<>] [\d/]{10} [\d:]{8}\.(\d{9})(?= +length=)')
_SIGROK = re.compile(r'(?:\d+-\d+ )?[\w ]{1,40}-?\d*: (?:[\w/ ]{1,40}: )?([0-9A-F]{2})')
_PYTHON = re.compile(r"""\bb(?:'((?:[^'\\]|\\.)*)'|"((?:[^"\\]|\\.)*)")""")


class _Run(NamedTuple):
    """Bytes in a row, and where they are in a line."""

    data: bytes
    begin: int
    end: int


def read_text(text: str) -> ByteText:
    """Return what a text shows."""
    times = _SOCAT.findall(text)
    if times and all(one.startswith('000') for one in times):  # socat 1.7.4: microseconds
        text = _SOCAT.sub(lambda one: one[0].removesuffix(one[1]) + one[1][3:], text)
    reader = _LineReader()
    unused = {number: line for number, line in enumerate(text.splitlines(), 1)
              if not reader.accept(line, number) and line.strip('- \t`')}
    for number in reader.headlines:
        unused.pop(number, None)
    parts: Sequence[TextBytes] = reader.strace.of_ports(reader.parts)
    note = ''
    if not reader.has_words and len({one.side for one in parts}) == 1:
        # An arrow in each line, as the monitor of Arduino prints, is no side.
        parts = [one._replace(side=UNKNOWN) for one in parts]
    if not reader.strace.is_used:
        parts, note = settle_sides(parts)
    return ByteText(' and '.join(reader.shapes), parts, unused, baud=reader.strace.baud,
                    notes=[one for one in (note, reader.dump.note, reader.note) if one])


class _LineReader:
    """Reads line after line; what a line says of time and side holds for bare lines below it."""

    def __init__(self) -> None:
        self.shapes: dict[str, None] = {}
        self.parts: list[TextBytes] = []
        self.headlines = set[int]()            # numbers of those that held for lines below them
        self.note = ''
        self.has_words = False     # that name a side; else arrows do
        self.strace = StraceText()
        self.dump = HexDump()
        self._side = UNKNOWN
        self._time: int | None = None
        self._number = self._headline = 0
        self._days = 0
        self._readers: tuple[tuple[str, Callable[[str], bool]], ...] = (
            ('strace', self._strace), ('a hex dump', self._dump), ('Python bytes', self._python),
            ("sigrok's text", self._sigrok), ('numbers', self._numbers))

    def accept(self, line: str, number: int) -> bool:
        """Take a line; return whether it was of use."""
        self._number, count = number, len(self.parts)
        found = next((shape for shape, read in self._readers if read(line)), '')
        if len(self.parts) > count and found:
            self.shapes[found] = None
        return bool(found)

    def _strace(self, line: str) -> bool:
        found = self.strace.read(line)
        if found is not None and found[1] is not None:
            self.parts.append(found[1]._replace(time=self._time_in(line[:found[0]])))
        return found is not None

    def _dump(self, line: str) -> bool:
        data = self.dump.read(line)
        if data:
            self.parts.append(TextBytes(data, *self._inherited()))
        return data is not None

    def _python(self, line: str) -> bool:
        return self._add_runs(line, line, [
            _Run(unescaped(one[1] or one[2] or ''), *one.span())
            for one in _PYTHON.finditer(line)])

    def _sigrok(self, line: str) -> bool:
        found = _SIGROK.fullmatch(line)
        if found is not None:
            self.parts.append(TextBytes(bytes.fromhex(found[1])))
        return found is not None

    def _numbers(self, line: str) -> bool:
        bare = _TIME.sub(_blank, _DATE.sub(_blank, line))
        if len(_COUNT.findall(bare)) <= LINE_MAX_COUNTS:
            bare = _COUNT.sub(_blank, bare)
        runs = list(_runs(bare))
        if 'Python bytes' in self.shapes and len(line) < LINE_MIN_NUMBERS:
            return False                       # what write() returned
        if not runs:                           # a headline of what follows, as socat -x has
            bare = bare.removeprefix('>>> ')   # Python's prompt
            words = {bool(one[1]) for one in _SIDE.finditer(bare) if one[0].isalpha()}
            self._side = self._side_in(bare) if len(words) < 2 else UNKNOWN    # it means both
            self._time, self._headline = self._time_in(line), self._number
            return False
        if broken := _BROKEN.search(bare):
            shown = printable(line.strip(), BROKEN_MAX_LENGTH)
            self.note = self.note or f'{broken[1]!r} is no byte, line {self._number}: {shown}'
            runs = [one._replace(data=b'') for one in runs]
        self._add_runs(line, bare, runs)
        return not broken

    def _add_runs(self, line: str, bare: str, runs: list[_Run]) -> bool:
        """Add what a line shows: bytes, or a question and its answer; bare: without times."""
        end, side, time = 0, UNKNOWN, None
        for number, run in enumerate(runs):
            before, own = bare[end:run.begin], self._time_in(line[end:run.begin])
            end, time = run.end, time if own is None else own
            if number and not any(one[0].isalpha() for one in _SIDE.finditer(before)):
                side = UNKNOWN if run.data.startswith(b'\xff\xff') else side
            else:
                side = self._side_in(before)
            if not (number or side) and time is None:
                side, time = self._inherited()
            elif not number:
                self._side, self._time = UNKNOWN, None
            self.parts.append(TextBytes(run.data, side, time,
                                        None if run.data else Change(LOST, 1)))
        return bool(runs)

    def _inherited(self) -> tuple[str, int | None]:
        """Return the side and the time that a line above says."""
        if self._side or self._time is not None:
            self.headlines.add(self._headline)
        return self._side, self._time

    def _side_in(self, text: str) -> str:
        found = list(_SIDE.finditer(text))
        words = [one for one in found if one[0].isalpha()]
        if not found:
            return UNKNOWN
        first = (words or found)[0]
        is_out = bool(first[1] or first[2])
        if not words and _SERVO.search(text[:first.start()]):      # `Servo -> Host:`
            is_out, words = not is_out, [first]
        self.has_words |= bool(words) or not is_out
        return OUT if is_out else IN

    def _time_in(self, text: str) -> int | None:
        """Return the time that a text says, if that is exact enough."""
        found = _TIME.search(_DATE.sub(' ', text))
        if found is None or len(found[5] or '') < TIME_MIN_DIGITS:
            return None
        hours, minutes, seconds, alone, part = found.groups()
        whole = int(alone) if alone else (int(hours) * 60 + int(minutes)) * 60 + int(seconds)
        time = whole * NS_PER_S + int(part.ljust(9, '0')) + self._days * DAY_NS
        last = self.parts[-1].time if self.parts else None
        if hours and last is not None and last - time > DAY_NS // 2:       # midnight
            self._days += 1
            time += DAY_NS
        return time


def _blank(found: re.Match[str]) -> str:
    return ' ' * len(found[0])


def _runs(line: str) -> Iterator[_Run]:
    """
    Yield the most bytes in a row that a line shows, and others that are as surely bytes.

    Those begin as a packet does, or follow a word that names a side.
    """
    size = len(line.strip())
    found = [_Run(data, *one.span()) for one in chain(
        _NUMBERS.finditer(line), _JOINED.finditer(line), _PAIRS.finditer(line))
        if len(data := _values(one[0])) >= LINE_MIN_NUMBERS
        or (data and len(one[0].strip()) == size)]
    longest, end = max(found, key=lambda run: len(run.data), default=None), 0
    for run in sorted(found, key=lambda run: run.begin):
        if run.begin >= end and (run is longest or run.data.startswith(b'\xff\xff') or any(
                one[0].isalpha() for one in _SIDE.finditer(line[end:run.begin]))):
            yield run
            end = run.end


def _values(numbers: str) -> bytes:
    """Return the bytes of numbers: decimal if one has three digits or none a letter."""
    if _JOINED.fullmatch(numbers):
        return bytes.fromhex(''.join(_WORDS.findall(numbers)))
    if _PAIRS.fullmatch(numbers):
        return bytes.fromhex(numbers)
    digits = _DIGITS.findall(re.sub(r'0x|\\x|h', ' ', numbers, flags=re.IGNORECASE))
    is_decimal = any(len(one) == 3 for one in digits)
    try:
        return bytes(int(one, 10 if is_decimal else 16) for one in digits)
    except ValueError:             # above 255, or letters among decimals
        return b''
