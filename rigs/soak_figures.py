# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""What came of a soak as figures, and what they must come to."""

from collections.abc import Mapping
from collections.abc import Sequence
import math
import statistics
from typing import NamedTuple

from rigs.harness import Figure

SECTION = 'both nodes with faults'
LIMITS = {
    'growth of memory, bridge': 5.0, 'growth of memory, monitor': 8.0,
    'more descriptors, bridge': 0, 'more descriptors, monitor': 0,
    'more threads, bridge': 0, 'more threads, monitor': 0,
    'nodes ended': 0, 'processes missing': 0, 'silences': 0, 'false verdicts': 0,
    'bytes not accounted for': 0, 'bytes counted wrong': 0, 'bytes lost in quiet': 0,
    'frames damaged in quiet': 0, 'velocities made up': 0, 'drives without motion': 0,
    'drives too late': 0, 'stops too late': 0, 'statuses not well at the end': 0,
}
LEAST = {'quiet times': 1, 'bytes to the monitor': 1, 'drives': 1, 'stops': 1}


class Sample(NamedTuple):
    """A node at one moment, with the process beside it."""

    memory_mb: float
    descriptors: int
    threads: int


def problems(figures: list[Figure]) -> list[str]:
    """Return what exceeds LIMITS or does not come to LEAST."""
    found = []
    for one in figures:
        value = f'{one.name}: {one.median:g} {one.unit}'.rstrip()
        if one.name in LIMITS and not one.median <= LIMITS[one.name]:
            found.append(f'{value}, at most {LIMITS[one.name]:g} is right')
        if one.name in LEAST and not one.median >= LEAST[one.name]:
            found.append(f'{value}, less than {LEAST[one.name]:g} proves nothing')
    return found


def figures(measured: Mapping[str, tuple[float, str]], samples: Sequence[Sequence[Sample]],
            wrong: Mapping[str, int]) -> list[Figure]:
    """Return what was measured (value, unit), what grew, and how often what went wrong."""
    rows = dict(measured)
    for at, node in enumerate(('bridge', 'monitor')):
        its = [one[at] for one in samples]
        rows[f'memory at the end, {node}'] = (its[-1].memory_mb if its else math.nan, 'MB')
        for what, unit, values in (
                ('growth of memory', 'MB', [one.memory_mb for one in its]),
                ('more descriptors', '', [one.descriptors for one in its]),
                ('more threads', '', [one.threads for one in its])):
            rows[f'{what}, {node}'] = (_growth(values), unit)
    for name in LIMITS:
        rows.setdefault(name, (wrong.get(name, 0), 'B' if 'bytes' in name else ''))
    return [Figure(SECTION, name, unit, [float(value)], _bound(name))
            for name, (value, unit) in rows.items()]


def _growth(values: Sequence[float]) -> float:
    """Return how much more the last third has than the first; NaN, a problem, for nothing."""
    if not values:
        return math.nan
    third = max(1, len(values) // 3)
    return statistics.median(values[-third:]) - statistics.median(values[:third])


def _bound(name: str) -> str:
    if name in LIMITS:
        return f'at most {LIMITS[name]:g}'
    return f'at least {LEAST[name]:g}' if name in LEAST else ''
