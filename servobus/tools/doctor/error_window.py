# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""
The bytes around the first error of a run, for a report: bounded in time and size.

Until something is wrong the newest are kept; then those that come for half of the time more.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Mapping
import io

from msg_defs.diagnostics import Level
from msg_defs.event import Chunk
from servobus.bus.report import BusReport
from servobus.sources.capture import ClockReading
from servobus.sources.capture import Wire
from servobus.sources.capture import Writer

WINDOW_S = 30
WINDOW_MAX_BYTES = 1_500_000       # bytes of the bus; as text in a report about half of that
_HALF_NS = WINDOW_S * 500_000_000


class ErrorWindow:
    """Takes all chunks of a run; first_error: the stamp of the first finding, once there is."""

    def __init__(self) -> None:
        self.first_error = 0
        self._chunks: deque[tuple[Chunk, Wire]] = deque()
        self._size = 0

    def record_chunk(self, wire: Wire, chunk: Chunk) -> None:
        """Keep a chunk, if it is near enough to the first error, or to now."""
        if self.first_error and (chunk.stamp > self.first_error + _HALF_NS
                                 or self._size > WINDOW_MAX_BYTES):
            return
        self._chunks.append((chunk, wire))
        self._size += len(chunk.data)
        before = self.first_error - _HALF_NS if self.first_error else chunk.stamp - 2 * _HALF_NS
        while self._chunks and (self._chunks[0][0].stamp < before or (
                self._size > WINDOW_MAX_BYTES and not self.first_error)):
            self._size -= len(self._chunks.popleft()[0].data)

    def record_report(self, bus: str, report: BusReport) -> None:
        """Note the time of the first report with a finding that is no advice."""
        if not self.first_error and any(one.level > Level.OK for one in report.findings):
            self.first_error = report.stamp

    def capture(self, names: Mapping[str, str]) -> bytes:
        """Return it as a capture, with the buses renamed and without their ports."""
        file = io.BytesIO()
        writer = Writer(file, ClockReading(0, self._chunks[0][0].stamp if self._chunks else 0))
        for chunk, wire in self._chunks:
            name = names.get(chunk.bus, 'bus')
            writer.write_chunk(wire._replace(name=name, port=''), chunk._replace(bus=name))
        return file.getvalue()
