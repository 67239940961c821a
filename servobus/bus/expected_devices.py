# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""
What is on a bus, as a person writes it: '11:MX-106:left_knee', '1-20:MX-64', '30'.

The one home of this syntax; the order of the entries is the order along the cable. Whether a
model of that name exists is decided by Models.
"""

from __future__ import annotations

from collections.abc import Iterable
import re
from typing import NamedTuple

from servobus.errors import ParameterError

MAX_ID = 252                       # in Protocol 2.0
MAX_ID_1 = 253                     # in the 1.0 family
_ENTRY = re.compile(r'\s*(\d{1,9})\s*(?:-\s*(\d{1,9})\s*)?(?::([^:]*))?(?::([^:]*))?')
# A joint may have a slash, too.
_BUS_AND_ENTRY = re.compile(r'(.*?)/(\s*\d+\s*(?:[-:,].*)?)', re.DOTALL)
_EXAMPLES = "write ID:MODEL:JOINT, e.g. '11:MX-106:left_knee', '1-20:MX-64' or '30'"


class Expected(NamedTuple):
    """One device that the user listed; model and joint are '' where the entry leaves them out."""

    id: int
    model: str = ''
    joint: str = ''


def split_bus(entry: str) -> tuple[str, str]:
    """Return the bus that an entry 'BUS/ID:MODEL:JOINT' names, '' for none, and the rest."""
    match = _BUS_AND_ENTRY.fullmatch(entry)
    return (match[1], match[2]) if match else ('', entry)


def parse(text: str) -> list[Expected]:
    """Return the devices of one entry, or of several with commas."""
    return [device for entry in text.split(',') for device in _parse_entry(entry)]


def parse_all(entries: Iterable[str]) -> list[Expected]:
    """Return the devices of all entries in their order; an ID twice is a mistake."""
    devices = [device for entry in entries for device in parse(entry)]
    refuse_twice('devices: ID', [device.id for device in devices])
    refuse_twice('devices: joint', [device.joint for device in devices if device.joint])
    return devices


def runs(numbers: Iterable[int]) -> list[tuple[int, int]]:
    """Return first and last of each run: of 1, 2, 3, 9 it is (1, 3), (9, 9)."""
    found: list[tuple[int, int]] = []
    for number in numbers:
        first = found.pop()[0] if found and number == found[-1][1] + 1 else number
        found.append((first, number))
    return found


def spans(ids: Iterable[int], spelt: str = '{}') -> list[str]:
    """Return '1-20', '22': runs of IDs in the order given."""
    return ['-'.join(map(spelt.format, dict.fromkeys(run))) for run in runs(ids)]


def refuse_twice(thing: str, values: Iterable[object]) -> None:
    """Raise ParameterError for the first value that is there already; 'NAME:' or 'NAME: part'."""
    seen: set[object] = set()
    for value in values:
        if value in seen:
            raise ParameterError(f'{thing} {value} is given twice; give it once')
        seen.add(value)


def _parse_entry(entry: str) -> list[Expected]:
    match = _ENTRY.fullmatch(entry)
    if match is None:
        raise ParameterError(f'devices: {entry!r} is not a device; {_EXAMPLES}')
    first = int(match[1])
    last = first if match[2] is None else int(match[2])
    model, joint = ((part or '').strip() for part in match.group(3, 4))
    if last > MAX_ID_1:
        raise ParameterError(f'devices: {entry!r}: an ID is at most {MAX_ID_1}; {_EXAMPLES}')
    if last < first:
        raise ParameterError(f'devices: {entry!r}: the range goes down; write {last}-{first}')
    if joint and last > first:
        raise ParameterError(f'devices: {entry!r}: one joint name for {last - first + 1} devices; '
                             'write an entry for each device')
    return [Expected(number, model, joint) for number in range(first, last + 1)]
