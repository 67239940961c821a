# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""
Rhythm: how regularly a master repeats an instruction, from the stamps of its last repetitions.

Stamps are those of chunks: an adapter that gathers bytes blurs them by as much, which is why every
judgement here is relative to the period and none is finer than a fifth of it.

Two timers in the stamps of one instruction are two loops, as when two copies of a program run.
"""

from __future__ import annotations

from bisect import bisect_left
from bisect import bisect_right
from collections.abc import Iterator
from collections.abc import Sequence
from itertools import pairwise
from math import inf
from operator import le
from operator import sub
from typing import NamedTuple

from msg_defs.dxl_instruction import Instruction
from msg_defs.nanoseconds import NS_PER_MS
from msg_defs.nanoseconds import NS_PER_S
from msg_defs.uart import byte_ns
from servobus.bus.report import Cycle

WRITES = (Instruction.WRITE, Instruction.REG_WRITE, Instruction.SYNC_WRITE,
          Instruction.BULK_WRITE)
RHYTHM_MIN_PERIODS = 12            # fewer have no percentiles
RHYTHMS_MAX = 8                    # the most frequent instructions: a loop has few
GOING_ON_NS = 2 * NS_PER_S         # since its last repetition
REPEAT_MAX_SHARE = 0.35            # share of the period: asked again before its time
SAME_PERIOD_SHARE = 0.15           # share of the period: two periods are the same
EVEN_MAX_SPREAD = 0.25             # a loop that a clock paces varies less
PERIODS_TOGETHER = 8               # with a sleep until a fixed time they vary no more than one
STEADY_MIN_SHARE = 0.8             # share of the periods; others had a repetition that was lost
REPEATS_MAX_SHARE = 0.3            # share of the periods; more often, and it is part of the cycle
REPEAT_WITHIN_NS = 1_500_000       # after the answers; chunks of 2 ms blur it
STATUS_BYTES = 11                  # without parameters
OVERLAP_MIN_PERIODS = 8            # one rhythm, while the other went on
PHASE_BINS = 16                    # parts of a period; one program's own instructions fill few
ALTERNATE_MIN_SHARE = 0.9          # share of the periods, with just one of the other in it
MULTIPLE_TOLERANCE = 0.05          # relative: from the next whole number
CLOCK_TOLERANCE = 0.02             # the same, of means of many periods, of those of a clock
LATE_MIN_FACTOR = 1.5              # times the period: a cycle that was late
LATE_MAX_FACTOR = 8.0              # a longer one is a pause
LATE_MIN_NS = 3 * NS_PER_MS        # a sleep ends later than it should by less
LATE_MIN_SILENT_SHARE = 0.7        # share of what it was late
LATE_DECIDED_AFTER = 12            # periods, in which a listener makes up for what it was late
TIMER_MIN_STAMPS = 8
TIMER_MIN_FILL = 0.85              # share of its stamps that are there: some ran into others
TIMERS_MIN_COVERAGE = 0.9          # share of the stamps that the two account for
TIMER_TOLERANCE = 0.05             # share of the period: a stamp is in its place
TIMER_BLUR_FACTOR = 1.5            # times the blur: the first stamp has its own
TIMER_MIN_TOLERANCES = 4           # a shorter period says nothing
TIMER_TRIES = 6                    # a period is the distance to one of the next stamps


class Rhythm(NamedTuple):
    """An instruction and the times between its repetitions (ns)."""

    cycle: Cycle
    periods: tuple[int, ...]
    period: float                  # median
    spread: float                  # from the 10th to the 90th percentile, relative to the median
    base: int                      # the shortest usual period; others may be multiples
    answer_ns: float               # within so long the answers are on the wire, or just over

    @property
    def repeats(self) -> list[tuple[int, int]]:
        """
        When it was asked again at once, and when before, without the next one being late for it.

        Only where it is regular otherwise: short + rest = period, and all others the period.
        """
        low = min(REPEAT_MAX_SHARE * self.period, self.answer_ns)
        tolerance = SAME_PERIOD_SHARE * self.period
        if min(self.periods) >= low or self.cycle.instruction in WRITES:
            return []                          # writes with other data or IDs count as one kind
        found, whole = [], [abs(one - self.period) < tolerance for one in self.periods]
        for at, (one, two) in enumerate(pairwise(self.periods)):
            if one < low and abs(one + two - self.period) < tolerance and whole[max(0, at - 1)]:
                found.append((self.cycle.stamps[at], self.cycle.stamps[at + 1]))
        regular = 2 * len(found) + sum(whole) >= STEADY_MIN_SHARE * len(whole)
        return found if regular and len(found) <= REPEATS_MAX_SHARE * len(whole) else []

    def turn(self, since: int) -> float:
        """
        Return the mean (ns) of its usual periods since a stamp, 0 where they are too few.

        It is finer than the time between two chunks.
        """
        usual = [period for stamp, period in zip(self.cycle.stamps, self.periods, strict=False)
                 if stamp >= since and abs(period - self.base) < SAME_PERIOD_SHARE * self.base]
        return sum(usual) / len(usual) if len(usual) >= OVERLAP_MIN_PERIODS else 0.0

    @property
    def is_even(self) -> bool:
        """Whether its periods hardly differ: a clock makes them, not the work between them."""
        return self.spread < EVEN_MAX_SPREAD

    @property
    def is_paced(self) -> bool:
        """Whether a clock makes most of its periods, and the others are longer."""
        alike = sum(abs(one - self.base) < CLOCK_TOLERANCE * self.base for one in self.periods)
        return 2 * alike > len(self.periods)

    @property
    def may_sleep(self) -> bool:
        """
        Whether a program may sleep in it, which is late at times, rather than work.

        A sleep ends late, never early: few periods are much shorter than most. One until the
        next whole period makes up for a late one: several together vary no more than one.
        """
        least = sorted(self.periods)[len(self.periods) // 10]
        together = spread_of([*map(sub, self.cycle.stamps[PERIODS_TOGETHER:], self.cycle.stamps)])
        return least > (1 - EVEN_MAX_SPREAD) * self.period \
            or together < self.spread * 2 / PERIODS_TOGETHER

    @property
    def is_steady(self) -> bool:
        """Whether it keeps time, repetitions that were lost left aside."""
        if self.spread < SAME_PERIOD_SHARE:
            return True
        turns = [period / max(1, self.base) for period in self.periods]
        return sum(turn > 0.5 and abs(turn - round(turn)) < SAME_PERIOD_SHARE for turn in turns) \
            >= STEADY_MIN_SHARE * len(turns)

    @property
    def jitter(self) -> float:
        """
        Return its spread, 0 where that has an order: few different periods, a change of pace.

        A program with several paces has few different periods; one that is held up has any.
        """
        if self.spread < SAME_PERIOD_SHARE:
            return self.spread
        low, high = min(self.periods), max(self.periods)
        width = (high - low) / PHASE_BINS or 1.0
        if len({int((period - low) / width) for period in self.periods}) < PHASE_BINS // 2:
            return 0.0
        half = len(self.periods) // 2
        return min(spread_of(self.periods[:half]), spread_of(self.periods[half:]))


def rhythms(cycles: tuple[Cycle, ...], now: int, baud: int) -> list[Rhythm]:
    """Return the rhythms of the most frequent instructions that are still going on."""
    going_on = [cycle for cycle in cycles
                if len(cycle.stamps) > RHYTHM_MIN_PERIODS and now - cycle.stamps[-1] < GOING_ON_NS
                and all(map(le, cycle.stamps, cycle.stamps[1:]))]      # the clock was not set
    return [_rhythm(cycle, baud) for cycle in going_on[:RHYTHMS_MAX]]


def answer_ns(cycle: Cycle, baud: int) -> float:
    """Return how long the answers to an instruction take on the wire."""
    if cycle.instruction in WRITES[2:]:
        return 0.0
    return len(cycle.ids) * (STATUS_BYTES + cycle.length) * byte_ns(baud)


def answered_within_ns(cycle: Cycle, baud: int) -> float:
    """Return within how long the answers to an instruction are on the wire, or just over."""
    return 1.2 * answer_ns(cycle, baud) + REPEAT_WITHIN_NS


def _rhythm(cycle: Cycle, baud: int) -> Rhythm:
    periods = tuple(map(sub, cycle.stamps[1:], cycle.stamps))
    ordered = sorted(periods)
    return Rhythm(cycle, periods, ordered[len(ordered) // 2], spread_of(ordered),
                  ordered[len(ordered) // 4], answered_within_ns(cycle, baud))


def spread_of(periods: Sequence[int]) -> float:
    """Return the distance from the 10th to the 90th percentile, relative to the median."""
    low, middle, high = percentiles(periods)
    return (high - low) / middle if middle > 0 else 0.0


def percentiles(periods: Sequence[int]) -> tuple[int, int, int]:
    """Return the 10th, 50th and 90th percentile."""
    ordered = sorted(periods)
    edge = len(ordered) // 10
    return ordered[edge], ordered[len(ordered) // 2], ordered[-1 - edge]


# --- two instructions ----------------------------------------------------------------------------

def is_multiple(slow: Rhythm, fast: Rhythm) -> bool:
    """Tell whether one period fits the other a whole number of times: one program's, as a rule."""
    return is_whole(slow.base / max(1, fast.base), MULTIPLE_TOLERANCE)


def is_locked(slow: Rhythm, fast: Rhythm) -> bool:
    """Tell the same more finely, by the time in which both are known, or each alone."""
    since = max(slow.cycle.stamps[0], fast.cycle.stamps[0])
    one, other = slow.turn(since), fast.turn(since)
    if not (one and other):
        one, other = slow.turn(0), fast.turn(0)
    return not (one and other) or is_whole(one / other, CLOCK_TOLERANCE)


def is_whole(ratio: float, uneven: float) -> bool:
    """Tell whether a ratio is a whole number, but for a share of itself."""
    return abs(ratio - round(ratio)) < uneven * ratio


def is_independent(one: Rhythm, other: Rhythm) -> bool:
    """
    Tell whether one rhythm knows nothing of another.

    What one program asks has few places in its cycle; another's falls anywhere in it. Where
    the two alternate strictly, one program asks both.
    """
    stamps = one.cycle.stamps
    between = [bisect_right(stamps, end) - bisect_right(stamps, begin)
               for begin, end in pairwise(other.cycle.stamps) if begin >= stamps[0]]
    if between and between.count(1) >= ALTERNATE_MIN_SHARE * len(between):
        return False
    bins = set()
    inside = 0
    for stamp in other.cycle.stamps:
        at = bisect_right(stamps, stamp) - 1
        if 0 <= at < len(stamps) - 1:
            inside += 1
            bins.add(int(PHASE_BINS * (stamp - stamps[at]) / (stamps[at + 1] - stamps[at] or 1)))
    return inside >= OVERLAP_MIN_PERIODS and len(bins) >= min(PHASE_BINS // 2, inside // 2)


# --- late cycles ---------------------------------------------------------------------------------

def loop_of(found: Sequence[Rhythm]) -> Rhythm:
    """Return the rhythm that has the most periods in a time: one of the fastest loop."""
    means = [(one.cycle.stamps[-1] - one.cycle.stamps[0]) / len(one.periods) for one in found]
    most = (1 + SAME_PERIOD_SHARE) * min(means)
    return next(one for one, mean in zip(found, means, strict=True) if mean <= most)


def find_late_cycles(loop: Rhythm, cycles: Sequence[Cycle], baud: int, blur_ns: float,
                     has_sides: bool) -> list[int]:
    """
    Return when a cycle began late (ns).

    The line is silent then, after what is not asked in late cycles only: the program has no
    reason. Whole periods are repetitions that were left out. A listener that is late makes up for
    it, as some loops do: only stamps of the program, with its sides, show which it was.
    """
    stamps, usual = loop.cycle.stamps, max(1, loop.period)
    least = max(LATE_MIN_FACTOR * usual, usual + max(LATE_MIN_NS, blur_ns))
    periods = loop.periods[:-LATE_DECIDED_AFTER]
    if max(periods, default=0) < least:
        return []
    silences = _silences(stamps, cycles, baud)
    usual_ns = sorted(silences)[len(silences) // 2][0]
    usual_before = {before for (_, before), period in zip(silences, periods, strict=False)
                    if period < least}
    return [stamps[at + 1] for at, period in enumerate(periods)
            if least <= period <= LATE_MAX_FACTOR * usual
            and not is_whole(period / usual, SAME_PERIOD_SHARE * usual / period)
            and silences[at][0] - usual_ns > LATE_MIN_SILENT_SHARE * (period - usual)
            and silences[at][1] in usual_before
            and (has_sides
                 or not _is_made_up_for(stamps[at:at + 2 + LATE_DECIDED_AFTER], usual))]


def _silences(stamps: Sequence[int], cycles: Sequence[Cycle], baud: int
              ) -> list[tuple[float, int]]:
    """Return the longest silence (ns) of each period, and the place of what was asked before."""
    asked = sorted((stamp, stamp + answer_ns(cycle, baud), place)
                   for place, cycle in enumerate(cycles) for stamp in cycle.stamps)
    found = []
    for begin, end in pairwise(stamps):
        inside = asked[bisect_left(asked, (begin,)):bisect_right(asked, (end, inf))]
        found.append(max((two - over, place) for (_, over, place), (two, *_) in pairwise(inside)))
    return found


def _is_made_up_for(stamps: Sequence[int], period: float) -> bool:
    """Tell whether the cycles after a late one are back in their places."""
    return any(stamp - stamps[0] < (places + EVEN_MAX_SPREAD) * period
               for places, stamp in enumerate(stamps[2:], 2))


# --- two timers in one instruction ---------------------------------------------------------------

# A timer makes a stamp each period, a few left out. Two timers that together are all stamps, with
# periods that do not fit each other, are two loops.

class PeriodicTimer(NamedTuple):
    """Its period (ns), and which of the stamps are its own."""

    period: float
    places: tuple[int, ...]


def two_timers(stamps: Sequence[int], blur_ns: float
               ) -> tuple[PeriodicTimer, PeriodicTimer] | None:
    """Return the two timers that made these stamps (ns), None where it was one, or none."""
    for one in _timers(stamps, blur_ns):
        taken = {*one.places}
        rest = [stamp for at, stamp in enumerate(stamps) if at not in taken]
        for other in _timers(rest, blur_ns, TIMERS_MIN_COVERAGE * len(stamps) - len(one.places)):
            if not is_whole(max(one.period, other.period) / min(one.period, other.period),
                            MULTIPLE_TOLERANCE):
                return one, other
    return None


def _timers(stamps: Sequence[int], blur_ns: float, least: float = 0.0) -> Iterator[PeriodicTimer]:
    """Yield the timers of at least so many stamps, from the first stamp to the last."""
    least = max(TIMER_MIN_STAMPS, least)
    # From the first one on: a float holds no nanoseconds of stamps that are far from 0.
    stamps = [stamp - stamps[0] for stamp in stamps]
    for period in stamps[1:1 + TIMER_TRIES]:
        # Fitted to its stamps a period becomes shorter, but by less than its slack.
        if stamps[-1] / (1 - 1 / TIMER_MIN_TOLERANCES) < (least - 1) * period:
            return
        timer = _fit_timer(stamps, float(period), blur_ns)
        if timer is not None and len(timer.places) >= least:
            yield timer


def _fit_timer(stamps: Sequence[int], period: float, blur_ns: float) -> PeriodicTimer | None:
    """Return the timer of about this period from the first stamp, 0, on, None where none is."""
    places, periods = [0], 0
    due = period
    while due <= stamps[-1]:
        periods += 1
        slack = max(TIMER_BLUR_FACTOR * blur_ns, TIMER_TOLERANCE * period)
        if period <= TIMER_MIN_TOLERANCES * slack:      # 0 too, where stamps are equal
            return None
        at = _nearest(stamps, due, places[-1] + 1)
        if abs(stamps[at] - due) <= slack:
            places.append(at)
            period = stamps[at] / periods
        elif periods - len(places) >= 2 + (1 - TIMER_MIN_FILL) * periods:
            return None
        due = (periods + 1) * period
    if len(places) < TIMER_MIN_STAMPS or len(places) < TIMER_MIN_FILL * (periods + 1):
        return None
    return PeriodicTimer(period, tuple(places))


def _nearest(stamps: Sequence[int], due: float, first: int) -> int:
    """Return the stamp from `first` on that is nearest to `due`, which is not after the last."""
    at = bisect_left(stamps, due, first)
    return at - 1 if at > first and due - stamps[at - 1] <= stamps[at] - due else at
