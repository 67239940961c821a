# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""Model files: any text in a folder of the user's, and what a table makes of it."""

from itertools import pairwise
from pathlib import Path
import re
from tempfile import TemporaryDirectory

import yaml

from fuzz.script import Script
from servobus.bus.table import READ
from servobus.bus.table import Table
from servobus.model.checked_yaml import ModelError
from servobus.model.models import check_models
from servobus.model.models import Models

SAMPLE = b"""model_numbers: {7: Own, 9: Other}
source: a page
words: {state: {0: off, 1: on}}
torque_constants: {7: 1.5}
indirect: [{address: 168, data: 224, count: 28}]
aliases: {Voltage: Present Voltage}
blocks: [{at: 300, size: 8, name: Log}]
each: {9: {without: [], fields: [{at: 90, name: Own, type: u8}]}}
firmware: [{up_to: 40, fields: [{at: 80, name: Old, type: i16}]}]
fields:
  - {at: 0, name: Model Number, type: u16, access: r, memory: eeprom}
  - {at: 8, name: Baud Rate, type: u8, unit: bit/s, enum: {0: 9600, 3: 1000000}}
  - {at: 9, name: Mode, type: u8, enum: state}
  - {at: 10, name: Code, type: u8, show: hex}
  - {at: 20, name: Position, type: i32, unit: rad, scale: 0.00153398, offset: -3.14159}
  - {at: 24, name: Speed, type: u16, unit: rad/s, scale: 0.01, sign_bit: 10}
  - {at: 26, name: Errors, type: u8, flags: {0: voltage, 2: overheating}}
  - {at: 30, name: 'History {n}', type: u8, repeat: 4}
  - {repeat: 2, step: 40, prefix: 'Motor {n}', shift: 400,
     fields: [{at: 0, name: Goal, type: f32}]}
  - {at: 60, name: Goal, type: i16, by: Mode, mask: 1, cases: {0: {unit: A}, 1: {unit: rad}}}
  - {at: 70, name: Present Voltage, type: u16, unit: V, scale: 0.1}
"""
WORDS = (b'-1', b'0', b'65535', b'65536', b'1e999', b'0.0', b'-0.0', b'null', b'true', b'[]',
         b'{}', b'~', b'\xff', b'{n}', b'u64', b'f64', b'*a', b'&a', b'|', b"''",
         b'!!python/name:os.system', b'0x10', b'{0: 1}',
         b'[1, 2]', b'Model Number', b'include: m', b'\x00', b'\n',
         b'99999999999999999999', b'1e-320', b'5e-324', b'\xc3\xa9', b'...', b'---', b'? x')


NUMBERS = (b'0', b'1', b'2', b'3', b'7', b'8', b'15', b'16', b'20', b'26', b'60', b'80', b'255',
           b'-1', b'4096', b'65533', b'65535', b'65536', b'0.0', b'-0.5', b'1e-3', b'1e99')
NUMBER = re.compile(rb'(?<![a-z0-9])-?[0-9]+(?:\.[0-9]+)?')
IMAGES = (b'\xff', b'\x80', b'\0', b'\0\0\x80\x7f', b'\x01\0', bytes(range(256)))


def check(data):
    """
    Check one file.

    Never raises but ModelError, one line with a remedy; both ways of checking agree; what is
    taken gives no key twice and describes a table: registers that lie in 0 to 65535, one
    behind the other, called by one name each, and all they refer to is there. Any bytes are shown
    by it.
    """
    script = Script(data)
    raw = script.byte() < 40
    image = data[-64:] if len(data) % 3 else script.pick(IMAGES)
    text = script.take_rest() if raw else mutated(script)
    with TemporaryDirectory(dir=_fast()) as folder:
        Path(folder, 'm.yaml').write_bytes(text)
        problems = check_models(folder)
        for line in problems:
            assert '; ' in line and '\n' not in line, line
        try:
            models = Models([folder])
        except ModelError as error:
            assert problems
            assert str(error) in problems
            return
        assert not problems
        no_key_twice(yaml.compose(text, yaml.CSafeLoader))
        for number in models.names():
            if number < 100:
                show_image(models, number, (image * 768)[:768])


def mutated(script):
    """Replace, drop and insert pieces, lines and numbers of the sample."""
    text = SAMPLE
    for _ in range(script.byte() % 6):
        what = script.byte()
        lines = text.splitlines(True)
        at = script.word() % len(text)
        if what < 110:
            size = script.byte() % 24
            piece = script.pick(WORDS) if script.byte() < 160 else script.take_bytes(
                script.byte() % 8)
            text = text[:at] + piece + text[at + size:]
        elif what < 140:
            lines.insert(at % len(lines), lines[script.byte() % len(lines)])
            text = b''.join(lines)
        elif what < 160:
            del lines[at % len(lines)]
            text = b''.join(lines)
        else:
            found = list(NUMBER.finditer(text)) or [re.match(b'', text)]
            begin, end = found[at % len(found)].span()
            text = text[:begin] + script.pick(NUMBERS) + text[end:]
        text = text or b' '
    return text


def no_key_twice(node):
    if isinstance(node, yaml.MappingNode):
        keys = [(key.tag, key.value) for key, _ in node.value]
        assert len(set(keys)) == len(keys)
    for child in node.value if isinstance(node.value, list) else ():
        for one in child if isinstance(child, tuple) else (child,):
            no_key_twice(one)


def show_image(models, number, image):
    for firmware in (None, 0, 40, 41):
        model = models.get(number, firmware)
        assert model is not None, models.problems
        is_a_table(model)
        table = Table()
        table.store(0, image, 1, READ)
        for seen in table.observed(model, 2):
            assert isinstance(seen.value.text, str)
            assert seen.field.key


def is_a_table(model):
    names = [field.name for field in model.fields]
    assert len(set(names)) == len(names)
    assert all(0 <= field.at < field.end <= 0x10000 for field in model.fields)
    assert all(first.end <= second.at for first, second in pairwise(model.fields))
    assert all(field.cases.by in names for field in model.fields if field.cases)
    assert set(model.aliases.values()) <= set(names)
    for one in model.indirect:
        assert 0 <= one.address <= 0x10000 - 2 * one.size
        assert 0 <= one.data <= 0x10000 - one.size


def _fast():
    return '/dev/shm' if Path('/dev/shm').is_dir() else None
