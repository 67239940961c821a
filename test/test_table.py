# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""The memory image of a device: what is known, since when, from whom; indirect data; bounds."""

from pathlib import Path
import struct

import pytest
import yaml

from servobus.bus.table import READ
from servobus.bus.table import Table
from servobus.bus.table import WRITTEN
from servobus.model.models import Models

SECOND = 10**9


def servo(name='MX-106', firmware=None):
    return Models().by_name(name, firmware)


def seen(table, model, now=0):
    return {observed.field.name: observed for observed in table.observed(model, now)}


@pytest.mark.parametrize('missing', range(4))
def test_a_half_observed_value_is_never_shown(missing):
    table, model = Table(), servo()
    for n in range(4):
        if n != missing:
            table.store(132 + n, b'\x01', 1, READ)
    assert seen(table, model) == {}
    assert table.observed_of(model, ('Present Position',), 0)[0] is None
    table.store(132 + missing, b'\x01', 1, READ)
    assert list(seen(table, model)) == ['Present Position']


def test_the_age_is_that_of_the_oldest_byte_and_one_written_byte_makes_it_written():
    table, model = Table(), servo()
    table.store(132, b'\0\0\0\0', 1 * SECOND, READ)
    table.store(133, b'\1', 4 * SECOND, WRITTEN)
    position = seen(table, model, 5 * SECOND)['Present Position']
    assert (position.age_s, position.source, position.value.raw) == (4.0, 'w', 256)


def point(table, model, first, targets, stamp):
    address = model.by_name[f'Indirect Address {first}'].at
    table.store(address, struct.pack(f'<{len(targets)}H', *targets), stamp, WRITTEN)


@pytest.mark.parametrize(('name', 'firmware', 'first', 'data'), yaml.safe_load(
    Path(__file__).with_name('indirect_reads.yaml').read_text(encoding='utf-8')))
def test_an_indirect_read_shows_under_the_real_name(name, firmware, first, data):
    table, model = Table(), servo(name, firmware)
    register = model.by_name['Present Position']
    point(table, model, first, list(range(register.at, register.end)), 1)
    for stamp, raw in ((2, 100), (3, 200), (4, -300)):      # a moving joint
        table.store(data, struct.pack('<i', raw), stamp * SECOND, READ)
        position = seen(table, model, 5 * SECOND)['Present Position']
        assert (position.value.raw, position.source) == (raw, 'r')
        assert position.age_s == 5 - stamp
    assert not any(field.startswith('Indirect Data') for field in seen(table, model))
    assert table.observed_of(model, ('Present Position',), 5 * SECOND)[0] == position


def test_indirect_data_stay_raw_while_it_is_unknown_where_they_point():
    table, model = Table(), servo()
    table.store(224, b'\x05\x06', 1, READ)
    assert {name: o.value.text for name, o in seen(table, model).items()} == {
        'Indirect Data 1': '5', 'Indirect Data 2': '6'}


def test_indirect_data_older_than_their_address_are_not_taken_for_its_target():
    table, model = Table(), servo()
    point(table, model, 1, [146], 1)
    table.store(224, b'\x2a', 2, READ)
    assert table.observed_of(model, ('Present Temperature',), 0)[0] is not None
    point(table, model, 1, [65], 3)
    assert table.observed_of(model, ('LED',), 0)[0] is None
    table.store(224, b'\x01', 4, READ)
    led = table.observed_of(model, ('LED',), 0)[0]
    assert led.value.text == 'on'


def test_of_direct_and_indirect_the_newer_one_counts():
    table, model = Table(), servo()
    point(table, model, 1, [146], 1)
    table.store(224, b'\x2a', 2, READ)
    table.store(146, b'\x2b', 3, READ)
    assert seen(table, model)['Present Temperature'].value.text == '43'
    table.store(224, b'\x2c', 4, READ)
    assert seen(table, model)['Present Temperature'].value.text == '44'
    assert table.bytes(146, 1) == b'\x2b'        # unresolved


def test_indirect_goes_one_level():
    table, model = Table(), servo()
    point(table, model, 1, [225, 146], 1)       # data 1 -> data 2 -> temperature
    table.store(224, b'\x2a', 2, READ)
    assert 'Present Temperature' not in seen(table, model)
