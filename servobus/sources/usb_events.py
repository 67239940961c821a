# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""
The USB events of a file: pcap or pcapng of usbmon or USBPcap, or what /dev/usbmonN gave.

Problems are given in words at the end; what is readable is used.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator
import os
from typing import BinaryIO

from servobus.sources.pcap import CapturedPacket
from servobus.sources.pcap import is_pcap
from servobus.sources.pcap import LINK_USB_LINUX
from servobus.sources.pcap import LINK_USB_LINUX_MMAPPED
from servobus.sources.pcap import LINK_USBPCAP
from servobus.sources.pcap import MAGIC_SIZE
from servobus.sources.pcap import PcapReader
from servobus.sources.usbmon import decode
from servobus.sources.usbmon import decode_usbpcap
from servobus.sources.usbmon import HEADER_SIZE
from servobus.sources.usbmon import is_record
from servobus.sources.usbmon import OLD_HEADER_SIZE
from servobus.sources.usbmon import Records
from servobus.sources.usbmon import UsbEvent

READ_SIZE = 1 << 16


def is_usb(head: bytes) -> bool:
    """Tell whether a file that begins so (64 bytes, or all of it) holds USB events."""
    return is_pcap(head) or is_record(head)


def may_be_usb(head: bytes) -> bool:
    """Tell whether more bytes may show that a file that begins so holds USB events."""
    return is_pcap(head) or (len(head) < HEADER_SIZE and head[8:9] in (b'', b'S', b'C', b'E'))


class UsbEvents:
    """The events of an open file, from its position on; it can seek."""

    def __init__(self, file: BinaryIO) -> None:
        self.problems: list[str] = []
        self._file = file
        head = file.read(MAGIC_SIZE)
        self._is_pcap = is_pcap(head)
        file.seek(-len(head), os.SEEK_CUR)

    def __iter__(self) -> Iterator[UsbEvent]:
        return self._from_packets() if self._is_pcap else self._from_records()

    def _from_packets(self) -> Iterator[UsbEvent]:
        others: Counter[int] = Counter()
        reader = PcapReader(self._file)
        bad = 0
        for packet in reader:
            if packet.link not in (LINK_USB_LINUX, LINK_USB_LINUX_MMAPPED, LINK_USBPCAP):
                others[packet.link] += 1
                continue
            event = _event(packet)
            if event is None:
                bad += 1
            else:
                yield event
        if reader.problem:
            self.problems.append(reader.problem)
        if bad:
            self.problems.append(f'{bad} packets are not USB events and were left out')
        for link, count in others.items():
            self.problems.append(f'{count} packets of link type {link} were left out; usbmon has '
                                 '189 and 220, USBPcap 249')

    def _from_records(self) -> Iterator[UsbEvent]:
        records = Records()
        while piece := self._file.read(READ_SIZE):
            yield from records.events(piece)
        if records.skipped:
            self.problems.append(f'{records.skipped} bytes are not USB events and were left out')
        if records.rest:
            self.problems.append('it ends within an event: cut off, or still being written')


def _event(packet: CapturedPacket) -> UsbEvent | None:
    if packet.link == LINK_USBPCAP:
        return decode_usbpcap(packet.data, packet.stamp)
    size = OLD_HEADER_SIZE if packet.link == LINK_USB_LINUX else HEADER_SIZE
    return decode(packet.data, packet.order, size)
