# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""A case of the doctor made by hand: devices, incidents and counts, without any packets."""

from collections import deque
from pathlib import Path

import yaml

from msg_defs.diagnostics import Level
from msg_defs.diagnostics import Metric
from msg_defs.dxl_instruction import Instruction as I
from msg_defs.running_statistics import Summary
from servobus.bus import evidence as ev
from servobus.bus import report as words
from servobus.bus.report import BusReport
from servobus.bus.report import Counts
from servobus.bus.report import Cycle
from servobus.bus.report import CycleTimes
from servobus.bus.report import DeviceReport
from servobus.bus.report import IdWrite
from servobus.bus.report import Incident
from servobus.bus.report import ReplyLatency
from servobus.bus.report import Wait
from servobus.bus.table import Observed
from servobus.doctor import RULES
from servobus.doctor.case import Case
from servobus.doctor.case import Mark
from servobus.doctor.case import mark_of
from servobus.doctor.case import Sample
from servobus.doctor.engine import found_by
from servobus.doctor.rule import Claim
from servobus.model.control_table import UNKNOWN
from servobus.model.models import Models

MODELS = Models()
S = 1_000_000_000
MS = 1_000_000
NOW = 100 * S
RULE = {one.name: one for one in RULES}

def summary(p50, p95=0.0, count=5):
    return Summary(count, p50, 0.0, p50, p95, p50, p95 or p50, p95 or p50)


def blurred(ms):
    """Return what is said of the time between two chunks."""
    return (Metric('time_between_buffers', 'ms', summary(ms)),)


def seen(device, registers, source='r', age_s=0.5):
    fields = [(device.model.by_name[name], raw) for name, raw in registers.items()]
    return tuple(Observed(field, field.decode(field.bytes_of(raw)), age_s, source)
                 for field, raw in fields)


def device(number=1, model='XL430-W250', state=words.CONNECTED, registers=None, written=None,
           age_s=0.5, totals=None, delay=None, window=None, sent=None, **other):
    found = MODELS.by_name(model) if model else None
    one = DeviceReport(
        number, f'{number:03}', '', words.PROTOCOL_2, found or UNKNOWN,
        found.number if found else None, model or 'unknown', 50, state, Level.OK, state,
        Counts(**(totals or {})), Counts(**(window or {})), 0, None, 0.1, False, '', None, None, 0,
        (), 0, ReplyLatency(delay, None, 1.0), {})._replace(**other)
    return one._replace(observed=seen(one, registers or {}, age_s=age_s)
                        + seen(one, written or {}, 'w', age_s)
                        + tuple(found for name, (raw, ago_s) in (sent or {}).items()
                                for found in seen(one, {name: raw}, 'w', ago_s)))


def note(kind, detail, count, number=1, every_ms=300.0, ago_s=0.0):
    """Return as many incidents of a kind, the last of them so long ago."""
    return [Incident(NOW - int(ago_s * S) - int(place * every_ms * MS), kind, number, detail)
            for place in reversed(range(count))]


def asks(code, *ids, at=132, size=4, asked=30, missed=0, stamps=(NOW,)):
    return Cycle(code, ids, at, size, asked, missed, tuple(stamps))


COUNTERS = dict.fromkeys(('Bytes', 'Packet Bytes', 'Packets', 'Instructions', 'Noise Bytes'), 0)


def case(*devices, notes=(), counters=None, marks=None, samples=None, repeats=None, rhythms=None,
         steady=None, quiet_s=0.0, loop=((), ()), turned=(), **report):
    """Return a bus of 1 MBd, heard since 60 s. marks: what was counted, by how long ago (s)."""
    by_kind = {}
    for one in notes:
        by_kind.setdefault(one.kind, deque()).append(one)
    nothing = dict.fromkeys(Mark._fields[1:], 0) | {'totals': {}}
    told = BusReport(
        'arm', NOW, NOW - 60 * S, 1_000_000, Level.OK, 'ok', tuple(devices),
        COUNTERS | (counters or {}), {}, (), (), (), (), (), b'', 0.01, {})._replace(**report)
    now = mark_of(told)._asdict()
    found = Case(
        told, by_kind,
        deque(Mark(**{**(nothing if age else now), 'stamp': NOW - int(age * S), **values})
              for age, values in sorted((marks or {10: {}, 0: {}}).items(), reverse=True)),
        {number: deque(some) for number, some in (samples or {}).items()}, repeats or {},
        rhythms or [], steady or set(), loop=loop[0], late=loop[1])
    found.quiet_s, found.run_from, found.turned = quiet_s, told.started, {*turned}
    found.highest = {number: max([one.voltage or 0.0 for one in some], default=0.0)
                     for number, some in found.samples.items()}
    return found


def told(rule, **parts):
    """Return what a rule says of a case."""
    return found_by(RULE[rule], case(*parts.pop('devices', ()), **parts))


def claims(rule, **parts):
    """Return what a rule claims of a case, without its doubts."""
    return [one for one in told(rule, **parts) if isinstance(one, Claim)]


def speaks_from_its_edge_on(rule, enough, message, figures, too_little):
    """
    Check what a rule claims of a case that is just enough, and nothing where it is too little.

    enough: the parts of the case; and whom it is about, its level and what it covers, where that
    is not the usual. too_little: parts that take the place of those.
    """
    [claim] = claims_of_row(rule, enough)
    assert (claim.message, dict(claim.evidence)) == (message, figures)
    assert (claim.device, claim.level, claim.covers) == tuple(
        enough.get(name, usual) for name, usual in (
            ('whom', None if RULE[rule].subject == 'bus' else 1), ('level', None), ('covers', ())))
    for less in too_little:
        assert claims_of_row(rule, {**enough, **less}) == [], less


def claims_of_row(rule, parts):
    """Return what a rule claims of the case in a row, which also has what is expected of it."""
    return claims(rule, **{name: part for name, part in parts.items()
                           if name not in ('whom', 'level', 'covers')})


# --- cases in a file -------------------------------------------------------------------------

KINDS = {str(kind): kind for kind in vars(ev).values() if isinstance(kind, ev.IncidentKind)}
DETAILS = {frozenset(detail._fields): detail for detail in vars(ev).values()
           if isinstance(detail, type) and issubclass(detail, tuple)}
SPOKEN = {'window': {'answers': 1000}, 'totals': {'answers': 1000}}
SILENT = {'state': words.DISCONNECTED, 'missed_in_a_row': 9, 'last_heard_s': 1.6,
          'window': {'missed': 9}}


def cases_of(file):
    """Yield the rows of a file, as speaks_from_its_edge_on takes them."""
    rows = yaml.safe_load(Path(__file__).with_name(file).read_text(encoding='utf-8'))
    for row in rows:
        rule, says, figures = row.pop('rule'), row.pop('says'), row.pop('figures', {})
        too_little = [_parts(less) for less in row.pop('too little', ())]
        yield rule, _parts(row), says, figures, too_little


def _parts(raw):
    """Return the parts of a case as they are in Python."""
    if 'blurred' in raw:
        raw['metrics'] = blurred(raw.pop('blurred'))
    return {key.removesuffix('_ago_ns'): NOW - value if key.endswith('_ago_ns')
            else _READ.get(key, lambda value: value)(value) for key, value in raw.items()}


def _device(id=0, spoken=0, silent=0, **parts):
    usual = SPOKEN if spoken else SILENT if silent else {}
    if 'delay' in parts:
        parts['delay'] = summary(*parts['delay'])
    return device(id or spoken or silent, **{**usual, **parts})


def notes_of(what, times=1, device=1, every_ms=300.0, ago_s=0.0, **detail):
    if isinstance(code := detail.get('instruction'), str):
        detail['instruction'] = I[code]
    return note(KINDS[what], DETAILS[frozenset(detail)](**detail), times, device, every_ms, ago_s)


def _cycles(ids=(), ago_ns=(0,), every_ms=0, times=1, ago_ms=0.0, apart=0.0, of=7, **parts):
    if apart:
        return [one for number in range(1, of + 1) for one in _cycles(
            [number], every_ms=every_ms or 200, times=5, ago_ms=apart * number, asks='READ',
            **parts)]
    if every_ms:
        ago_ns = [round((ago_ms + every_ms * n) * MS) for n in reversed(range(times))]
    code = parts.pop('asks')
    return [asks(I[code] if isinstance(code, str) else code, *ids,
                 stamps=[NOW - ago for ago in ago_ns], **parts)]


def _loop(late, usual, uneven=0, every_s=0.75, ago_s=2.0, late_ms=25):
    late = [NOW - int((ago_s + every_s * n) * S) for n in reversed(range(late))]
    return ([(NOW, 10 * MS)] * usual + [(NOW, 13 * MS)] * uneven
            + [(at, late_ms * MS) for at in late],
            late)


def _waits(us, device=1, times=1, ago_s=0.0, spoilt=False, asks='READ'):
    return [Wait(NOW - int(ago_s * S), us, device, spoilt, I[asks])] * times


def _id_write(number, ids, ago_s, baud=-1, back_s=None, locked=False):
    return IdWrite(number, tuple(ids), NOW - int(ago_s * S), baud, locked,
                   0 if back_s is None else NOW - int(back_s * S))


def _sample(ago_s, *values):
    return Sample(NOW - int(ago_s * S), *[*values, None, None, None, None][:5])


def _mark(totals=None, **counted):
    if totals is not None:
        counted['totals'] = {number: Counts(**counts) for number, counts in totals.items()}
    return counted


_READ = {
    'covers': tuple, 'scanned': tuple, 'chain': tuple, 'level': Level.__getitem__,
    'devices': lambda rows: [_device(**row) for row in rows],
    'notes': lambda rows: [one for row in rows for one in notes_of(**row)],
    'cycles': lambda rows: tuple(one for row in rows for one in _cycles(**row)),
    'noise': bytes.fromhex,
    'id_writes': lambda rows: tuple(_id_write(**row) for row in rows),
    'loop': lambda of: _loop(**of),
    'cycle': lambda of: CycleTimes(**{**of, 'waiting': tuple(map(tuple, of['waiting']))}),
    'waits': lambda rows: tuple(one for row in rows for one in _waits(**row)),
    'samples': lambda of: {number: [_sample(*row) for row in rows]
                           for number, rows in of.items()},
    'marks': lambda of: {ago_s: _mark(**counted) for ago_s, counted in of.items()},
}
