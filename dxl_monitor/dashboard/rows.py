# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""
Statuses to the rows that the page shows.

Pure. Knows the keys of dxl_monitor/status.py and vel2d_bridge/status.py, whatever the nodes are
called. Values stay the text they arrived as: a page that shows text cannot stumble over NaN.
"""
from __future__ import annotations

import json
import re
from typing import Any
from typing import NamedTuple

from dxl_monitor.dashboard.cdr import RawStatus
from msg_defs.reports import Level

Row = dict[str, Any]

HEAD = 26                          # pairs in front of the table: facts, counters, findings
_LISTED = ('finding.', 'error ', 'cannot tell.')        # keys of a bus that are lists
_NAMING = 3                         # of them: Model, Firmware Version, State
_LEVELS = frozenset(Level)
_OBSERVED = 'observed'
_OBSERVED_LIMIT = 100_000           # characters of its JSON
_JITTER_S = 0.3                     # of "seen at": what differs less was not seen again
_BRIDGE = {'link': {'Port', 'State'}, 'commands': {'Topic', 'Message type'}}
_DEVICE = re.compile(r'\d{3}(?: |$)')
_FIGURES = ('p50', 'p95', 'max')


class Field(NamedTuple):
    """A field of a control table; seen: monotonic s, None if unknown; source 'r' or 'w'."""

    key: str
    value: str
    raw: str
    seen: float | None
    source: str


class Table(NamedTuple):
    """What is known of one device: facts and counters, then its fields."""

    facts: list[tuple[str, str]]
    fields: list[Field]


def split(status: RawStatus) -> tuple[str, str]:
    """Return the node and what it speaks of; ('', ...) where a name is of another kind."""
    node, colon, rest = status.name.partition(': ')
    return (node, rest) if colon else ('', status.name)


def section(status: RawStatus) -> str:
    """Return where a status belongs: devices, buses, bridge or timing; '' if it is not ours."""
    _, rest = split(status)
    if rest.startswith('timing/'):
        return 'timing'
    keys = {key for key, _ in status.pairs(3)}
    if rest in _BRIDGE and keys >= _BRIDGE[rest]:
        return 'bridge'
    if rest.partition(' ')[0] == 'bus' and 'Port' in keys:
        return 'buses'
    if _DEVICE.match(_own_name(status, rest)) and {'Model', 'State'} <= keys:
        return 'devices'
    return ''


def _own_name(status: RawStatus, rest: str) -> str:
    """Return the name of a device without its bus."""
    bus = status.hardware_id.rpartition('/')[0]
    return rest.removeprefix(f'{bus}/') if bus else rest


def metric_of(status: RawStatus) -> str:
    """Return what a timing status is about: a bus, [bus/]device, or '' (a node, its only bus)."""
    return split(status)[1].removeprefix('timing/').rpartition('/')[0]


def is_device(of: str) -> bool:
    """Tell whether a name, with or without a bus in front, is written like that of a device."""
    return _DEVICE.match(of.rpartition('/')[2]) is not None


def row(kind: str, status: RawStatus) -> Row:
    """Return what the page knows of a status at all times (tables come on demand)."""
    node, rest = split(status)
    level = status.level if status.level in _LEVELS else Level.STALE
    common = {'node': node, 'level': int(level), 'message': status.message}
    return common | _MAKERS[kind](status, rest)


def _device(status: RawStatus, rest: str) -> Row:
    pairs = status.pairs(HEAD)
    values = dict(reversed(pairs))      # a field of the table may be called like a fact
    number, _, joint = _own_name(status, rest).partition(' ')
    return {
        'bus': status.hardware_id.rpartition('/')[0],
        'id': int(number),
        'joint': joint,
        'model': values['Model'],
        'firmware': values.get('Firmware Version', ''),
        'state': values['State'],
        'loss': values.get('Loss in 10 s (%)', ''),
        'latency': _calm(values.get('Reply latency p50 (ms)', '')),
        'findings': _findings(pairs),
    }


def _bus(status: RawStatus, rest: str) -> Row:
    pairs = status.pairs()
    return {
        'bus': rest.partition(' ')[2],
        'values': [pair for pair in pairs if not pair[0].startswith(_LISTED)],
        'errors': [value for key, value in pairs if key.startswith('error ')],
        'findings': _findings(pairs),
        'doubts': _findings(pairs, 'cannot tell.'),
    }


def _bridge(status: RawStatus, rest: str) -> Row:
    return {'part': rest, 'values': status.pairs()}


def _timing(status: RawStatus, rest: str) -> Row:
    return {'of': metric_of(status), 'metric': rest.rpartition('/')[2], 'values': status.pairs()}


_MAKERS = {'devices': _device, 'buses': _bus, 'bridge': _bridge, 'timing': _timing}


def _findings(pairs: list[tuple[str, str]], prefix: str = 'finding.') -> list[tuple[str, str]]:
    return [(key.removeprefix(prefix), value) for key, value in pairs if key.startswith(prefix)]


def figures(values: list[tuple[str, str]]) -> list[float | None]:
    """Return what of a metric is plotted: [p50, p95, max] of the window, or [value]."""
    by_name = {key.partition(' (')[0]: value for key, value in values}
    names = _FIGURES if 'p50' in by_name else ('value',)
    return [_finite(by_name.get(name, '')) for name in names]


def _calm(text: str) -> str:
    """Round a number to two digits: what only jitters is no change."""
    value = _finite(text)
    return text if value is None else f'{value:.2g}'


def _finite(text: str) -> float | None:
    try:
        value = float(text)
    except ValueError:
        return None
    return value if abs(value) < 1e300 else None        # False for NaN, too


def table(status: RawStatus, arrived_s: float, before: Table | None = None) -> Table:
    """Return facts and fields of a device status; `observed` decides which keys are fields."""
    pairs = status.pairs(limit=_OBSERVED_LIMIT)
    seen = _seen(dict(pairs).get(_OBSERVED, ''))
    old = {field.key: field.seen for field in before.fields} if before else {}
    facts: list[tuple[str, str]] = []
    fields: list[Field] = []
    for at, (key, value) in enumerate(status.pairs()):
        name = key if key in seen else key.rpartition(' (')[0]
        if name not in seen or at < _NAMING:
            if key != _OBSERVED and not key.startswith('finding.'):
                facts.append((key, value))
        elif key == f'{name} (raw)' and fields:
            fields[-1] = fields[-1]._replace(raw=value)
        else:
            age_s, source = seen[name]
            when = None if age_s is None else _steady(arrived_s - age_s, old.get(key))
            fields.append(Field(key, value, '', when, source))
    return Table(facts, fields)


def _steady(when_s: float, before_s: float | None) -> float:
    if before_s is not None and abs(when_s - before_s) < _JITTER_S:
        return before_s
    return round(when_s, 2)


def _seen(text: str) -> dict[str, tuple[float | None, str]]:
    """Read the value of `observed`; whatever is not as it should be is left out."""
    try:
        entries = json.loads(text)
    except (ValueError, RecursionError):
        return {}
    result: dict[str, tuple[float | None, str]] = {}
    for name, entry in entries.items() if isinstance(entries, dict) else ():
        if isinstance(entry, list) and len(entry) == 2:
            age_s, source = entry
            known = isinstance(age_s, int | float) and 0 <= age_s < 1e9
            result[name] = (float(age_s) if known else None,
                            source if source in ('r', 'w') else '')
    return result
