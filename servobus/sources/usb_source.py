# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""
A file of USB events as a source: the bytes of one serial adapter in it, with their sides.

pcap or pcapng of usbmon or USBPcap, or what /dev/usbmonN gave. Problems are given in words at the
end; what is readable is used.
"""
from __future__ import annotations

from collections import Counter
from collections.abc import Iterator
from io import BufferedReader
import shutil
from tempfile import TemporaryFile
from typing import BinaryIO
from typing import cast

from msg_defs.event import Chunk
from servobus.errors import UsageError
from servobus.sources.capture import ClockReading
from servobus.sources.capture import STAMP_END
from servobus.sources.pcap import is_pcap
from servobus.sources.pcap import LINK_USB_LINUX
from servobus.sources.pcap import LINK_USB_LINUX_MMAPPED
from servobus.sources.pcap import LINK_USBPCAP
from servobus.sources.pcap import MAGIC_SIZE
from servobus.sources.pcap import PcapReader
from servobus.sources.source import File
from servobus.sources.source import READ_SIZE
from servobus.sources.usb_port import UsbPort
from servobus.sources.usb_survey import Found
from servobus.sources.usb_survey import Survey
from servobus.sources.usbmon import decode
from servobus.sources.usbmon import decode_usbpcap
from servobus.sources.usbmon import HEADER_SIZE
from servobus.sources.usbmon import is_record
from servobus.sources.usbmon import OLD_HEADER_SIZE
from servobus.sources.usbmon import Records
from servobus.sources.usbmon import UsbEvent

_HEADER_SIZES = {LINK_USB_LINUX: OLD_HEADER_SIZE, LINK_USB_LINUX_MMAPPED: HEADER_SIZE}


def is_usb(head: bytes) -> bool:
    """Tell whether a file that begins so (64 bytes, or all of it) holds USB events."""
    return is_pcap(head) or is_record(head)


def may_be_usb(head: bytes) -> bool:
    """Tell whether more bytes may show that a file that begins so holds USB events."""
    return is_pcap(head) or (len(head) < HEADER_SIZE and head[8:9] in (b'', b'S', b'C', b'E'))


class UsbEvents:
    """The events of an open file that can seek, each time from its start."""

    def __init__(self, file: BinaryIO) -> None:
        self.problems: list[str] = []
        self._file = file

    def __iter__(self) -> Iterator[UsbEvent]:
        self.problems.clear()
        self._file.seek(0)
        is_packets = is_pcap(self._file.read(MAGIC_SIZE))
        self._file.seek(0)
        return self._from_packets() if is_packets else self._from_records()

    def _from_packets(self) -> Iterator[UsbEvent]:
        others: Counter[int] = Counter()
        reader = PcapReader(self._file)
        bad = 0
        for packet in reader:
            if packet.link == LINK_USBPCAP:
                event = decode_usbpcap(packet.data, packet.stamp)
            elif packet.link in _HEADER_SIZES:
                event = decode(packet.data, packet.order, _HEADER_SIZES[packet.link])
            else:
                others[packet.link] += 1
                continue
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


class UsbFile(File):
    """
    The chunks of a file of USB events; it says the rate where that is set in it.

    adapter: as `Place.words` spells it; needed where several adapters carried bytes. Raises
    UsageError, which lists them. The file is read twice: a pipe goes through a temporary file.
    """

    def __init__(self, name: str, file: BufferedReader, baud: int | None,
                 adapter: str | None) -> None:
        super().__init__(name, _seekable(file), baud)
        self._events = UsbEvents(self._file)
        survey = Survey()
        for event in self._events:
            survey.add_event(event)
        found = _chosen(survey.ports(), adapter, self._events.problems)
        self._port = UsbPort(found.place, found.adapter, self._bus)
        self._add_bus(0)

    def _read(self) -> Iterator[Chunk]:
        """Yield what was heard, in the order of its stamps: those of the file, ns since 1970."""
        newest = 0
        for event in self._events:
            for chunk in self._port.decode_event(event):
                if chunk.stamp < STAMP_END:        # else the file is damaged
                    newest = max(newest, chunk.stamp)
                if not self.began.stamp:
                    self.began = ClockReading(newest, newest)
                yield chunk._replace(stamp=newest)

    def _problems(self) -> list[str]:
        return self._events.problems


def _seekable(file: BufferedReader) -> BufferedReader:
    if file.seekable():
        return file
    copy = TemporaryFile()                             # noqa: SIM115 - closed with the source
    shutil.copyfileobj(file, copy)
    return cast(BufferedReader, copy)


def _chosen(ports: list[Found], adapter: str | None, problems: list[str]) -> Found:
    """Return the port that was asked for, or the only one, or the only one with bytes."""
    named = [one for one in ports if one.place.words == adapter]
    used = named or [one for one in ports if one.size] or ports
    if len(used) == 1 and (named or adapter is None):
        return used[0]
    if not ports:
        reason = ''.join(f' ({problem})' for problem in problems[:1])
        raise UsageError(f'no serial adapter found in it{reason}; record the right USB bus, and '
                         'start before the port is used')
    known = '; '.join(one.words for one in used)
    problem = f'no adapter {adapter} in it' if adapter else 'several adapters in it'
    raise UsageError(f'{problem}: {known}; choose with --adapter {used[0].place.words}')
