# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""
Lines of strace as people run it, with any options: which bytes a program read and wrote.

A number is of one file until it is closed, or opened again. A port is what is opened as one
or has settings of a terminal.
"""
from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from itertools import dropwhile
import re

from msg_defs.event import Change
from msg_defs.event import IN
from msg_defs.event import LOST
from msg_defs.event import OUT
from servobus.sources.byte_sides import packet_size
from servobus.sources.byte_sides import TextBytes

_FRONT = r'\s*(?:\[pid +(\d+)\] |(\d+) +)?(?:[\d:.]+ +|\( *\+? *[\d.]+\) +){0,3}'
_ANY_CALL = re.compile(_FRONT + r'(\w+\(.*(?:\)\s+= (?:-?\d|\?)|<unfinished \.\.\.>$)'
                       r'|<\.\.\. \w+ resumed>)')
# The parts of other text have a most: a search from each of a million places must end.
_STRING = r'"((?:[^"\\]|\\.)*)"(\.\.\.)?'
_BYTES = re.compile(rf'\b(writev?|pwrite64|readv?|pread64)\((\d+)(?:<([^>]{{,999}})>)?, '
                    rf'(?:\[\{{iov_base=)?{_STRING}.{{,99}}\)\s{{,99}}= (-?\d{{1,9}})')
_OPENED = re.compile(r'open(?:at)?\([^"]{,99}"([^"]{1,199})".{,199}= (\d{1,9})')
_CLOSED = re.compile(r'\bclose\((\d{1,9})')
_SET = re.compile(r'\bioctl\((\d{1,9})(?:<([^>]{,999})>)?, [^{]{,99}TCSETS.{,999}= 0')
_RATE = re.compile(r'\bB(\d{3,7})\b|c_ospeed=(\d{3,7})')
_REPEATED = re.compile(r' \| [0-9a-f]{5}  ', re.IGNORECASE)      # by strace -e read=3, as a dump
_UNFINISHED, _RESUMED = ' <unfinished ...>', re.compile(r'<\.\.\. \w+ resumed>')
_PORT = re.compile(r'/dev/tty\w|/dev/serial/')


class StraceText:
    """Takes the lines of a text. baud: as the program set it, 0: unknown."""

    def __init__(self) -> None:
        self.baud = 0
        self.is_used = False                   # there were calls
        self._ports = set[str]()
        self._opened = Counter[str]()          # files that had a number
        self._unfinished: dict[str, str] = {}  # by thread

    def read(self, line: str) -> tuple[int, TextBytes | None] | None:
        """Return where a call begins, and its bytes if any; None where there is no call."""
        if self.is_used and _REPEATED.match(line):
            return 0, None
        call = _ANY_CALL.match(line)
        thread = (call[1] or call[2] or '') if call else ''
        if call and line.endswith(_UNFINISHED):
            self._unfinished[thread] = line[call.start(3):].removesuffix(_UNFINISHED)
        elif call and (resumed := _RESUMED.search(line)):
            line = line[:resumed.start()] + self._unfinished.pop(thread, '') + line[resumed.end():]
        found = _BYTES.search(line)
        if not (call or found):
            return None
        self.is_used = True
        self._note_file(line)
        return (found.start(), self._bytes(found)) if found else (0, None)

    def _note_file(self, line: str) -> None:
        """Note what is opened, closed or set as a port."""
        if opened := _OPENED.search(line):
            self._opened[opened[2]] += 1
            if _PORT.match(opened[1]):
                self._ports.add(self._file(opened[2]))
        elif closed := _CLOSED.search(line):
            self._opened[closed[1]] += 1
        elif (found := _SET.search(line)) and int(found[1]) > 2:       # no terminal of the user
            file = found[2] or self._file(found[1])
            if file not in self._ports and not found[2]:
                self._opened[found[1]] += 1    # what it was before is no port
                file = self._file(found[1])
            self._ports.add(file)
            rates = _RATE.findall(line)
            self.baud = int(rates[-1][0] or rates[-1][1]) if rates else self.baud

    def _file(self, number: str) -> str:
        return f'{number}:{self._opened[number]}'

    def _bytes(self, found: re.Match[str]) -> TextBytes | None:
        call, number, path, text, is_cut, result = found.groups()
        path = unescaped(path or '').decode('latin-1')
        if _PORT.match(path):
            self._ports.add(path)
        size = int(result)
        data = unescaped(text)[:max(0, size)]
        if is_cut:                             # also in a packet: the rest of that is no noise
            data = data[:_end_of_last_packet(data)]
        lost = size - len(data)
        return TextBytes(data, OUT if 'write' in call else IN,
                         change=Change(LOST, lost) if lost > 0 else None,
                         file=path or self._file(number)) if size > 0 else None

    def of_ports(self, parts: Sequence[TextBytes]) -> list[TextBytes]:
        """Leave out what a program read and wrote elsewhere."""
        ports = self._ports or {one.file for one in parts if one.data.startswith(b'\xff\xff')}
        found = [one for one in parts if not one.file or one.file in ports]
        return found if self._ports else list(       # a library is loaded under the same number
            dropwhile(lambda one: one.file and not one.data.startswith(b'\xff\xff'), found))


def unescaped(text: str) -> bytes:
    """Return the bytes of a string as C and Python print them."""
    data = text.encode('latin-1', 'replace')
    return data.decode('unicode_escape', 'replace').encode('latin-1', 'replace')


def _end_of_last_packet(data: bytes) -> int:
    """Return where the bytes of a packet begin that lacks its end."""
    begin = data.rfind(b'\xff\xff')
    return len(data) if begin < 0 or packet_size(data[begin:]) else begin
