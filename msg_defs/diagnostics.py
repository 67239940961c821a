# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""
The plain values that both nodes publish, and the rules by which these are named and spelt.

Units stand in the key, bare numbers in the value: PlotJuggler and Foxglove then plot every number
by its name. A status is known to those tools by hardware_id and name: neither ever changes, and
both carry the namespace of the node, because all robots share the topic /diagnostics.
"""

from collections.abc import Iterable
from collections.abc import Mapping
from collections.abc import Sequence
from decimal import Decimal
from enum import IntEnum
from math import isfinite
import re
from typing import NamedTuple

from msg_defs.running_statistics import Summary


class Level(IntEnum):
    """The levels of diagnostic_msgs/DiagnosticStatus."""

    OK = 0
    WARN = 1
    ERROR = 2
    STALE = 3


Pairs = list[tuple[str, str]]      # keys and values, in order


class Status(NamedTuple):
    """One diagnostic_msgs/DiagnosticStatus."""

    name: str
    level: Level
    message: str
    hardware_id: str
    values: Pairs


class Metric(NamedTuple):
    """
    One timing metric: a series (window, total) or a single value.

    `notes` are further (key, value) pairs that belong to the figures, unit in the key. `bus` is
    part of the name of its status, '' with a single bus; `bus_name` of its topics, always.
    """

    name: str
    unit: str
    window: Summary | None = None
    total: Summary | None = None
    value: float | None = None
    bus: str = ''
    device: str = ''
    notes: tuple[tuple[str, str], ...] = ()
    bus_name: str = ''
    hardware_id: str = ''


class Joint(NamedTuple):
    """One joint of a sensor_msgs/JointState in rad, rad/s and Nm; None where unknown."""

    name: str
    position: float | None = None
    velocity: float | None = None
    effort: float | None = None


# Values of the key `State` that a program reads again: a device that answers, a port.
CONNECTED, PORT_OPEN, PORT_CLOSED, DRIVING = 'connected', 'open', 'closed', 'driving'

# As diagnostic_aggregator groups: of a silent part nothing is known, which is worse than a
# warning, but it must not hide an error. (A plain maximum, as in diagnostic_updater, would.)
SEVERITY = (Level.OK, Level.WARN, Level.STALE, Level.ERROR)


def worst(levels: Iterable[Level]) -> Level:
    """Return the level of a group; OK for an empty one."""
    return max(levels, key=SEVERITY.index, default=Level.OK)


def worst_first(statuses: Iterable[Status]) -> list[Status]:
    """Return statuses by level; those of one level keep their order."""
    return sorted(statuses, key=lambda one: -SEVERITY.index(one.level))


def number(value: float) -> str:
    """Spell a number: integers in full, others with at least 6 significant digits, no minus 0."""
    if isinstance(value, int):
        return f'{value:d}'
    text = f'{value + 0.0:.6g}'
    if 'e' not in text or not 1e-9 <= abs(value) < 1e15:
        return text
    return f'{value:.0f}' if abs(value) >= 1 else f'{Decimal(text):f}'


def pairs(values: Mapping[str, str | float | None]) -> Pairs:
    """Spell values: numbers, true or false, text; what is None, NaN or infinite is left out."""
    found = []
    for key, value in values.items():
        if isinstance(value, bool):
            value = str(value).lower()
        if isinstance(value, str):
            found.append((key, value))
        elif value is not None and isfinite(value):
            found.append((key, number(value)))
    return found


def status_name(node: str, *parts: str) -> str:
    """
    Return '<node>: <part>/<part>', empty parts left out (the bus name, with a single bus).

    `node` is the full name of the node without its first slash: 'rover1/dxl_monitor'.
    """
    return f'{node}: {"/".join(part for part in parts if part)}'


def namespace_of(node: str) -> str:
    """Return the namespace in the full name of a node: 'rover1' of 'rover1/dxl_monitor'."""
    return node.rpartition('/')[0]


BUS_HARDWARE_PREFIX = 'servo bus '  # then its name, and for a device '/ID 11'


def hardware_id(node: str, *parts: str) -> str:
    """Return '[<namespace>/]<part>/<part>', empty parts left out."""
    namespace = namespace_of(node)
    text = '/'.join(part for part in parts if part)
    return f'{namespace}/{text.lstrip("/")}' if namespace else text


def topic_names(names: Sequence[str]) -> dict[str, str]:
    """Map free names to topic name parts: [A-Za-z0-9_], and kept apart where they collide."""
    taken = {name for name in names if name == topic_name(name)}
    result: dict[str, str] = {}
    for name in names:
        plain = part = topic_name(name)
        suffix = 2
        while part != name and part in taken:
            part = f'{plain}_{suffix}'
            suffix += 1
        taken.add(part)
        result[name] = part
    return result


def topic_name(name: str) -> str:
    """
    Reduce a name to what ROS takes as one part of a topic name, without promise of uniqueness.

    ROS reserves repeated underscores, hides names with a leading one and refuses leading digits.
    """
    part = re.sub('[^A-Za-z0-9]+', '_', name).strip('_')
    return part if part[:1].isalpha() else f'bus_{part}'.rstrip('_')


# Which timing topics a node has: none, those with plain figures, MetricsMessage too.
OFF, HEADLINE, ALL = TIMING_TOPICS = ('off', 'headline', 'all')

_UNIT_NAMES = {'%': 'percent', 'B/s': 'bytes_per_second', 'B': 'bytes'}


def unit_name(unit: str) -> str:
    """Return a unit as it is spelt in topic names: ms, hz, percent, bytes_per_second."""
    return _UNIT_NAMES.get(unit) or re.sub('[^a-z0-9]+', '_', unit.lower())


def headline_figure(metric: Metric) -> float | None:
    """Return the one figure of a metric: its value, or the p95 of the window; None without."""
    figure = metric.window.p95 if metric.window is not None else metric.value
    return figure if figure is not None and isfinite(figure) else None


def metric_status(node: str, metric: Metric) -> Status:
    """Return the status of one metric: '<node>: timing/[<bus>/][<device>/]<name>'."""
    values = pairs({f'value ({metric.unit})': metric.value})
    values += _figures('', metric.unit, metric.window)
    values += _figures('since start ', metric.unit, metric.total)
    values += metric.notes
    name = status_name(node, 'timing', metric.bus, metric.device, metric.name)
    return Status(name, Level.OK, _headline_text(metric), metric.hardware_id or node, values)


def _figures(prefix: str, unit: str, summary: Summary | None) -> Pairs:
    if summary is None:
        return []
    return pairs({
        f'{prefix}mean ({unit})': summary.mean,
        f'{prefix}deviation ({unit})': summary.deviation,
        f'{prefix}min ({unit})': summary.minimum,
        f'{prefix}max ({unit})': summary.maximum,
        f'{prefix}p50 ({unit})': summary.p50,
        f'{prefix}p95 ({unit})': summary.p95,
        f'{prefix}p99 ({unit})': summary.p99,
        f'{prefix}count': summary.count,
    })


def _headline_text(metric: Metric) -> str:
    figure = headline_figure(metric)
    if figure is None:
        return 'no data'
    text = f'{number(figure)} {metric.unit}'
    return f'p95 {text}' if metric.window is not None else text
