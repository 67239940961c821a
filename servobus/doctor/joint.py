# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""Whether a joint follows its goal, by what was read of it."""

from __future__ import annotations

from operator import ne

from servobus.doctor.case import Case
from servobus.doctor.case import Sample

S = 1_000_000_000
MOVES, STANDS = 20, 6              # raw steps of a goal, of a position: it does not follow
STOPPED_S = 1.0                    # standing still for so long means something
FOLLOW_S = 4.0                     # samples of so long tell whether it follows


def does_not_follow(samples: list[Sample]) -> bool:
    """Tell whether the goal moves and the position does not."""
    samples = samples[1:]
    if len(samples) < 2 or samples[-1].stamp - samples[0].stamp < STOPPED_S * S:
        return False
    return span([one.goal for one in samples]) >= MOVES \
        and 0 <= span([one.position for one in samples]) <= STANDS


def span(places: list[float | None]) -> float:
    """Return how far apart places are; -1 where none is known."""
    known = [place for place in places if place is not None]
    return max(known) - min(known) if known else -1.0


def lately(case: Case, number: int) -> list[Sample]:
    return [one for one in case.samples.get(number, ()) if one.stamp > case.now - FOLLOW_S * S]


def since_it_moved(samples: list[Sample]) -> list[Sample]:
    """Return the samples since a joint moved last, with that one."""
    last = samples[-1].position if samples else None
    moved = [at for at, one in enumerate(samples) if one.position is not None
             and last is not None and abs(one.position - last) > STANDS]
    return samples[moved[-1] if moved else 0:]


def is_ignored(samples: list[Sample], least: float) -> bool:
    """
    Tell whether no goal moves a joint, on both sides of it, or away from it and back again.

    One that is blocked ignores one side, and what a gripper holds is not let go at each turn.
    """
    ways = [one.goal - one.position for one in samples[1:]
            if one.goal is not None and one.position is not None]
    ends = [abs(one) > least for one in ways if not least / 3 < abs(one) < 3 * least]
    return does_not_follow(samples) and (sum(map(ne, ends, ends[1:])) > 2 or min(
        sum(one > least for one in ways), sum(one < -least for one in ways)) > 1)
