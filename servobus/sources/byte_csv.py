# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""
Bytes that a logic analyser decoded, as CSV: Saleae Logic 1 and 2, DSView, sigrok.

The first line names the columns; a time has its unit in its name, or is in seconds. Two
analysers are two lines, by their names.
"""
from __future__ import annotations

from collections import defaultdict
from collections.abc import Collection
import csv
import re
import shlex

from msg_defs.event import IN
from msg_defs.event import OUT
from msg_defs.event import UNKNOWN
from msg_defs.units import NS_PER_MS
from msg_defs.units import NS_PER_S
from servobus.plain import printable
from servobus.sources.byte_text import ByteText
from servobus.sources.byte_text import TextBytes
from servobus.sources.byte_text import unescaped

_TIME = re.compile(r'(?:start[_ ]?)?time\b\s*(?:[\[(](\w+)[\])])?')
_DATA = ('data', 'value', 'decoded protocol result', 'hex')
_DECODER = re.compile(r'uart|serial|\b[rt]x\b')
_UNITS = {'s': NS_PER_S, 'ms': NS_PER_MS, 'us': 1000, '\u00b5s': 1000, 'ns': 1}
_ANALYSER = ('name', 'analyzer name')
_SIDES = {OUT: re.compile(r'\btx\b', re.IGNORECASE), IN: re.compile(r'\brx\b', re.IGNORECASE)}
_MARKED = re.compile(r'\[([0-9A-F]{2})\]|\\x([0-9A-F]{2})', re.IGNORECASE)
_QUOTED = re.compile(r"'(.*)'")
_CLOCK = re.compile(r'.*T(\d+):(\d+):(\d+(?:\.\d+)?).*')
NAME = 'CSV of a logic analyser'
ANALYSERS_NAMED_MAX = 4


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
    is_ascii = any(_MARKED.fullmatch(row[data[0]]) for row in cells)
    values = [_value(*both, data[0], is_ascii) for both in zip(rows, cells, strict=True)]
    is_decimal = not any('0x' in one for one in values) and any(
        one.isdecimal() and len(one) == 3 for one in values)
    named = [at for at, name in enumerate(names) if name in _ANALYSER][:1]
    lines, unused = defaultdict[str, list[TextBytes]](list), {}
    for number, (row, value) in enumerate(zip(cells, values, strict=True), 2):
        one = _character(value) if is_ascii else _byte(value, 10 if is_decimal else 16)
        if one is None:
            unused[number] = rows[number - 2]
        else:
            time = _time(row[when], _UNITS.get(unit, NS_PER_S))
            lines[''.join(row[at] for at in named)].append(TextBytes(one, time=time))
    parts = [one._replace(side=_side(name) if len(lines) == 2 else UNKNOWN)
             for name, line in lines.items() for one in line]
    return ByteText(NAME, sorted(parts, key=lambda one: one.time or 0), unused, _which(lines))


def _which(lines: Collection[str]) -> str:
    """Ask which line is the bus, unless one is TX and the other RX."""
    if len(lines) < 2 or sorted(map(_side, lines)) == [IN, OUT]:
        return ''
    names = [shlex.quote(printable(one)) for one in lines][:ANALYSERS_NAMED_MAX]
    return (f'bytes of {len(lines)} analysers, {", ".join(names)}; name two TX and RX, or give '
            f'one: (head -n 1 FILE; grep -F {names[0]} FILE) | dxl_dump -')


def _side(name: str) -> str:
    return next((side for side, named in _SIDES.items() if named.search(name)), UNKNOWN)


def _value(row: str, cells: list[str], at: int, is_ascii: bool) -> str:
    """Return what a row shows at a column; DSView does not quote a character."""
    cell = cells[at].strip()
    return cell if cell or not is_ascii else cells[at] or ''.join(row.split(',', at)[at:])[:1]


def _cells(line: str) -> list[str]:
    try:
        return next(csv.reader([line.replace('\0', '')]), [])
    except csv.Error:              # a cell that is too long
        return []


def _byte(value: str, base: int) -> bytes | None:
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
