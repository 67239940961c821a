# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""
Two timers in the stamps of one instruction, as when two copies of a program run. Pure.

A timer makes a stamp each period, a few left out. Two timers that together are all stamps, with
periods that do not fit each other, are two loops.
"""

from __future__ import annotations

from bisect import bisect_left
from collections.abc import Iterator
from collections.abc import Sequence
from typing import NamedTuple

from servobus.doctor.rhythm import is_whole
from servobus.doctor.rhythm import UNEVEN

ENOUGH = 8                         # stamps of a timer
FULL = 0.85                        # share of its stamps that are there
ALL = 0.9                          # share of the stamps that the two account for
FINE = 0.05                        # share of the period: a stamp is in its place
SLACK = 1.5                        # times the blur: the first stamp has its own
BLURRED = 4                        # times the tolerance: a shorter period says nothing
TRIES = 6                          # a period is the distance to one of the next stamps


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
        for other in _timers(rest, blur_ns, ALL * len(stamps) - len(one.places)):
            if not is_whole(max(one.period, other.period) / min(one.period, other.period),
                            UNEVEN):
                return one, other
    return None


def _timers(stamps: Sequence[int], blur_ns: float, least: float = 0.0) -> Iterator[PeriodicTimer]:
    """Yield the timers of at least so many stamps, from the first stamp to the last."""
    least = max(ENOUGH, least)
    # From the first one on: a float holds no nanoseconds of stamps that are far from 0.
    stamps = [stamp - stamps[0] for stamp in stamps]
    for period in stamps[1:1 + TRIES]:
        # Fitted to its stamps a period becomes shorter, but by less than its slack.
        if stamps[-1] / (1 - 1 / BLURRED) < (least - 1) * period:
            return
        timer = _timer(stamps, float(period), blur_ns)
        if timer is not None and len(timer.places) >= least:
            yield timer


def _timer(stamps: Sequence[int], period: float, blur_ns: float) -> PeriodicTimer | None:
    """Return the timer of about this period from the first stamp, 0, on, None where none is."""
    places, periods = [0], 0
    due = period
    while due <= stamps[-1]:
        periods += 1
        slack = max(SLACK * blur_ns, FINE * period)
        if period <= BLURRED * slack:      # 0 too, where stamps are equal
            return None
        at = _nearest(stamps, due, places[-1] + 1)
        if abs(stamps[at] - due) <= slack:
            places.append(at)
            period = stamps[at] / periods
        elif periods - len(places) >= 2 + (1 - FULL) * periods:
            return None
        due = (periods + 1) * period
    if len(places) < ENOUGH or len(places) < FULL * (periods + 1):
        return None
    return PeriodicTimer(period, tuple(places))


def _nearest(stamps: Sequence[int], due: float, first: int) -> int:
    """Return the stamp from `first` on that is nearest to `due`, which is not after the last."""
    at = bisect_left(stamps, due, first)
    return at - 1 if at > first and due - stamps[at - 1] <= stamps[at] - due else at
