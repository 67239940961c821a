# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""The memory image of a device: what is known, since when, from whom; indirect data; bounds."""

import random
import struct

import pytest

from dxl_monitor.bus.table import Observed
from dxl_monitor.bus.table import READ
from dxl_monitor.bus.table import SIZE_LIMIT
from dxl_monitor.bus.table import size_of
from dxl_monitor.bus.table import SPAN_LIMIT
from dxl_monitor.bus.table import Table
from dxl_monitor.bus.table import WRITTEN
from dxl_monitor.model.control_table import Field
from dxl_monitor.model.control_table import Indirect
from dxl_monitor.model.control_table import Model
from dxl_monitor.model.models import Models

SECOND = 10**9


def servo(name: str = 'MX-106', firmware: int | None = None) -> Model:
    model = Models().by_name(name, firmware)
    assert model is not None
    return model


def seen(table: Table, model: Model, now: int = 0) -> dict[str, Observed]:
    return {observed.field.name: observed for observed in table.observed(model, now)}


def test_value_age_and_source() -> None:
    table, model = Table(), servo()
    table.store(132, struct.pack('<i', 3072), 2 * SECOND, READ)
    table.store(116, struct.pack('<i', 1024), 3 * SECOND, WRITTEN)
    position, goal = table.observed(model, 5 * SECOND)[::-1]
    assert (position.field.name, position.value.text) == ('Present Position', '1.5708')
    assert (position.age_s, position.source) == (3.0, 'r')
    assert (goal.field.name, goal.value.text, goal.age_s, goal.source) == (
        'Goal Position', '-1.5708', 2.0, 'w')


def test_nothing_is_made_up() -> None:
    table, model = Table(), servo()
    assert table.observed(model, 0) == []
    assert table.observed_of(model, ('Present Position',), 0)[0] is None
    assert table.observed_of(model, ('No Such Register',), 0)[0] is None
    assert table.byte(0) is None
    assert table.bytes(0, 2) is None


@pytest.mark.parametrize('missing', range(4))
def test_a_half_observed_value_is_never_shown(missing: int) -> None:
    table, model = Table(), servo()
    for n in range(4):
        if n != missing:
            table.store(132 + n, b'\x01', 1, READ)
    assert seen(table, model) == {}
    assert table.observed_of(model, ('Present Position',), 0)[0] is None
    table.store(132 + missing, b'\x01', 1, READ)
    assert list(seen(table, model)) == ['Present Position']


def test_the_age_is_that_of_the_oldest_byte_and_one_written_byte_makes_it_written() -> None:
    table, model = Table(), servo()
    table.store(132, b'\0\0\0\0', 1 * SECOND, READ)
    table.store(133, b'\1', 4 * SECOND, WRITTEN)
    position = seen(table, model, 5 * SECOND)['Present Position']
    assert (position.age_s, position.source, position.value.raw) == (4.0, 'w', 256)


def test_the_last_word_counts_also_at_one_stamp() -> None:
    table = Table()
    table.store(10, b'aaaa', 7, READ)
    table.store(12, b'b', 7, WRITTEN)
    assert table.bytes(10, 4) == b'aaba'
    table.store(10, b'cccc', 7, READ)
    table.store(12, b'd', 7, READ)
    table.store(10, b'eeee', 7, READ)
    assert table.bytes(10, 4) == b'eeee'


def test_any_order_of_spans_gives_what_byte_by_byte_gives() -> None:
    generator = random.Random(1)
    for _ in range(50):
        table = Table()
        naive: dict[int, int] = {}
        for stamp in range(300):
            address, data = generator.randrange(60), generator.randbytes(generator.randrange(9))
            table.store(address, data, stamp // 4, generator.choice((READ, WRITTEN)))
            naive.update(enumerate(data, address))
            if generator.random() < 0.05:
                assert table.byte(address) == naive.get(address)
        assert [table.byte(at) for at in range(70)] == [naive.get(at) for at in range(70)]


def test_a_copy_stays_as_it_was() -> None:
    table = Table()
    table.store(10, b'ab', 1, READ)
    copy = table.copy()
    table.store(10, b'xy', 2, READ)
    assert (copy.bytes(10, 2), table.bytes(10, 2)) == (b'ab', b'xy')


def test_known_gives_the_runs() -> None:
    table = Table()
    table.store(4, b'\0\1', 1, READ)
    table.store(9, b'\2', 1, READ)
    table.store(6, b'\3', 1, READ)
    assert table.known() == [(4, b'\0\1\3'), (9, b'\2')]


def point(table: Table, model: Model, first: int, targets: list[int], stamp: int) -> None:
    address = model.by_name[f'Indirect Address {first}'].at
    table.store(address, struct.pack(f'<{len(targets)}H', *targets), stamp, WRITTEN)


@pytest.mark.parametrize(('name', 'firmware', 'first', 'data'), [
    ('MX-106', None, 1, 224), ('MX-106', None, 29, 634), ('XM430-W350', None, 5, 228),
    ('XL330-M288', 53, 1, 224), ('XL330-M288', 52, 1, 208), ('XL330-M288', None, 1, 224),
    ('PH54-200-S500', None, 65, 698), ('YM070-210-R051', None, 3, 636)])
def test_an_indirect_read_shows_under_the_real_name(name: str, firmware: int | None, first: int,
                                                    data: int) -> None:
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


def test_indirect_data_stay_raw_while_it_is_unknown_where_they_point() -> None:
    table, model = Table(), servo()
    table.store(224, b'\x05\x06', 1, READ)
    assert {name: o.value.text for name, o in seen(table, model).items()} == {
        'Indirect Data 1': '5', 'Indirect Data 2': '6'}


def test_indirect_data_older_than_their_address_are_not_taken_for_its_target() -> None:
    table, model = Table(), servo()
    point(table, model, 1, [146], 1)
    table.store(224, b'\x2a', 2, READ)
    assert table.observed_of(model, ('Present Temperature',), 0)[0] is not None
    point(table, model, 1, [65], 3)
    assert table.observed_of(model, ('LED',), 0)[0] is None
    table.store(224, b'\x01', 4, READ)
    led = table.observed_of(model, ('LED',), 0)[0]
    assert led is not None
    assert led.value.text == 'on'


def test_of_direct_and_indirect_the_newer_one_counts() -> None:
    table, model = Table(), servo()
    point(table, model, 1, [146], 1)
    table.store(224, b'\x2a', 2, READ)
    table.store(146, b'\x2b', 3, READ)
    assert seen(table, model)['Present Temperature'].value.text == '43'
    table.store(224, b'\x2c', 4, READ)
    assert seen(table, model)['Present Temperature'].value.text == '44'
    assert table.byte(146) == 43        # unresolved


def test_indirect_goes_one_level() -> None:
    table, model = Table(), servo()
    point(table, model, 1, [225, 146], 1)       # data 1 -> data 2 -> temperature
    table.store(224, b'\x2a', 2, READ)
    assert 'Present Temperature' not in seen(table, model)


def test_after_a_reboot_ram_is_unknown() -> None:
    table, model = Table(), servo()
    table.store(0, bytes(range(147)), 1, READ)
    table.forget('ram', model)
    names = set(seen(table, model))
    assert {'Model Number', 'ID', 'Operating Mode', 'Homing Offset'} <= names
    assert not names & {'Torque Enable', 'Present Position', 'Goal Position'}
    assert table.byte(14) is None       # between the fields


def test_after_a_factory_reset_only_what_stays_is_known() -> None:
    table, model = Table(), servo()
    table.store(0, bytes(range(147)), 1, READ)
    table.forget('all', model, ('Model Number', 'Firmware Version', 'ID'))
    assert set(seen(table, model)) == {'Model Number', 'Firmware Version', 'ID'}
    table.store(132, bytes(4), 2, READ)
    assert 'Present Position' in seen(table, model)


def test_what_a_table_takes_up_is_bounded_by_its_model() -> None:
    table = Table()
    table.store(0x800, b'b', 1, READ)
    table.store(0x7FF, b'a', 1, READ)
    assert (table.byte(0x7FF), table.byte(0x800)) == (ord('a'), None)
    assert size_of(servo()) == 0x800
    assert size_of(Model(1, 'Large', (Field(4000, 'Far', 'u32'),))) == 4004
    assert size_of(Model(1, 'Huge', (Field(60_000, 'Far', 'u32'),))) == 0x4000
    table.limit = 4004
    table.store(4000, b'abcd', 2, READ)
    assert table.bytes(4000, 4) == b'abcd'


def test_hostile_stores_stay_bounded() -> None:
    generator = random.Random(2)
    table, model = Table(), servo()
    for stamp in range(20_000):
        table.store(generator.randrange(0x10000), generator.randbytes(generator.randrange(1025)),
                    stamp, READ)
        assert len(table._latest) <= SPAN_LIMIT + 1
        assert sum(len(one[0]) for one in table._latest.values()) <= SPAN_LIMIT * 256
    table.store(0xFFFF, bytes(1024), 1, READ)
    assert len(table._image.data) <= SIZE_LIMIT
    assert table.byte(0xFFFF) is None
    point(table, model, 1, [0xFFFF] * 28, 30_000)
    table.store(224, bytes(28), 30_001, READ)
    assert table.observed(model, 40_000)


def test_indirect_ranges_that_point_anywhere_do_no_harm() -> None:
    generator = random.Random(3)
    model = Model(1, 'Odd', (Field(0, 'A', 'u8'), Field(300, 'B', 'u32')),
                  indirect=(Indirect(2, 40, 10), Indirect(30, 250, 10)))
    for _ in range(300):
        table = Table()
        for stamp in range(8):
            table.store(generator.randrange(310), generator.randbytes(30), stamp, READ)
        for observed in table.observed(model, 10):
            assert observed.age_s >= 0
