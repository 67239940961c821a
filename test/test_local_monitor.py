# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""dxl_dashboard without ROS: a program, a port and a recording on the page, as dxl_doctor says."""
import ast
from contextlib import ExitStack
import fcntl
import json
import math
import os
import pty
import re
import struct
import subprocess
import sys
import termios
from types import SimpleNamespace
from urllib.error import HTTPError
from urllib.parse import urlencode
from urllib.request import urlopen

import dashboard_page
from harness import Program
from harness import ROOT
from harness import wait
import pytest

from benchmark import confusion
from benchmark.confusion_cases import Scene
from mecarover_dashboard.local_monitor import conclusion
from mecarover_dashboard.local_monitor import LocalMonitor
from mecarover_fakes.fake_bus import make_devices
from mecarover_fakes.fake_bus import make_line
from mecarover_fakes.faults import parse
from mecarover_fakes.master import Master
from mecarover_fakes.traffic import PATTERNS
from msg_defs.diagnostics import Level
from msg_defs.event import Chunk
from servobus.sources.capture import ClockReading
from servobus.sources.capture import Wire
from servobus.sources.capture import Writer
from servobus.tools.doctor.verdict import OpenPoint
from servobus.tools.doctor.verdict import Trouble
from servobus.tools.doctor.verdict import Verdict

ARM = '1-6:STS3215'
BUS = ('--dialect', 'feetech', '--devices', ARM)
NO_ROS = """
import sys
sys.modules['rclpy'] = None
from mecarover_dashboard.{tool} import main
sys.exit(main())
"""
LEADER = """
import fcntl, termios
fcntl.ioctl(0, termios.TIOCSCTTY, 0)
"""
MASTER = """
import sys, time
import scservo_sdk as sdk
port = sdk.PortHandler(sys.argv[1])
port.setBaudRate(1000000)
packet = sdk.PacketHandler(0)
end = time.monotonic() + float(sys.argv[2])
goals, seen = [], []
while time.monotonic() < end:
    for servo in range(2, 7):
        packet.read2ByteTxRx(port, servo, 56)
    for _ in range(5):
        goals.append(2048 + 7 * len(goals) % 500)
        packet.syncWriteTxOnly(port, 42, 2, [1, goals[-1] % 256, goals[-1] // 256], 3)
        seen.append(packet.read2ByteTxRx(port, 1, 56)[0])
print('said', (goals, seen))
print('my program ends')
"""


def read_until(terminal, pattern):
    """Return what was written to a terminal, until a pattern is there."""
    data = b''
    while not re.search(pattern, text := data.decode(errors='ignore')):     # it may be cut
        data += os.read(terminal, 65536)
    return text


def dashboard(*arguments):
    """Start it where there is no ROS."""
    return Program('', '--port', '0', '--no-browser', '--history', 'none', *arguments,
                   script=NO_ROS.format(tool='dxl_dashboard'))


def events(program):
    """Yield what a page gets."""
    address = program.wait_for('http://').split('http://')[1].split()[0]
    with urlopen(f'http://{address}/events', timeout=20) as stream:
        for line in stream:
            if line.startswith(b'data: '):
                yield json.loads(line.removeprefix(b'data: '))


def devices(program, until):
    """Return the devices of a page, when something is so of them, and what came first."""
    found, first = {}, None
    for event in events(program):
        first = first or event
        for row in event.get('devices', {}).values():
            found[row['id']] = row
        if until(found):
            return found, first
    raise AssertionError(found)


def recorded(program, device, count):
    """Return goals and positions of a servo as its counts, once there are so many."""
    address = program.wait_for('http://').split('http://')[1].split()[0]
    keys = ('Goal Position (rad)', 'Present Position (rad)')
    query = urlencode([pair for key in keys for pair in (
        ('of', device), ('register', key), ('after', 0))])
    numbers = ()

    def is_enough():
        nonlocal numbers
        with urlopen(f'http://{address}/signals?{query}') as answer:
            numbers = [one for one, in struct.iter_unpack('<d', answer.read())]
        return numbers[4] >= count
    wait(is_enough)
    values = [round(2048 + rad * 2048 / math.pi) for rad in numbers[9::2]]
    return values[:int(numbers[4])], values[int(numbers[4]):]


@pytest.mark.realtime(bears=0.02)
def test_a_program_is_shown_while_it_runs_and_judged_at_its_end(tmp_path):
    link = str(tmp_path / 'bus')
    with Program('mecarover_fakes.fake_bus', '--link', link, *BUS, '--pattern', 'none',
                 '--fault', 'silent:3:0:999') as fake:
        fake.wait_for('6 devices')
        with dashboard('--devices', ARM, 'run', '--', sys.executable, '-c', MASTER, link,
                       '6') as program:
            found, first = devices(program, lambda rows: {
                number for number, row in rows.items() if row['level'] == 2} == {3})
            assert {row['state'] for row in found.values() if row['id'] != 3} == {'connected'}
            assert found[3]['bus'] == 'bus'
            assert first['facts']['source'].startswith(sys.executable)
            goals, positions = recorded(program, 'dxl_monitor: bus/001', 50)
            assert program.exit_code() == 0
    assert program.said('my program ends')
    said = ast.literal_eval(next(line for line in program.lines if line.startswith('said '))[5:])
    asked, seen = said
    assert any(asked[at:at + len(goals)] == goals for at in range(len(asked)))
    rest = iter(seen)                       # on a busy machine either may give up an answer
    assert sum(one in rest for one in positions if one in seen) > 20
    assert re.search(r'dxl_dashboard: .*003, STS3215: no answer', program.text)


@pytest.mark.realtime(bears=0.02)
def test_a_port_may_go_and_come_again(tmp_path):
    link = tmp_path / 'bus'
    with ExitStack() as stack:
        with Program('mecarover_fakes.fake_bus', '--link', str(link), *BUS) as fake:
            fake.wait_for('6 devices')
            program = stack.enter_context(dashboard(str(link), '-b', '1000000', '--devices', ARM))
            devices(program, lambda rows: len(rows) == 6 and rows[6]['live'])
        lost = program.wait_for(f'{link}: ')
        with Program('mecarover_fakes.fake_bus', '--link', str(link), *BUS):
            program.wait_for(f'{link}: the port is open again')
            devices(program, lambda rows: [row['level'] for row in rows.values()] == 6 * [0])
    assert ';' in lost                                          # its remedy
    assert program.said('dxl_dashboard: ', 'STS3215')


@pytest.mark.parametrize(('arguments', 'code', 'words'), [
    ((), 2, 'SOURCE: none given, and ROS 2 is not sourced; name a port or a recording, or write '
            'dxl_dashboard run -- python my_script.py'),
    (('no_such_file',), 1, 'no_such_file: no such file or port; check the name'),
    (('run', 'x.py'), 2, 'write dxl_dashboard'),
    (('run', '--', 'no_such_program'), 1, 'check the name of the program'),
    ((__file__,), 2, 'write: dxl_dashboard run -- python'),
    (('usb:x', '-b', '0'), 2, '--baud: 0: not possible'),
    (('/dev/x', '/dev/x'), 2, 'twice')])
def test_mistakes_are_one_line(arguments, code, words):
    with dashboard(*arguments) as program:
        assert program.exit_code() == code
    own = [line for line in program.lines if 'http://' not in line and 'heard' not in line]
    assert len(own) == 1
    assert words in own[0]


def test_what_is_handed_over_is_what_is_published():
    """One report, once serialised as for ROS, once handed over: the page gets the same."""
    from page_states import Robot

    from mecarover_dashboard.state import State
    *_, report = confusion.reports(['silent:3:1', 'hot:2:1'], Scene(devices=('1-6:MX-64',)), 4.0)
    robot = Robot(buses={'': report}, bridge=None)
    told, handed = State(), State()
    for topic, message in robot.messages():
        if topic != '/diagnostics':
            told.store_message(topic, message, 1.0)
    monitor = LocalMonitor()
    monitor.out = lambda topic, statuses: handed.store_message(topic, statuses, 1.0)
    monitor.add(SimpleNamespace(
        monitor=SimpleNamespace(name='', alarms=lambda: 0), is_late=lambda now: False,
        report=lambda now: report, port_state=lambda: robot.port_state()))
    monitor.report(report.stamp)
    for section in ('devices', 'buses'):
        rows = [{one.row_name: one for one in state.reports(section)} for state in (told, handed)]
        assert rows[0] == rows[1]
    for one in told.reports('devices'):
        assert told.table(one.row_name) == handed.table(one.row_name)


@pytest.mark.realtime(bears=0.02)
def test_the_same_rows_in_a_terminal(tmp_path):
    """Of a port, in place and by key; of a recording, whole and once."""
    link, capture = str(tmp_path / 'bus'), str(tmp_path / 'bus.txt')
    status = NO_ROS.format(tool='mecarover_status')
    with Program('mecarover_fakes.fake_bus', '--link', link, *BUS, '--fault',
                 'silent:3:0:999') as fake:
        fake.wait_for('6 devices')
        ours, theirs = pty.openpty()
        fcntl.ioctl(theirs, termios.TIOCSWINSZ, struct.pack('4H', 24, 100, 0, 0))
        with subprocess.Popen(
                [sys.executable, '-c', LEADER + status, link, '-b', '1000000', '--devices', ARM],
                cwd=ROOT, stdin=theirs, stdout=theirs, stderr=theirs,
                start_new_session=True) as shown:
            os.close(theirs)
            read_until(ours, r'ERROR +003 ')
            read_until(ours, r'ok +001 +-?\d\.\d+ +\d+ +12 ')                  # rad, °C, V
            os.write(ours, b't')
            read_until(ours, r'state \(temperature\)[\s\S]*ok +001')
            os.write(ours, b'q')
            read_until(ours, 'mecarover_status: 003, STS3215: ')
        os.close(ours)
        assert shown.returncode == 0
        with Program('servobus.tools.dxl_dump', link, '-b', '1000000', '-w', capture,
                     '--seconds', '4') as dump:
            assert dump.exit_code() == 0
    with Program('', capture, '--once', '--all', '--devices', ARM, script=status) as once:
        assert once.exit_code() == 4
    assert once.said('ERROR', '003 ')
    with Program('', capture, '--json', '--devices', ARM, script=status) as once:
        assert once.exit_code() == 4
    [bus] = json.loads(once.text)['buses']
    assert [one['id'] for one in bus['devices']] == [1, 2, 3, 4, 5, 6]
    assert bus['devices'][2]['level'] == 'ERROR'
    assert bus['devices'][0]['voltage'] == 12


def test_a_recording_whose_name_is_not_utf_8(tmp_path):
    capture = os.fsdecode(os.fsencode(tmp_path) + b'/arm_\xff.txt')
    with open(capture, 'wb') as file:
        Writer(file, ClockReading(10**12, 10**12)).write_chunk(
            Wire('arm', 10**6), Chunk(10**12, 'arm', bytes.fromhex('ffff010281007b')))
    with dashboard(capture) as program:
        first = next(events(program))
        assert first['facts']['source'] == f'{tmp_path}/arm_\ufffd.txt'
    assert program.exit_code() == 0
    assert 'Traceback' not in ''.join(program.lines)


def test_the_last_line_is_no_all_clear_where_causes_are_left():
    trouble = Trouble(Level.WARN, 'the program', '', 'it ended with an error', '')
    point = OpenPoint('003', 'no_answer', 'no cause is sure', 'swap the cable')
    verdict = Verdict('bus.txt', (), (), (), (), ())
    assert conclusion(verdict) == 'no problem found; heard: no device'
    assert conclusion(verdict._replace(not_sure=[point])) == '003: no cause is sure'
    advice = trouble._replace(level=Level.OK)
    assert conclusion(verdict._replace(wrong=[advice], not_sure=[point])) \
        == '003: no cause is sure'
    assert conclusion(verdict._replace(wrong=[trouble], not_sure=[point])) \
        == 'the program: it ended with an error; and 1 more: dxl_doctor shows all'


WHY_NOT = dashboard_page.why_not()


@pytest.mark.realtime(bears=0.02)
@pytest.mark.skipif(bool(WHY_NOT), reason=WHY_NOT or 'runs')
def test_a_recording_is_played_stopped_and_moved(tmp_path):
    """In a browser: to a finding and back; what was found is what dxl_doctor finds."""
    capture = tmp_path / 'arm.txt'
    line = make_line(make_devices([ARM], confusion.MODELS, 10**6, dialect='feetech'), 10**6,
                     'feetech', waits_in_line=False)
    master = Master(line, PATTERNS['moving'], rate=30.0, faults=[parse('silent:3:20')])
    with open(capture, 'wb') as file:
        writer = Writer(file, ClockReading(10**12, 10**12))
        for data, stamp, _ in confusion.chunks(master, 30 * 10**9, 0):
            writer.write_chunk(Wire('arm', 10**6), Chunk(10**12 + stamp, 'arm', data))
    with dashboard(str(capture), '--devices', ARM) as program, dashboard_page.browser() as browser:
        address = 'http://' + program.wait_for('http://').split('http://')[1].split()[0]
        page = browser.new_page()
        page.goto(address)
        bar = page.locator('.buses .buses .bar')
        bar.filter(has_text='6 of 6').wait_for()
        page.locator('#player option', has_text='no answer').wait_for(state='attached')
        page.get_by_label('Go to a finding').select_option(index=1)
        bar.filter(has_text=re.compile('003 silent')).wait_for()
        assert page.get_by_role('button', name='Play').count() == 1         # it was stopped
        slider = page.get_by_label('Time in the recording')
        assert 19 < float(slider.input_value()) < 24
        slider.fill('10')
        bar.filter(has_text='6 of 6').wait_for()
        assert page.locator('.servo[data-state=ok]').count() == 6
        page.get_by_role('link', name='Signals').click()        # stopped, yet it has the past
        page.locator('.legend', has_text=re.compile(r'(29|30) /s')).wait_for()
        page.get_by_role('button', name='Play').click()
        wait(lambda: float(slider.input_value()) > 10.3)
        with urlopen(f'{address}/player') as answer:
            found = json.loads(answer.read())
        with pytest.raises(HTTPError, match='403'):                 # no other program moves it
            urlopen(f'{address}/player?at=0')
    said = subprocess.run([sys.executable, '-m', 'servobus.tools.dxl_doctor', '--json',
                           '--devices', ARM, capture], cwd=ROOT, capture_output=True, text=True)
    logged = json.loads(said.stdout)['buses'][0]['findings']
    assert {text.partition(': ')[2] for _, _, text in found} == {
        one['message'] for one in logged if one['level'] != 'OK'}
    assert program.said('dxl_dashboard: 003, STS3215: no answer')
