# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""
Bytes that a logic analyser decoded, as CSV: Saleae Logic 1 and 2, DSView, sigrok.

The first line names the columns; a time has its unit in its name, or is in seconds.
"""
from __future__ import annotations

import csv
import re

from msg_defs.units import NS_PER_MS
from msg_defs.units import NS_PER_S
from servobus.sources.byte_text import ByteText
from servobus.sources.byte_text import TextBytes
from servobus.sources.byte_text import unescaped

_TIME = re.compile(r'(?:start[_ ]?)?time\b\s*(?:[\[(](\w+)[\])])?', re.IGNORECASE)
_DATA = ('data', 'value', 'decoded protocol result', 'hex')
_DECODER = re.compile(r'uart|serial|\b[rt]x\b', re.IGNORECASE)
_UNITS = {'s': NS_PER_S, 'ms': NS_PER_MS, 'us': 1000, '\u00b5s': 1000, 'ns': 1}
_NUMBER = re.compile(r'(?:0x)?([0-9a-f]{1,2}|\d{3})', re.IGNORECASE)
_QUOTED = re.compile(r"'(.*)'")
_CLOCK = re.compile(r'.*T(\d+):(\d+):(\d+(?:\.\d+)?).*')
NAME = 'CSV of a logic analyser'


def read_csv(text: str) -> ByteText | None:
    """Return what the file shows, None where its first line names no times and bytes."""
    first, *rows = text.splitlines() or ['']
    names = _cells(first)
    timed = {at: found for at, name in enumerate(names) if (found := _TIME.match(name.strip()))}
    data = [at for at, name in enumerate(names) if name.strip().casefold() in _DATA] or [
        at for at, name in enumerate(names) if _DECODER.search(name)]
    if not timed or not data:
        return None
    [(when, unit), *_] = timed.items()
    cells = [_cells(row) for row in rows]
    values = [row[data[0]].strip() if len(row) > data[0] else '' for row in cells]
    is_decimal = not any('0x' in one for one in values) and any(
        one.isdecimal() and len(one) == 3 for one in values)
    parts, unused = [], {}
    for number, (row, value) in enumerate(zip(cells, values, strict=True), 2):
        one = _byte(value, 10 if is_decimal else 16)
        if one is None:
            unused[number] = rows[number - 2]
        else:
            time = _time(row[when], _UNITS.get(unit[1] or 's', NS_PER_S))
            parts.append(TextBytes(one, time=time))
    return ByteText(NAME, sorted(parts, key=lambda one: one.time or 0), unused)


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
    found = _NUMBER.fullmatch(value)
    try:
        return bytes((int(found[1], base),)) if found else None
    except ValueError:
        return None


def _time(text: str, unit: int) -> int | None:
    """Return a time in ns: a number, or a time of day as Logic 2 writes it on demand."""
    try:
        if clock := _CLOCK.fullmatch(text):
            return int(((int(clock[1]) * 60 + int(clock[2])) * 60 + float(clock[3])) * NS_PER_S)
        return int(float(text) * unit)
    except (ValueError, OverflowError):
        return None
