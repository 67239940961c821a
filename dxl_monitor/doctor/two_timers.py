# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""
Combs: two clocks in the stamps of one instruction, as when two copies of a program run. Pure.

A comb is what one clock makes: a stamp each period, a few left out. Two combs that together are
all stamps, with periods that do not fit each other, are two loops.
"""

from __future__ import annotations

from bisect import bisect_left
from collections.abc import Iterator
from collections.abc import Sequence
from typing import NamedTuple

from dxl_monitor.doctor.rhythm import is_whole
from dxl_monitor.doctor.rhythm import UNEVEN

ENOUGH = 8                         # teeth of a comb
FULL = 0.85                        # share of its teeth that are there
ALL = 0.9                          # share of the stamps that the two account for
FINE = 0.05                        # share of the period: a tooth is in its place
SLACK = 1.5                        # times the blur: the first tooth has its own
BLURRED = 4                        # times the tolerance: a shorter period says nothing
TRIES = 6                          # a period is the distance to one of the next stamps


class PeriodicTimer(NamedTuple):
    """A clock: its period (ns), and where its teeth are among the stamps."""

    period: float
    teeth: tuple[int, ...]


def two_combs(stamps: Sequence[int], blur_ns: float) -> tuple[PeriodicTimer, PeriodicTimer] | None:
    """Return the two clocks that made these stamps (ns), None where it was one, or none."""
    for one in _combs(stamps, blur_ns):
        taken = {*one.teeth}
        rest = [stamp for at, stamp in enumerate(stamps) if at not in taken]
        for other in _combs(rest, blur_ns, ALL * len(stamps) - len(one.teeth)):
            if not is_whole(max(one.period, other.period) / min(one.period, other.period),
                            UNEVEN):
                return one, other
    return None


def _combs(stamps: Sequence[int], blur_ns: float, least: float = 0.0) -> Iterator[PeriodicTimer]:
    """Yield the combs of at least so many teeth, from the first stamp to the last."""
    least = max(ENOUGH, least)
    for stamp in stamps[1:1 + TRIES]:
        period = stamp - stamps[0]
        # Fitted to its teeth a period becomes shorter, but by less than its slack.
        if (stamps[-1] - stamps[0]) / (1 - 1 / BLURRED) < (least - 1) * period:
            return
        comb = _comb(stamps, float(period), blur_ns)
        if comb is not None and len(comb.teeth) >= least:
            yield comb


def _comb(stamps: Sequence[int], period: float, blur_ns: float) -> PeriodicTimer | None:
    """Return the comb of about this period from the first stamp on, None where there is none."""
    begin, end = stamps[0], stamps[-1]
    teeth, places = [0], 0
    due = begin + period
    while due <= end:
        places += 1
        slack = max(SLACK * blur_ns, FINE * period)
        if period < BLURRED * slack:
            return None
        at = _nearest(stamps, due, teeth[-1] + 1)
        if abs(stamps[at] - due) <= slack:
            teeth.append(at)
            period = (stamps[at] - begin) / places
        elif places - len(teeth) >= 2 + (1 - FULL) * places:
            return None
        due = begin + (places + 1) * period
    if len(teeth) < ENOUGH or len(teeth) < FULL * (places + 1):
        return None
    return PeriodicTimer(period, tuple(teeth))


def _nearest(stamps: Sequence[int], due: float, first: int) -> int:
    """Return the stamp from `first` on that is nearest to `due`, which is not after the last."""
    at = bisect_left(stamps, due, first)
    return at - 1 if at > first and due - stamps[at - 1] <= stamps[at] - due else at
