# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""
ModelGuesses: the registers of a device of unknown model, by what the program uses.

A program shows what it believes: it writes 1 byte at 64 and 4 at 116, it reads 4 at 132. What all
tables of servos agree on that have these registers has a meaning. A use that no table has, or
a value that cannot be, and nothing has a meaning any more.
"""

from __future__ import annotations

from collections.abc import Collection
from collections.abc import Iterable
from collections.abc import Mapping
from dataclasses import replace
from math import pi
import re

from servobus.model.control_table import Field
from servobus.model.control_table import Indirect
from servobus.model.control_table import Model
from servobus.model.control_table import UNKNOWN
from servobus.model.control_table import Value
from servobus.model.models import Models
from servobus.model.robotis_file import SUFFIX

Use = tuple[int, int]              # address and size of what a program reads or writes

REGISTERS_NEEDED = 3               # with Torque Enable or a goal among them; or both positions
USE_MAX_BYTES = 24                 # bytes: a longer read takes all there is, gaps too
IMPOSSIBLE_USE = (-1, 1)           # a use that no table has
# Uses only of numbers that make sense in this order of bytes: of positions, and of goals, which
# a program may send wrongly.
LITTLE, BIG = (-2, 1), (-2, 2)
SENT_LITTLE, SENT_BIG = (-3, 1), (-3, 2)
LAYOUTS_KEPT = 256
# Series whose names do not begin with their letters. MX(2.0) has the table of the X series.
_SERIES = {'X': r'2?X[A-Z]\d|2X|MX-\d+$', 'P': r'P[HM]\d', 'PRO(A)': r'[HM]\d\d-.*\(A\)',
           'PRO': r'[HLM]\d\d-|RH-P12-RN$', 'SMS': r'SM\d', 'Y': r'YM\d'}
_NAMED_SERIES = 4                  # more are "several"
# Where several series are left, only these have a meaning: what else is at one address in all
# series that are known may well be something different in one that is not.
_COMMON = ('Torque Enable', 'Goal Position', 'Goal Velocity', 'Present Position',
           'Present Velocity', 'Present Load', 'Present Input Voltage', 'Present Temperature',
           'Hardware Error Status', 'Min Voltage Limit', 'Max Voltage Limit', 'Lock', 'ID',
           'Baud Rate')
_BASIC = ('ID', 'Baud Rate', 'Lock')
# These too where the program uses just them, and they are the same in all tables that are left.
_WHERE_USED = ('Min Position Limit', 'Max Position Limit', 'CW Angle Limit', 'CCW Angle Limit',
               'Operating Mode', 'Torque Limit')
POSITIONS = ('Goal Position', 'Present Position')      # signed in some tables
POSITION_AT, SPEED_AT, GOAL_AT = 56, 58, 42  # positions and velocity of Feetech
# What a register can hold, in its unit. Of positions: by size, in rad and in steps.
_LARGEST_VALUES = {'Torque Enable': 1, 'Present Temperature': 120, 'Present Input Voltage': 400}
_FARTHEST_POSITIONS = {2: (2 * pi, 4095), 4: (512 * pi, 1 << 22)}
REFUSALS_NEEDED = 3
_WRONG_TABLE = (5, 7)              # error numbers: data length, access


class ModelGuesses:
    """Finds a model for such a device, in the tables of all servos; these are read when asked."""

    def __init__(self, models: Models) -> None:
        self._models = models
        self._servos: list[Model] = []
        self._known: dict[tuple[str, frozenset[Use]], Model] = {}

    def find_model(self, protocol: str, used: frozenset[Use]) -> Model:
        """Return the registers of a device with which a program does that; or UNKNOWN."""
        found = self._known.get((protocol, used))
        if found is None:
            if len(self._known) >= LAYOUTS_KEPT:
                self._known.clear()
            found = self._known[protocol, used] = agreed_model(
                (one for one in self.servos() if one.protocol == protocol), used)
        return found

    def servos(self) -> list[Model]:
        """Return the servos with a YAML file: boards have no torque, *.model no access."""
        self._servos = self._servos or [
            model for key in self._models.names() if (model := self._models.get(key)) is not None
            and {'Torque Enable', 'Goal Position'} <= model.by_name.keys()
            and not model.file.endswith(SUFFIX)]
        return self._servos


def agreed_model(tables: Iterable[Model], used: Collection[Use]) -> Model:
    """Return the registers on which all tables agree that have what is used; or UNKNOWN."""
    order = _order_in(used)
    uses = [(at, size) for at, size in used if at >= IMPOSSIBLE_USE[0] and size]
    fits = {table: registers for table in tables if (registers := _registers(table, uses))
            and order in ('', table.by_name['Goal Position'].byte_order)}
    if not fits:
        return UNKNOWN
    first, *others = fits
    is_enough = all(map(_is_enough, fits.values()))
    names = {table.name for table in fits}
    series = sorted({_series(name) for name in names})
    knows_units = len({table.file for table in fits}) > 1
    knows_order = len({table.by_name['Goal Position'].byte_order for table in fits}) == 1
    named = _COMMON if is_enough else _BASIC
    found = [_agreed_field([field, *(table.by_address.get(field.at) for table in others)],
                           knows_units)
             for field in first.fields if (field.size == 1 or knows_order)
             and (field.name in named or (is_enough and (len(series) == 1 or (
                 field.name in _WHERE_USED and (field.at, field.size) in uses))))
             and (is_enough or (field.at, field.size) in uses)]
    fields = [field for field in found if field]
    fields += [goal for field in first.fields if is_enough and any(
        at <= field.at and field.end <= at + size for at, size in uses)
        and (goal := _either_goal([table.by_address.get(field.at) for table in fits]))]
    fields += [Field(at + n, f'Address {at + n}', 'u8', access='rw', memory='eeprom')
               for at, size in uses if all(_is_eeprom(table, at, size) for table in fits)
               and not any(field.at == at for field in fields) for n in range(size)]
    if not fields:
        return UNKNOWN
    name = 'several series' if len(series) > _NAMED_SERIES or not is_enough else \
        names.pop() if len(names) == 1 else f'the {_listed(series)} series'
    return Model(None, name, tuple(fields), protocol=first.protocol,
                 indirect=tuple(_agreed_indirect(fits)))


def _agreed_indirect(tables: Iterable[Model]) -> list[Indirect]:
    """Return the indirect data that all tables have at the same place."""
    areas = [{(one.address, one.data): one.size for one in table.indirect} for table in tables]
    return [Indirect(*place, min(area[place] for area in areas)) for place in areas[0]
            if all(place in area for area in areas)]


def _is_eeprom(table: Model, at: int, size: int) -> bool:
    field = table.by_address.get(at)
    return field is not None and field.size == size and field.memory == 'eeprom' \
        and 'w' in field.access


def _is_enough(registers: set[str]) -> bool:
    return registers.issuperset(POSITIONS) or (len(registers) >= REGISTERS_NEEDED and any(
        name == 'Torque Enable' or name.startswith('Goal') for name in registers))


def order_of(place: bytes | None, goal: bytes | None) -> set[Use]:
    """Return the order of bytes in which a position of Feetech makes sense, if in one only."""
    for two, little, big in ((place, LITTLE, BIG), (goal, SENT_LITTLE, SENT_BIG)):
        low, high = two or (0, 0)
        if high < 16 <= low:           # 16 and more: beyond one turn
            return {little}
        if low < 4 and high >= 16 and high % 16:       # SCS: 1023 at most; STS: whole turns, -1
            return {big}
        if place is None:
            break                      # it comes soon
    return set()


def _order_in(used: Collection[Use]) -> str:
    """Return the order of bytes of a servo: that of its positions, else that of its goals."""
    for little, big in ((LITTLE, BIG), (SENT_LITTLE, SENT_BIG)):
        if little in used or big in used:
            return '' if little in used and big in used else 'little' if little in used else 'big'
    return ''


def _registers(table: Model, used: Iterable[Use]) -> set[str]:
    """Return the registers that are used; nothing where the table has not all of them."""
    names: set[str] = set()
    for at, size in used:
        fields = [field for address in range(at, at + size)
                  if (field := table.by_address.get(address))]
        # A block may have a gap: Feetech's SDK reads 56 to 70 of an STS, which has nothing at 67.
        if not fields or fields[0].at != at or fields[-1].end != at + size:
            return set()
        names.update(field.name for field in fields)
    return names


def _agreed_field(fields: list[Field | None], knows_units: bool) -> Field | None:
    """Return what all say of a register, None if they do not even agree on what it is."""
    first = fields[0]
    assert first is not None
    same = [field for field in fields if field is not None and _kind(field) == _kind(first)]
    if len(same) < len(fields):
        return None
    found = replace(first, cases=None)
    if any(one.type != first.type for one in same):    # a negative position speaks against it
        found = replace(found, type=f'u{8 * first.size}')
    if not knows_units or any(_unit(one) != _unit(first) for one in same) or first.cases:
        found = replace(found, unit='', scale=None, offset=0.0)
    if any((one.enum, one.spans, one.flags) != (first.enum, first.spans, first.flags)
           for one in same):
        found = replace(found, enum=None, spans=(), flags=())
    return found


def _either_goal(fields: list[Field | None]) -> Field | None:
    """Return a goal that has one of two names; None where the tables differ in more."""
    known = [field for field in fields if field is not None and field.name.startswith('Goal')]
    names = sorted({field.name for field in known})
    if len(known) < len(fields) or len(names) != 2 \
            or len({(one.at, one.size, one.byte_order) for one in known}) > 1:
        return None
    return Field(known[0].at, ' or '.join(names), f'u{8 * known[0].size}',
                 access=known[0].access, memory=known[0].memory, byte_order=known[0].byte_order)


def _kind(field: Field) -> tuple[object, ...]:
    return (field.name, field.size if field.name in POSITIONS else field.type, field.sign_bit,
            field.size == 1 or field.byte_order, field.access, field.memory)


def _unit(field: Field) -> tuple[object, ...]:
    return field.unit, field.scale, field.offset


def _series(name: str) -> str:
    known = (series for series, names in _SERIES.items() if re.match(names, name))
    return next(known, (re.match('[A-Z]+', name) or (name,))[0])


def _listed(series: list[str]) -> str:
    *others, last = series
    return f'{", ".join(others)} and {last}' if others else last


def is_contradicted(layout: Model, values: Iterable[tuple[Field, Value]],
                    refused: Mapping[tuple[int, int, int], int]) -> bool:
    """Return whether values or refusals (instruction, address, error) speak against a layout."""
    # Positions of Feetech: where it is, has the order of bytes; the goal may be a mistake.
    apart = POSITIONS if layout.protocol == 'feetech' else ()
    if any(field.name not in apart and _cannot_be(field, value) for field, value in values):
        return True
    return any(count >= REFUSALS_NEEDED and error in _WRONG_TABLE and field is not None
               and not (field.memory == 'eeprom' and 'w' in field.access)
               for (_, address, error), count in refused.items()
               for field in [layout.by_address.get(address)])


def _cannot_be(field: Field, value: Value) -> bool:
    if field.in_words:                 # flags may be new ones
        return value.text.startswith('unknown (')
    number = abs(value.number or 0)
    if field.name in POSITIONS:
        return number > _FARTHEST_POSITIONS.get(field.size, (0, 0))[not field.unit]
    return number > _LARGEST_VALUES.get(field.name, number)
