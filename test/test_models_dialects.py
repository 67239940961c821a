# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""Model files of Protocol 1.0 and Feetech: against their sources, and what they decode."""

from collections import defaultdict
from pathlib import Path
import struct

import pytest

from rigs.tables import rows_of
from servobus.model.checked_yaml import read_yaml
from servobus.model.layers import model_key
from servobus.model.models import BUILT_IN
from servobus.model.models import Models

MODELS = Models()
FAMILIES = {'1': ('AX-12A', 'RX-64', 'EX-106+', 'MX-12W', 'MX-28(1.0)', 'MX-64(1.0)'),
            'feetech': ('STS3215', 'STS3250', 'SM8512BL', 'SCS0009', 'SCS15', 'HLS3625')}

SOURCES = defaultdict(dict)
for source, register, at, size in rows_of(Path(__file__).with_name('register_sources.tsv')):
    SOURCES[source][register] = int(at), int(size)


def named(name):
    model = MODELS.by_name(name)
    assert model is not None, name
    return model


def shown(name, field, raw):
    return named(name).by_name[field].decode(raw).text


@pytest.mark.parametrize(('name', 'source'), [
    ('STS3215', 'LeRobot STS'), ('STS3250', 'LeRobot STS'), ('SM8512BL', 'LeRobot STS'),
    ('SCS0009', 'LeRobot SCS'), ('SCS15', 'LeRobot SCS'),
    *((name, 'workbench MX') for name in FAMILIES['1'])])
def test_every_register_of_the_sources_is_where_they_have_it(name, source):
    model, rows = named(name), SOURCES[source]
    assert {field: (model.by_name[field].at, model.by_name[field].size) for field in rows} == rows


@pytest.mark.parametrize('protocol', FAMILIES)
def test_each_family_says_what_it_speaks(protocol):
    assert {named(name).protocol for name in FAMILIES[protocol]} == {protocol}
    assert named('XM430-W350').protocol == '2'


def test_model_numbers_are_those_of_the_sources():
    lerobot = {'STS3215': 777, 'STS3250': 2825, 'SM8512BL': 11272, 'HLS3625': 3338,
               'HLS3930': 4106, 'HLS3950': 4618}
    assert {name: named(name).number for name in lerobot} == lerobot
    # LeRobot reads the two bytes of the SCS0009 the other way round
    number = named('SCS0009').number or 0
    assert struct.unpack('>H', struct.pack('<H', number)) == (1284,)
    robotis = {'AX-12A': 12, 'AX-12W': 300, 'AX-18A': 18, 'RX-10': 10, 'RX-24F': 24, 'RX-28': 28,
               'RX-64': 64, 'EX-106+': 107, 'MX-12W': 360, 'MX-28(1.0)': 29, 'MX-64(1.0)': 310,
               'MX-106(1.0)': 320, 'MX-28': 30, 'MX-64': 311, 'MX-106': 321}
    assert {name: named(name).number for name in robotis} == robotis


def test_the_numbers_of_two_makers_are_kept_apart():
    dynamixel, feetech = MODELS.get(261), MODELS.get(model_key(261, 'feetech'))
    assert (dynamixel.name, feetech.name) == ('HX5-D20-RL', 'SCS0002')
    assert dynamixel.number == feetech.number == 261


def test_a_sign_stands_apart_from_the_magnitude():
    assert shown('STS3215', 'Present Position', b'\x00\x08') == '0'
    assert shown('STS3215', 'Present Position', b'\x01\x80') == '-3.14313'     # -1 step
    assert shown('STS3215', 'Homing Offset', struct.pack('<H', 1 << 11 | 1024)) == '-1.5708'
    assert shown('HLS3930', 'Homing Offset', struct.pack('<H', 1 << 15 | 1024)) == '-1.5708'
    assert shown('STS3215', 'Present Load', struct.pack('<H', 1 << 10 | 500)) == '-50'
    assert shown('AX-12A', 'Present Load', struct.pack('<H', 1 << 10 | 1023)) == '-100'
    assert shown('AX-12A', 'Present Velocity', struct.pack('<H', 100)) == '1.1624'


def test_the_high_byte_comes_first_in_the_scs_series():
    for name in ('SCS0009', 'SCS15'):
        fields = named(name).by_name
        assert {fields[one].byte_order for one in ('Goal Position', 'Present Load')} == {'big'}
        assert fields['Model Number'].byte_order == 'little'
    assert shown('SCS0009', 'Present Position', b'\x02\x00') == '0'            # 512
    assert shown('SCS15', 'Present Position', b'\x02\x01') == '513'
    field = named('SCS15').by_name['Present Position']
    assert field.bytes_of(513) == b'\x02\x01'
    assert field.code_of(b'\x02\x01') == 513
    assert field.moved(2, str).byte_order == 'big'
    assert shown('STS3215', 'Present Load', b'\x02\x01') == '25.8'


def test_the_speed_of_an_sts_is_no_number_as_long_as_its_unit_is_unknown():
    field = named('STS3215').by_name['Present Velocity']
    assert field.unit == ''
    assert field.cases.fields[4].decode(b'\xe8\x83').text == '-1.53398'
    assert field.cases.fields[0].decode(b'\x14\x00').text == '1.534'


def test_feetech_wins_where_lerobot_has_other_baud_rates():
    field = named('STS3215').by_name['Baud Rate']
    assert [field.decode(bytes([code])).number for code in range(8)] == [
        1_000_000, 500_000, 250_000, 128_000, 115_200, 76_800, 57_600, 38_400]
    text = (BUILT_IN / '_feetech.yaml').read_text()
    assert '57600, 38400' in text and 'LeRobot' in text


def test_each_row_is_from_two_sources_or_says_so():
    marked = 0
    for path in sorted(BUILT_IN.glob('*')):
        raw = read_yaml(path)
        rows = raw.get('fields', [])
        marked += sum(row.get('source') == 'single' for row in rows)
        if path.name.startswith(('_feetech', 'feetech', '_dxl1', 'ax_', 'ex_', '_mx_1')):
            assert ';' in raw['source'], f'{path.name}: name two sources'
    assert marked > 15
