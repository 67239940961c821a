# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""wireshark/servobus_tables.lua: names, errors and control tables, from those of the code."""
from msg_defs import dxl1_instruction
from msg_defs import dxl_instruction
from servobus.model.models import Models

HEAD = """-- Copyright 2026 The mecarover_serial authors
-- SPDX-License-Identifier: Apache-2.0
-- Written by `python -m docs.generate`; do not edit.
"""


def lua(value):
    """Spell a value in Lua."""
    if isinstance(value, dict):
        return '{' + ','.join(f'{_key(key)}={lua(one)}' for key, one in value.items()) + '}'
    if isinstance(value, list | tuple):
        return '{' + ','.join(map(lua, value)) + '}'
    if value is None or isinstance(value, bool):
        return 'true' if value else 'false'
    if isinstance(value, str):
        return '"' + value.replace('\\', r'\\').replace('"', r'\"') + '"'
    return repr(value)


def _key(key):
    return key if isinstance(key, str) and key.isidentifier() else f'[{lua(key)}]'


def field(one):
    """Return a register: address, size, name, type, unit, scale, offset, sign bit, words, raw."""
    words = dict(one.enum or {})
    plain = not one.flags and not one.cases and not one.spans and not one.hexadecimal
    order = '>' if one.byte_order == 'big' else '<'
    found = [one.at, one.size, one.name, order + one.type, one.unit,
             one.scale if plain else None, one.offset, one.sign_bit, words or None, not plain]
    while not found[-1]:               # what is left out is nil
        del found[-1]
    return found


def runs(numbers):
    """Return numbers as first and last of each run: [1, 2, 3, 9] is [1, 3, 9, 9]."""
    found = []
    for number in numbers:
        if found and number == found[-1] + 1:
            found[-1] = number
        else:
            found += [number, number]
    return found


def wireshark_tables():
    models = Models()
    registers, layouts, models_found = {}, {}, {}
    for number, name in models.names().items():
        numbers = [registers.setdefault(lua(field(one)), len(registers) + 1)
                   for one in models.get(number).fields if not one.name.startswith('Indirect ')]
        models_found[number] = [name, layouts.setdefault(lua(runs(numbers)), len(layouts) + 1)]
    names, feetech = ({int(code): dxl_instruction.name_of(code) for code in dialect.entries}
                      for dialect in (dxl1_instruction.DYNAMIXEL_1, dxl1_instruction.FEETECH))
    parts = {
        'instructions': {'2': dxl_instruction.NAMES, '1': names, 'feetech': feetech},
        'errors': {'2': dxl_instruction.ERROR_NAMES, '1': dxl1_instruction.DYNAMIXEL_1.errors,
                   'feetech': dxl1_instruction.FEETECH.errors},
        'models': models_found,
    }
    lines = [f'{name} = {lua(table)},' for name, table in parts.items()]
    for name, texts in (('registers', registers), ('layouts', layouts)):
        lines += [f'{name} = {{', *(f'{text},' for text in texts), '},']
    return HEAD + 'return {\n' + '\n'.join(lines) + '\n}\n'
