# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""All model files, one after the other; families against each other; the loader and its errors."""

from itertools import pairwise
import os
from pathlib import Path
import re

import pytest
import yaml

from rigs.tables import rows_of
from servobus.bus.table import READ
from servobus.bus.table import Table
from servobus.model.checked_yaml import ModelError
from servobus.model.checked_yaml import read_yaml
from servobus.model.field_entries import FIELD_KEYS
from servobus.model.layers import FILE_KEYS
from servobus.model.layers import model_key
from servobus.model.models import BUILT_IN
from servobus.model.models import check_models
from servobus.model.models import Models

SOURCE = Path(__file__).parents[2] / 'shared' / 'data' / 'dxl_models'
DOCS = Path(__file__).parents[1] / 'docs' / 'models.md'
MODELS = Models()
X330 = (1190, 1200, 1210, 1220, 1230, 1240)


def load(number, firmware=None):
    model = MODELS.get(number, firmware)
    assert model is not None, MODELS.problems
    return model


TABLES = [(number, None) for number in MODELS.names()] + [(number, 52) for number in X330]
NUMBERS_2 = {number for number in MODELS.names() if load(number).protocol == '2'}
PARTS = {231, *range(620, 626), *range(6001, 6026)}     # ranges of another device's table
NAME = re.compile(r'[A-Z0-9][\w.\-/]*( ([A-Z0-9][\w.\-]*|\([A-Z]\w*\)))*')
UNITS = {'', 'rad', 'rad/s', 'rad/s^2', 'A', 'V', 'V/s', '°C', '%', 's', 'Hz', 'bit/s'}


def test_the_built_in_files_have_no_mistake():
    assert check_models(BUILT_IN) == []


@pytest.mark.parametrize(('number', 'firmware'), TABLES)
def test_a_table_is_sound(number, firmware):
    model = load(number, firmware)
    assert model_key(model.number or 0, model.protocol) == number
    assert '\nsource: ' in Path(model.file).read_text()
    for first, second in pairwise(model.fields):
        assert first.end <= second.at, (first, second)
    for field in model.fields:
        assert field.end <= 0x10000
        assert NAME.fullmatch(field.name), field.name
        assert field.unit in UNITS, field
        assert not (field.access == 'r' and field.name.startswith('Goal')), field
    assert len({field.name for field in model.fields}) == len(model.fields)
    assert all(model.by_name[alias] is model.by_name[name]
               for alias, name in model.aliases.items())


@pytest.mark.parametrize('number', sorted(NUMBERS_2 - PARTS))
def test_common_registers_are_where_they_belong(number):
    model = load(number)
    assert model.by_name['Model Number'].at == 0
    small = number in (350, 0xABBA, 0xAFFE, 0xBAFF)
    firmware = {'Firmware Version', 'Firmware Version Minor'} & model.by_name.keys()
    assert [model.by_name[name].at for name in firmware] == [2 if small else 6]
    if not small:
        assert model.by_name['ID'].at == 7
    if 'Torque Enable' in model.by_name and not small:
        assert {'Hardware Error Status', 'Error Code'} & model.by_name.keys()
        assert model.by_name['Present Position'].unit == 'rad'
        assert model.by_name['Present Position'].type == 'i32'


def shared(first, second):
    return [field.name for field in first.fields if field.name in second.by_name]


@pytest.mark.parametrize(('one', 'other', 'apart'), [
    ('XM430-W350', 'MX-106', {'Current Limit', 'Goal Current', 'Present Current'}),
    ('XM430-W350', 'XL430-W250', set()),
    ('XM430-W350', 'XW540-T260', set()),
    ('XM430-W350', 'XH430-V350', {'Current Limit', 'Goal Current', 'Present Current'}),
    ('XM430-W350', 'XM540-W270', set()),
    ('PH54-200-S500', 'H54-200-S500-R(A)', set()),
    ('PH54-200-S500', 'PM42-010-S260', {
        'Homing Offset', 'Max Position Limit', 'Min Position Limit', 'Goal Position',
        'Present Position', 'Position Trajectory'}),
    ('YM070-210-M001', 'YM080-230-A099', set()),
])
def test_families_agree(one, other, apart):
    first, second = MODELS.by_name(one), MODELS.by_name(other)
    names = shared(first, second)
    assert len(names) > 50
    different = {name for name in names if _meaning(first, name) != _meaning(second, name)}
    assert different == apart


def _meaning(model, name):
    field = model.by_name[name]
    return (field.at, field.type, field.access, field.memory, field.unit, field.scale,
            field.offset, field.enum, field.flags)


def test_signs_are_as_the_quantities_are():
    for number in NUMBERS_2:
        for field in load(number).fields:
            quantity = re.sub(r'^(Motor\d|Swerve DXL\d) ', '', field.name)
            if re.fullmatch('(Present|Goal) (PWM|Current|Velocity|Position)|Homing Offset|'
                            '(Position|Velocity) Trajectory', quantity) and number != 350:
                assert field.type[0] == 'i', (number, field)
            elif re.search('Limit$|Temperature|Voltage|Gain$', quantity) \
                    and 'Position' not in quantity:
                assert field.type[0] == 'u', (number, field)


# ---- against the makers' tables -----------------------------------------------------------------

SPELLING = (('_', ' '), ('Saveve', 'Save'), ('Freqency', 'Frequency'), ('Bandwith.', 'Bandwidth'),
            ('Depth.', 'Depth'))
# Rows that contradict their own file. XC335: its indirect data two bytes apart, but 'Indirect Data
# Read' (230) belongs to 'Indirect Address Read' (180), the seventh. RCU: one name, three motors.
MISTAKEN = {('xc335_t332.model', 224 + 2 * n) for n in range(1, 28)} | {
    ('ffw_g10_rcu.model', 101), ('ffw_g10_rcu.model', 102)}


def source_rows(file):
    table = (SOURCE / file).read_text(encoding='utf-8-sig').split('[control table]')[1]
    rows = [line.split('\t') for line in table.splitlines() if line[:1].isdigit()]
    return [(int(at), int(size), name) for at, size, name in rows]


def spelled(name):
    for wrong, right in SPELLING:
        name = name.replace(wrong, right)
    return name.casefold()


def test_every_register_of_the_makers_tables_is_in_ours():
    if not SOURCE.is_dir():
        pytest.skip(f"skipped: no makers' tables at {SOURCE}")
    index = (SOURCE / 'INDEX.tsv').read_text().splitlines()
    files = [line.split('\t')[:2] for line in index if not line.startswith('#')]
    assert len(files) > 100
    missing = []
    for number, file in files:
        model = load(1280 if number == '-' else int(number), 52 if 'fw52' in file else None)
        ours = {(field.at, field.size, spelled(name)) for name, field in model.by_name.items()}
        text = Path(model.file).read_text()
        ours |= {(block['at'], block['size'], spelled(block['name']))
                 for block in (yaml.safe_load(text)['blocks'] if 'blocks:' in text else ())}
        missing += [(file, at, size, name) for at, size, name in source_rows(file)
                    if (at, size, spelled(name)) not in ours and (file, at) not in MISTAKEN]
    assert missing == []


# ---- the loader ---------------------------------------------------------------------------------

GOOD = """model_numbers: {4660: Gripper}
fields:
  - {at: 0, name: Model Number, type: u16}
  - {at: 2, name: Mode, type: u8, enum: {0: off, 1: on}}
"""


def write(folder, text, name='device.yaml'):
    folder.mkdir(exist_ok=True)
    (folder / name).write_text(text, encoding='utf-8')
    return folder


def test_a_folder_of_the_users_wins_number_by_number(tmp_path):
    first = write(tmp_path / 'a', GOOD.replace('4660: Gripper', '321: Mine'))
    second = write(tmp_path / 'b', GOOD.replace('4660: Gripper', '321: Other, 9: Nine'))
    models = Models([first, second])
    assert [models.names()[number] for number in (9, 311, 321)] == ['Nine', 'MX-64', 'Mine']
    assert models.by_name('MX-106') is None
    assert models.by_name('mine') is models.get(321)


def test_names_are_found_as_people_write_them():
    for name in ('XM430-W350', 'xm430_w350', 'xm430w350'):
        model = MODELS.by_name(name)
        assert model.number == 1020
    assert MODELS.by_name('XM431-W350') is None
    assert MODELS.closest('XM431-W350') == 'XM430-W350'
    assert MODELS.closest('STS3125') == 'STS3215'              # STS3250 is as near
    assert MODELS.closest('teapot') is None
    assert MODELS.closest('54024') == 'H54-200-S500-R'
    assert MODELS.closest('54023') is None


@pytest.mark.parametrize(('name', 'known'), [
    ('H54P-200-S500-R', 'PH54-200-S500'), ('M42P_010_S260_R', 'PM42-010-S260'),
    ('H54-200-S500-R', 'H54-200-S500-R')])
def test_the_names_of_pro_and_pro_plus_are_not_taken_for_each_other(name, known):
    assert MODELS.by_name(name).name == known
    assert known in MODELS.closest(f'PRO_{name}').split(' or ')


@pytest.mark.parametrize(('firmware', 'count', 'data'), [
    (None, 28, 224), (53, 28, 224), (52, 20, 208), (46, 20, 208), (0, 20, 208)])
def test_the_firmware_picks_the_table(firmware, count, data):
    model = load(1200, firmware)
    assert [(i.data, i.size) for i in model.indirect] == [(data, count)]
    assert model.by_name['Indirect Data 1'].at == data


def test_unquoted_on_and_off_are_words(tmp_path):
    model = Models([write(tmp_path, GOOD)]).get(4660)
    assert model.by_name['Mode'].decode(b'\0').text == 'off'


def test_a_file_that_goes_wrong_later_counts_as_unknown(tmp_path):
    models = Models([write(tmp_path, GOOD)])
    write(tmp_path, 'model_numbers: {4660: Gripper}\nfields: 3\n')
    assert models.get(4660) is None
    assert models.get(4660) is None
    assert len(models.problems) == 1
    assert 'fields is 3' in models.problems[0]
    assert (models.by_name('Gripper'), models.closest('Gripper')) == (None, None)


@pytest.mark.parametrize('protocol', [
    'protocol: feetech\n', 'protocol: feetech    # STS\n', "protocol: 'feetech'\n",
    'protocol: feetech\r\n', '\ufeffprotocol: feetech\n', '"protocol" :\tfeetech\n'])
def test_a_feetech_model_is_found_however_its_protocol_is_written(tmp_path, protocol):
    model = Models([write(tmp_path, protocol + GOOD)]).get(model_key(4660, 'feetech'))
    assert (model.name, model.protocol) == ('Gripper', 'feetech')


MISTAKES = rows_of(Path(__file__).with_name('model_mistakes.tsv'))


@pytest.mark.parametrize(('good', 'wrong', 'said'), MISTAKES)
def test_a_mistake_is_named_with_file_field_and_reason(tmp_path, good, wrong, said):
    good, wrong = (one.replace('\\n', '\n') for one in (good, wrong))
    assert good in GOOD
    folder = write(tmp_path, GOOD.replace(good, wrong, 1))
    problems = check_models(folder)
    assert said in problems[0]
    assert '; ' in problems[0]
    assert '\n' not in problems[0]
    with pytest.raises(ModelError) as caught:
        Models([folder])
    assert str(caught.value) == problems[0]




def levels(opening, innermost, closing, count):
    return count * opening + innermost + count * closing


LAUGHS = '\n'.join(['words:', '  a0: &a0 {0: ha, 1: ha}', *(
    f'  a{n}: &a{n} {{{", ".join(f"{key}: *a{n - 1}" for key in range(10))}}}'
    for n in range(1, 12))])
BLOCK, BYTE = "{repeat: 4096, step: 1, prefix: 'B {n}', fields: [", '{at: 0, name: C, type: u8}'
REPEATS = levels(BLOCK, BYTE, ']}', 4)


@pytest.mark.parametrize(('text', 'words'), [
    ('[' * 100_000, 'line 1: not YAML: '),             # a newer libyaml says it itself
    ('{a: ' * 100_000, 'line 1: not YAML: more than 50 levels'),
    ('- ' * 100_000, 'line 1: not YAML: more than 50 levels'),
    ('? ' * 100_000, 'line 1: not YAML: more than 50 levels'),
    (GOOD + LAUGHS, 'line 10: not YAML: more than 60000 values'),
    (GOOD + 'words: &w {a: *w}', 'not YAML: *w refers to nothing, or to itself'),
    (GOOD + f'words: {{{", ".join(f"{n}: x" for n in range(30_000))}}}',
     'not YAML: more than 60000 values'),
    (GOOD + f'words: {{{", ".join(["a: x"] * 9_000)}}}', "not YAML: key 'a' twice"),
    (GOOD + '#' * 600_000, 'cannot be read: longer than 500000 bytes'),
    (GOOD.replace('at: 0', f'at: {"9" * 5000}'), 'not YAML: '),
    (GOOD.replace('at: 0', f'at: {"9" * 4000}'), 'line 3: not YAML: a number of 13288 bits'),
    (GOOD.replace('at: 0', f'at: 0x{"9" * 50_000}'), 'line 3: not YAML: a number of 200000 bits'),
    (GOOD.replace('at: 0', 'at: !!int x'), 'not YAML: '),
    (GOOD.replace('at: 0', "at: !!int ''"), 'not YAML: '),
    (GOOD.replace('at: 0', f'at: !!float {"1:" * 200}1'), 'not YAML: '),
    (GOOD.replace('at: 0', 'at: !!bool x'), 'not YAML: '),
    (GOOD.replace('at: 0', 'at: !!timestamp x'), 'not YAML: '),
    (GOOD.replace('at: 0', 'at: !!python/name:os.system'), 'not YAML: could not determine'),
    (GOOD.replace('4660: Gripper', f'{"9" * 5000}: Gripper'), 'not YAML: '),
    (GOOD.replace('name: Mode,', 'name: "\\e[31mM\\nB",'),
     "name is '\\x1b[31mM\\nB'; give a text"),
    (GOOD.replace('1: on', '1: "\\e[31m"'), "Mode: word of 1 is '\\x1b[31m'"),
    (GOOD.replace('1: on', '1: 1e999'), 'Mode: word of 1 is inf'),
    (GOOD.replace('{0: off, 1: on}', f"{{'1-{'9' * 90}': x}}"), "Mode: code '1-999"),
    (GOOD.replace('Mode', '"\0"'), 'not YAML: '),
    (GOOD + '\0', 'not YAML: '),
    (GOOD.encode('utf-16')[:-1].decode('latin-1'), 'not YAML: '),
    (GOOD.replace('Mode', 'M\xe4ode'), 'not YAML: '),
    (GOOD + f'  - {REPEATS}\n', 'with this one more than 65536 fields'),
    (GOOD + ''.join(f"  - {{at: {n}, name: 'C{n} {{n}}', type: u8, repeat: 4096}}\n"
                    for n in range(300)), 'with this one more than 65536 fields'),
    (GOOD + f'indirect: [{", ".join(9 * ["{address: 9, data: 9, count: 4096}"])}]',
     'with this one more than 65536 fields'),
    (GOOD.replace('4660: Gripper', ', '.join(f'{n}: A{n}' for n in range(1, 18)))
     + 'each:\n' + ''.join(f'  {n}: {{fields: [{BLOCK}{BYTE.replace("0", "3")}]}}]}}\n'
                           for n in range(1, 18)),
     'with this one more than 65536 fields'),
    (GOOD.replace('fields:', f'include: {"a" * 300}\nfields:'), 'include: no file aaa'),
])
def test_no_file_takes_the_process_or_its_time(tmp_path, text, words):
    """Written as latin-1, so that one of them is no UTF-8."""
    (tmp_path / 'device.yaml').write_bytes(text.encode('latin-1'))
    problems = check_models(tmp_path)
    assert words in problems[0]
    assert all(problem.isprintable() and len(problem) < 1000 for problem in problems)
    with pytest.raises(ModelError):
        Models([tmp_path])


def test_what_is_no_file_is_told_at_once(tmp_path):
    os.mkfifo(tmp_path / 'pipe.yaml')
    (tmp_path / 'folder.yaml').mkdir()
    assert [problem.partition('.yaml: ')[2] for problem in check_models(tmp_path)] == [
        'cannot be read: not a file; check the file and its permissions'] * 2


def test_files_in_files_without_end_are_told(tmp_path):
    for n in range(400):
        write(tmp_path, f'include: [_{n + 1}]\n', f'_{n}.yaml')
    assert '21 files include one another; ' in check_models(tmp_path)[0]


def test_files_that_include_each_other_are_told(tmp_path):
    for one, other in ('ab', 'ba'):
        write(tmp_path, GOOD.replace('4660', str(ord(one))) + f'  - {{include: {other}}}\n',
              f'{one}.yaml')
    assert 'includes itself; break the circle' in check_models(tmp_path)[0]


def test_a_folder_that_is_none_is_told(tmp_path):
    assert 'No such file' in check_models(tmp_path / 'none')[0]
    assert 'no model files' in check_models(tmp_path)[0]
    with pytest.raises(ModelError, match='no model files'):
        Models([tmp_path])


def test_a_model_of_the_users_may_include_a_built_in_one(tmp_path):
    write(tmp_path, 'model_numbers: {5000: Mine}\ninclude: [_x, _x_load]\nwithout: [LED]\n')
    model = Models([tmp_path]).get(5000)
    assert 'LED' not in model.by_name
    assert model.by_name['Present Load'].unit == '%'


@pytest.mark.parametrize('copies', [0, 20])
def test_loading_reads_no_file_before_it_is_asked_for(copies, tmp_path, monkeypatch):
    for n in range(copies):
        write(tmp_path, GOOD.replace('4660', str(30_000 + n)), f'device_{n}.yaml')
    parsed = []

    def read(path):
        parsed.append(path)
        return read_yaml(path)

    monkeypatch.setattr('servobus.model.layers.read_yaml', read)
    models = Models([tmp_path] if copies else [])
    assert not [path for path in parsed if path.parent == BUILT_IN]
    assert models.get(1020) is not None
    assert {path.name for path in parsed if path.parent == BUILT_IN} == {
        'x430.yaml', '_x.yaml', '_words.yaml', '_x_current.yaml', '_x_backup.yaml'}


# ---- docs/models.md -----------------------------------------------------------------------------

def block(title):
    found = re.search(rf'{title}\n\n```\w*\n(.*?)```', DOCS.read_text(encoding='utf-8'), re.DOTALL)
    assert found
    return found[1]


def test_the_worked_example_works(tmp_path):
    write(tmp_path, block('Save this as `my_models/gripper.yaml`:'))
    assert check_models(tmp_path) == []
    model = Models([tmp_path]).get(0x1234)
    table = Table()
    table.store(20, bytes.fromhex('02 09'), 1, READ)
    table.store(24, bytes.fromhex('72 10 a2 fe 00 00 48 41 00 00 00 00'), 1, READ)
    shown = [f'{seen.field.key} = {seen.value.text}' for seen in table.observed(model, 2)]
    assert shown == block('the monitor shows:').splitlines()


def test_the_docs_name_every_file_and_every_key():
    text = DOCS.read_text(encoding='utf-8')
    for path in BUILT_IN.glob('[!_]*.yaml'):
        assert f'`{path.stem}`' in text
    for key in (FIELD_KEYS | FILE_KEYS) - {'fields', 'show'}:
        assert f'`{key}`' in text, key
