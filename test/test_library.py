# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""servobus as a library: in a robot's own program, on a recording, in a test (docs/library.md)."""
import ast
from contextlib import ExitStack
import json
from pathlib import Path
import re
import subprocess
import sys
import traceback
from types import SimpleNamespace

import pytest
import serial
from test_dxl_doctor import capture
from test_dxl_doctor import doctor

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
        'servobus.port', 'servobus.errors', 'servobus.printable_text', 'servobus.worker'))]


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


@pytest.mark.realtime(bears=0.02)
@pytest.mark.parametrize('was_handling', [False, True])
def test_what_the_block_raises_comes_first_and_shows_the_other_mistake_too(servo_bus,
                                                                            was_handling):
    bus = servo_bus('1-3:XL430-W250', faults=['silent:2:0'])
    with serial.Serial(bus.path, 1_000_000, timeout=0.2) as port, \
            pytest.raises(ConnectionError) as caught, \
            servobus.listen(port, devices=['1-3:XL430-W250'], on_finding=lambda _: 1 / 0):
        try:
            if was_handling:
                raise ConnectionError('lost')
        finally:
            for _ in range(20):
                ask(port, 1, 2, 3)
        raise ConnectionError('lost') from OSError('unplugged')
    shown = ''.join(traceback.format_exception(caught.type, caught.value, None))
    assert shown.index('ZeroDivisionError') < shown.index('ConnectionError: lost')
    assert was_handling or shown.index('ZeroDivisionError') < shown.index('OSError: unplugged')


@pytest.mark.parametrize('live', [True, False])
def test_a_source_that_gave_no_byte_does_not_look_healthy(tmp_path, live):
    (tmp_path / 'empty.bin').touch()
    name, words = ('tap:none', 'tap:none: nothing was heard. No program sent anything: start it '
                   'with dxl_tap none -- COMMAND') if live else (
        f'{tmp_path}/empty.bin', 'empty.bin holds no byte of a bus')
    with pytest.raises(servobus.NothingHeardError, match=words), servobus.listen(name) as bus:
        bus.run(seconds=0.2)
    with pytest.raises(ValueError, match='0 reports') as caught, servobus.listen(name) as bus:
        bus.run(seconds=0.2)
        raise ValueError(f'{len(bus.reports())} reports')
    assert isinstance(caught.value.__context__, servobus.NothingHeardError)
    with servobus.listen(name):
        pass                                   # nothing was asked


@pytest.mark.parametrize('name', ['loop://', 'run.txt'])
def test_after_its_block_a_source_says_that_it_is_closed(tmp_path, monkeypatch, name):
    monkeypatch.chdir(tmp_path)
    capture(tmp_path / 'run.txt')
    with servobus.listen(name) as bus:
        pass
    with pytest.raises(servobus.ClosedError, match=f'{name}: closed at the end of the with block'):
        bus.run(seconds=0.1)


@pytest.mark.realtime(bears=0.02)
def test_a_port_that_the_program_opens_again_is_heard_on(servo_bus):
    bus, other = servo_bus('1-3:XL430-W250'), servo_bus('7:XL430-W250')
    path = bus.path
    before = serial.Serial.open
    with serial.Serial(path, 1_000_000, timeout=0.2) as first, \
            serial.Serial(other.path, 1_000_000, timeout=0.2) as second, ExitStack() as stack:
        heard_second = stack.enter_context(servobus.listen(second))
        with servobus.listen(first) as heard:
            ask(first, 1)
            with serial.Serial(path, 1_000_000, timeout=0.2):
                pass                           # the first one is still open
            first.close()
            with serial.Serial(path, 1_000_000, timeout=0.2) as again:
                ask(again, 2)
            first.open()
            ask(first, 3)
            stack.close()                      # this block is over before the later one
            first.close()
            with serial.Serial(path, 1_000_000, timeout=0.2) as again:
                ask(again, 1)
        with serial.Serial(path, 1_000_000, timeout=0.2) as last:
            assert type(last) is type(again) is type(first) is serial.Serial
            ask(last, 1)
    assert serial.Serial.open is before
    [report] = heard.reports()
    assert [(one.id, one.totals.answers) for one in report.devices] == [(1, 2), (2, 1), (3, 1)]
    assert not any(one.devices for one in heard_second.reports())


def test_there_is_a_report_from_the_first_byte_on(servo_bus, servo_doctor):
    bus = servo_bus('1-2:XL430-W250')
    with serial.Serial(bus.path, 1_000_000, timeout=0.2) as port:
        heard = servo_doctor(port, devices=['1-2:XL430-W250'])
        assert heard.reports() == []
        ask(port, 1, 2)
        assert [one.totals.answers for one in heard.reports()[0].devices] == [1, 1]


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


def test_what_is_like_a_port_needs_no_open():
    class Double:
        port, baudrate, is_open, in_waiting = 'double', 1_000_000, True, 0

        def read(self, size=1):
            return bytes(size)

        def write(self, data):
            return len(data)

    double = Double()
    with servobus.listen(double) as heard:
        double.write(encode(1, Instruction.PING))
    assert heard.reports()[0].counters['Packets'] == 1


@pytest.mark.parametrize(('port', 'options', 'words'), [
    (42, {}, 'int: not a port of pyserial'),
    (serial.Serial(), {}, 'this port is not open'),
    ('loop://', {'devices': ['1:XL999']}, "no model is called 'XL999'"),
    ('loop://', {'devices': ['one']}, 'is not a device'),
    ('loop://', {'devices': [3]}, 'devices: .3. is no list of texts'),
    ('loop://', {'devices': '1-6:STS3215'}, 'is no list of texts'),
    ('loop://', {'protocol': '3'}, 'protocol: .3. is none; use one of auto'),
    ('loop://', {'baud': -5}, 'baud: -5 is no baud rate'),
    ('loop://', {'on_finding': 3}, 'on_finding: 3 cannot be called; give a function'),
    (__file__, {}, 'dxl_tap arm -- '),
])
def test_what_cannot_be_is_one_line(port, options, words):
    with pytest.raises(ServobusError, match=words):
        servobus.listen(port, **options)


def test_the_example_of_a_recording_prints_plain_data(tmp_path, monkeypatch, capsys):
    [example] = [one for one in EXAMPLES if "listen('run.txt')" in one]
    capture(tmp_path / 'run.txt', 'silent:3:0')
    monkeypatch.chdir(tmp_path)
    exec(example)
    found = json.loads(capsys.readouterr().out)
    assert [one['rule'] for one in found['findings']] == ['no_answer']


def test_a_recording_that_ends_in_silence_has_the_findings_of_dxl_doctor(tmp_path):
    path = capture(tmp_path / 'run.txt', 'silent:4:3')
    path.write_text(f'{path.read_text()}# ended at 20.000000000\n')
    with servobus.listen(str(path)) as bus:
        bus.run()
    [shown] = json.loads(doctor(path, '--json').stdout)['buses']
    assert [one.message for one in bus.findings] == [
        one['message'] for one in shown['findings']] != []


def test_the_examples_of_a_monitor_report_what_was_fed(tmp_path, monkeypatch):
    first, second = (one for one in EXAMPLES if 'monitor.feed' in one)
    names = {'servobus': servobus}
    exec(first, names)
    assert [(one.id, one.model_name) for one in names['report'].devices] == [(1, 'XL430-W250')]
    capture(tmp_path / 'run.txt', 'silent:3:0')
    monkeypatch.chdir(tmp_path)
    exec(second, names)
    report = names['monitor'].report(names['source'].ended)
    assert ('no_answer', 3) in [(one.rule, one.device) for one in report.findings]


def test_the_example_around_a_port_hears_it(servo_bus):
    [example] = [one for one in EXAMPLES if "Serial('/dev/ttyUSB0'" in one]
    bus = servo_bus('1-6:STS3215', dialect='feetech')
    names = {}
    exec(example.replace('/dev/ttyUSB0', bus.path).replace(
        '    ... ', "    port.write(bytes.fromhex('ffff01040238 02be')); port.read(8)"), names)
    [report] = names['bus'].reports()
    assert [(one.id, one.totals.answers) for one in report.devices if one.totals.asked] == [(1, 1)]


@pytest.mark.realtime(bears=0.02)
def test_the_example_of_a_finding_that_a_test_expects(servo_bus):
    [example] = [one for one in EXAMPLES if 'my_arm.read_joints' in one]
    bus = servo_bus('1-6:XL430-W250', faults=['silent:2:0'])
    with serial.Serial(bus.path, 1_000_000, timeout=0.2) as port:
        names = {'servobus': servobus, 'port': port, 'my_arm': SimpleNamespace(
            read_joints=lambda: [ask(port, 1, 2) for _ in range(6)])}
        exec(example.replace('STS3215', 'XL430-W250'), names)


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
