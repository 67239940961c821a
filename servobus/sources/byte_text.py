# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""
Text that shows bytes, as people paste it: lines in, bytes out, with times and sides where known.

Hex or decimal numbers, with or without TX and RX, arrows and times; xxd, hexdump, od; socat -x;
what strace prints with other options than ours; CSV of a logic analyser is in byte_csv.py.
"""
from __future__ import annotations

from itertools import chain
from itertools import islice
import re
from typing import NamedTuple

from msg_defs.dxl1_packet import Dxl1Framer
from msg_defs.dxl_packet import Framer
from msg_defs.dxl_packet import HEADER
from msg_defs.event import IN
from msg_defs.event import OUT
from msg_defs.event import UNKNOWN
from msg_defs.units import NS_PER_S

DAY_NS = 86_400 * NS_PER_S
TIME_MIN_DIGITS = 3                # decimals of a second: coarser times say nothing of a bus
PACKET_MAX_BYTES, HEADERS_MAX = 1100, 10_000     # looked at for a right packet
LINE_MIN_NUMBERS = 4               # among words: fewer may be words, or a date
_NUMBER = r'(?:(?:0x|\\x)[0-9a-f]{1,2}|[0-9a-f]{1,2}|[12]\d\d)(?![0-9a-z.])'
_NUMBERS = re.compile(rf'(?<![0-9a-z.])(?:{_NUMBER}[\s,;:|\[\](){{}}-]*)+', re.IGNORECASE)
_WORD = r'(?:0x)?((?:[0-9a-f]{2}){6,})(?![0-9a-z])'
_JOINED = re.compile(rf'(?<![0-9a-z])(?:{_WORD}[\s,;|]*)+', re.IGNORECASE)
_WORDS = re.compile(_WORD, re.IGNORECASE)
# A count or an ID next to the bytes: `(8 bytes)`, `[8]:`, `len=8`, `id 1:`.
_COUNT = re.compile(r'[\[(] ?\d{1,4} ?(?:bytes?)?[])]:?'
                    r'|\b(?:len|length|size|id) ?[=:]? ?\d{1,4}\b:?', re.IGNORECASE)
_REPEATED = re.compile(r' \| [0-9a-f]{5}  ', re.IGNORECASE)      # by strace -e read=3, as a dump
_DIGITS = re.compile(r'[0-9a-f]{1,3}(?![0-9a-fx])', re.IGNORECASE)
_TIME = re.compile(r'(?<![\w.:])(?:(\d{1,2}):(\d\d):(\d\d)|(?<![-+])(\d{1,10})(?=\.\d{3}))'
                   r'(?:[.,:](\d{1,9}))?(?![\d:])(?: ?s\b)?')
_DATE = re.compile(r'\b\d{4}[-/.]\d\d[-/.]\d\d[T ]?|\b\d\d[-/.]\d\d[-/.]\d{4}[T ]?')
_SERVO = re.compile(r'servo|motor|dxl|device|slave', re.IGNORECASE)
_SIDE = re.compile(r'\b(?:(tx|sent|sending|send|writ|wrote|request|out\b)'
                   r'|(?:rx|recv|receiv|respon|repl|answer|in\b))|(->|>|\u2192)|<-?|\u2190',
                   re.IGNORECASE)
_DUMP = re.compile(r'([0-9a-f]{6,16})(:? {1,3})((?:[0-9a-f]{2,4} {1,2})*[0-9a-f]{2,4})(?: .*)?',
                   re.IGNORECASE)
_STRING = r'"((?:[^"\\]|\\.)*)"(\.\.\.)?'
# The parts of other text have a most: a search from each of a million places must end.
_STRACE = re.compile(rf'\b(writev?|pwrite64|readv?|pread64)\((\d+)(?:<([^>]{{,999}})>)?, '
                     rf'(?:\[\{{iov_base=)?{_STRING}.{{,99}}\)\s{{,99}}= (-?\d{{1,9}})')
_OPENED = re.compile(r'open(?:at)?\([^"]{,99}"(/dev/[^"]{1,99})".{,199}= (\d{1,9})')
_SIGROK = re.compile(r'(?:\d+-\d+ )?[\w ]{1,40}-?\d*: (?:[\w/ ]{1,40}: )?([0-9A-F]{2})')
_PYTHON = re.compile(r"""\bb(?:'((?:[^'\\]|\\.)*)'|"((?:[^"\\]|\\.)*)")""")


class TextBytes(NamedTuple):
    """Bytes of one line; time: ns since any moment, None: not said. lost: left out there."""

    data: bytes
    side: str = UNKNOWN
    time: int | None = None
    lost: int = 0
    file: str = ''                 # strace: the number of a file or its path


class ByteText(NamedTuple):
    """What a text shows; unused: lines that show no bytes; problem: why it cannot be used."""

    shape: str
    parts: list[TextBytes]
    unused: dict[int, str]         # by number
    problem: str = ''

    @property
    def cut(self) -> str:
        """Say that strace left out bytes, '' where it did not."""
        lost = sum(one.lost for one in self.parts)
        return f'; strace left out {lost} bytes, where it prints "...": add -s 4096' * (lost > 0)

    @property
    def data(self) -> bytes:
        """Return all bytes."""
        return b''.join(one.data for one in self.parts)

    @property
    def is_timed(self) -> bool:
        """Tell whether all bytes have times that never go back."""
        times = [one.time for one in self.parts]
        known = [one for one in times if one is not None]
        return len(known) == len(times) and known == sorted(known)


def read_text(text: str) -> ByteText:
    """Return what a text shows."""
    reader = _LineReader()
    unused = {number: line for number, line in enumerate(text.splitlines(), 1)
              if not reader.accept(line) and line.strip('- \t`')}
    if not reader.has_words and len({one.side for one in reader.parts}) == 1:
        # An arrow in each line, as the monitor of Arduino prints, is no side.
        reader.parts = [one._replace(side=UNKNOWN) for one in reader.parts]
    return ByteText(' and '.join(dict.fromkeys(reader.shapes)), _of_ports(reader), unused)


def _of_ports(reader: _LineReader) -> list[TextBytes]:
    """Leave out what strace shows of files that are no ports."""
    ports = reader.ports or {one.file for one in reader.parts if one.data.startswith(b'\xff\xff')}
    return [one for one in reader.parts if not one.file or one.file in ports]


def holds_packet(data: bytes) -> bool:
    """Tell whether there is a packet with a right checksum among bytes."""
    return any(_is_packet(data[found.start():found.start() + PACKET_MAX_BYTES])
               for found in islice(re.finditer(b'(?=\xff\xff)', data), HEADERS_MAX))


def _end_of_last_packet(data: bytes) -> int:
    """Return where the bytes of a packet begin that lacks its end."""
    begin = data.rfind(b'\xff\xff')
    return len(data) if begin < 0 or _is_packet(data[begin:]) else begin


def _is_packet(data: bytes) -> bool:
    if data.startswith(HEADER):
        return Framer().is_whole(data)
    return data[2:3] != b'\xff' and Dxl1Framer().is_whole(data)


class _LineReader:
    """Reads line after line; what a line says of time and side holds for bare lines below it."""

    def __init__(self) -> None:
        self.shapes: list[str] = []
        self.parts: list[TextBytes] = []
        self.ports = set[str]()    # numbers or paths, as strace prints them
        self.has_words = False     # that name a side; else arrows do
        self._side = UNKNOWN
        self._time: int | None = None
        self._days = 0

    def accept(self, line: str) -> bool:
        """Take a line; return whether it was of use."""
        found = next((shape for shape, read in (
            ('strace', self._strace), ('a hex dump', self._dump), ('Python bytes', self._python),
            ("sigrok's text", self._sigrok), ('numbers', self._numbers)) if read(line)), '')
        if found and found not in self.shapes:
            self.shapes.append(found)
        return bool(found)

    def _strace(self, line: str) -> bool:
        if opened := _OPENED.search(line):
            if opened[1].startswith('/dev/tty') or '/serial/' in opened[1]:
                self.ports.add(opened[2])
            return True
        found = _STRACE.search(line)
        if found is None:
            return False
        call, number, path, text, is_cut, result = found.groups()
        path = unescaped(path or '').decode('latin-1')
        if path.startswith('/dev/tty'):
            self.ports.add(path)
        size = int(result)
        data = unescaped(text)[:max(0, size)]
        if is_cut:                             # also in a packet: the rest of that is no noise
            data = data[:_end_of_last_packet(data)]
        if size > 0:
            self._add(data, OUT if 'write' in call else IN, self._time_in(line[:found.start()]),
                      size - len(data), path or number)
        return True

    def _dump(self, line: str) -> bool:
        if 'strace' in self.shapes and _REPEATED.match(line):
            return True
        found = _DUMP.fullmatch(line.strip())
        if found is None:
            return False
        shown = re.split(r'  (?![0-9a-fA-F]{2} )', found[3])[0] if ':' in found[2] else found[3]
        groups = shown.split()
        # hexdump and od -x show numbers of two bytes, xxd shows two bytes after a colon.
        swapped = ':' not in found[2] and all(len(one) == 4 for one in groups)
        data = b''.join(bytes.fromhex(one)[::-1 if swapped else 1] for one in groups
                        if len(one) % 2 == 0)
        self._add(data, self._side, self._time)
        return True

    def _python(self, line: str) -> bool:
        found = list(_PYTHON.finditer(line))
        if not found:
            return False
        before = line[:found[0].start()]
        self._add(b''.join(unescaped(one[1] or one[2] or '') for one in found),
                  self._side_in(before), self._time_in(before))
        return True

    def _sigrok(self, line: str) -> bool:
        found = _SIGROK.fullmatch(line)
        if found is not None:
            self._add(bytes.fromhex(found[1]), UNKNOWN, None)
        return found is not None

    def _numbers(self, line: str) -> bool:
        bare = _DATE.sub(lambda one: ' ' * len(one[0]), line)
        bare = _TIME.sub(lambda one: ' ' * len(one[0]), bare)
        counts = _COUNT.findall(bare)
        if len(counts) == 1:                   # in `[FF] [01]` each is a byte
            bare = _COUNT.sub(lambda one: ' ' * len(one[0]), bare)
        data, at = _bytes_in(bare)
        side, time = self._side_in(bare[:at]), self._time_in(line[:at])
        if not data:                           # a headline of what follows, as socat -x has
            self._side, self._time = side, time
            return False
        is_bare = not side and time is None
        self._add(data, self._side if is_bare else side, self._time if is_bare else time)
        if not is_bare:
            self._side, self._time = UNKNOWN, None
        return True

    def _add(self, data: bytes, side: str, time: int | None, lost: int = 0,
             file: str = '') -> None:
        self.parts.append(TextBytes(data, side, time, lost, file))

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


def unescaped(text: str) -> bytes:
    """Return the bytes of a string as C and Python print them."""
    data = text.encode('latin-1', 'replace')
    return data.decode('unicode_escape', 'replace').encode('latin-1', 'replace')


def _bytes_in(line: str) -> tuple[bytes, int]:
    """Return the most bytes in a row that a line shows, and where they begin."""
    data, at, size = b'', len(line), len(line.strip())
    for found in chain(_NUMBERS.finditer(line), _JOINED.finditer(line)):
        one = _values(found[0])
        is_all = len(found[0].strip()) == size
        if len(one) > len(data) and (is_all or len(one) >= LINE_MIN_NUMBERS):
            data, at = one, found.start()
    return data, at


def _values(numbers: str) -> bytes:
    """Return the bytes of numbers: decimal if one has three digits or none a letter."""
    if _JOINED.fullmatch(numbers):
        return bytes.fromhex(''.join(_WORDS.findall(numbers)))
    digits = _DIGITS.findall(re.sub(r'0x|\\x', ' ', numbers, flags=re.IGNORECASE))
    is_decimal = any(len(one) == 3 for one in digits)
    try:
        return bytes(int(one, 10 if is_decimal else 16) for one in digits)
    except ValueError:             # above 255, or letters among decimals
        return b''
