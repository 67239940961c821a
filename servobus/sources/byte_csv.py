# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""
Bytes that a logic analyser decoded, as CSV: Saleae Logic 1 and 2, DSView, sigrok.

The first line names the columns; a time has its unit in its name, or is in seconds. Several
analysers are several lines, by their names or in columns of their own.
"""
from __future__ import annotations

from collections import defaultdict
from collections.abc import Sequence
import csv
import re
import shlex

from msg_defs.event import Change
from msg_defs.event import FRAMING
from msg_defs.event import PARITY
from msg_defs.nanoseconds import NS_PER_MS
from msg_defs.nanoseconds import NS_PER_S
from servobus.printable_text import printable
from servobus.sources.byte_sides import ByteText
from servobus.sources.byte_sides import NAMED_MAX
from servobus.sources.byte_sides import one_bus
from servobus.sources.byte_sides import OneBus
from servobus.sources.byte_sides import TextBytes
from servobus.sources.strace_text import unescaped

_TIME = re.compile(r'(?:start[_ ]?)?time\b\s*(?:[\[(](\w+)[\])])?')
_DATA = ('data', 'value', 'decoded protocol result', 'hex')
_DECODER = re.compile(r'uart|serial|\b[rt]x\b')
_UNITS = {'s': NS_PER_S, 'ms': NS_PER_MS, 'us': 1000, '\u00b5s': 1000, 'ns': 1}
_ANALYSER = ('name', 'analyzer name')
_FLAW = re.compile(r'(?:(parity|framing) )?error')
_FLAWS = {None: FRAMING, 'framing': FRAMING, 'parity': PARITY}
_MARKED = re.compile(r'\[([0-9A-F]{2})\]|\\x([0-9A-F]{2})', re.IGNORECASE)
_QUOTED = re.compile(r"'(.*)'")
_SHOWN_TWICE = re.compile(r"'?.*'? \((0x[0-9a-f]{1,2})\)", re.IGNORECASE)
_CLOCK = re.compile(r'.*T(\d+):(\d+):(\d+(?:\.\d+)?).*')
NAME = 'CSV of a logic analyser'


def read_csv(text: str) -> ByteText | None:
    """Return what the file shows, None where its first line names no times and bytes."""
    first, *rows = text.splitlines() or ['']
    names = [name.strip().lower() for name in _cells(first)]
    times = [(at, found[1]) for at, name in enumerate(names) if (found := _TIME.match(name))]
    data = [at for at, name in enumerate(names) if name in _DATA] or [
        at for at, name in enumerate(names) if _DECODER.search(name)]
    if not times or not data:
        return None
    when, unit = times[0]
    cells = [_cells(row) + [''] * len(names) for row in rows]      # some may be cut
    named = [at for at, name in enumerate(names) if name in _ANALYSER][:1]
    # Without a column of names DSView has a column for each analyser.
    shown = data if names[data[0]] not in _DATA and not named else data[:1]
    columns = {at: _column(rows, cells, at) for at in shown}
    flaws = {at: _FLAWS[found[1]] for at, name in enumerate(names)
             if (found := _FLAW.fullmatch(name))}
    lines, unused = defaultdict[str, list[TextBytes]](list), {}
    for number, row in enumerate(cells):
        flaw = next((Change(what, 1) for at, what in flaws.items() if row[at].strip()), None)
        time = _time(row[when], _UNITS.get(unit, NS_PER_S))
        values = [(at, one) for at, column in columns.items() if (one := column[number])]
        for at, one in values:
            name = ''.join(row[at] for at in named) or (
                f'{names[at]} {shown.index(at) + 1}' if len(shown) > 1 else '')
            lines[name].append(TextBytes(one, time=time, change=flaw))
        if not values:
            unused[number + 2] = rows[number]
    bus = one_bus(lines) if len(lines) > 1 else OneBus(lines.popitem()[1] if lines else ())
    return ByteText(NAME, bus.parts, unused, _which(bus.rivals, bool(named)),
                    [printable(bus.note)] * bool(bus.note))


def _which(names: Sequence[str], is_named: bool) -> str:
    """Ask which of several lines is the bus."""
    if not names:
        return ''
    shown = [shlex.quote(printable(one)) for one in names][:NAMED_MAX]
    return (f'packets of {len(names)} analysers, {", ".join(shown)}; ' + (
        f'name two TX and RX, or give one: (head -n 1 FILE; grep -F {shown[0]} FILE) | dxl_dump -'
        if is_named else 'export one of them, or the two of one bus'))


def _column(rows: Sequence[str], cells: Sequence[Sequence[str]], at: int) -> list[bytes | None]:
    """Return the bytes of a column, None where a row has none."""
    is_ascii = any(_MARKED.fullmatch(row[at]) for row in cells)
    values = [_value(*both, at, is_ascii) for both in zip(rows, cells, strict=True)]
    is_decimal = not any('0x' in one for one in values) and any(
        one.isdecimal() and len(one) == 3 for one in values)
    return [_character(one) if is_ascii else _byte(one, 10 if is_decimal else 16)
            for one in values]


def _value(row: str, cells: Sequence[str], at: int, is_ascii: bool) -> str:
    """Return what a row shows at a column; DSView does not quote a character."""
    cell = cells[at].strip()
    return cell if cell or not is_ascii else cells[at] or ''.join(row.split(',', at)[at:])[:1]


def _cells(line: str) -> list[str]:
    try:
        return next(csv.reader([line.replace('\0', '')]), [])
    except csv.Error:              # a cell that is too long
        return []


def _byte(value: str, base: int) -> bytes | None:
    if both := _SHOWN_TWICE.fullmatch(value):
        value = both[1]
    if quoted := _QUOTED.fullmatch(value):
        value = quoted[1]
        if not value.isdecimal() or len(value) == 1:
            one = unescaped(value)
            return one if len(one) == 1 else None
        base = 10
    try:
        return bytes((int(value, 0 if value[:2] in ('0x', '0b') else base),))
    except ValueError:
        return None


def _character(value: str) -> bytes | None:
    r"""Return a byte that is shown as a character, as [FF] or as \xFF where it is none."""
    found = _MARKED.fullmatch(value)
    one = chr(int(found[1] or found[2], 16)) if found else value
    return one.encode('latin-1', 'ignore') if len(one) == 1 else None


def _time(text: str, unit: int) -> int | None:
    """Return a time in ns: a number, or a time of day as Logic 2 writes it on demand."""
    try:
        if clock := _CLOCK.fullmatch(text):
            return int(((int(clock[1]) * 60 + int(clock[2])) * 60 + float(clock[3])) * NS_PER_S)
        return int(float(text) * unit)
    except (ValueError, OverflowError):
        return None
