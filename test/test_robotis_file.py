# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""ROBOTIS' own tables, *.model, in a folder of the user's."""

from importlib.util import find_spec
from pathlib import Path

import pytest

from servobus.bus.table import READ
from servobus.bus.table import Table
from servobus.model.checked_yaml import ModelError
from servobus.model.layers import Layers
from servobus.model.model_guesses import ModelGuesses
from servobus.model.models import BUILT_IN
from servobus.model.models import check_models
from servobus.model.models import Models
from servobus.model.robotis_file import listed_numbers

HARDWARE_INTERFACE = Path(__file__).parents[2] / 'shared' / 'data' / 'dxl_models'
NUMBERS = 'Number\tName\n4660\tour_arm.model\n4661\tour_arm.model\n1020\txm430_w350.model\n'
TABLE = """[unit info]
Data Name\tvalue\tunit\tSign Type\tOffset
Present Position\t0.001\trad\tsigned\t-3.14
Present Current\t1.0\traw\tsigned\t0.0

[control table]
Address\tSize\tData Name
0\t2\tModel Number
6\t1\tFirmware Version
7\t1\tID
8\t1\tBaud Rate (Bus)
64\t1\tTorque Enable
116\t4\tGoal Position
126\t2\tPresent Current
132\t4\tPresent Position
168\t2\tIndirect Address 1
224\t1\tIndirect Data 1
168\t2\tIndirect Address Write
224\t1\tIndirect Data Write
180\t2\tIndirect Address Read
230\t1\tIndirect Data Read
"""


def write(folder, **files):
    """Make NAME.model of each text; the numbers are in dynamixel.model."""
    for name, text in {'dynamixel': NUMBERS, 'our_arm': TABLE, **files}.items():
        (folder / f'{name}.model').write_text(text, encoding='utf-8')
    return folder


def values(model, at, data):
    table = Table()
    table.store(at, bytes.fromhex(data), 1, READ)
    return {seen.field.key: seen.value.text for seen in table.observed(model, 2)}


def test_a_table_in_a_folder_is_a_model_with_the_numbers_of_the_list(tmp_path):
    models = Models([write(tmp_path)])
    assert check_models(tmp_path) == models.problems == []
    assert models.names()[4660] == models.names()[4661] == 'OUR-ARM'
    model = models.by_name('our_arm')
    assert (model.number, model.protocol) == (4660, '2')
    assert values(model, 126, 'fe ff') == {'Present Current': '-2'}
    assert values(model, 132, 'e8 03 00 00') == {'Present Position (rad)': '-2.14'}
    assert values(model, 116, 'ff ff ff ff') == {'Goal Position': '-1'}        # no unit info


def test_rows_for_the_same_bytes_are_names_of_one_register(tmp_path):
    model = Models([write(tmp_path, our_arm=TABLE + '126\t2\tPresent Load\n')]).get(4660)
    assert model.by_name['Present Load'] is model.by_name['Present Current']
    assert model.by_name['Baud Rate (Bus)'] is model.by_name['Baud Rate']
    assert values(model, 8, '03') == {'Baud Rate (bit/s)': '1000000'}


def test_indirect_data_are_shown_as_what_they_refer_to(tmp_path):
    model = Models([write(tmp_path)]).get(4660)
    assert [tuple(one) for one in model.indirect] == [(168, 224, 28)]
    assert model.by_name['Indirect Data 28'].at == 251
    table = Table()
    table.store(180, bytes.fromhex('84 00 85 00 86 00 87 00'), 1, READ)
    table.store(230, bytes.fromhex('e8 03 00 00'), 1, READ)
    shown = {seen.field.name: seen.value.text for seen in table.observed(model, 2)}
    assert shown['Present Position'] == '-2.14'


def test_a_block_and_a_name_given_twice_do_not_overlap(tmp_path):
    text = TABLE + '300\t1024\tMotor1_Control_Table\n300\t1\tState\n301\t1\tState\n'
    model = Models([write(tmp_path, our_arm=text)]).get(4660)
    assert [field.name for field in model.fields if 300 <= field.at < 400] == [
        'State', 'State (301)']


@pytest.mark.parametrize(('firmware', 'data'), [(None, 224), (53, 224), (52, 208), (3, 208)])
def test_a_table_of_older_firmware(tmp_path, firmware, data):
    older = TABLE.replace('224\t', '208\t').replace('230\t', '214\t').replace(
        '7\t1\tID\n', '') + '146\t1\tPresent Temperature\n'
    model = Models([write(tmp_path, our_arm_fw52=older)]).get(4660, firmware)
    assert [one.data for one in model.indirect] == [data]
    is_older = data == 208
    assert ('Present Temperature' in model.by_name) == is_older
    assert ('ID' in model.by_name) != is_older


def test_the_angle_of_a_count_as_the_sdk_gives_it(tmp_path):
    text = ('[type info]\nname\tvalue\nvalue_of_zero_radian_position\t512\n'
            'value_of_max_radian_position\t1012\nmax_radian\t2.5\n\n'
            + TABLE.replace('Present Position\t0.001', 'Of Another\t0.001'))
    model = Models([write(tmp_path, our_arm=text)]).get(4660)
    assert values(model, 132, '0c 02 00 00') == {'Present Position (rad)': '0.06'}


def test_a_yaml_file_has_words_and_wins(tmp_path):
    folder = write(tmp_path, xm430_w350=TABLE)
    models = Models([folder])
    assert models.get(1020).file == str(BUILT_IN / 'x430.yaml')
    assert models.by_name('XM430-W350') is models.get(1020)
    mine = tmp_path / 'mine'
    mine.mkdir()
    (mine / 'arm.yaml').write_text('model_numbers: {4660: Arm}\n')
    assert Models([folder, mine]).names()[4660] == 'Arm'


def test_a_known_device_without_a_number_is_no_mistake(tmp_path):
    """ROBOTIS lists no number for xw430_t200.model."""
    assert check_models(write(tmp_path, xw430_t200=TABLE)) == []


def test_the_registers_of_an_unknown_servo_do_not_depend_on_it(tmp_path):
    used = frozenset({(64, 1), (116, 4), (132, 4)})
    own, plain = (ModelGuesses(models).find_model('2', used)
                  for models in (Models([write(tmp_path)]), Models()))
    assert list(own.by_name) == list(plain.by_name) != []


@pytest.mark.parametrize(('name', 'old', 'new', 'said'), [
    ('dynamixel', '4660\tour_arm.model\n4661\tour_arm.model\n', '',
     'our_arm.model: model number: dynamixel.model does not list the file; add a line to '),
    ('dynamixel', '4660\tour', 'our', 'dynamixel.model: line 2: not a number and a file with'),
    ('dynamixel', '4660', '0x12', "dynamixel.model: line 2: '0x12' is no number; correct"),
    ('dynamixel', '4660', '70000', 'our_arm.model: number in model_numbers is 70000; give'),
    ('our_arm', '[control table]', '[table]', 'our_arm.model: [control table]: missing or empty;'),
    ('our_arm', '7\t1\tID', '7 1 ID', 'our_arm.model: line 10: not an address, a size and a name'),
    ('our_arm', '7\t1\tID', '7\tone\tID', "our_arm.model: line 10: 'one' is no number;"),
    ('our_arm', '7\t1\tID', '7.5\t1\tID', 'our_arm.model: ID: at is 7.5; give a whole number'),
    ('our_arm', '7\t1\tID', '7\t3\tID', 'our_arm.model: ID: size is 3; use 1, 2, 4 or 8'),
    ('our_arm', '7\t1\tID', '7\t2\tID', 'our_arm.model: Baud Rate: at 8 it overlaps ID (7 to 8);'),
    ('our_arm', '7\t1\tID', '70000\t1\tID', 'our_arm.model: ID: at is 70000; give a whole number'),
    ('our_arm', '7\t1\tID', '7\t1\t', "our_arm.model: field at 7: name is ''; give a text"),
    ('our_arm', '\t0.001\t', '\t0\t', 'our_arm.model: Present Position: scale is 0; leave'),
    ('our_arm', '\t0.001\t', '\tx\t', "our_arm.model: line 3: 'x' is no number; correct"),
    ('our_arm', 'signed\t-3', 'sined\t-3', 'our_arm.model: line 3: not a name, value, unit'),
    ('our_arm', '[unit info]',
     f'[type info]\nvalue_of_max_radian_position\t9\nmax_radian\t{"9" * 400}\n[unit info]',
     'our_arm.model: Goal Position: scale is inf; give'),
    ('our_arm', '\t0.001\t', '\tnan\t', 'our_arm.model: Present Position: scale is nan; give'),
])
def test_a_mistake_stops_the_start_with_file_field_and_reason(tmp_path, name, old, new, said):
    text = {'dynamixel': NUMBERS, 'our_arm': TABLE}[name]
    assert old in text
    problems = check_models(write(tmp_path, **{name: text.replace(old, new, 1)}))
    assert said in problems[0]
    assert '\n' not in problems[0] and '; ' in problems[0]
    with pytest.raises(ModelError) as caught:
        Models([tmp_path])
    assert str(caught.value) == problems[0]


def test_a_file_without_a_list_and_one_that_is_no_text(tmp_path):
    folder = write(tmp_path)
    (folder / 'dynamixel.model').unlink()
    assert 'our_arm.model: model number: dynamixel.model does not list' in check_models(folder)[0]
    write(tmp_path)
    (folder / 'our_arm.model').write_bytes(b'[control table]\n\xff\n')
    assert 'our_arm.model: not UTF-8: ' in check_models(folder)[0]
    (folder / 'our_arm.model').write_bytes(b'#' * 600_000)
    assert 'our_arm.model: cannot be read: longer than' in check_models(folder)[0]


# ---- what ROBOTIS publishes ---------------------------------------------------------------------

def sdk():
    found = find_spec('dynamixel_easy_sdk')
    return Path(found.submodule_search_locations[0], 'control_table') if found else Path('none')


BOARDS = ('ffw', 'sensorxel', 'omy', 'hx5')                # ours are spelled otherwise


@pytest.mark.parametrize('folder', [HARDWARE_INTERFACE, sdk()], ids=['ros', 'sdk'])
def test_the_tables_of_robotis_are_taken_and_agree_with_ours(folder):
    if not (folder / 'dynamixel.model').is_file():
        pytest.skip(f"skipped: no makers' tables at {folder}")
    assert check_models(folder) == []
    models, ours, layers = Models([folder]), Models(), Layers(folder, BUILT_IN)
    assert models.names() == ours.names()
    for file, (number, *_) in listed_numbers(folder).items():
        theirs, own = layers.model(folder / file, number, None), ours.get(number)
        same = [field for field in theirs.fields if field.name in own.by_name]
        assert [field for field in same
                if (field.at, field.size) != (own.by_name[field.name].at,
                                              own.by_name[field.name].size)] == [], file
        assert len(same) * 2 > len(theirs.fields) or file.startswith(BOARDS), file
