# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""
Draw the distributions of a results file as an SVG, one row each, on a logarithmic axis.

A thin line runs from the smallest to the largest value, a bar from the median to p99 where that
is known, a mark stands at the median. What we compare with is grey.
usage: python -m benchmark.plot RESULTS.json ... FILE.svg
"""

from collections.abc import Mapping
from collections.abc import Sequence
from html import escape
import json
from math import ceil
from math import floor
from math import log10
from pathlib import Path
import sys
from typing import Any
from typing import NamedTuple

from mecarover_serial.cli import run_tool
from mecarover_serial.cli import UsageError

LEFT, WIDTH, RIGHT = 250, 540, 50
ROW, TOP = 22, 36
SMALLEST = 1e-4                 # ms; what is less stands at the edge
OURS, OTHERS = '#2a6fb0', '#9a9a9a'
TEXT = 'font-family="sans-serif" font-size="12" fill="#444"'


class Row(NamedTuple):
    """A distribution in ms: min, median, max, and p99 where it is known."""

    name: str
    points: Mapping[str, float]

    @property
    def colour(self) -> str:
        return OTHERS if self.name.endswith(('thesis', 'floor', 'thread')) else OURS


class Axis(NamedTuple):
    """Decades of ms from left to right."""

    low: int
    high: int

    def x(self, value: float) -> float:
        share = (log10(max(value, 10.0 ** self.low)) - self.low) / (self.high - self.low)
        return round(LEFT + share * WIDTH, 1)


def rows_of(results: Mapping[str, Any]) -> list[Row]:
    """Return the distributions of a results file in its order."""
    return [Row(name, points) for figure in results['figures']
            for name, points in figure['distributions'].items()]


def svg(rows: Sequence[Row]) -> str:
    axis = Axis(floor(log10(min(max(row.points['min'], SMALLEST) for row in rows))),
                ceil(log10(max(row.points['max'] for row in rows))))
    height = TOP + ROW * len(rows) + 12
    return '\n'.join([
        f'<svg xmlns="http://www.w3.org/2000/svg" width="{LEFT + WIDTH + RIGHT}" '
        f'height="{height}"><rect width="100%" height="100%" fill="white"/>',
        *(_decade(axis, decade, height) for decade in range(axis.low, axis.high + 1)),
        *(_row(axis, row, TOP + ROW * i + ROW // 2) for i, row in enumerate(rows)),
        '</svg>', ''])


def _decade(axis: Axis, decade: int, height: int) -> str:
    x = axis.x(10.0 ** decade)
    return (f'<line x1="{x}" y1="{TOP - 8}" x2="{x}" y2="{height - 8}" stroke="#ddd"/>'
            f'<text x="{x}" y="{TOP - 14}" text-anchor="middle" {TEXT}>{10.0 ** decade:g} ms'
            '</text>')


def _row(axis: Axis, row: Row, y: int) -> str:
    low, middle, high = (axis.x(row.points[name]) for name in ('min', 'median', 'max'))
    parts = [f'<text x="{LEFT - 12}" y="{y + 4}" text-anchor="end" {TEXT}>{escape(row.name)}'
             f'</text><line x1="{low}" y1="{y}" x2="{high}" y2="{y}" stroke="{row.colour}"/>']
    if 'p99' in row.points:
        width = round(max(axis.x(row.points['p99']) - middle, 1.0), 1)
        parts.append(f'<rect x="{middle}" y="{y - 5}" width="{width}" height="10" '
                     f'fill="{row.colour}" fill-opacity="0.5"/>')
    parts.append(f'<line x1="{middle}" y1="{y - 7}" x2="{middle}" y2="{y + 7}" '
                 f'stroke="{row.colour}" stroke-width="3"/>')
    return ''.join(parts)


def main(arguments: Sequence[str]) -> None:
    if len(arguments) < 2:
        raise UsageError('usage: python -m benchmark.plot RESULTS.json ... FILE.svg')
    *results, drawing = map(Path, arguments)
    rows = [row for result in results for row in rows_of(json.loads(result.read_text()))]
    if not rows:
        raise UsageError(f'{results[0]}: no distributions; run scripts/bench --thesis --json')
    drawing.write_text(svg(rows))


if __name__ == '__main__':
    sys.exit(run_tool('plot', main))
