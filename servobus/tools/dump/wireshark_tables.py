# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""The tables of the Wireshark dissector: names, errors and control tables, as a file in Lua."""
from __future__ import annotations

import json
from pathlib import Path

from msg_defs import dxl1_instruction
from msg_defs import dxl_instruction
from servobus.bus.expected_devices import runs
from servobus.model.control_table import Field
from servobus.model.models import Models

FILE_NAME = 'servobus_tables.lua'
_HEAD = """-- Copyright 2026 The mecarover_serial authors
-- SPDX-License-Identifier: Apache-2.0
-- Written by `dxl_dump --wireshark DIR`; do not edit.
"""


def write_tables(folder: Path, models: Models) -> Path:
    """Write the file into a folder, which is made if it does not exist; OSError in one line."""
    path = folder / FILE_NAME
    try:
        if not folder.exists():
            folder.mkdir(parents=True)
        path.write_text(wireshark_tables(models), 'utf-8')
    except OSError as error:
        raise OSError(f'{path}: {error.strerror}; give a folder that you may write to') from error
    return path


def wireshark_tables(models: Models) -> str:
    """Return the content of the file."""
    registers: dict[str, int] = {}
    layouts: dict[str, int] = {}
    models_found = {}
    for number, name in models.names().items():
        model = models.get(number)
        numbers = [registers.setdefault(_lua(_register(one)), len(registers) + 1)
                   for one in (model.fields if model else ())
                   if not one.name.startswith('Indirect ')]
        ends = [end for run in runs(numbers) for end in run]
        models_found[number] = [name, layouts.setdefault(_lua(ends), len(layouts) + 1)]
    names, feetech = ({int(code): dxl_instruction.name_of(code) for code in dialect.entries}
                      for dialect in (dxl1_instruction.DYNAMIXEL_1, dxl1_instruction.FEETECH))
    parts = {
        'instructions': {'2': dxl_instruction.NAMES, '1': names, 'feetech': feetech},
        'errors': {'2': dxl_instruction.ERROR_NAMES, '1': dxl1_instruction.DYNAMIXEL_1.errors,
                   'feetech': dxl1_instruction.FEETECH.errors},
        'models': models_found,
    }
    lines = [f'{name} = {_lua(table)},' for name, table in parts.items()]
    for name, texts in (('registers', registers), ('layouts', layouts)):
        lines += [f'{name} = {{', *(f'{text},' for text in texts), '},']
    return _HEAD + 'return {\n' + '\n'.join(lines) + '\n}\n'


def _register(one: Field) -> list[object]:
    """Return a register: address, size, name, type, unit, scale, offset, sign bit, words, raw."""
    plain = not one.flags and not one.cases and not one.spans and not one.hexadecimal
    order = '>' if one.byte_order == 'big' else '<'
    found = [one.at, one.size, one.name, order + one.type, one.unit,
             one.scale if plain else None, one.offset, one.sign_bit,
             dict(one.enum or {}) or None, not plain]
    while not found[-1]:               # what is left out is nil
        del found[-1]
    return found


def _lua(value: object) -> str:
    """Spell a value in Lua."""
    if isinstance(value, dict):
        return '{' + ','.join(f'{_key(key)}={_lua(one)}' for key, one in value.items()) + '}'
    if isinstance(value, list | tuple):
        return '{' + ','.join(map(_lua, value)) + '}'
    if value is None or isinstance(value, bool):
        return 'true' if value else 'false'
    if isinstance(value, str):
        return json.dumps(value, ensure_ascii=False)    # Lua has the same escapes for " and \
    return repr(value)


def _key(key: object) -> str:
    return key if isinstance(key, str) and key.isidentifier() else f'[{_lua(key)}]'
