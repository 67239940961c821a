# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""
Where the time of a master's cycle goes. Pure: stamps come with each call, in monotonic ns.

A cycle lasts from an instruction to its next repetition. What is on the wire is wire time, what
passes before an answer is the device's, what passes without an answer is waiting, all else is
the program's.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Collection
from collections.abc import Iterable
from itertools import pairwise
from statistics import median

from dxl_monitor.bus.plan import Plan
from dxl_monitor.bus.report import CycleTimes
from msg_defs.dxl_packet import BROADCAST
from msg_defs.reports import Metric
from msg_defs.timing import Rate
from msg_defs.timing import Series

PARTS = ('cycle', 'cycle_wire', 'cycle_device', 'cycle_waiting', 'cycle_program')
AT_ONCE_NS = 50_000
ENOUGH = 4                         # repetitions
FRESH_NS = 3_000_000_000
ALIKE = 0.1                        # share of a period: two instructions of one cycle
BLURRED = 0.01                     # share of the cycle
LOOKED_AT = 32                     # instructions
LONG = 10                          # times the usual cycle: a pause
NO_SIDES = 'this source does not say who sent what'
NO_RATE = 'the baud rate is unknown'


class CycleClock:
    """Adds up what a master and its devices do, and divides it into cycles."""

    def __init__(self) -> None:
        self._period = 0.0                     # ns; 0: unknown
        self._leader: Plan | None = None       # a cycle begins with it
        self.reset()

    def reset(self) -> None:
        """Start all statistics at 0."""
        self._series = {part: Series() for part in PARTS}
        self._waits: defaultdict[int, Rate] = defaultdict(Rate)
        self._blurred = Rate()
        self._sleeps = Series()
        self.interrupt()

    def interrupt(self) -> None:
        """Forget the present cycle: not all of it was heard."""
        self._began = self._last = 0
        self._gave_up, self._gap, self._away = -1, 0.0, 0
        self._start_cycle(0)

    def _start_cycle(self, began: int) -> None:
        self._began = began
        self._wire = self._device = self._program = self._traced = self._asleep = 0.0
        self._waiting: defaultdict[int, float] = defaultdict(float)

    def give_up(self, ns: int) -> None:
        """Take note that the master looked for bytes in vain until so long before its write."""
        self._gave_up = ns

    def look_away(self, ns: int) -> None:
        """Take note that the bytes which follow may have been there for so long."""
        self._away = ns

    def trace(self, ns: int) -> None:
        """Take note of what strace took since the write before."""
        self._traced += ns

    def write(self, began: int, wire_ns: float, awaited: Collection[int], is_missed: bool) -> None:
        """Take bytes of the master; awaited: IDs without an answer; is_missed: it was due."""
        rest = max(0.0, began - self._last) if self._last else 0.0
        vain = 0.0
        if awaited and (is_missed or self._gave_up >= 0):
            vain = max(0, rest - max(0, self._gave_up))
            if vain < AT_ONCE_NS and 0 <= self._gave_up <= rest:    # bytes came when time was up
                self._device -= self._gap
                vain, rest = vain + self._gap, rest + self._gap
            self._waiting[next((one for one in awaited if one != BROADCAST), BROADCAST)] += vain
            if self._gave_up < 0:
                self._blurred.add(vain, began)
        self._gave_up = -1
        self._program += rest - vain
        self._last = max(began, self._last)
        self._wire += wire_ns
        self._gap = 0.0
        self._last += int(wire_ns)

    def ask(self, plan: Plan, began: int, wire_ns: float) -> None:
        """Take note that the last write completed an instruction, after write()."""
        if plan is not self._leader or not wire_ns:    # it is unknown
            return
        began = max(began, self._last - int(wire_ns))
        self._wire -= wire_ns                  # it belongs to the cycle that begins
        if self._began and began - self._began < LONG * self._period:
            self._add(began)
        self._start_cycle(began)
        self._wire = wire_ns

    def _add(self, now: int) -> None:
        traced = min(self._traced, self._program)
        values = (now - self._began, self._wire, self._device, sum(self._waiting.values()),
                  self._program - traced)
        for series, value in zip(self._series.values(), values, strict=True):
            series.add(value / 1e6, now)
        self._sleeps.add(self._asleep / 1e6, now)
        for number, ns in self._waiting.items():
            self._waits[number].add(ns, now)

    def answer(self, stamp: int, wire_ns: float) -> None:
        """Take bytes that came to the master."""
        if self._last:
            on_wire = min(wire_ns, max(0, stamp - self._last))
            self._wire += on_wire
            gap = max(0.0, stamp - self._last - on_wire)
            away, self._away = min(gap, self._away), 0
            self._program += away
            self._asleep += away
            self._gap = gap - away
            self._device += self._gap
            self._last = max(stamp, self._last)

    def choose(self, plans: Iterable[Plan], now: int) -> None:
        """Look for the instruction that begins each cycle."""
        found = sorted((plan for plan in plans if len(plan.stamps) >= ENOUGH
                        and now - plan.stamps[-1] < FRESH_NS),
                       key=lambda plan: -plan.asked)[:LOOKED_AT]
        found = [plan for plan in found if 2 * plan.missed < plan.asked] or found
        periods = [(period, plan) for plan in found if (period := median(
            two - one for one, two in pairwise(plan.stamps))) > 0]
        alike = max(([(other, plan) for other, plan in periods
                      if abs(other - period) <= ALIKE * period] for period, _ in periods),
                    key=lambda many: (len(many), -many[0][0]), default=[])
        self._period = alike[0][0] if alike else 0.0
        if alike and not any(plan is self._leader for _, plan in alike):
            self._leader = alike[0][1]
            self._began = 0

    def metrics(self, now: int, bus: str) -> list[Metric]:
        """Return the parts of a cycle over the last 10 s and since start, if there were any."""
        return [Metric(part, 'ms', one.summary(now), one.total(), bus=bus)
                for part, one in self._series.items() if one.total() is not None]

    def times(self, now: int, unknown: str) -> CycleTimes | None:
        """Return the mean cycle; unknown: why its parts are not known. None: there is none."""
        if unknown:
            return CycleTimes(self._period / 1e6, unknown=unknown) if self._period else None
        means = [round(one.mean, 3) for series in self._series.values()
                 if (one := series.summary(now))]
        if len(means) < len(PARTS):            # a part is refused where stamps are of ages apart
            return None
        cycle, wire, device, waiting, program = means
        rates = {number: rate.per_second(now) for number, rate in [*self._waits.items()]}
        share = waiting / (sum(rates.values()) or 1.0)
        tracer = round(max(0.0, cycle - wire - device - waiting - program), 3)
        blurred = self._blurred.per_second(now) * share
        slept = self._sleeps.summary(now)
        return CycleTimes(cycle, wire, device, program, tracer, tuple(sorted(
            ((number, round(rate * share, 3)) for number, rate in rates.items() if rate),
            key=lambda one: -one[1])), blurred > BLURRED * cycle,
            asleep=round(slept.mean, 3) if slept else 0.0)
