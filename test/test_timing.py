# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""Running statistics against exact ones, in simulated time."""

from math import ceil
from math import inf
from math import nan
import random
import statistics
import sys
import threading

import pytest

from msg_defs.running_statistics import Rate
from msg_defs.running_statistics import Series
from msg_defs.running_statistics import SLICES
from msg_defs.running_statistics import VALUE_MAX

S = 1_000_000_000
MS = 1_000_000
DISTRIBUTIONS = {
    'around zero': lambda r: r.gauss(0.0, 1.0),
    'negative': lambda r: -r.lognormvariate(0.0, 1.0),
    'constant': lambda r: 0.125,
    'zero': lambda r: 0.0,
    'heavy tail': lambda r: 0.05 * r.paretovariate(1.2),
    'huge': lambda r: r.uniform(1e6, 9e8),
}


def fill(series, values, start=0, step=MS):
    for i, value in enumerate(values):
        series.add(value, start + i * step)
    return start + len(values) * step


def exact(values, share):
    return sorted(values)[max(1, ceil(share * len(values))) - 1]


@pytest.mark.parametrize('name', DISTRIBUTIONS)
@pytest.mark.parametrize('count', [1, 2, 100, 8000])
def test_agrees_with_exact_statistics(name, count):
    rng = random.Random(count)
    values = [DISTRIBUTIONS[name](rng) for _ in range(count)]
    series = Series()
    now = fill(series, values)
    window = series.summary(now)
    assert window == series.total()
    assert window.count == count
    assert (window.minimum, window.maximum) == (min(values), max(values))
    assert window.mean == pytest.approx(statistics.fmean(values), rel=1e-9, abs=1e-12)
    assert window.deviation == pytest.approx(statistics.pstdev(values), rel=1e-6, abs=1e-12)
    for share, estimate in ((0.5, window.p50), (0.95, window.p95), (0.99, window.p99)):
        assert estimate == pytest.approx(exact(values, share), rel=0.026, abs=1e-6)


def test_percentiles_of_a_long_run_stay_within_five_percent():
    rng = random.Random(5)
    values = [rng.lognormvariate(-2.0, 1.0) for _ in range(50_000)]
    series = Series()
    now = fill(series, values, step=2 * MS)         # 100 s: most of it has left the window
    assert series.total().count == 50_000
    assert series.total().p99 == pytest.approx(exact(values, 0.99), rel=0.05)
    recent = values[-series.summary(now).count:]
    assert 4500 <= len(recent) <= 5000
    assert series.summary(now).p99 == pytest.approx(exact(recent, 0.99), rel=0.05)
    assert series.summary(now).mean == pytest.approx(statistics.fmean(recent))


def test_window_forgets_and_total_does_not():
    series = Series(window_s=10.0)
    series.add(1.0, 0)
    series.add(3.0, 5 * S)
    assert series.summary(9 * S).count == 2
    assert series.summary(10 * S).mean == 3.0
    assert series.summary(14 * S).count == 1
    assert series.summary(15 * S) is None
    series.add(7.0, 100 * S)
    assert series.summary(100 * S).mean == 7.0
    assert series.total().count == 3
    assert series.total().minimum == 1.0


@pytest.mark.parametrize('value', [nan, inf, -inf, VALUE_MAX, -VALUE_MAX, 1e300])
def test_what_is_no_sample_is_refused(value):
    series = Series()
    series.add(value, 0)
    assert series.total() is None
    series.add(1.0, 1)
    assert series.total().count == 1


def footprint(thing):
    """Return the bytes held by a series: its slots, slices and their buckets."""
    past, slices = thing._state
    buckets = [piece.buckets for piece in slices] + [past.buckets if past else {}]
    return sum(sys.getsizeof(table) for table in buckets) + len(slices) * 1000


def test_memory_does_not_grow_with_samples_or_time():
    rng = random.Random(7)
    series = Series(window_s=1.0)
    now = fill(series, [rng.lognormvariate(0.0, 2.0) for _ in range(20_000)])
    early = footprint(series)
    fill(series, [rng.lognormvariate(0.0, 2.0) for _ in range(40_000)], start=now)
    assert len(series._state[1]) <= SLICES
    assert footprint(series) <= 1.5 * early


def test_readers_do_not_disturb_the_writer():
    series = Series(window_s=0.01)
    done = threading.Event()
    odd = []

    def read():
        while not done.is_set():
            summary = series.total()
            if summary and not 1.0 <= summary.p50 <= summary.p99 <= 2.0:
                odd.append(summary)

    reader = threading.Thread(target=read)
    reader.start()
    try:
        fill(series, [random.Random(8).uniform(1.0, 2.0) for _ in range(20_000)], step=MS)
    finally:
        done.set()
        reader.join()
    assert odd == []


def test_rate_falls_to_zero_in_silence_and_recovers():
    rate = Rate(window_s=1.0)
    assert rate.per_second(0) == 0.0
    for i in range(1000):
        rate.add(1, i * MS)
    assert rate.per_second(S) == pytest.approx(1000, rel=0.11)
    assert rate.per_second(3 * S) == 0.0
    rate.add(500, 4 * S)
    assert rate.per_second(4 * S) == pytest.approx(500, rel=0.2)
