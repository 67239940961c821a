# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""Two clocks in the stamps of one instruction: told apart, and not seen where there is one."""

from itertools import accumulate
import random

import pytest

from servobus.doctor.rhythm import two_timers

MS = 1_000_000
BLUR_NS = 1.0 * MS
KEPT = 64                          # stamps of a cycle


def clock(period_ms, seed, begin_ms=0.0):
    """Return the stamps of a loop, each as late as chunks are: up to 1 ms."""
    rng = random.Random(seed)
    return [int(MS * (begin_ms + n * period_ms + rng.random())) for n in range(200)]


def last(*clocks, ago=0):
    """Return the last stamps of them together, up to where all are going on, or so many before."""
    end = min(one[-1] for one in clocks)
    stamps = sorted(stamp for one in clocks for stamp in one if stamp <= end)
    return stamps[len(stamps) - KEPT - ago:len(stamps) - ago]


@pytest.mark.parametrize(('one', 'other'), [(20.0, 30.03), (20.0, 21.3), (33.3, 20.0),
                                            (50.0, 77.0), (25.0, 37.0)])
@pytest.mark.parametrize('seed', range(4))
def test_two_loops_are_told_by_their_periods(one, other, seed):
    loops = clock(one, seed), clock(other, seed + 100, 7.0)
    looks = [two_timers(last(*loops, ago=ago), BLUR_NS) for ago in (0, 30, 60)]
    found = [sorted(timer.period / MS for timer in look) for look in looks if look is not None]
    assert found                       # one look in ten fails
    assert all(both == pytest.approx(sorted((one, other)), rel=0.02) for both in found)


@pytest.mark.parametrize('missing', [7, 9, 11])
def test_a_clock_that_leaves_one_out_now_and_then_is_still_one(missing):
    slow = [stamp for at, stamp in enumerate(clock(30.03, 1, 7.0)) if at % missing]
    assert two_timers(last(clock(20.0, 2), slow), BLUR_NS) is not None


@pytest.mark.parametrize(('missing', 'is_told'), [((5, 9, 13), True), ((5, 8, 11, 14), False)])
def test_a_clock_that_leaves_out_more_than_three_of_twenty_is_none(missing, is_told):
    stamps = sorted([20 * MS * n for n in range(30)]
                    + [7 * MS + 31 * MS * n for n in range(20) if n not in missing])
    assert (two_timers(stamps, 0.5 * MS) is not None) == is_told


@pytest.mark.parametrize('seed', range(30))
def test_one_program_is_not_two(seed):
    rng = random.Random(seed)
    waits = [rng.expovariate(1 / 12) for _ in range(KEPT)]
    assert two_timers([int(MS * at) for at in accumulate(waits)], BLUR_NS) is None
    assert two_timers(last(clock(20.0, seed)), BLUR_NS) is None
    assert two_timers(last(clock(20.0, seed), clock(40.0, seed + 1, 5.0)), BLUR_NS) is None
    assert two_timers(last(clock(20.0, seed), clock(20.0, seed + 1, 5.0)), BLUR_NS) is None


def test_what_is_finer_than_the_chunks_is_not_judged():
    assert two_timers(last(clock(20.0, 1), clock(30.03, 2, 7.0)), 16.0 * MS) is None


@pytest.mark.parametrize('count', [2, KEPT])
def test_stamps_that_are_equal_are_of_no_timer(count):
    assert two_timers([MS] * count, 0.0) is None


def test_two_loops_are_the_same_however_far_their_stamps_are_from_zero():
    stamps = last(clock(20.0, 0), clock(30.03, 100, 7.0))
    found = two_timers(stamps, BLUR_NS)
    assert found is not None
    assert two_timers([stamp + (1 << 90) for stamp in stamps], BLUR_NS) == found
