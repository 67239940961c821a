# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""
ROBOTIS' own tables, as in dynamixel_hardware_interface, read as a YAML file of ours.

NAME.model has tab-separated rows in [type info], [unit info] and [control table]. NAME_fw52.model
is the table up to firmware 52. dynamixel.model has the model numbers.
"""

from __future__ import annotations

from collections.abc import Iterable
from functools import cache
from pathlib import Path
import re
from typing import NamedTuple

from servobus.model.checked_yaml import BUILT_IN
from servobus.model.checked_yaml import describe
from servobus.model.checked_yaml import ModelError
from servobus.model.checked_yaml import Raw
from servobus.model.checked_yaml import read_file
from servobus.model.checked_yaml import read_yaml
from servobus.model.field_entries import ADDRESS_END
from servobus.model.field_entries import REPEAT_LIMIT

SUFFIX = '.model'
NUMBERS_FILE = 'dynamixel.model'
_OLDER = re.compile(r'(.+)_fw([0-9]{1,3})')
_HEADINGS = ('address', 'data name', 'name', 'number')
_SIZES = (1, 2, 4, 8)              # what is longer is a block: it has rows of its own
_RENAMED = {'Baud Rate (Bus)': 'Baud Rate', 'BUS Watchdog': 'Bus Watchdog',
            'Secondary(Shadow) ID': 'Secondary ID'}
_INDIRECT = re.compile(r'Indirect[ _](Address|Data)([ _](\d+|Write|Read))?')
_BAUD = {'unit': 'bit/s', 'enum': 'baud_rate'}


class TableRow(NamedTuple):
    """A line of a file."""

    path: Path
    line: int
    cells: list[str]

    def error(self, reason: str) -> ModelError:
        return ModelError(self.path, f'line {self.line}', reason, 'correct the line')

    def number(self, cell: int) -> float:
        text = self.cells[cell]
        try:
            return int(text) if text.isdecimal() and len(text) < 10 else float(text)
        except ValueError:
            raise self.error(f'{describe(text)} is no number') from None


class Register(NamedTuple):
    """A row of the control table."""

    at: float
    size: float
    name: str


def is_newest_table(path: Path) -> bool:
    """Whether the file is a device's table, and not one of older firmware or the numbers."""
    older = _OLDER.fullmatch(path.stem)
    return path.name != NUMBERS_FILE and not (
        older and path.with_name(older[1] + SUFFIX).exists())


def listed_numbers(folder: Path) -> dict[str, list[float]]:
    """Return the model numbers of each file; {} if the folder does not list them."""
    path = folder / NUMBERS_FILE
    found: dict[str, list[float]] = {}
    for row in _sections(path)[''] if path.exists() else ():
        if len(row.cells) != 2:
            raise row.error('not a number and a file with a tab between them')
        found.setdefault(row.cells[1], []).append(row.number(0))
    return found


def read_robotis(path: Path) -> Raw:
    """Return what a YAML file would say; ModelError where the table cannot be used."""
    numbers = listed_numbers(path.parent).get(path.name)
    if not numbers:
        raise ModelError(path, 'model number', f'{NUMBERS_FILE} does not list the file',
                         f'add a line to {path.with_name(NUMBERS_FILE)}: the number, a tab, '
                         f'{path.name}')
    newest = _read_table(path)
    older = ((_OLDER.fullmatch(one.stem), one) for one in sorted(path.parent.iterdir())
             if one.suffix == SUFFIX)
    return {'model_numbers': dict.fromkeys(numbers, path.stem.upper().replace('_', '-')),
            'include': '_words', **newest,
            'firmware': [_older_table(one, int(match[2]), newest) for match, one in older
                         if match and match[1] == path.stem]}


def _older_table(path: Path, up_to: int, newest: Raw) -> Raw:
    table = _read_table(path)
    names = {field['name'] for field in table['fields']}
    without = [field['name'] for field in newest['fields'] if field['name'] not in names]
    return {'up_to': up_to, 'without': without, **table}


def _sections(path: Path) -> dict[str, list[TableRow]]:
    """Return the rows of each section without their headings; '': before the first section."""
    try:
        text = read_file(path).decode('utf-8-sig')
    except UnicodeDecodeError as error:
        raise ModelError(path, '', f'not UTF-8: {error.reason}', 'save it as UTF-8') from None
    rows: list[TableRow] = []
    sections = {'': rows}
    for line, content in enumerate(text.split('\n'), 1):
        cells = [cell.strip() for cell in content.split('\t')]
        if content.startswith('['):
            rows = sections.setdefault(content.strip().casefold(), [])
        elif any(cells) and cells[0].casefold() not in _HEADINGS:
            rows.append(TableRow(path, line, cells))
    return sections


def _read_table(path: Path) -> Raw:
    sections = _sections(path)
    registers = [_register(row) for row in sections.get('[control table]', ())]
    if not registers:
        raise ModelError(path, '[control table]', 'missing or empty', 'add it')
    meanings = _positions(sections.get('[type info]', ()))
    meanings.update(map(_meaning, sections.get('[unit info]', ())))
    indirect = _indirect(registers)
    fields = []
    names: dict[tuple[float, float], str] = {}     # fields by address and size
    aliases: dict[str, str] = {}
    for register in registers:
        at, size, name = register
        if size > max(_SIZES) or (indirect and _INDIRECT.fullmatch(name)):
            continue
        if (at, size) not in names:
            own = names[at, size] = _RENAMED.get(name, name) + f' ({at})' * (name in aliases)
            fields.append(_field(register, own, meanings.get(name, {}), path))
        aliases.setdefault(name, names[at, size])
    return {'fields': fields, 'indirect': indirect, 'aliases': {
        alias: name for alias, name in aliases.items() if alias != name}}


def _register(row: TableRow) -> Register:
    if len(row.cells) < 3:
        raise row.error('not an address, a size and a name with tabs between them')
    return Register(row.number(0), row.number(1), row.cells[2])


def _field(register: Register, name: str, meaning: Raw, path: Path) -> Raw:
    if register.size not in _SIZES:
        raise ModelError(path, name, f'size is {register.size}', 'use 1, 2, 4 or 8')
    meaning = _BAUD if name == 'Baud Rate' and register.size == 1 else meaning
    sign = meaning.get('type') or _signs().get(name, 'u')
    return {**meaning, 'at': register.at, 'name': name, 'type': f'{sign}{8 * register.size}'}


@cache
def _signs() -> dict[str, str]:
    """Return i or u by name, where [unit info] has no line: all series agree with the X series."""
    return {field['name']: field['type'][0] for field in read_yaml(BUILT_IN / '_x.yaml')['fields']}


def _meaning(row: TableRow) -> tuple[str, Raw]:
    """Return the name of a register, and what [unit info] says of it."""
    cells = row.cells
    if len(cells) < 4 or cells[3] not in ('signed', 'unsigned'):
        raise row.error('not a name, value, unit and signed or unsigned with tabs between them')
    meaning: Raw = {'type': 'i' if cells[3] == 'signed' else 'u'}
    if cells[2] not in ('raw', ''):
        meaning['unit'] = cells[2]
    scale, offset = row.number(1), row.number(4) if len(cells) > 4 else 0
    if (scale, offset) != (1, 0):
        meaning.update(scale=scale, offset=offset)
    return cells[0], meaning


def _positions(rows: Iterable[TableRow]) -> dict[str, Raw]:
    """Return what [type info] says of positions: the angle of one count, the count of no angle."""
    values = {row.cells[0]: row.number(1) for row in rows if len(row.cells) > 1}
    zero = values.get('value_of_zero_radian_position', 0)
    counts = values.get('value_of_max_radian_position', 0) - zero
    scale = values.get('max_radian', 0) / counts if counts else 0
    meaning = {'type': 'i', 'unit': 'rad', 'scale': scale, 'offset': -zero * scale}
    return dict.fromkeys(('Goal Position', 'Present Position'), meaning) if scale else {}


def _indirect(registers: list[Register]) -> list[Raw]:
    """Return the ranges of indirect data: each goes on until there is something else."""
    places = {register.name.replace('_', ' '): register.at for register in registers}
    pairs = sorted((places[f'Indirect Address{end}'], places[f'Indirect Data{end}'])
                   for end in ('', ' 1', ' Write', ' Read')
                   if {f'Indirect Address{end}', f'Indirect Data{end}'} <= places.keys())
    first = [(address, data) for n, (address, data) in enumerate(pairs)     # others are within
             if all(address - start != 2 * (data - its_data) for start, its_data in pairs[:n])]
    taken = sorted({at for name, at in places.items() if not _INDIRECT.fullmatch(name)}.union(
        *first))

    def room(start: float) -> float:
        return next((at for at in taken if at > start), ADDRESS_END) - start

    return [{'address': address, 'data': data,
             'count': min(room(address) // 2, room(data), REPEAT_LIMIT)}
            for address, data in first]
