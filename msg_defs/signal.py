# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""The values of one register over time, kept as the page gets them: f64 pairs, little-endian."""
from __future__ import annotations

from bisect import bisect_left
from math import inf
from struct import Struct
from typing import NamedTuple

SPAN_S = 60.0
POINTS_MAX = 60_000                 # 60 s at 1 kHz
POINT = Struct('<dd')                # s, value


class Points(NamedTuple):
    """Points in a row; first: the number of the first."""

    first: int
    is_written: bool
    data: bytes


class PointRing:
    """
    The last points of a register, (s, value); is_written: the last was written, not read.

    They are numbered from the time of the first, in us: no two records share a number.
    """

    def __init__(self) -> None:
        self._data = bytearray()
        self._first = 0
        self.is_written = False

    def add(self, at_s: float, value: float, kept: int = POINTS_MAX) -> None:
        """Add a point, and forget what is older than a minute, or more than what is kept."""
        data = self._data
        if not data:
            self._first = int(max(0.0, at_s) * 1e6)
        data += POINT.pack(at_s, value)
        while len(data) > kept * POINT.size or at_s - POINT.unpack_from(data)[0] > SPAN_S:
            del data[:POINT.size]
            self._first += 1

    def last_s(self) -> float:
        """Return the time of the last point, -inf where there is none."""
        return POINT.unpack_from(self._data, len(self._data) - POINT.size)[0] if self._data \
            else -inf

    def after(self, number: int, since_s: float) -> Points:
        """Return the points from a number on, else all; none from before since_s."""
        data, size = self._data, POINT.size
        points = range(len(data) // size)
        skipped = number - self._first if number - self._first <= len(points) else 0
        begin = max(skipped, bisect_left(
            points, since_s, key=lambda point: POINT.unpack_from(data, point * size)[0]))
        return Points(self._first + begin, self.is_written, bytes(data[begin * size:]))
