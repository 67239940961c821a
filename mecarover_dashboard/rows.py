# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""
Statuses to the rows that the page shows.

Pure. Knows the keys of servobus/status.py and vel2d_bridge/bridge_status.py; the
nodes may have any name, and their namespace is the name of the robot. Values stay the text they
arrived as: a page that shows text cannot stumble over NaN.
"""
from __future__ import annotations

from collections.abc import Iterator
import json
import re
from typing import Any
from typing import NamedTuple

from mecarover_dashboard.cdr import AnyStatus
from msg_defs import status_keys as keys
from msg_defs.diagnostics import BUS_HARDWARE_PREFIX
from msg_defs.diagnostics import CONNECTED
from msg_defs.diagnostics import Level
from msg_defs.diagnostics import namespace_of
from msg_defs.diagnostics import number
from msg_defs.diagnostics import Pairs
from msg_defs.diagnostics import PORT_CLOSED

Row = dict[str, Any]

HEAD = 32                          # pairs in front of the table: facts, counters, findings
_LISTED = (keys.FINDING, keys.SEVERITY, keys.COVERS, keys.ERROR, keys.DOUBT, keys.DEVICE_PROBLEM)
_ID_MAX = 253
_NAMING = 3                         # Model, Firmware Version, State
_ASIDE = (keys.RUNNING, keys.PART)      # keys of a bus shown elsewhere, or nowhere
_LEVELS = frozenset(Level)
_OBSERVED_LIMIT = 100_000           # characters of its JSON
JITTER_S = 0.3                      # "seen at" that differs by less is the same time
_BRIDGE = {'link': {keys.PORT, keys.STATE},
           'commands': {keys.TOPIC, keys.MESSAGE_TYPE}}
_DEVICE = re.compile(r'\d{3}(?: |$)')
_FIGURES = ('p50', 'p95', 'max')
_ERROR = re.compile(r'(\d+\.\d+) s: (.*)', re.DOTALL)
_VALUES = tuple(tuple(f'{name} ('.encode() for name in names) for names in (
    ('Present Position',), keys.TEMPERATURES, keys.VOLTAGES, ('Present Load', 'Present Current')))
_LIMITS = ((b'Min Position Limit (', b'CW Angle Limit ('),
           (b'Max Position Limit (', b'CCW Angle Limit ('),
           (b'Temperature Limit (', b'Motor Temperature Limit ('),
           (b'Min Voltage Limit (',), (b'Max Voltage Limit (',))


class FieldRow(NamedTuple):
    """A field of a control table; seen: monotonic s, None if unknown; source 'r' or 'w'."""

    key: str
    value: str
    raw: str
    seen: float | None
    source: str


class Values(NamedTuple):
    """Health of a device, as text: °C, V, load or current in `unit`; '' = not known."""

    position: str
    temperature: str
    voltage: str
    load: str
    unit: str
    position_unit: str                  # rad; of an axis that does not turn m
    limits: tuple[str, ...] = ()        # position (2), temperature, voltage (2)

    def calm(self) -> Values:
        """Return what is shown; positions to 0.001: servos count many turns."""
        return self._replace(voltage=calm(self.voltage, 3), load=calm(self.load),
                             position=rounded(self.position, 3))


NOTHING = Values('', '', '', '', '', '')


class RegisterTable(NamedTuple):
    """What is known of one device: facts and counters, then its fields."""

    facts: Pairs
    fields: list[FieldRow]


def split_name(name: str) -> tuple[str, str]:
    """Return the node in the name of a status, '' where it is of another kind, and the rest."""
    node, colon, rest = name.partition(': ')
    return (node, rest) if colon else ('', name)


def section(status: AnyStatus) -> str:
    """Return where a status belongs: devices, buses, bridge or timing; '' if it is not ours."""
    _, rest = split_name(status.name)
    if rest.startswith('timing/'):
        return 'timing'
    names = {key for key, _ in status.pairs(3)}
    if rest in _BRIDGE and names >= _BRIDGE[rest]:
        return 'bridge'
    if rest.partition(' ')[0] == 'bus' and keys.PORT in names:
        return 'buses'
    if _DEVICE.match(_bus_and_name(status)[1]) and {keys.MODEL, keys.STATE} <= names:
        return 'devices'
    return ''


def _bus_and_name(status: AnyStatus) -> tuple[str, str]:
    """Return the bus of a device, '' where its node has only one, and its name without that."""
    node, rest = split_name(status.name)
    # hardware_id in older recordings: '[BUS/]11'.
    bus = status.hardware_id.removeprefix(f'{namespace_of(node)}/').rpartition('/')[0]
    bus = bus.removeprefix(BUS_HARDWARE_PREFIX)
    return (bus, rest[len(bus) + 1:]) if bus and rest.startswith(f'{bus}/') else ('', rest)


def metric_of(status: AnyStatus) -> str:
    """Return what a timing status is about: a bus, [bus/]device, or '' (a node, its only bus)."""
    return split_name(status.name)[1].removeprefix('timing/').rpartition('/')[0]


def is_device(of: str) -> bool:
    """Tell whether a name, with or without a bus in front, is written like that of a device."""
    return _DEVICE.match(of.rpartition('/')[2]) is not None


def row(kind: str, status: AnyStatus) -> Row:
    """Return what the page knows of a status at all times (tables come on demand)."""
    node, rest = split_name(status.name)
    level = status.level if status.level in _LEVELS else Level.STALE
    common = {'robot': namespace_of(node), 'node': node, 'level': int(level),
              'message': status.message}
    return common | _MAKERS[kind](status, rest)


def _device(status: AnyStatus, _: str) -> Row:
    pairs = _head(status)
    values = dict(reversed(pairs))      # a field of the table may be called like a fact
    bus, name = _bus_and_name(status)
    id_, _, joint = name.partition(' ')
    return {
        'bus': bus,
        'id': int(id_),
        'joint': joint,
        'model': values[keys.MODEL],
        'firmware': values.get(keys.FIRMWARE, ''),
        'state': values[keys.STATE],
        'live': values[keys.STATE] == CONNECTED and status.level != Level.STALE,
        'findings': _findings(pairs),
    } | {one.name: calm(found) if one.is_rounded else found for one in keys.FIGURES
         for found in [values.get(one.key, '')]}


def _head(status: AnyStatus) -> Pairs:
    """Return the pairs in front of the table, with all findings, however many there are."""
    most = HEAD
    pairs = status.pairs(most)
    while len(pairs) == most and pairs[-1][0].startswith(_LISTED):
        most *= 2
        pairs = status.pairs(most)
    return pairs


def _is_open(pairs: Pairs) -> bool:
    """Tell whether the port of a bus or bridge is open, as far as that is said."""
    return dict(pairs).get(keys.STATE) != PORT_CLOSED


def _bus(status: AnyStatus, rest: str) -> Row:
    pairs = status.pairs()
    return {
        'bus': rest.partition(' ')[2],
        'live': _is_open(pairs),
        'values': [pair for pair in pairs
                   if not pair[0].startswith(_LISTED) and pair[0] not in _ASIDE],
        'findings': _findings(pairs),
        'doubts': _findings(pairs, keys.DOUBT),
        'covers': _covered(pairs),
    }


def _bridge(status: AnyStatus, rest: str) -> Row:
    pairs = status.pairs()
    return {'part': rest, 'values': pairs, 'live': _is_open(pairs)}


def _timing_row(status: AnyStatus, rest: str) -> Row:
    return {'of': metric_of(status), 'metric': rest.rpartition('/')[2], 'values': status.pairs()}


_MAKERS = {'devices': _device, 'buses': _bus, 'bridge': _bridge, 'timing': _timing_row}


def _findings(pairs: Pairs,
              prefix: str = keys.FINDING) -> list[tuple[str, str, str]]:
    """Return (rule, message, severity) of each; 'warn' where no severity is given."""
    severities = {key.removeprefix(keys.SEVERITY): value for key, value in pairs
                  if key.startswith(keys.SEVERITY)}
    found = ((key.removeprefix(prefix), value) for key, value in pairs if key.startswith(prefix))
    return [(rule, text, 'error' if severities.get(rule) == 'error' else 'warn')
            for rule, text in found]


def _covered(pairs: Pairs) -> dict[int, tuple[str, str]]:
    """Return (severity, rule) of what the bus has, by ID of each device that suffers from it."""
    severities = {rule: severity for rule, _, severity in _findings(pairs)}
    return {number: (severities.get(rule, 'warn'), rule)
            for key, spans in pairs if key.startswith(keys.COVERS)
            for rule in [key.removeprefix(keys.COVERS)] for number in _ids(spans)}


def _ids(spans: str) -> Iterator[int]:
    """Read '001-018, 020'."""
    for span in spans.split(', '):
        first, _, last = span.partition('-')
        yield from range(natural(first), min(natural(last or first), _ID_MAX) + 1)


def errors(status: AnyStatus, arrived_s: float, before: Row) -> Row:
    """Return what the row of a bus has of its errors, each as (monotonic s or None, text)."""
    pairs = status.pairs()
    running_s = finite(dict(pairs).get(keys.RUNNING, ''))
    started_s = None if running_s is None else _steady(
        arrived_s - running_s, before.get('started'))
    return {'started': started_s, 'errors': [
        _dated(value, started_s) for key, value in pairs if key.startswith(keys.ERROR)]}


def _dated(line: str, started_s: float | None) -> tuple[float | None, str]:
    found = _ERROR.match(line)
    after_s = None if found is None else finite(found[1])
    if found is None or after_s is None or started_s is None:
        return None, line
    return round(started_s + after_s, 2), found[2]


def figures(values: Pairs) -> list[float | None]:
    """Return what of a metric is plotted: [p50, p95, max] of the window, or [value]."""
    by_name = {key.partition(' (')[0]: value for key, value in values}
    names = _FIGURES if 'p50' in by_name else ('value',)
    return [finite(by_name.get(name, '')) for name in names]


def calm(text: str, digits: int = 2) -> str:
    """Round a number: what only jitters is not a change."""
    value = finite(text)
    return text if value is None else number(float(f'{value:.{digits}g}'))


def rounded(text: str, decimals: int) -> str:
    """Round a number to so many decimals."""
    value = finite(text)
    return text if value is None else number(round(value, decimals))


def finite(text: str) -> float | None:
    """Return the number in a text; None for NaN, infinity and other text."""
    try:
        value = float(text)
    except ValueError:
        return None
    return value if abs(value) < 1e300 else None        # False for NaN, too


def natural(text: str) -> int:
    """Return the number in a text, 0 where it is none or too long for one of ours."""
    return int(text) if text.isdecimal() and len(text) < 17 else 0


def table(status: AnyStatus, arrived_s: float,
          before: RegisterTable | None = None) -> RegisterTable:
    """Return facts and fields of a device status; `observed` decides which keys are fields."""
    pairs = status.pairs(limit=_OBSERVED_LIMIT)
    seen = _seen(pairs)
    old = {field.key: field.seen for field in before.fields} if before else {}
    facts: Pairs = []
    fields: list[FieldRow] = []
    for at, (key, value) in enumerate(status.pairs()):
        name = key if key in seen else key.rpartition(' (')[0]
        if name not in seen or at < _NAMING:
            if key not in (keys.OBSERVED, keys.PART) and not key.startswith(_LISTED):
                facts.append((key, value))
        elif key == keys.raw(name) and fields:
            fields[-1] = fields[-1]._replace(raw=value)
        else:
            age_s, source = seen[name]
            when = None if age_s is None else _steady(arrived_s - age_s, old.get(key))
            fields.append(FieldRow(key, value, '', when, source))
    return RegisterTable(facts, fields)


def samples(status: AnyStatus, arrived_s: float) -> Iterator[tuple[str, str, float, str]]:
    """
    Yield key, value, when it was seen and source of each register; much less work than table().

    What is no number comes twice, the second time as its raw number.
    """
    pairs = status.pairs(limit=_OBSERVED_LIMIT)
    seen = _seen(pairs)
    name = shown = ''
    for key, value in pairs[_NAMING:]:
        if key != keys.raw(name):
            shown, name = key, key if key in seen else key.rpartition(' (')[0]
        if name in seen:
            age_s, source = seen[name]
            yield shown, value, 0.0 if age_s is None else arrived_s - age_s, source


def values(status: AnyStatus) -> Values:
    """Return what the registers of a device say of its health, as far as they were read."""
    (position_unit, position), (_, temperature), (_, voltage), (unit, load) = (
        _first(status, names) for names in _VALUES)
    low, high, *limits = (_first(status, names) for names in _LIMITS)
    return Values(position, temperature, voltage, load, unit, position_unit, (
        *(limit if found == position_unit else '' for found, limit in (low, high)),
        *(limit for _, limit in limits)))


def _first(status: AnyStatus, names: tuple[bytes, ...]) -> tuple[str, str]:
    """Return the unit and the value of the first of these registers; '' for none."""
    key, value = next(filter(None, map(status.find, names)), ('', ''))
    return key.rpartition(' (')[2].rstrip(')'), value


def _steady(when_s: float, before_s: float | None) -> float:
    if before_s is not None and abs(when_s - before_s) < JITTER_S:
        return before_s
    return round(when_s, 2)


def _seen(pairs: Pairs) -> dict[str, tuple[float | None, str]]:
    """Read the value of `observed`; what is not as it should be is left out."""
    try:
        entries = json.loads(dict(pairs).get(keys.OBSERVED, ''))
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
