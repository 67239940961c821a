# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""A bus that is listened to: its port and its monitor, with or without ROS."""
from __future__ import annotations

from collections.abc import Sequence
import time

from msg_defs.diagnostics import Pairs
from msg_defs.diagnostics import pairs
from msg_defs.event import Chunk
from servobus.bus.report import BusReport
from servobus.doctor.case import Names
from servobus.doctor.case import PARAMETERS
from servobus.model.models import Models
from servobus.monitor import Monitor
from servobus.port.inspection import Inspection
from servobus.settings import Bus
from servobus.sources.capture import Wire
from servobus.sources.listener import RECORDS_EVERY_S
from servobus.sources.listeners import listener_on
from servobus.sources.recorders import Recorders
from servobus.sources.serial_driver import adapter
from servobus.sources.source_name import is_live
from servobus.status import PortState

LATE_AFTER_NS = 1_000_000_000  # after a freeze; else a listener is 0.3 s late at most
LATE_PATIENCE_NS = 2_500_000_000  # longer is not a freeze: its reader hangs; a dashboard waits 4 s


def _time_of_day(stamp: int) -> str:
    """Spell a monotonic stamp as a clock on the wall shows it."""
    ago_s = (time.monotonic_ns() - stamp) / 1e9
    return time.strftime('%H:%M:%S', time.localtime(time.time() - ago_s))


class MonitoredBus:
    """One bus: its listener and its monitor, and the recorders of all buses."""

    def __init__(self, bus: Bus, models: Models, recorders: Recorders,
                 joint_state_rate: float = 0.0, names: Names = PARAMETERS) -> None:
        self.bus = bus
        self.monitor = Monitor(bus.label, models, bus.settings, idle_is_told=True,
                               names=names._replace(time_of_day=_time_of_day))
        self._behind_since = 0
        self._known_adapter: tuple[int, Pairs] = (0, [])
        self._recorders = recorders
        self._wire: Wire | None = None         # what a capture says of the bus, after its changes
        self._inspection = None if is_live(bus.port) else Inspection(bus.port, [])
        self.listener = listener_on(
            bus.port, bus.settings.baud,
            self._record_and_feed if recorders else self.monitor.feed_chunks,
            self.monitor.flush_if_idle, bus=bus.name,
            records_every_s=min(RECORDS_EVERY_S, 0.5 / (joint_state_rate or 1.0)))

    def _record_and_feed(self, chunks: Sequence[Chunk]) -> None:
        wire = self._wire or Wire(self.bus.name, self.bus.settings.baud,
                                  self.listener.latency_timer_ms or 0, self.bus.port)
        for chunk in chunks:
            wire = wire.changed(chunk.change)
            self._recorders.record_chunk(wire, chunk)
        self._wire = wire
        self.monitor.feed_chunks(chunks)

    def is_late(self, now: int) -> bool:
        """Return whether a report must wait, because what came is still to be read."""
        if not self.listener.state.is_open or now - self.listener.listened < LATE_AFTER_NS:
            self._behind_since = 0
            return False
        self._behind_since = self._behind_since or now
        return now - self._behind_since < LATE_PATIENCE_NS

    def report(self, now: int) -> BusReport:
        """Return what is known; what the adapter delays is not silence."""
        self.monitor.decoder.set_latency_timer(self.listener.latency_timer_ms or 0)
        return self.monitor.report(now, self.listener.line_errors,
                                   self.listener.state.is_open and not self._behind_since)

    def port_state(self, warnings: Sequence[str] = ()) -> PortState:
        """Return what the driver and the thread know about the port; `warnings` are the node's."""
        listener, state = self.listener, self.listener.state
        errors = listener.line_errors._asdict() if listener.line_errors is not None else {}
        values = pairs({
            'Bytes read': listener.bytes,
            'Reads': listener.reads,
            'Openings': listener.openings,
            'Largest gap between reads (ms)': f'{listener.largest_gap / 1e6:.1f}',
            'Low latency mode': listener.low_latency,
            'Read by': None if not state.is_open else 'a process of its own'
            if listener.reader_pid else 'a thread of the node',
            **dict(self._adapter(listener.openings) if state.is_open else ()),
            'Latency timer (ms)': listener.latency_timer_ms,
            **dict(self._recorders.values()),
            **{f'Driver: {name}': count for name, count in errors.items()},
        })
        warning = self._recorders.problem or '; '.join(
            [*listener.problems(), *self._complaints()])
        if state.is_open and self._behind_since:
            warning = (f'{self.bus.port}: its reader is not responding, so the data is stale; '
                       'plug the adapter in again, or restart the node')
        return PortState(self.bus.port, '' if state.is_open else state.text, tuple(values),
                         '; '.join(filter(None, [*warnings, warning])), self.bus.name)

    def _complaints(self) -> list[str]:
        """Return what disturbs the port while it is open: a login, a console."""
        if self._inspection is None or not self.listener.state.is_open:
            return []
        self._inspection.inspect_if_due(self.listener.openings, time.monotonic())
        return self._inspection.complaints

    def _adapter(self, openings: int) -> Pairs:
        """Return what the adapter says of itself; another one may be there after each opening."""
        if self._known_adapter[0] != openings:
            self._known_adapter = openings, adapter(self.bus.port)
        return self._known_adapter[1]
