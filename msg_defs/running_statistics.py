# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""
Running statistics of constant memory: over a sliding window and since start.

Each window is cut into slices; a slice holds moments and a histogram of log-spaced buckets, so a
percentile is off by less than one bucket (2.5 %). Time is an argument: monotonic nanoseconds.
One thread adds; any other thread may read. A reader may see the newest sample half
taken in (counted, but not yet in the mean), never anything worse.
"""

from collections import defaultdict
from collections.abc import Iterable
from math import asinh
from math import ceil
from math import floor
from math import log
from math import sinh
from math import sqrt
from typing import NamedTuple

WINDOW_S = 10
SLICES = 10                 # in a window: it slides in steps of a tenth
VALUE_MAX = 1e12            # larger values are refused, as NaN and infinities are
_SMALLEST = 1e-6            # buckets are not much narrower than a fortieth of this
_PER_E = 1 / log(1.025)     # buckets per factor of e; the width of one bounds a percentile's error


def _edge(bucket: int) -> float:
    """Return the smallest value of a bucket."""
    return _SMALLEST * sinh(bucket / _PER_E)


class Summary(NamedTuple):
    """What a series says about itself, in the unit of its values; `deviation` is sqrt(m2 / n)."""

    count: int  # type: ignore[assignment]      # the field's name, not tuple.count
    mean: float
    deviation: float
    minimum: float
    maximum: float
    p50: float
    p95: float
    p99: float


class _Partial(NamedTuple):
    """The statistics of some samples; parts can be merged without loss."""

    count: int  # type: ignore[assignment]
    mean: float
    m2: float               # sum of squared distances from the mean
    minimum: float
    maximum: float
    buckets: dict[int, int]


class _Slice:
    """The samples of one slice of time, open for more."""

    def __init__(self, index: int, value: float) -> None:
        self.index = index
        self.pivot = value          # sums of distances from a sample keep their digits
        self.sum = 0.0
        self.squares = 0.0
        self.minimum = value
        self.maximum = value
        self.buckets: defaultdict[int, int] = defaultdict(int)

    def part(self) -> _Partial | None:
        buckets = dict(self.buckets)    # one C call: a writer cannot come in between
        count = sum(buckets.values())
        if not count:
            return None
        mean = self.pivot + self.sum / count
        m2 = max(0.0, self.squares - self.sum * self.sum / count)
        return _Partial(count, mean, m2, self.minimum, self.maximum, buckets)


def _merge(parts: Iterable[_Partial | None]) -> _Partial | None:
    found = [part for part in parts if part is not None]
    if len(found) < 2:
        return found[0] if found else None
    count = sum(part.count for part in found)
    mean = sum(part.count * part.mean for part in found) / count
    m2 = sum(part.m2 + part.count * (part.mean - mean) ** 2 for part in found)
    buckets = dict(found[0].buckets)
    for part in found[1:]:
        for bucket, n in part.buckets.items():
            buckets[bucket] = buckets.get(bucket, 0) + n
    return _Partial(count, mean, m2, min(part.minimum for part in found),
                    max(part.maximum for part in found), buckets)


def _quantile(part: _Partial, order: list[int], share: float) -> float:
    """Return the sample of nearest rank, its place inside the bucket interpolated."""
    rank = max(1, ceil(share * part.count))
    if rank == part.count:
        return part.maximum
    below = 0
    for bucket in order:
        n = part.buckets[bucket]
        if below + n >= rank:
            break
        below += n
    low, high = _edge(bucket), _edge(bucket + 1)
    value = low + (high - low) * (rank - below - 0.5) / n
    return min(max(value, part.minimum), part.maximum)


def _summary(part: _Partial | None) -> Summary | None:
    if part is None:
        return None
    order = sorted(part.buckets)
    return Summary(
        part.count, min(max(part.mean, part.minimum), part.maximum),
        sqrt(part.m2 / part.count), part.minimum, part.maximum,
        _quantile(part, order, 0.5), _quantile(part, order, 0.95), _quantile(part, order, 0.99))


class Series:
    """Samples of one quantity."""

    def __init__(self, window_s: float = WINDOW_S) -> None:
        self._width = int(window_s * 1e9 / SLICES)
        self._slice = _Slice(0, 0.0)
        # Slices that take no more, and what they come to: so a second look costs one slice.
        self._closed: tuple[tuple[_Slice, ...], _Partial | None] = ((), None)
        self._end = 0
        self._state: tuple[_Partial | None, tuple[_Slice, ...]] = (None, ())

    def add(self, value: float, now_ns: int) -> None:
        if not -VALUE_MAX < value < VALUE_MAX:
            return
        if now_ns >= self._end:
            self._open_slice(value, now_ns)
        piece = self._slice
        piece.buckets[floor(asinh(value / _SMALLEST) * _PER_E)] += 1
        distance = value - piece.pivot
        piece.sum += distance
        piece.squares += distance * distance
        if value < piece.minimum:
            piece.minimum = value
        if value > piece.maximum:
            piece.maximum = value

    def summary(self, now_ns: int) -> Summary | None:
        """Return what the window holds: the slice of now and the nine before it; None if empty."""
        oldest = now_ns // self._width - SLICES + 1
        _, slices = self._state
        return _summary(self._merged(tuple(
            piece for piece in slices if piece.index >= oldest)))

    def total(self) -> Summary | None:
        """Return the statistics since start or reset; None if there was nothing."""
        past, slices = self._state
        return _summary(_merge((past, self._merged(slices))))

    def _merged(self, slices: tuple[_Slice, ...]) -> _Partial | None:
        """Return what these slices come to; all but the last take no more."""
        if not slices:
            return None
        known, closed = self._closed
        if known != slices[:-1]:
            closed = _merge(piece.part() for piece in slices[:-1])
            self._closed = slices[:-1], closed
        return _merge((closed, slices[-1].part()))

    def _open_slice(self, value: float, now_ns: int) -> None:
        index = now_ns // self._width
        past, slices = self._state
        kept = tuple(piece for piece in slices if piece.index > index - SLICES)
        gone = slices[:len(slices) - len(kept)]
        self._slice = _Slice(index, value)
        self._end = (index + 1) * self._width
        self._state = _merge((past, *(piece.part() for piece in gone))), (*kept, self._slice)


class Rate:
    """Amounts per second over a sliding window: packets, bytes, errors."""

    def __init__(self, window_s: float = WINDOW_S) -> None:
        self._width = int(window_s * 1e9 / SLICES)
        self._end = 0
        self._started: int | None = None
        self._slice: list[float] = [0, 0]                   # index, amount
        self._slices: tuple[list[float], ...] = ()

    def add(self, amount: float, now_ns: int) -> None:
        """Take in an amount; the first call, of 0 if need be, starts the clock."""
        if now_ns >= self._end:
            self._open_slice(now_ns)
        self._slice[1] += amount

    def per_second(self, now_ns: int) -> float:
        """Return the mean rate over the window, or since the start while that is shorter."""
        started = self._started
        if started is None:
            return 0.0
        oldest = now_ns // self._width - SLICES + 1
        amount = sum(piece[1] for piece in self._slices if piece[0] >= oldest)
        covered = now_ns - max(started, oldest * self._width)
        return amount * 1e9 / max(covered, self._width)

    def _open_slice(self, now_ns: int) -> None:
        index = now_ns // self._width
        if self._started is None:
            self._started = now_ns
        self._slice = [index, 0]
        self._slices = (*(piece for piece in self._slices if piece[0] > index - SLICES),
                        self._slice)
        self._end = (index + 1) * self._width
