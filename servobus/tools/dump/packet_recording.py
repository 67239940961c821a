# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""
A recording of packets: each entry of the listing as a packet of a pcapng file.

What has no bytes, a finding or an answer that did not come, is a comment on the next packet.
"""
from __future__ import annotations

from collections import defaultdict
from collections.abc import Callable
from collections.abc import Mapping
from typing import BinaryIO

from msg_defs.event import AWAY
from msg_defs.event import BAUD
from msg_defs.event import BUSY
from msg_defs.event import Change
from msg_defs.event import CLOSED
from msg_defs.event import GAVE_UP
from msg_defs.event import GONE
from msg_defs.event import LOST
from msg_defs.event import TRACED
from msg_defs.event import UNREAD
from msg_defs.reports import Level
from msg_defs.uart import byte_ns
from servobus.bus.report import BusReport
from servobus.sources.capture import Moment
from servobus.sources.capture import Wire
from servobus.sources.packet_file import PacketWriter
from servobus.tools.dump.listing import DAMAGED
from servobus.tools.dump.listing import Entry
from servobus.tools.dump.listing import Listing
from servobus.tools.dump.listing import MISSED
from servobus.tools.dump.text_format import FLAWS

NOISE = 'not a packet: noise, or part of a packet'


class PacketRecording:
    """wire: what is known of a bus; began: a moment on both clocks, once it is known."""

    def __init__(self, file: BinaryIO, wire: Callable[[str], Wire],
                 began: Callable[[], Moment]) -> None:
        self._writer = PacketWriter(file)
        self._wire = wire
        self._began = began
        self._comments: defaultdict[str, list[str]] = defaultdict(list)    # by bus
        self._known: set[tuple[str, str, int | None]] = set()      # findings: bus, rule, device

    def take(self, bus: str, entry: Entry) -> None:
        if entry.before:
            wire = self._wire(bus)
            early = int(len(entry.before) * byte_ns(wire.baud))
            self._write(bus, entry.stamp - early, entry.before, entry.side, [NOISE])
        if entry.kind == MISSED and entry.device is not None:
            self._comments[bus].append(f'no answer from {entry.device.number:03}')
        if not entry.wire:
            return
        comments = [f'damaged: {FLAWS.get(entry.reason, entry.reason)}'] * (entry.kind == DAMAGED)
        self._write(bus, entry.stamp, entry.wire, entry.side, comments)

    def change(self, bus: str, change: Change, stamp: int, listing: Listing) -> None:
        """Write what happened besides bytes; what a packet lacks then will not come."""
        if change.what in (UNREAD, GAVE_UP, AWAY, BUSY, TRACED):
            self._comments[bus].append(PacketWriter.comment(change))
            return
        if change.what in (BAUD, CLOSED, GONE, LOST):
            self._write_rest(bus, listing, stamp)
        self._write(bus, stamp, b'', '', [PacketWriter.comment(change)])

    def look(self, bus: str, report: BusReport) -> None:
        """Take the findings that began since the last look."""
        now = {(bus, one.rule, one.device): one for one in report.findings
               if one.level > Level.OK}
        for key, finding in now.items():
            if key not in self._known:
                who = 'bus' if finding.device is None else f'{finding.device:03}'
                self._comments[bus].append(
                    f'{finding.level.name}: {who}: {finding.rule}: {finding.message}')
        self._known = {key for key in self._known if key[0] != bus} | set(now)

    def finish(self, listings: Mapping[str, Listing], stamp: int) -> None:
        """Write the bytes that became no packet."""
        for bus, listing in listings.items():
            self._write_rest(bus, listing, stamp)

    def _write_rest(self, bus: str, listing: Listing, stamp: int) -> None:
        for side, data in listing.rest():
            if data:
                self._write(bus, stamp, data, side, [NOISE])

    def _write(self, bus: str, stamp: int, data: bytes, side: str, comments: list[str]) -> None:
        began = self._began()
        comments = [*self._comments.pop(bus), *comments] if bus in self._comments else comments
        self._writer.write(self._wire(bus), max(0, stamp - began.stamp + began.wall), data, side,
                           comments)
