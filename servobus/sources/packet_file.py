# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""
Packets of a servo bus in a pcapng file, for Wireshark: one block per packet, and back.

Linktype USER0, the bytes as they were on the wire. What was no packet is a block of its own; what
happened besides bytes (another rate, a cable lost) is a block without bytes. Both say so in a
comment, as does a packet at which a finding begins. Source: IETF draft opsawg-pcapng.
"""
from __future__ import annotations

from collections.abc import Iterator
from collections.abc import Sequence
from contextlib import suppress
from io import BytesIO
import struct
from typing import BinaryIO

from msg_defs.event import Change
from msg_defs.event import Chunk
from msg_defs.event import IN
from msg_defs.event import OUT
from msg_defs.event import UNKNOWN
from msg_defs.uart import byte_ns
from servobus.sources import pcap
from servobus.sources.capture import BAUD_MAX
from servobus.sources.capture import change_of
from servobus.sources.capture import ClockReading
from servobus.sources.capture import Wire
from servobus.sources.source import File
from servobus.sources.source_name import DEFAULT_BAUD

_FLAG = {UNKNOWN: 0, IN: 1, OUT: 2}
_SIDE = {flag: side for side, flag in _FLAG.items()}
_NS_RESOLUTION = b'\x09'
_EVENT = 'event: '                 # begins the comment of a block without bytes


class PacketWriter:
    """Writes to a file that somebody else opened, and flushes and closes."""

    def __init__(self, file: BinaryIO) -> None:
        self._file = file
        self._interfaces: dict[str, int] = {}
        self._block(pcap.SECTION, struct.pack('<IHHq', pcap.SECTION_MAGIC, 1, 0, -1))

    def write(self, wire: Wire, stamp: int, data: bytes, side: str = UNKNOWN,
              comments: Sequence[str] = ()) -> None:
        """Write one packet; stamp: when its first byte was on the wire, ns since 1970."""
        number = self._interfaces.get(wire.name)
        if number is None:
            number = self._interfaces[wire.name] = len(self._interfaces)
            self._block(pcap.INTERFACE, struct.pack('<HHI', pcap.LINK_USER0, 0, 0) + _options(
                (pcap.NAME, wire.name.encode()), (pcap.ABOUT, wire.port.encode()),
                (pcap.SPEED, wire.baud.to_bytes(8, 'little')), (pcap.RESOLUTION, _NS_RESOLUTION)))
        options = b''
        if side or comments:
            options = _options(*((pcap.COMMENT, text.encode()) for text in comments),
                               (pcap.FLAGS, _FLAG[side].to_bytes(4, 'little')))
        size = len(data)
        head = struct.pack('<IIIII', number, stamp >> 32, stamp & 0xFFFFFFFF, size, size)
        self._block(pcap.ENHANCED, head + _padded(data) + options)

    @staticmethod
    def comment(change: Change) -> str:
        """Return the comment of a change; it may be on a packet without bytes."""
        return f'{_EVENT}{change.what} {change.value}'

    def _block(self, kind: int, body: bytes) -> None:
        size = struct.pack('<I', len(body) + 12)
        self._file.write(struct.pack('<I', kind) + size + body + size)


def _options(*options: tuple[int, bytes]) -> bytes:
    return b''.join(struct.pack('<HH', code, len(value)) + _padded(value)
                    for code, value in options if value) + bytes(4)


def _padded(data: bytes) -> bytes:
    return data + bytes(-len(data) % 4)


def holds_packets(begin: bytes) -> bool:
    """Tell whether a file that begins so is one of these."""
    first = next(iter(pcap.PcapReader(BytesIO(begin))), None) if pcap.is_pcap(begin) else None
    return first is not None and first.link == pcap.LINK_USER0


class PacketFile(File):
    """Such a file as a source."""

    def _begin(self) -> None:
        self._packets = pcap.PcapReader(self._file)

    def _read(self) -> Iterator[Chunk]:
        """Yield each packet as a chunk; its stamp is of the last byte, or for OUT of the first."""
        for packet in self._packets:
            if packet.link == pcap.LINK_USER0:
                yield from self._chunks(packet)

    def _chunks(self, packet: pcap.CapturedPacket) -> Iterator[Chunk]:
        stamp, bus = packet.stamp, packet.interface.name
        if not self.began.stamp:
            self.began = ClockReading(stamp, stamp)
        if bus not in self.wires:
            self.wires[bus] = Wire(bus, min(packet.interface.speed, BAUD_MAX) or DEFAULT_BAUD,
                                   port=packet.interface.about)
        for comment in packet.comments:
            if change := _change(comment):
                yield Chunk(stamp, bus, change=change)
        if packet.data:
            side = _SIDE.get(packet.flags & 3, UNKNOWN)
            length_ns = 0 if side == OUT else \
                int(len(packet.data) * byte_ns(self.wire(bus).baud))
            yield Chunk(stamp + length_ns, bus, packet.data, side)

    def _problems(self) -> list[str]:
        return list(filter(None, [self._packets.problem]))


def _change(comment: str) -> Change | None:
    if comment.startswith(_EVENT):
        what, _, value = comment.removeprefix(_EVENT).partition(' ')
        with suppress(ValueError):
            return change_of(what, value)
    return None
