# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""
Recordings of dxl_dump: a capture, or packets in a pcapng file (mcap_recording.py: messages).

What has no bytes, a finding or an answer that did not come, is a comment on the next packet.
"""
from __future__ import annotations

import argparse
from collections import defaultdict
from collections.abc import Iterable
from collections.abc import Mapping
import os
import sys
from typing import BinaryIO

from msg_defs.diagnostics import Level
from msg_defs.event import AWAY
from msg_defs.event import BAUD
from msg_defs.event import BUSY
from msg_defs.event import Change
from msg_defs.event import Chunk
from msg_defs.event import CLOSED
from msg_defs.event import GAVE_UP
from msg_defs.event import GONE
from msg_defs.event import LOST
from msg_defs.event import TRACED
from msg_defs.event import UNREAD
from msg_defs.uart import byte_ns
from servobus.bus.report import Finding
from servobus.errors import UsageError
from servobus.monitor import Monitor
from servobus.sources.capture import check_new
from servobus.sources.capture import is_capture
from servobus.sources.capture import open_new
from servobus.sources.capture import Writer
from servobus.sources.packet_file import holds_packets
from servobus.sources.packet_file import PacketWriter
from servobus.sources.source import Source
from servobus.tools.dump.listing import DAMAGED
from servobus.tools.dump.listing import Entry
from servobus.tools.dump.listing import Listing
from servobus.tools.dump.listing import MISSED
from servobus.tools.dump.mcap_recording import is_mcap
from servobus.tools.dump.mcap_recording import McapRecording
from servobus.tools.dump.text_format import flaw_words

CAPTURE, PCAPNG, MCAP = FORMATS = ('capture', 'pcapng', 'mcap')
_IS_OURS = {CAPTURE: is_capture, PCAPNG: holds_packets, MCAP: is_mcap}
REPORT_NS = 1_000_000_000          # between two reports, for findings
NOISE = 'not a packet: noise, or part of a packet'


class CaptureRecording:
    """A capture of what the source gives."""

    def __init__(self, file: BinaryIO, source: Source) -> None:
        self._file = file
        self._source = source
        self._writer: Writer | None = None     # its header has the moment of the first chunk

    def record_chunk(self, chunk: Chunk, monitors: Mapping[str, Monitor]) -> None:
        """Write a chunk; it was fed to the monitor of its bus before."""
        self._writer = self._writer or Writer(self._file, self._source.began)
        self._writer.write_chunk(self._source.wire(chunk.bus), chunk)
        self._flush()

    def _flush(self) -> None:
        if self._source.is_live:
            self._file.flush()

    def close(self) -> None:
        self._file.close()


class PacketRecording(CaptureRecording):
    """Packets for Wireshark."""

    def __init__(self, file: BinaryIO, source: Source) -> None:
        super().__init__(file, source)
        self._packets = PacketWriter(file)
        self._next_report = 0                  # stamp
        self._comments: defaultdict[str, list[str]] = defaultdict(list)    # by bus
        self._known: set[tuple[str, str, int | None]] = set()      # findings: bus, rule, device

    def record_entry(self, bus: str, entry: Entry) -> None:
        if entry.before:
            early = int(len(entry.before) * byte_ns(self._source.wire(bus).baud))
            self._write(bus, entry.stamp - early, entry.before, entry.side, [NOISE])
        if entry.kind == MISSED and entry.device is not None:
            self._comments[bus].append(f'no answer from {entry.device.number:03}')
        if not entry.wire:
            return
        comments = [f'damaged: {flaw_words(entry)}'] if entry.kind == DAMAGED else []
        self._write(bus, entry.stamp, entry.wire, entry.side, comments)

    def record_chunk(self, chunk: Chunk, monitors: Mapping[str, Monitor]) -> None:
        """Write the change of a chunk, and once a second the findings that began."""
        if chunk.change is not None:
            self._record_change(chunk.bus, chunk.change, chunk.stamp, monitors[chunk.bus])
        if chunk.stamp >= self._next_report:
            self._next_report = chunk.stamp + REPORT_NS
            for bus, monitor in monitors.items():
                self._record_findings(bus, monitor.report(chunk.stamp).findings)
        self._flush()

    def _record_change(self, bus: str, change: Change, stamp: int, monitor: Monitor) -> None:
        """Write what happened besides bytes; what a packet lacks then will not come."""
        if change.what in (UNREAD, GAVE_UP, AWAY, BUSY, TRACED):
            self._comments[bus].append(PacketWriter.comment(change))
            return
        if change.what in (BAUD, CLOSED, GONE, LOST):
            self._write_rest(bus, monitor, stamp)
        self._write(bus, stamp, b'', '', [PacketWriter.comment(change)])

    def _record_findings(self, bus: str, findings: Iterable[Finding]) -> None:
        """Keep those that were not in the last report as comments."""
        now = {(bus, one.rule, one.device): one for one in findings if one.level > Level.OK}
        for key, finding in now.items():
            if key not in self._known:
                who = 'bus' if finding.device is None else f'{finding.device:03}'
                self._comments[bus].append(
                    f'{finding.level.name}: {who}: {finding.rule}: {finding.message}')
        self._known = {key for key in self._known if key[0] != bus} | set(now)

    def finish(self, now: int, monitors: Mapping[str, Monitor]) -> None:
        """Write the bytes that became no packet."""
        for bus, monitor in monitors.items():
            self._write_rest(bus, monitor, now)

    def _write_rest(self, bus: str, monitor: Monitor, stamp: int) -> None:
        assert isinstance(monitor.decoder, Listing)
        for side, data in monitor.decoder.rest():
            if data:
                self._write(bus, stamp, data, side, [NOISE])

    def _write(self, bus: str, stamp: int, data: bytes, side: str, comments: list[str]) -> None:
        began = self._source.began
        comments = [*self._comments.pop(bus), *comments] if bus in self._comments else comments
        self._packets.write(self._source.wire(bus), max(0, stamp - began.stamp + began.wall), data,
                            side, comments)


def open_recording(source: Source, options: argparse.Namespace
                   ) -> CaptureRecording | McapRecording | None:
    """Open the file to write, if any; checked before anything is read."""
    path, kind = options.write, options.format
    if not path:
        return None
    if path == '-':
        if kind == MCAP:
            raise UsageError('-w - --format mcap: needs a file name')
        if options.json or options.summary or options.stats:
            raise UsageError('-w -: the capture goes to stdout, so nothing else can be shown; '
                             'give a file name')
        file: BinaryIO = open(                 # noqa: SIM115 - it is the run's
            sys.stdout.fileno(), 'wb', closefd=False)
    else:
        if os.path.exists(path) and os.path.exists(options.source) \
                and os.path.samefile(path, options.source):
            raise UsageError(f'{path}: is also the source, and writing would destroy it; '
                             'give another file name')
        check_new(path, _IS_OURS[kind], 'recording of dxl_dump')
        if kind == MCAP:
            return McapRecording(path, source)
        file = open_new(path)
    return (PacketRecording if kind == PCAPNG else CaptureRecording)(file, source)
