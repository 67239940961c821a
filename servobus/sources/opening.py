# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""
One function that opens any source by its name: a port, usb:, tap:, a file, or stdin.

The content of a file decides what it is: captures, USB events (pcap, pcapng, usbmon), raw bytes,
text that shows bytes, levels (sigrok). Other text is refused: no packet is text, and a program is
given here by mistake.
"""

from __future__ import annotations

import codecs
from collections.abc import Sequence
from io import BufferedReader
from io import RawIOBase
import os
import re
import shlex
import stat
import sys
from typing import Any

from servobus.errors import UsageError
from servobus.port.port_error import PortError
from servobus.port.preflight import why_not
from servobus.sources.byte_csv import read_csv
from servobus.sources.byte_sides import ByteText
from servobus.sources.byte_sides import holds_packet
from servobus.sources.capture import MAGIC
from servobus.sources.logic_file import read_sigrok
from servobus.sources.packet_file import holds_packets
from servobus.sources.packet_file import PacketFile
from servobus.sources.pasted_text import read_text
from servobus.sources.source import CaptureFile
from servobus.sources.source import File
from servobus.sources.source import RawFile
from servobus.sources.source import Source
from servobus.sources.source import TextFile
from servobus.sources.source_name import is_live
from servobus.sources.usb_source import is_usb
from servobus.sources.usb_source import may_be_usb
from servobus.sources.usb_source import UsbFile

HEAD_SIZE = 64
TEXT_MAX_BYTES = 1 << 24           # longer texts are refused
STRANGE_MAX_SHARE = 0.1            # share of the letters of a text
_COLOUR = re.compile(r'\x1b\[[0-9;]{0,20}[A-Za-z]')      # a terminal shows
REPORT = '# dxl_doctor report'         # how a report of dxl_doctor begins
_HEARS = {
    'servobus': "dxl_tap arm -- {}, and servobus.listen('tap:arm')",
    'dxl_doctor': 'dxl_doctor run -- {}',
    'dxl_dashboard': 'dxl_dashboard run -- {}',
    'mecarover_status': 'dxl_tap arm -- {}, and mecarover_status tap:arm{} in another terminal',
    'dxl_dump': 'dxl_tap arm -- {}, and dxl_dump tap:arm{} in another terminal',
    'dxl_replay': 'dxl_tap arm -- {}, and dxl_dump tap:arm -w bus.txt in another terminal, to '
                  'play bus.txt',
}
_PACKED = {b'\x1f\x8b\x08': 'gzip', b'\xfd7zXZ': 'xz', b'\x28\xb5\x2f\xfd': 'zstd',
           b'BZh': 'bzip2', b'PK\x03\x04': 'zip'}


def open_source(tool: str, name: str, baud: int | None, adapter: str | None = None) -> Source:
    """
    Return the source of this name, open; raise PortError, OSError or UsageError.

    tool: who says on stderr what happens to a port. baud: overrides what the source says; None
    for what it says, or else 2 MBd. adapter: which one in a file of USB events, needed where it
    holds several.
    """
    if name == '-':
        if sys.stdin.isatty():
            raise UsageError('-: stdin is a terminal; pipe bytes or a capture into it')
        return _file(name, open(sys.stdin.fileno(), 'rb', closefd=False), baud, adapter, tool)
    if is_port(name):
        from servobus.sources.live import LivePort  # needs fcntl, and files do not

        return LivePort(name, baud, tool)
    return open_file(name, baud, adapter, tool=tool)


def open_file(name: str, baud: int | None, adapter: str | None = None, *, tool: str) -> File:
    """
    Return a capture, a file of USB events or a file of bytes as a source.

    tool: the message for a program file says how this tool listens to a program.
    """
    return _file(name, open(name, 'rb'), baud, adapter, tool)


def is_port(name: str) -> bool:
    """Tell whether a source is live; raise where there is nothing of that name."""
    if is_live(name):
        return True
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


def how_to_hear(tool: str, command: str, options: Sequence[str] = ()) -> str:
    """Return what a user of `tool` types, with its options, to hear what `command` starts."""
    words = ''.join(f' {shlex.quote(option)}' for option in options)
    return _HEARS.get(tool, _HEARS['servobus']).format(command, words)


def _file(name: str, file: BufferedReader, baud: int | None, adapter: str | None,
          tool: str) -> File:
    try:
        return _read_as(name, file, baud, adapter, tool)
    except UsageError as error:
        file.close()
        raise UsageError(f'{name}: {error}') from error


def _read_as(name: str, file: BufferedReader, baud: int | None, adapter: str | None,
             tool: str) -> File:
    """Return the source that the content of a file makes it; raise UsageError without a name."""
    head = b''
    # A pipe gives what is there, at least a byte: that is too few to tell.
    while len(head) < HEAD_SIZE and (more := file.read1(HEAD_SIZE - len(head))):
        head += more
        if not MAGIC.startswith(head[:len(MAGIC)]) and not may_be_usb(head):
            break
    if head.startswith(b'PK') and file.seekable() and (levels := read_sigrok(file, baud)):
        return TextFile(name, file, baud, levels)
    for front, kind in _PACKED.items():
        if head.startswith(front):
            raise UsageError(f'compressed with {kind}; unpack it first')
    begin = head + file.read1()
    if is_regular := file.seekable():
        file.seek(-len(begin), os.SEEK_CUR)
    else:
        file = BufferedReader(_Joined(begin, file))
    if holds_packets(begin):
        return PacketFile(name, file, baud)
    if is_usb(head):
        return UsbFile(name, file, baud, adapter)
    if adapter is not None:
        raise UsageError(f'not a file of USB events; leave out --adapter {adapter}')
    if head.startswith(MAGIC):
        return CaptureFile(name, file, baud)
    # Text on a pipe may be what a board prints, for ever; only bytes are waited for to the end.
    if is_text(begin) and (is_regular or b'\xff\xff' in _shown(begin).data):
        return _text_file(name, file, baud, tool)
    return RawFile(name, file, baud)


def _text_file(name: str, file: BufferedReader, baud: int | None, tool: str) -> TextFile:
    """Return the bytes that a text shows as a source; raise UsageError where it shows none."""
    begin = file.read(TEXT_MAX_BYTES)
    problem = ''
    if begin.startswith(REPORT.encode()):
        problem = f'a report of dxl_doctor; write: dxl_doctor {shlex.quote(name)}'
    elif name.endswith('.py'):
        problem = (f'a text file, not a recording; write: '
                   f'{how_to_hear(tool, shlex.join(["python", name]))}')
    elif file.read(1):
        problem = f'a text of more than {TEXT_MAX_BYTES >> 20} MiB; cut it into parts'
    else:
        found = _shown(begin)
        data = found.data
        if not found.problem and holds_packet(data):
            return TextFile(name, file, baud, found)
        problem = found.problem or (
                   f'read as {found.shape}: {len(data)} bytes, but no packet with a right '
                   f'checksum{found.cut or "; dxl_dump --check HEX says what is wrong with one"}'
                   if found.cut or b'\xff\xff' in data else
                   'a text file, not a recording; give a pcap file, raw bytes or a capture (it '
                   f'begins with {MAGIC.decode().strip()!r}), or text that shows packets (of '
                   'a logic analyser: its decoded bytes in hex, as CSV)')
    raise UsageError(problem)


def _shown(content: bytes) -> ByteText:
    text = _COLOUR.sub('', content.decode(_encoding(content), 'replace'))
    return read_csv(text) or read_text(text)


def _encoding(begin: bytes) -> str:
    """Return how a text is encoded: PowerShell writes UTF-16."""
    return 'utf-16' if begin[:2] == codecs.BOM_UTF16_LE and begin[3:4] == b'\0' else 'utf-8-sig'


class _Joined(RawIOBase):
    """A pipe, from its beginning on, after that was read."""

    def __init__(self, begin: bytes, file: BufferedReader) -> None:
        self._begin = begin
        self._file = file

    def readable(self) -> bool:
        return True

    def readinto(self, buffer: Any, /) -> int:
        data = self._begin[:len(buffer)] or self._file.read1(len(buffer))
        self._begin = self._begin[len(data):]
        buffer[:len(data)] = data
        return len(data)


def is_text(begin: bytes) -> bool:
    """
    Tell whether a file that begins so is text; a packet has a byte 255, which no text has.

    A few bytes may be of an older encoding, as Windows writes it, where it shows packets.
    """
    encoding = _encoding(begin)
    if encoding == 'utf-8-sig' and b'\xff' in begin:
        return False
    # Its last letter may be cut.
    text = _COLOUR.sub('', codecs.getincrementaldecoder(encoding)('replace').decode(begin))
    strange = text.count('\ufffd')
    if strange and b'\xff\xff' not in _shown(begin).data:
        return False
    return bool(text) and strange <= STRANGE_MAX_SHARE * len(text) and all(
        letter.isprintable() or letter.isspace() for letter in text if letter != '\ufffd')
