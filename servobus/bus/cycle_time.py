# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""
Where the time of a master's cycle goes. Pure: stamps come with each call, in monotonic ns.

A cycle is one turn of the program's fastest loop: of the instruction that it repeats most often.
What is on the wire is wire time, what passes before an answer is the device's, what passes
without an answer is waiting, all else is the program's.
"""

from __future__ import annotations

from bisect import bisect_left
from collections import defaultdict
from collections.abc import Collection
from collections.abc import Iterable
from operator import attrgetter
from operator import sub
from typing import NamedTuple

from msg_defs.diagnostics import Metric
from msg_defs.dxl_packet import BROADCAST
from msg_defs.event import AWAY
from msg_defs.event import BUSY
from msg_defs.event import Change
from msg_defs.event import GAVE_UP
from msg_defs.event import TRACED
from msg_defs.running_statistics import Rate
from msg_defs.running_statistics import Series
from servobus.bus.plan import Plan
from servobus.bus.report import CycleTimes

PARTS = ('cycle', 'cycle_wire', 'cycle_device', 'cycle_waiting', 'cycle_program')
VAIN_WAIT_MIN_NS = 50_000
REPETITIONS_NEEDED = 4             # repetitions
LOOP_GOES_ON_NS = 3_000_000_000
SAME_PERIOD_SHARE = 0.1            # share of a period: two instructions of one cycle
PACED_MAX_SPREAD = 0.25            # spread of repetitions that a clock paces
TIMES_A_CYCLE_END = 4              # more often in one cycle nothing is asked
SHORT_GAP_SHARE = 0.4              # share of the mean: asked again in the same cycle
WHOLE_RATIO_SHARE = 0.05           # share of a ratio: from the next whole number
BLURRED_MIN_SHARE = 0.01           # share of the cycle
INSTRUCTIONS_COMPARED = 32         # instructions
PAUSE_MIN_PERIODS = 10             # times the usual cycle: a pause
NO_SIDES = 'this source does not say who sent what'
NO_RATE = 'the baud rate is unknown'


class Pace(NamedTuple):
    """How an instruction is repeated; times: how often in each period."""

    plan: Plan
    times: int
    period: float                  # ns: the mean, without pauses
    shortest: float                # ns: the 10th percentile
    spread: float                  # from there to the 90th, relative to the period

    def contains(self, other: Pace) -> bool:
        """
        Tell whether this is a cycle in which the other, asked more often, is asked again.

        Either it keeps time and the other does not, or the other is asked again when it did
        not answer.
        """
        ratio = self.period / other.period
        is_whole = ratio <= TIMES_A_CYCLE_END \
            and abs(ratio - round(ratio)) < WHOLE_RATIO_SHARE * ratio
        if is_mostly_missed(other.plan):
            return is_whole and not is_mostly_missed(self.plan)
        return other.spread > max(PACED_MAX_SPREAD, 2 * self.spread) and (is_whole or ratio < 2)

    def is_group_of(self, one: Pace) -> bool:
        """Tell whether this is the pace of groups of a question that is asked at that pace."""
        return one.shortest < SHORT_GAP_SHARE * one.period \
            and TIMES_A_CYCLE_END * self.spread * self.period < one.spread * one.period


def is_mostly_missed(plan: Plan) -> bool:
    """Tell whether most times nothing answers an instruction that asks one device."""
    return len(plan.slots) == 1 and 2 * plan.missed > plan.asked


def pace_of(plan: Plan, times: int = 1) -> Pace | None:
    """Return how each so many repetitions of an instruction follow, None if they are too few."""
    stamps = [*plan.stamps]
    if len(stamps) < REPETITIONS_NEEDED * times:
        return None
    gaps = sorted(map(sub, stamps[times:], stamps))
    usual = gaps[:bisect_left(gaps, PAUSE_MIN_PERIODS * gaps[3 * len(gaps) // 4])]
    if sum(usual) <= 0:                # the clock was set, or all came in one chunk
        return None
    edge, period = len(usual) // 10, sum(usual) / len(usual)
    return Pace(plan, times, period, usual[edge], (usual[-1 - edge] - usual[edge]) / period)


def find_control_loop(plans: Iterable[Plan], now: int) -> list[Pace]:
    """Return what is asked once in each turn of the fastest loop that goes on, or often in it."""
    often = sorted([plan for plan in plans
                    if plan.stamps and now - plan.stamps[-1] < LOOP_GOES_ON_NS],
                   key=attrgetter('asked'))
    found = sorted([one for one in map(pace_of, often[-INSTRUCTIONS_COMPARED:]) if one],
                   key=attrgetter('period'))
    for at, first in enumerate(found):
        alike = [one for one in found[at:] if one.period <= (1 + SAME_PERIOD_SHARE) * first.period]
        if len(alike) > 1:
            return alike
        if not any(one.contains(first) for one in found[at + 1:]):
            groups = [one for times in range(2, TIMES_A_CYCLE_END)
                      if (one := pace_of(first.plan, times)) and one.is_group_of(first)]
            return groups[:1] or alike
    return []


class CycleClock:
    """Adds up what a master and its devices do, and divides it into cycles."""

    def __init__(self) -> None:
        self._period = 0.0                     # ns; 0: unknown
        self._least = 0.0                      # ns: what the leader asks sooner is no new cycle
        self._leader: Plan | None = None       # a cycle begins with it
        self.reset()

    def reset(self) -> None:
        """Start all statistics at 0."""
        self._series = {part: Series() for part in PARTS}
        self._waits: defaultdict[int, Rate] = defaultdict(Rate)
        self._blurred = Rate()
        self._sleeps = Series()
        self._busy: Rate | None = None         # ns per s
        self.interrupt()

    def interrupt(self) -> None:
        """Forget the present cycle: not all of it was heard."""
        self._began = self._last = 0
        self._gave_up, self._gap, self._late, self._away = -1, 0.0, 0.0, 0
        self._start_cycle(0)

    def _start_cycle(self, began: int) -> None:
        self._began = began
        self._wire = self._device = self._program = self._traced = self._asleep = 0.0
        self._waiting: defaultdict[int, float] = defaultdict(float)

    def process_change(self, change: Change, stamp: int) -> None:
        """Note what a source says of the program; each is ahead of its bytes."""
        what, ns = change.what, 1000 * change.value
        if what == GAVE_UP:
            self._gave_up = ns
        elif what == AWAY:
            self._away = ns
        elif what == TRACED:
            self._traced += ns
        elif what == BUSY:
            self._busy = self._busy or Rate()
            self._busy.add(ns, stamp)

    def add_write(self, began: int, wire_ns: float, awaited: Collection[int],
                  is_missed: bool) -> None:
        """Take bytes of the master; awaited: IDs without an answer; is_missed: it was due."""
        rest = max(0.0, began - self._last) if self._last else 0.0
        if self._gave_up >= 0 or (awaited and is_missed):
            vain = max(0.0, rest - max(0, self._gave_up))
            # Bytes came when time was up.
            if vain < VAIN_WAIT_MIN_NS and 0 <= self._gave_up <= rest:
                vain, rest = (one + self._gap + self._late for one in (vain, rest))
                self._device -= self._gap
                self._program -= self._late
                self._asleep -= self._late
            if not awaited:                    # it waits for more than it asked for
                self._asleep += vain
            else:
                rest -= vain
                self._waiting[next((one for one in awaited if one != BROADCAST),
                                   BROADCAST)] += vain
                if self._gave_up < 0:
                    self._blurred.add(vain, began)
        self._gave_up = -1
        self._program += rest
        self._last = max(began, self._last)
        self._wire += wire_ns
        self._gap = self._late = 0.0
        self._last += int(wire_ns)

    def add_instruction(self, plan: Plan, began: int, wire_ns: float) -> None:
        """Note that the last write completed an instruction, after add_write()."""
        if plan is not self._leader or not wire_ns:    # it is unknown
            return
        began = max(began, self._last - int(wire_ns))
        if began - self._began < self._least:
            return
        self._wire -= wire_ns                  # it belongs to the cycle that begins
        if self._began and began - self._began < PAUSE_MIN_PERIODS * self._period:
            self._add_cycle(began)
        self._start_cycle(began)
        self._wire = wire_ns

    def _add_cycle(self, now: int) -> None:
        traced = min(self._traced, self._program)
        waiting = sum(self._waiting.values()) if self._waiting else 0.0
        values = now - self._began, self._wire, self._device, waiting, self._program - traced
        for series, value in zip(self._series.values(), values, strict=True):
            series.add(value / 1e6, now)
        self._sleeps.add(self._asleep / 1e6, now)
        for number, ns in self._waiting.items():
            self._waits[number].add(ns, now)

    def add_received(self, stamp: int, wire_ns: float) -> None:
        """Take bytes that came to the master."""
        last = self._last
        if last:
            on_wire = min(wire_ns, max(0, stamp - last))
            self._wire += on_wire
            gap = max(0.0, stamp - last - on_wire)
            self._late, self._away = min(gap, self._away), 0
            self._program += self._late
            self._asleep += self._late
            self._gap = gap - self._late
            self._device += self._gap
            self._last = max(stamp, last)

    def choose_leader(self, plans: Iterable[Plan], now: int) -> None:
        """Look for the instruction that begins each cycle."""
        alike = find_control_loop(plans, now)
        before, self._period = self._period, alike[0].period if alike else 0.0
        least = self._period / 2 if alike and alike[0].times > 1 else 0.0
        if alike and (not any(one.plan is self._leader for one in alike)
                      or bool(least) is not bool(self._least)):
            self._leader = alike[0].plan
            self._began = 0
            if abs(before - self._period) > SAME_PERIOD_SHARE * self._period:
                self.reset()                   # it was another loop
        self._least = least

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
            key=lambda one: -one[1])), blurred > BLURRED_MIN_SHARE * cycle,
            asleep=round(slept.mean, 3) if slept else 0.0,
            busy=round(self._busy.per_second(now) / 1e9 * cycle, 3) if self._busy else None)
