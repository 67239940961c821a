# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""
What the node dxl_monitor would publish of some buses, handed over in this process as it is.

Stamps are monotonic ns, or those of a recording.
"""
from __future__ import annotations

from collections.abc import Callable
from collections.abc import Sequence
import math
import time
from typing import Protocol

from mecarover_dashboard.state import TABLES
from mecarover_dashboard.state import TIMING
from mecarover_serial.resident_memory import resident_memory
from msg_defs.diagnostics import Level
from msg_defs.diagnostics import metric_status
from msg_defs.diagnostics import Status
from msg_defs.diagnostics import status_name
from msg_defs.signal import Points
from msg_defs.signal import SPAN_S
from servobus.bus.report import BusReport
from servobus.doctor import BusSummary
from servobus.doctor import FindingLog
from servobus.examination import REPORT_NS
from servobus.monitor import Monitor
from servobus.signals import BusSignals
from servobus.status import PortState
from servobus.status import statuses_of
from servobus.status import timing_metrics
from servobus.tools.doctor.verdict import OpenPoint
from servobus.tools.doctor.verdict import Trouble
from servobus.tools.doctor.verdict import Verdict

NODE = 'dxl_monitor'                # in the names of statuses
APART_NS = 200_000_000              # a device that was lost is reported sooner
TIMING_NS = 1_000_000_000
NAMED = 3                           # groups of devices in a line


class LocalBus(Protocol):
    """A bus; a MonitoredBus is one."""

    monitor: Monitor

    def is_late(self, now: int) -> bool: ...

    def report(self, now: int) -> BusReport: ...

    def port_state(self) -> PortState: ...


class LocalMonitor:
    """
    Hands reports to `out(topic, statuses)`; used by one thread, but for what a page asks.

    begin: the first stamp of a recording; is_for_page: registers have a past there.
    """

    def __init__(self, *, is_for_page: bool = False) -> None:
        self._is_for_page = is_for_page
        self.out: Callable[[str, Sequence[Status]], None] = lambda topic, statuses: None
        self._logs: list[tuple[LocalBus, FindingLog]] = []
        self.begin: int | None = None
        self._now = 0
        self._places: dict[str, tuple[str, int]] = {}           # bus and ID, by status
        self._alarms = 0
        self._reported = self._timed = -math.inf     # on our clock

    def add(self, bus: LocalBus) -> None:
        """Report on one more bus from now on."""
        self._logs.append((bus, FindingLog()))
        self._reported = -math.inf
        if self._is_for_page:
            bus.monitor.signals.start()

    def clear(self) -> None:
        """Forget all buses."""
        self._logs.clear()
        self._alarms = 0

    def turn(self, now: int) -> None:
        """Report what is due, as of a stamp; called ten times a second or more often."""
        self._now = now
        since = time.monotonic_ns() - self._reported
        if since < REPORT_NS and (since < APART_NS or self._count_alarms() == self._alarms):
            return
        late = [bus.is_late(now) for bus, _ in self._logs]      # each: it notes since when
        if not any(late):
            self.report(now)

    def judge_buses(self, now: int) -> None:
        """Have the buses judged at a stamp, for the conclusion of a recording at its end."""
        for bus, log in self._logs:
            log.add_report(bus.report(now))

    def report(self, now: int) -> None:
        """Report at once."""
        self._alarms, self._reported = self._count_alarms(), time.monotonic_ns()
        statuses: list[Status] = []
        metrics = [resident_memory()]
        for bus, log in self._logs:
            report, port = bus.report(now), bus.port_state()
            log.add_report(report)
            label = bus.monitor.name
            statuses += statuses_of(NODE, label, report, port, whole=True)
            metrics += timing_metrics(NODE, report, port)
            self._places |= {status_name(NODE, label, one.name): (label, one.id)
                             for one in report.devices}
        self.out(TABLES, statuses)
        if self._reported - self._timed >= TIMING_NS:
            self._timed = self._reported
            self.out(TIMING, [metric_status(NODE, one) for one in metrics])

    def clock(self) -> tuple[float, float]:
        """Return now and what to add for Unix time, or for s of a recording; from any thread."""
        return self._now / 1e9, (time.time() - time.monotonic() if self.begin is None
                                 else -self.begin / 1e9)

    def signal(self, name: str, key: str, after: int) -> Points | None:
        """Return the points of a register after so many, of the last minute; from any thread."""
        return next((signals.read(number, key, after, self._now / 1e9 - SPAN_S)
                     for signals, number in self._signals_of(name)), None)

    def drop(self, name: str, key: str) -> None:
        """Keep the points of a register no more; from any thread."""
        for signals, number in self._signals_of(name):
            signals.drop(number, key)

    def _signals_of(self, name: str) -> list[tuple[BusSignals, int]]:
        """Return what records a device, and its ID; nothing for an unknown one."""
        label, number = self._places.get(name, (None, -1))
        return [(bus.monitor.signals, number) for bus, _ in self._logs
                if bus.monitor.name == label]

    def _count_alarms(self) -> int:
        return sum(bus.monitor.alarms() for bus, _ in self._logs)

    def summaries(self, is_timed: bool) -> list[BusSummary]:
        """Return each bus as dxl_doctor shows it."""
        return [BusSummary.of(bus.monitor.name, log.last, log, is_timed)
                for bus, log in self._logs if log.last is not None]


def conclusion(verdict: Verdict) -> str:
    """Return what dxl_doctor says of a run, in a line."""
    if verdict.quiet:
        return f'nothing was heard: {verdict.quiet[0]}'
    wrong = [one for one in verdict.wrong if one.level > Level.OK]
    problems: Sequence[Trouble | OpenPoint] = [*wrong, *verdict.not_sure] or verdict.wrong
    if not problems:
        heard = '; '.join(f'{one.who} {one.what}' for one in verdict.heard[:NAMED])
        return f'no problem found; heard: {heard or "no device"}'
    more = len(problems) - 1
    return (f'{problems[0].who}: {problems[0].message}'
            + (f'; and {more} more: dxl_doctor shows all' if more else ''))
