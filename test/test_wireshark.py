# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""The dissector for Wireshark agrees with dxl_dump --json, packet by packet."""
from itertools import product
import os
from pathlib import Path
import re
import shutil
import subprocess

import pytest
from test_dump import BAUD
from test_dump import bursts
from test_dump import capture
from test_dump import dump
from test_dump import MODELS
from test_dump import objects
from test_dump import SECOND
from test_packet_file import with_sides
from usb_files import REAL

from mecarover_fakes.fake_bus import make_devices
from mecarover_fakes.fake_bus import make_line
from mecarover_fakes.fake_bus import PROTOCOLS
from mecarover_fakes.fake_bus import USUAL_MODEL
from mecarover_fakes.master import Master
from mecarover_fakes.traffic import PATTERNS
from mecarover_fakes.usb_adapter import FakeAdapter
from mecarover_fakes.usb_adapter import FAMILIES
from msg_defs.dxl_packet import encode
from rigs.usb_pcap import LINUX
from rigs.usb_pcap import MMAPPED
from rigs.usb_pcap import pcap
from rigs.usb_pcap import USBPCAP

WIRESHARK = Path(__file__).parents[1] / 'wireshark'
DEVICES = '1-3:MX-106,4:XL430-W250'
INDIRECT = 168                         # what indirect data are about is not in the tables
FIELDS = ('frame.number', 'id', 'instruction', 'error', 'params', 'address', 'size', 'data',
          'register', 'value', 'missing', 'request_in', 'response_in')
needs_tshark = pytest.mark.skipif(not shutil.which('tshark'),
                                  reason='skipped: tshark is not installed (apt has it)')


@pytest.fixture(scope='module')
def dissector(tmp_path_factory):
    """Return the dissector in a folder with tables that dxl_dump wrote."""
    folder = tmp_path_factory.mktemp('plugins')
    dump('--wireshark', folder)
    return shutil.copy(WIRESHARK / 'servobus.lua', folder)


def dissected(dissector, path, *options):
    """Return what the dissector says of each packet: the fields, each with all its values."""
    names = [name if '.' in name else f'servobus.{name}' for name in FIELDS]
    out = subprocess.run(
        ['tshark', '-2', '-X', f'lua_script:{dissector}', *options, '-r', path,
         '-T', 'fields', '-E', 'aggregator=|', *(word for name in names for word in ('-e', name))],
        capture_output=True, text=True, check=True)
    assert 'Lua' not in out.stderr
    return [dict(zip(FIELDS, (text.split('|') if text else [] for text in line.split('\t')),
                     strict=True)) for line in out.stdout.splitlines()]


def numbers(texts):
    return [int(text, 0) for text in texts]


def agrees(ours, theirs, bare, is_family_1):
    """
    Compare a packet of dxl_dump --json with the same one of tshark; return its registers.

    bare: what these registers mean depends on another one, and the dissector shows the number.
    """
    assert numbers(theirs['id']) == [ours['id']]
    assert numbers(theirs['instruction']) == [ours['code']]
    if ours['error'] is not None or not is_family_1:   # ours are as wide as those of 2.0
        assert ''.join(theirs['params']) == ours['params']
    parts = ours.get('registers', [])
    if ours['error'] is not None:
        errors = [part.get('error', 0) for part in parts] if ours['id'] == 254 else []
        assert numbers(theirs['error']) == [ours['error'], *errors]
    if not parts or ours.get('sure') is False:         # it may answer another instruction
        return 0
    assert numbers(theirs['address']) == [part['address'] for part in parts]
    assert numbers(theirs['size']) == [part['length'] for part in parts]
    assert theirs['data'] == [part['data'] for part in parts if 'data' in part]
    if not theirs['register'] or any(part['address'] >= INDIRECT for part in parts):
        return 0
    values = [pair for part in parts for pair in part.get('values', {}).items()]
    names = [name for name, _ in values] or [name for part in parts
                                            for name in part.get('names', ())]
    if not names:                      # the model was not known yet; tshark looks twice
        return 0
    assert [text.partition(':')[0] for text in theirs['register']] == [
        name.partition(' (')[0] for name in names]
    shown = [value for name, value in values
             if not isinstance(value, str) and name.partition(' (')[0] not in bare]
    assert [float(text) for text in theirs['value']] == pytest.approx(shown, rel=1e-5, abs=1e-8)
    return len(names)


def compare(dissector, text, tmp_path, devices, *options, is_family_1=False):
    """Return how many packets and registers agree; all must."""
    path = tmp_path / 'bus.pcapng'
    dump(text, '-w', path, *devices)
    theirs = [one for one in dissected(dissector, path, *options) if one['id']]
    ours = objects(text, *devices)
    assert len(ours) == len(theirs)
    models = map(MODELS.by_name, re.findall(r':([\w-]+)', ','.join(devices)))
    bare = {field.name for model in models for field in model.fields if field.cases}
    return len(ours), sum(agrees(*pair, bare, is_family_1)
                          for pair in zip(ours, theirs, strict=True))


@needs_tshark
@pytest.mark.parametrize('pattern', PATTERNS)
def test_2_0(pattern, tmp_path, dissector):
    text = capture(tmp_path / 'bus.txt', bursts('silent:2:0.2', pattern=pattern, seconds=0.4))
    packets, registers = compare(dissector, text, tmp_path, ['--devices', DEVICES], '-o',
                                 f'servobus.devices:{DEVICES}')
    assert packets and (registers or pattern in ('idle', 'none'))


@needs_tshark
@pytest.mark.parametrize(('dialect', 'family'), [('dxl1', 1), ('feetech', 2)])
def test_the_1_0_family(dialect, family, tmp_path, dissector):
    text, devices = tmp_path / 'bus.txt', f'1-6:{USUAL_MODEL[dialect]}'
    line = make_line(make_devices([devices], MODELS, BAUD, dialect=dialect), BAUD, dialect)
    master = Master(line, PATTERNS['moving'], rate=50)
    capture(text, [(one.data, SECOND + one.end) for one in master.bursts(SECOND)])
    packets, registers = compare(
        dissector, text, tmp_path, ['--devices', devices, '--protocol', PROTOCOLS[dialect]],
        '-o', f'servobus.devices:{devices}', '-o', f'servobus.family:{family}', is_family_1=True)
    assert packets > 100 and registers


@needs_tshark
def test_an_answer_that_did_not_come_is_named_at_its_instruction(tmp_path, dissector):
    text, path = with_sides(tmp_path / 'arm.txt'), tmp_path / 'arm.pcapng'
    dump(text, '-w', path)
    found = dissected(dissector, path)
    by_number = {one['frame.number'][0]: one for one in found}
    answers = [one for one in found if one['request_in']]
    assert answers
    for one in answers:
        assert one['frame.number'][0] in by_number[one['request_in'][0]]['response_in']


def recorded_with(family):
    """Return the events of a simulated adapter that carries what a master wrote and read."""
    adapter = FakeAdapter(family)
    events, now = adapter.plug(SECOND) + adapter.set_baud(1_000_000, SECOND), SECOND
    for side, data in re.findall(r' ([<>]) (\w+)', (REAL / 'healthy.master.log').read_text())[:60]:
        now += 1_000_000
        events += (adapter.sent if side == '>' else adapter.received)(bytes.fromhex(data), now)
    return events


@needs_tshark
@pytest.mark.parametrize(('name', 'link'), [
    *product(('healthy', 'acm', 'missing'), (LINUX, MMAPPED, USBPCAP)),
    *((family, USBPCAP) for family in FAMILIES)])
def test_a_serial_adapter_on_usb(name, link, tmp_path, dissector):
    """Of usbmon and USBPcap, straight from the file; a transfer may hold several packets."""
    path = tmp_path / 'usb.pcap'
    path.write_bytes(pcap(link, recorded_with(name) if name in FAMILIES
                          else (REAL / f'{name}.bin').read_bytes()))
    theirs, ours = dissected(dissector, path), objects(path)
    assert len(ours) > 20
    for field, wanted in (('id', 'id'), ('instruction', 'code'), ('address', 'address')):
        said = [part[wanted] for one in ours for part in (
            one.get('registers', []) if wanted == 'address' else [one])]
        assert numbers(text for one in theirs for text in one[field]) == said
    assert [text for one in theirs for text in one['params']] == [
        one['params'] for one in ours if one['params']]
    assert {text for one in theirs for text in one['missing']} == (
        {'7'} if name == 'missing' else set())
    assert sum(len(one['request_in']) for one in theirs) == sum(
        one['error'] is not None for one in ours)


@needs_tshark
def test_the_colours_are_taken(tmp_path, dissector):
    shutil.copy(WIRESHARK / 'colorfilters', tmp_path)
    done = subprocess.run(
        ['tshark', '--color', '-2', '-X', f'lua_script:{dissector}', '-r',
         REAL / 'missing.pcap', '-T', 'fields', '-e',
         'frame.coloring_rule.name'], capture_output=True, text=True, check=True,
        env={**os.environ, 'WIRESHARK_CONFIG_DIR': str(tmp_path)})
    assert {*done.stdout.splitlines()} == {
        '', 'servo bus: instruction', 'servo bus: answer', 'servo bus: no answer'}


MINE = """model_numbers: {1060: Half "7\\"}
fields:
  - {at: 132, name: Half Position, type: u16, unit: rad, scale: 0.5}
"""


@needs_tshark
def test_models_of_ones_own(tmp_path):
    """They win over ours, and their names may hold any letter."""
    models, plugins, path = tmp_path / 'models', tmp_path / 'new/plugins', tmp_path / 'bus.pcapng'
    models.mkdir()
    (models / 'mine.yaml').write_text(MINE)
    dump('--wireshark', plugins, '--model-dirs', models)
    text = capture(tmp_path / 'bus.txt', [
        (encode(1, 0x01), SECOND), (encode(1, 0x55, b'\x24\x04\x2d', error=0), 2 * SECOND),
        (encode(1, 0x02, b'\x84\0\2\0'), 3 * SECOND),
        (encode(1, 0x55, b'\3\0', error=0), 4 * SECOND)])
    dump(text, '-w', path)
    found = dissected(shutil.copy(WIRESHARK / 'servobus.lua', plugins), path)
    assert [one['register'] for one in found] == [
        [], [], ['Half Position'], ['Half Position: 1.5 rad']]


@needs_tshark
@pytest.mark.parametrize('content', [None, '', 'return {'])
def test_without_its_tables_the_dissector_says_so_in_one_line(tmp_path, content):
    dissector = shutil.copy(WIRESHARK / 'servobus.lua', tmp_path)
    if content is not None:
        (tmp_path / 'servobus_tables.lua').write_text(content)
    err = subprocess.run(['tshark', '-X', f'lua_script:{dissector}', '-r', REAL / 'missing.pcap'],
                         capture_output=True, text=True, check=True).stderr
    assert 'traceback' not in err
    [line] = [one for one in err.splitlines() if 'servobus' in one]
    assert f'{tmp_path}/servobus_tables.lua: missing or damaged (' in line
    assert line.endswith(f'; write it: dxl_dump --wireshark "{tmp_path}/"')
