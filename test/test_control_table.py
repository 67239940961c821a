# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""Raw -> shown, by hand from the e-Manual, over all families; and how numbers are written."""

import math
from pathlib import Path
import random

import pytest
import yaml

from rigs.tables import rows_of
from servobus.bus.table import kept_end
from servobus.bus.table import READ
from servobus.bus.table import Table
from servobus.model.control_table import Bits
from servobus.model.control_table import Field
from servobus.model.control_table import number_text
from servobus.model.control_table import Span
from servobus.model.control_table import STRUCTS
from servobus.model.models import Models

MODELS = Models()

SPOTS = rows_of(Path(__file__).with_name('register_texts.tsv'))


def named(name):
    return MODELS.by_name(name)


@pytest.mark.parametrize(('name', 'register', 'raw', 'unit', 'text'), SPOTS)
def test_spot(name, register, raw, unit, text):
    field = named(name).by_name[register]
    number = float(raw) if field.type == 'f32' else int(raw)
    value = field.decode(STRUCTS[field.type].pack(number))
    assert (field.unit, value.text, value.raw) == (unit, text, number)
    assert field.key == (f'{register} ({unit})' if unit else register)


@pytest.mark.parametrize(
    ('name', 'selector', 'code', 'register', 'raw', 'key', 'text'), yaml.safe_load(
        Path(__file__).with_name('register_meanings.yaml').read_text(encoding='utf-8')))
def test_a_meaning_hangs_on_another_register(name, selector, code, register, raw, key, text):
    model, table = named(name), Table()
    table.limit = kept_end(model)
    if selector:
        table.store(model.by_name[selector].at, bytes((code,)), 1, READ)
    field = model.by_name[register]
    table.store(field.at, STRUCTS[field.type].pack(raw), 1, READ)
    seen = table.observed_of(model, (register,), 1)[0]
    assert (seen.field.key, seen.value.text) == (key, text)


@pytest.mark.parametrize(('number', 'decimals', 'text'), [
    (0.1 + 0.2, 3, '0.3'), (-0.0, 3, '0'), (-0.0000001, 5, '0'), (1e-7, None, '0.0000001'),
    (123456789.0, None, '123457000'), (12.50, 3, '12.5'), (100, None, '100'),
    (2**32, None, '4294967296'),
    (1.570796, 5, '1.5708'), (3.0000001, 6, '3'), (0.00269, 5, '0.00269'),
    (-1e20, None, '-1' + 20 * '0'),
])
def test_a_number_is_short_and_bare(number, decimals, text):
    assert number_text(number, decimals) == text


@pytest.mark.parametrize('bad', [math.nan, math.inf, -math.inf])
def test_what_is_no_number_has_no_number(bad):
    value = Field(0, 'Force', 'f32').decode(STRUCTS['f32'].pack(bad))
    assert value.number is None
    assert value.text == str(bad)


def test_a_number_beyond_all_floats_is_none():
    value = Field(0, 'Force', 'f64', scale=100.0).decode(STRUCTS['f64'].pack(1e307))
    assert (value.text, value.number) == ('inf', None)


def test_bits_have_no_sign():
    flags = Field(0, 'Flags', 'i8', flags=(Bits(0, 1, ('', 'hot')),))
    assert flags.decode(b'\xe1').text == 'hot, bit 5, bit 6, bit 7'
    assert Field(0, 'Mask', 'i16', hexadecimal=True).decode(b'\xfe\xff').text == '0xFFFE'


def test_unknown_codes_and_bits_are_told():
    mode = Field(0, 'Mode', 'u8', enum={1: 'on'}, spans=(Span(5, 9, 'spare'),))
    flags = Field(0, 'Flags', 'u8', flags=(Bits(0, 1, ('', 'hot')), Bits(4, 3, ('', 'a'))))
    assert [mode.decode(bytes((code,))).text for code in (1, 2, 7)] == [
        'on', 'unknown (2)', 'spare']
    assert [flags.decode(bytes((code,))).text for code in (0, 1, 0x83, 0x30)] == [
        'none', 'hot', 'hot, bit 1, bit 7', 'bits 4+ = 3']


def test_the_text_says_the_number_within_the_resolution_of_the_register():
    generator = random.Random(4)
    for number in MODELS.names():
        model = MODELS.get(number)
        for field in model.fields:
            value = field.decode(generator.randbytes(field.size))
            if field.scale is not None and value.number is not None and not field.in_words:
                coarse = max(abs(field.scale), abs(value.number) * 1e-5)
                assert abs(float(value.text) - value.number) <= coarse / 2, field
                assert 'e' not in value.text
