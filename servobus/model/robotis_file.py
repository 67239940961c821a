# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""
ROBOTIS' own tables, as in dynamixel_hardware_interface, read as a YAML file of ours.

NAME.model has tab-separated rows in [type info], [unit info] and [control table]. NAME_fw52.model
is the table up to firmware 52. dynamixel.model has the model numbers.
"""

from __future__ import annotations

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
from servobus.model.file import ADDRESS_END
from servobus.model.file import REPEAT_LIMIT

SUFFIX = '.model'
NUMBERS_FILE = 'dynamixel.model'
_OLDER = re.compile(r'(.+)_fw([0-9]{1,3})')
_HEADINGS = ('address', 'data name', 'name', 'number')
_SIZES = (1, 2, 4, 8)                # what is longer is a block: it has rows of its own
_RENAMED = {'Baud Rate (Bus)': 'Baud Rate', 'BUS Watchdog': 'Bus Watchdog',
            'Secondary(Shadow) ID': 'Secondary ID'}
_INDIRECT = re.compile(r'Indirect (Address|Data)( \d+| Write| Read|)')
_FIRST_INDIRECT = ('', ' 1', ' Write', ' Read')
_BAUD = {'unit': 'bit/s', 'enum': 'baud_rate'}
Row = tuple[int, list[str]]          # number of the line, cells


class Register(NamedTuple):
    """A row of the control table."""

    at: int
    size: int
    name: str


def is_newest_table(path: Path) -> bool:
    """Whether the file is a device's table, and not one of older firmware or the numbers."""
    older = _OLDER.fullmatch(path.stem)
    return path.name != NUMBERS_FILE and not (
        older and path.with_name(older[1] + SUFFIX).exists())


def listed_numbers(folder: Path) -> dict[str, list[int]]:
    """Return the model numbers of each file; {} if the folder does not list them."""
    path = folder / NUMBERS_FILE
    found: dict[str, list[int]] = {}
    for line, row in _sections(path)[''] if path.exists() else ():
        cells = ' '.join(row).split()
        if len(cells) != 2:
            raise ModelError(path, f'line {line}', 'not a number and a file', 'correct the line')
        found.setdefault(cells[1], []).append(_integer(cells[0], path, line))
    return found


def read_robotis(path: Path) -> Raw:
    """Return what a YAML file would say; ModelError where the table cannot be used."""
    numbers = listed_numbers(path.parent).get(path.name)
    if not numbers:
        raise ModelError(path, 'model number', f'{NUMBERS_FILE} does not list the file',
                         f'add a line to {path.with_name(NUMBERS_FILE)}: the number, a tab, '
                         f'{path.name}')
    newest = _read_table(path)
    variants = ((_OLDER.fullmatch(one.stem), one) for one in sorted(path.parent.iterdir())
                if one.suffix == SUFFIX)
    return {'model_numbers': dict.fromkeys(numbers, path.stem.upper().replace('_', '-')),
            'include': '_words', **newest,
            'firmware': [_older_table(one, int(match[2]), newest) for match, one in variants
                         if match and match[1] == path.stem]}


def _older_table(path: Path, up_to: int, newest: Raw) -> Raw:
    table = _read_table(path)
    names = {field['name'] for field in table['fields']}
    without = [field['name'] for field in newest['fields'] if field['name'] not in names]
    return {'up_to': up_to, 'without': without, **table}


def _sections(path: Path) -> dict[str, list[Row]]:
    """Return the rows of each section without their headings; '': before the first section."""
    try:
        text = read_file(path).decode('utf-8-sig')
    except UnicodeDecodeError as error:
        raise ModelError(path, '', f'not UTF-8: {error.reason}', 'save it as UTF-8') from None
    rows: list[Row] = []
    sections = {'': rows}
    for number, line in enumerate(text.split('\n'), 1):
        cells = [cell.strip() for cell in line.split('\t')]
        if line.startswith('['):
            rows = sections.setdefault(line.strip().casefold(), [])
        elif line.strip() and cells[0].casefold() not in _HEADINGS:
            rows.append((number, cells))
    return sections


def _read_table(path: Path) -> Raw:
    sections = _sections(path)
    registers = [_register(row, path) for row in sections.get('[control table]', ())]
    if not registers:
        raise ModelError(path, '[control table]', 'missing or empty', 'add it')
    meanings = _positions(sections.get('[type info]', ()), path)
    meanings.update(_meaning(row, path) for row in sections.get('[unit info]', ()))
    indirect = _indirect(registers)
    fields = []
    names: dict[tuple[int, int], str] = {}     # fields by address and size
    aliases: dict[str, str] = {}
    for register in registers:
        at, size, name = register
        known = _indirect_name(register, indirect) or names.get((at, size))
        own = known or _RENAMED.get(name, name) + f' ({at})' * (name in aliases)
        aliases.setdefault(name, own)
        if known is None and size <= max(_SIZES):
            names[at, size] = own
            fields.append(_field(register, own, meanings.get(name, {}), path))
    return {'fields': fields, 'indirect': indirect, 'aliases': {
        alias: name for alias, name in aliases.items() if alias != name}}


def _register(row: Row, path: Path) -> Register:
    line, cells = row
    if len(cells) < 3:
        raise ModelError(path, f'line {line}', 'not an address, a size and a name',
                         'put a tab between them')
    return Register(_integer(cells[0], path, line), _integer(cells[1], path, line), cells[2])


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


def _meaning(row: Row, path: Path) -> tuple[str, Raw]:
    """Return the name of a register, and what [unit info] says of it."""
    line, cells = row
    if len(cells) < 4 or cells[3] not in ('signed', 'unsigned'):
        raise ModelError(path, f'line {line}', 'not a name, value, unit and signed or unsigned',
                         'put a tab between them')
    name, value, unit, sign = cells[:4]
    scale, offset = _number(value, path, line), _number((*cells, '0')[4], path, line)
    meaning: Raw = {'type': 'i' if sign == 'signed' else 'u'}
    if unit not in ('raw', ''):
        meaning['unit'] = unit
    if (scale, offset) != (1, 0):
        meaning.update(scale=scale, offset=offset)
    return name, meaning


def _positions(rows: list[Row] | tuple[()], path: Path) -> dict[str, Raw]:
    """Return what [type info] says of positions: the angle of one count, the count of no angle."""
    said = {cells[0]: _number(cells[1], path, line) for line, cells in rows if len(cells) > 1}
    zero = said.get('value_of_zero_radian_position', 0)
    counts = said.get('value_of_max_radian_position', 0) - zero
    scale = said.get('max_radian', 0) / counts if counts else 0
    meaning = {'type': 'i', 'unit': 'rad', 'scale': scale, 'offset': -zero * scale}
    return dict.fromkeys(('Goal Position', 'Present Position'), meaning) if scale else {}


def _indirect(registers: list[Register]) -> list[Raw]:
    """Return the ranges of indirect data: each goes on until there is something else."""
    places = {_spaced(register.name): register.at for register in registers}
    first: list[tuple[int, int]] = []
    for address, data in sorted(
            (places[f'Indirect Address{end}'], places[f'Indirect Data{end}'])
            for end in _FIRST_INDIRECT
            if {f'Indirect Address{end}', f'Indirect Data{end}'} <= places.keys()):
        if all(address - start != 2 * (data - its_data) for start, its_data in first):
            first.append((address, data))        # else it is within that range
    taken = {place for pair in first for place in pair}
    taken.update(at for name, at in places.items() if not _INDIRECT.fullmatch(name))

    def room(start: int) -> int:
        return min((at for at in taken if at > start), default=ADDRESS_END) - start

    return [{'address': address, 'data': data,
             'count': min(room(address) // 2, room(data), REPEAT_LIMIT)}
            for address, data in first]


def _indirect_name(register: Register, ranges: list[Raw]) -> str | None:
    """Return the name that a register of these ranges has with us."""
    match = _INDIRECT.fullmatch(_spaced(register.name))
    if not match or not ranges:
        return None
    if match[2][1:].isdigit():
        return match[0]
    size, key = (2, 'address') if match[1] == 'Address' else (1, 'data')
    before = 0
    for one in ranges:
        n, rest = divmod(register.at - one[key], size)
        if 0 <= n < one['count'] and not rest:
            return f'Indirect {match[1]} {before + n + 1}'
        before += one['count']
    return None


def _spaced(name: str) -> str:
    return name.replace('_', ' ')


def _integer(text: str, path: Path, line: int) -> int:
    try:
        return int(text)
    except ValueError:
        raise ModelError(path, f'line {line}', f'{describe(text)} is no whole number',
                         'correct it') from None


def _number(text: str, path: Path, line: int) -> float:
    try:
        return float(text)
    except ValueError:
        raise ModelError(path, f'line {line}', f'{describe(text)} is no number',
                         'correct it') from None
