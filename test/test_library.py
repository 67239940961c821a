# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""servobus as a library: in a robot's own program, on a recording, in a test (docs/library.md)."""
import ast
import json
from pathlib import Path
import re
import subprocess
import sys

import pytest
import serial
from test_dxl_doctor import capture

from msg_defs.dxl_instruction import Instruction
from msg_defs.dxl_packet import encode
import servobus
from servobus.errors import ServobusError

ROOT = Path(__file__).parents[1]
PAGE = (ROOT / 'docs/library.md').read_text()
EXAMPLES = re.findall(r'```python\n(.*?)```', PAGE, re.DOTALL)
READ = bytes((132, 0, 4, 0))
pytest_plugins = ['mecarover_fakes.pytest', 'pytester']


def python(script, *arguments):
    return subprocess.run([sys.executable, '-c', script, *arguments], cwd=ROOT, text=True,
                          capture_output=True, check=True).stdout


def ask(port, *servos):
    """Read Present Position of servos, as a program does that gives up after the time-out."""
    for number in servos:
        port.write(encode(number, Instruction.READ, READ))
        port.read(15)


def test_an_import_loads_no_doctor_no_ros_and_no_port():
    found = python('import sys; before = {*sys.modules}; import servobus\n'
                   'print(*{name.partition(".")[0] for name in {*sys.modules} - before})')
    assert not {'serial', 'socket', 'yaml', 'rclpy', 'threading'} & {*found.split()}
    found = python('import sys; from servobus.port.serial_port import open_port\n'
                   'print(*(name for name in sys.modules if name.startswith("servobus.")))')
    assert not [name for name in found.split() if not name.startswith((
        'servobus.port', 'servobus.errors', 'servobus.plain', 'servobus.worker'))]


def test_what_is_public_is_there_and_is_typed():
    tree = ast.parse((ROOT / 'servobus/__init__.py').read_text())
    [typed] = [node for node in tree.body if isinstance(node, ast.If)]
    assert servobus.__all__ == sorted(servobus.__all__) == sorted(
        node.names[0].name for node in typed.body)
    for name in servobus.__all__:
        assert getattr(servobus, name).__name__ == name
        assert f'`{name}' in PAGE or f'servobus.{name}' in PAGE, f'{name}: not in docs/library.md'


@pytest.mark.realtime(bears=0.02)
def test_around_a_port_a_silent_servo_is_named_and_the_port_stays_as_it_was(servo_bus):
    bus = servo_bus('1-3:XL430-W250', faults=('silent:2:0',))
    begun = []
    with serial.Serial(bus.path, 1_000_000, timeout=0.2) as port:
        before = type(port), {*vars(port)}
        with servobus.listen(port, devices=['1-3:XL430-W250'], on_finding=begun.append) as heard:
            for _ in range(20):
                ask(port, 1, 2, 3)
        assert (type(port), {*vars(port)}) == before
    assert [(one.rule, one.device) for one in heard.findings
            if one.level > servobus.Level.OK] == [('no_answer', 2)]
    assert ('no_answer', 2) in [(one.rule, one.device) for one in begun]
    [report] = heard.reports()
    assert [(one.id, one.totals.missed) for one in report.devices] == [(1, 0), (2, 20), (3, 0)]
    assert report.baud == 1_000_000
    assert json.dumps(servobus.report_data(report))


@pytest.mark.realtime(bears=0.02)
def test_a_mistake_of_the_program_is_raised_at_the_end_of_the_block_not_in_a_read(servo_bus):
    bus = servo_bus('1-3:XL430-W250', faults=('silent:2:0',))
    with serial.Serial(bus.path, 1_000_000, timeout=0.2) as port, \
            pytest.raises(ZeroDivisionError), \
            servobus.listen(port, devices=['1-3:XL430-W250'], on_finding=lambda _: 1 / 0):
        for _ in range(20):
            ask(port, 1, 2, 3)
    with pytest.raises(KeyError), serial.serial_for_url('loop://') as port, servobus.listen(port):
        raise KeyError('what the block raises comes first')


@pytest.mark.realtime(bears=0.02)
def test_a_servo_on_which_the_program_ends_is_named_after_one_question(servo_bus):
    bus = servo_bus('1-3:XL430-W250', faults=['silent:2:0'])
    with serial.Serial(bus.path, 1_000_000, timeout=0.2) as port, \
            pytest.raises(ConnectionError), \
            servobus.listen(port, devices=['1-3:XL430-W250']) as heard:
        ask(port, 1, 2)
        raise ConnectionError('Failed to read from servo 2')
    assert [(one.rule, one.device) for one in heard.findings
            if one.level > servobus.Level.OK] == [('no_answer', 2)]


@pytest.mark.parametrize(('port', 'options', 'words'), [
    (42, {}, 'int: not a port of pyserial'),
    (serial.Serial(), {}, 'this port is not open'),
    ('loop://', {'devices': ['1:XL999']}, "no model is called 'XL999'"),
    ('loop://', {'devices': ['one']}, 'is not a device'),
    ('loop://', {'devices': [3]}, 'devices: .3. is no list of texts'),
    ('loop://', {'devices': '1-6:STS3215'}, 'is no list of texts'),
    ('loop://', {'protocol': '3'}, 'protocol: .3. is none; use one of auto'),
    ('loop://', {'baud': -5}, 'baud: -5 is no baud rate'),
    (__file__, {}, 'dxl_tap arm -- '),
])
def test_what_cannot_be_is_one_line(port, options, words):
    with pytest.raises(ServobusError, match=words):
        servobus.listen(port, **options)


def test_the_example_of_a_recording_prints_plain_data(tmp_path, monkeypatch, capsys):
    [example] = [one for one in EXAMPLES if "'run.txt'" in one]
    capture(tmp_path / 'run.txt', 'silent:3:0')
    monkeypatch.chdir(tmp_path)
    exec(example)
    found = json.loads(capsys.readouterr().out)
    assert [one['rule'] for one in found['findings']] == ['no_answer']


def test_the_example_of_a_monitor_reports_what_was_fed():
    [example] = [one for one in EXAMPLES if 'monitor.feed' in one]
    names = {'servobus': servobus}
    exec(example, names)
    assert [one.id for one in names['report'].devices] == [1]


def test_the_example_around_a_port_hears_it(servo_bus):
    [example] = [one for one in EXAMPLES if "Serial('/dev/ttyUSB0'" in one]
    bus = servo_bus('1-6:STS3215', dialect='feetech')
    names = {}
    exec(example.replace('/dev/ttyUSB0', bus.path).replace(
        '    ... ', "    port.write(bytes.fromhex('ffff01040238 02be')); port.read(8)"), names)
    [report] = names['bus'].reports()
    assert [(one.id, one.totals.answers) for one in report.devices if one.totals.asked] == [(1, 1)]


@pytest.mark.realtime(bears=0.02)
@pytest.mark.parametrize(('fault', 'outcome'), [('', {'passed': 1}),
                                                ('silent:1:0', {'failed': 1, 'errors': 1})])
def test_the_example_of_a_test_fails_for_what_the_doctor_finds(pytester, fault, outcome):
    conftest, example = (next(one for one in EXAMPLES if word in one)
                         for word in ('pytest_plugins', 'def test_my_arm'))
    pytester.makeconftest(conftest)
    if fault:
        example = example.replace("dialect='feetech')", f"dialect='feetech', faults=['{fault}'])")
    pytester.makepyfile(example)
    result = pytester.runpytest_subprocess('-p', 'no:cacheprovider')
    result.assert_outcomes(**outcome)
    if fault:
        result.stdout.fnmatch_lines(['*the servo bus is not well:*',
                                     '*all_silent*not one byte comes back*'])
