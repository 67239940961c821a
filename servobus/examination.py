# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""
A run: a monitor per bus, a report twice a second, and what the reports said from the first on.

Time is that of the stamps; a live source reports in between that nothing came.
"""

from __future__ import annotations

from collections.abc import Mapping
from collections.abc import Sequence
import time
from typing import Protocol

from msg_defs.diagnostics import Level
from msg_defs.event import Chunk
from msg_defs.nanoseconds import NS_PER_S
from servobus.bus.decoder import DEFAULTS
from servobus.bus.report import BusReport
from servobus.bus.report import Finding
from servobus.doctor.case import Names
from servobus.doctor.case import OPTIONS
from servobus.doctor.finding_log import BusSummary
from servobus.doctor.finding_log import FindingLog
from servobus.model.models import Models
from servobus.monitor import Monitor
from servobus.settings import settings_of
from servobus.sources.capture import Wire
from servobus.sources.source import Source

REPORT_NS = NS_PER_S // 2
SETTLED_S = 2.0                    # the first guess after a few packets is often another one
ARRIVAL_NS = NS_PER_S // 5         # a chunk may be handed over so long after its stamp
ENOUGH_TRAFFIC_S, GIVE_UP_SILENCE_S = 10.0, 5.0   # for a live source without --seconds
LONGEST_PAUSE_NS = 12 * NS_PER_S   # a file is silent for longer: passed over, all is forgotten


class Watcher(Protocol):
    """Who has each chunk, and each report of each bus: a recorder."""

    def record_chunk(self, wire: Wire, chunk: Chunk) -> None: ...

    def record_report(self, bus: str, report: BusReport) -> None: ...


class Examination:
    """What was heard so far; stamps are monotonic ns."""

    def __init__(self, models: Models, devices: Sequence[str] = (),
                 protocol: str = DEFAULTS.protocol, watchers: Sequence[Watcher] = (),
                 names: Names = OPTIONS) -> None:
        self.bytes = 0
        self.first = self.last = 0             # stamps of chunks; 0: none yet
        self._models = models
        self._watchers = watchers
        self._devices = devices
        self._protocol = protocol
        self._names = names
        self._monitors: dict[str, Monitor] = {}
        self._wires: dict[str, Wire] = {}      # as they are after their changes
        self._logs: dict[str, FindingLog] = {}
        self._due = 0

    def feed_from(self, source: Source, chunk: Chunk | None) -> None:
        """Feed what a source gave; None: a live one gave nothing for a moment."""
        if chunk is not None:
            self.feed_chunk(chunk, source.wire(chunk.bus))
        else:
            self.pass_time(time.monotonic_ns() - ARRIVAL_NS)

    def feed_chunk(self, chunk: Chunk, wire: Wire) -> None:
        """Feed a chunk of a bus; wire: what the source knows of that bus."""
        self.pass_time(chunk.stamp)
        self._due = self._due or chunk.stamp + REPORT_NS
        monitor = self._monitors.get(chunk.bus) or self._begin(chunk.bus, wire)
        wire = self._wires[chunk.bus] = self._wires.get(chunk.bus, wire).changed(chunk.change)
        for one in self._watchers:
            one.record_chunk(wire, chunk)
        monitor.feed_chunks([chunk])
        if chunk.change is not None:
            return
        self.first = self.first or chunk.stamp
        self.last = chunk.stamp
        self.bytes += len(chunk.data)

    def _begin(self, bus: str, wire: Wire) -> Monitor:
        settings = settings_of(bus, wire, self._devices, self._protocol)
        self._logs[bus] = FindingLog()
        self._monitors[bus] = Monitor(bus, self._models, settings, names=self._names)
        return self._monitors[bus]

    def pass_time(self, now: int) -> None:
        """Make the reports that are due until now."""
        if self._due and now - self._due > LONGEST_PAUSE_NS:
            self._report(self._due)
            self._due = now
        while self._due and self._due <= now:
            self._report(self._due)
            self._due += REPORT_NS

    def _report(self, now: int) -> None:
        for bus, monitor in self._monitors.items():
            report = monitor.report(now)
            self._logs[bus].add_report(report)
            for one in self._watchers:
                one.record_report(bus, report)

    @property
    def seconds(self) -> float:
        """How long there was traffic, from the first byte to the last (s)."""
        return (self.last - self.first) / NS_PER_S

    def finish(self, now: int, is_over: bool, failed: str = '',
               users: Mapping[str, Sequence[str]] | None = None) -> None:
        """Make the last reports; is_over: nothing more comes; failed, users: Monitor.end()."""
        if is_over:
            for bus, monitor in self._monitors.items():
                monitor.end(now, failed, (users or {}).get(bus, ()))
        self._report(now)

    def finish_source(self, source: Source, is_over: bool) -> None:
        """Make the last reports of a source; is_over: a recording was fed to its end."""
        if source.is_live:
            self.finish(time.monotonic_ns(), is_over=False)
        elif is_over and source.ended > self.last:     # it went on in silence
            self.pass_time(source.ended)
            self.finish(source.ended, is_over=False)
        else:
            self.finish(self.last, is_over)

    def summary(self) -> str:
        """Return what is heard at this moment, in a line."""
        if not self.bytes:
            return 'nothing heard yet'
        reports = [log.last for log in self._logs.values() if log.last is not None]
        packets = sum(report.counters['Packets'] for report in reports)
        devices = sum(device.last_heard_s is not None for report in reports
                      for device in report.devices)
        rules = [one.rule.replace('_', ' ') for one in self._current_findings()]
        return '; '.join([f'{packets} packets, {devices} devices', *rules[:3]])

    def worst(self) -> str:
        """Return the worst of what is wrong, and has been for SETTLED_S; '' for nothing."""
        found = max(self._current_findings(SETTLED_S), key=lambda one: one.level, default=None)
        if found is None or found.level is Level.OK:
            return ''
        return f'{found.who}: {found.rule.replace("_", " ")}: {found.message}'

    def _current_findings(self, since_s: float = 0.0) -> list[Finding]:
        """Return what is found at this moment, of all buses; since_s: for so long at least."""
        return [one.finding for log in self._logs.values() for one in log.entries()
                if one.stands and one.last_s - one.first_s >= since_s]

    def buses(self, is_timed: bool) -> list[BusSummary]:
        """Return each bus as it is shown at the end; before its first report is due, as it is."""
        found = [(name, log, log.last or (self._monitors[name].report(self.last)
                                          if self.last else None))
                 for name, log in self._logs.items()]
        return [BusSummary.of(name if len(found) > 1 else '', last, log, is_timed)
                for name, log, last in found if last is not None]
