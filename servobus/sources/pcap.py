# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""
Files of packets, as tcpdump and Wireshark write them: pcap and pcapng. Reading only.

Sources: IETF drafts opsawg-pcap and opsawg-pcapng. A damaged or cut file gives what is readable in
front of the damage, and a problem in words.
"""

from __future__ import annotations

from collections.abc import Iterator
from collections.abc import Sequence
import struct
from typing import Any
from typing import BinaryIO
from typing import NamedTuple

from msg_defs.nanoseconds import NS_PER_S
from servobus.printable_text import printable

LINK_USB_LINUX, LINK_USB_LINUX_MMAPPED, LINK_USBPCAP = 189, 220, 249
LINK_USER0 = 147                   # ours: packet_file.py

# The first bytes of a file: the order of its numbers, and ns in a unit of the fraction.
_PCAP_MAGIC = {struct.pack(f'{order}I', number): (order, unit) for order in '<>'
               for number, unit in ((0xA1B2C3D4, 1000), (0xA1B23C4D, 1))}
SECTION, SECTION_MAGIC = 0x0A0D0D0A, 0x1A2B3C4D
_PCAPNG_MAGIC = SECTION.to_bytes(4, 'big')
_ORDERS = {struct.pack(f'{order}I', SECTION_MAGIC): order for order in '<>'}
INTERFACE, ENHANCED = 1, 6       # blocks; packets without a time are of no use here
NAME, ABOUT, SPEED, RESOLUTION, _OFFSET = 2, 3, 8, 9, 14       # options of an interface
_DEFAULTS = dict.fromkeys((NAME, ABOUT, SPEED, RESOLUTION, _OFFSET), b'')
_MICROSECONDS = b'\x06'            # resolution of a file that does not say
COMMENT, FLAGS = 1, 2            # options of a packet
MAGIC_SIZE = 4
BLOCK_MAX_BYTES = 1 << 26          # bytes: no packet of USB is near that


class Interface(NamedTuple):
    """What a file says of the interface of a packet; speed: bit/s, 0 where it does not say."""

    link: int
    units_per_second: int = 1_000_000
    offset_s: int = 0
    name: str = ''
    about: str = ''
    speed: int = 0


class CapturedPacket(NamedTuple):
    """One packet; stamp: ns since 1970. order: '<' or '>'."""

    interface: Interface
    stamp: int
    order: str
    data: bytes
    flags: int = 0
    comments: Sequence[str] = ()

    @property
    def link(self) -> int:
        return self.interface.link


class _Damaged(Exception):
    """The file is not as it should be from here on: in words."""


def is_pcap(head: bytes) -> bool:
    """Tell whether a file that begins so is a pcap or pcapng file."""
    magic = head[:MAGIC_SIZE]
    return magic == _PCAPNG_MAGIC or magic in _PCAP_MAGIC


class PcapReader:
    """The packets of a file; `problem` says at the end why it was not read to its end."""

    def __init__(self, file: BinaryIO) -> None:
        self.problem = ''
        self.position = 0          # bytes read
        self._file = file
        self._order = '<'
        self._interfaces: list[Interface] = []

    def __iter__(self) -> Iterator[CapturedPacket]:
        try:
            magic = self._exactly(MAGIC_SIZE, 'the magic number')
            if magic == _PCAPNG_MAGIC:
                self._section(self._exactly(4, 'the header of a section'))
                yield from self._pcapng()
            else:
                yield from self._pcap(magic)
        except _Damaged as damage:
            self.problem = f'{damage}; read up to byte {self.position}'

    # --- pcap ----------------------------------------------------------------------------------

    def _pcap(self, magic: bytes) -> Iterator[CapturedPacket]:
        if magic not in _PCAP_MAGIC:
            raise _Damaged('not a pcap file')
        self._order, unit = _PCAP_MAGIC[magic]
        *_, link = self._unpack('HHiIII', self._exactly(20, 'its header'))
        link &= 0xFFFF             # above: length of a checksum
        while front := self._some(16, 'the header of a packet'):
            seconds, fraction, kept, _ = self._unpack('IIII', front)
            if kept > BLOCK_MAX_BYTES:
                raise _Damaged(f'a packet of {kept} bytes: damaged')
            data = self._exactly(kept, 'a packet')
            stamp = seconds * NS_PER_S + fraction * unit
            yield CapturedPacket(Interface(link), stamp, self._order, data)

    # --- pcapng --------------------------------------------------------------------------------

    def _pcapng(self) -> Iterator[CapturedPacket]:
        while front := self._some(8, 'the header of a block'):
            kind, size = self._unpack('II', front)
            if kind == SECTION:               # its length is in the order of the new section
                self._section(front[4:])
                continue
            body = self._body(size)
            if kind == INTERFACE:
                self._interface(body)
            elif kind == ENHANCED:
                yield self._packet(body)

    def _section(self, length: bytes) -> None:
        magic = self._exactly(4, 'the header of a section')
        if magic not in _ORDERS:
            raise _Damaged('a section without its byte-order magic: damaged')
        self._order = _ORDERS[magic]
        self._interfaces = []
        self._body(self._unpack('I', length)[0], 12)

    def _body(self, size: int, done: int = 8) -> bytes:
        """Read the rest of a block of which `done` bytes were read, and check its end."""
        if size % 4 or not done + 4 <= size <= BLOCK_MAX_BYTES:
            raise _Damaged(f'a block of {size} bytes: damaged')
        body = self._exactly(size - done, 'a block')
        if self._unpack('I', body[-4:])[0] != size:
            raise _Damaged('a block that ends with another length: damaged')
        return body[:-4]

    def _interface(self, body: bytes) -> None:
        if len(body) < 8:
            raise _Damaged('a description of an interface that makes no sense: damaged')
        [link] = self._unpack('H', body)
        options = _DEFAULTS | dict(self._options(body[8:]))
        code = (options[RESOLUTION] or _MICROSECONDS)[0]
        base, power = (2, code & 0x7F) if code & 0x80 else (10, code)
        [offset_s] = self._unpack('q', options[_OFFSET].ljust(8, b'\0'))
        [speed] = self._unpack('Q', options[SPEED].ljust(8, b'\0'))
        self._interfaces.append(Interface(link, base ** min(power, 64), offset_s,
                                          _text(options[NAME]), _text(options[ABOUT]), speed))

    def _options(self, body: bytes) -> Iterator[tuple[int, bytes]]:
        at = 0
        while at + 4 <= len(body):
            code, size = self._unpack('HH', body, at)
            if code == 0:
                return
            yield code, body[at + 4:at + 4 + size]
            at += 4 + size + -size % 4

    def _packet(self, body: bytes) -> CapturedPacket:
        if len(body) < 20:
            raise _Damaged('a packet without its header: damaged')
        number, high, low, kept = self._unpack('IIII', body)
        if number >= len(self._interfaces) or kept > len(body) - 20:
            raise _Damaged('a packet of no interface, or cut: damaged')
        one = self._interfaces[number]
        stamp = (high << 32 | low) * NS_PER_S // one.units_per_second + one.offset_s * NS_PER_S
        flags, comments = 0, []
        for code, value in self._options(body[20 + kept + -kept % 4:]):
            if code == FLAGS and len(value) == 4:
                flags = self._unpack('I', value)[0]
            elif code == COMMENT:
                comments.append(_text(value))
        return CapturedPacket(one, stamp, self._order, body[20:20 + kept], flags, comments)

    # --- bytes ---------------------------------------------------------------------------------

    def _unpack(self, layout: str, data: bytes, at: int = 0) -> tuple[Any, ...]:
        return struct.unpack_from(self._order + layout, data, at)

    def _some(self, size: int, what: str) -> bytes:
        """Read so many bytes, or nothing at the end of the file."""
        data = self._file.read(size)
        self.position += len(data)
        if data and len(data) < size:
            raise _Damaged(f'it ends within {what}: cut off, or still being written')
        return data

    def _exactly(self, size: int, what: str) -> bytes:
        data = self._some(size, what) if size else b''
        if len(data) < size:
            raise _Damaged(f'it ends before {what}: cut off, or still being written')
        return data


def _text(value: bytes) -> str:
    return printable(value.rstrip(b'\0').decode(errors='replace'))
