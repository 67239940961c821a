# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""mecarover_status: which lines it shows and its exit codes."""
import fcntl
import json
import os
import pty
import re
import struct
import subprocess
import sys
import termios

from harness import ROOT
from harness import shown_on
import pytest
from synthetic_robot import serialise
from synthetic_robot import SyntheticRobot

from mecarover_dashboard.snapshot import snapshot
from mecarover_dashboard.state import OVERVIEW
from mecarover_dashboard.state import State
from mecarover_dashboard.state import TABLES
from mecarover_dashboard.status_lines import exit_code
from mecarover_dashboard.status_lines import screen
from mecarover_dashboard.status_lines import status_lines
from mecarover_dashboard.status_lines import table
from msg_defs.diagnostics import Level
from msg_defs.diagnostics import Status
from servobus.bus.report import Finding


def told(*robots, state=None, now_s=100.0):
    state = state or State()
    for robot in robots:
        state.store_message(OVERVIEW, serialise(robot.overview(now_s)), now_s)
    return state


def test_a_healthy_robot_has_a_line_per_bridge_and_bus():
    state = told(SyntheticRobot())
    lines = status_lines(state, 100.0)
    assert [(line.level, line.what) for line in lines] == [
        (Level.OK, 'bridge'), (Level.OK, 'bus')]
    assert exit_code(state) == 0
    assert len(status_lines(state, 100.0, every_device=True)) == 2 + 24


@pytest.mark.parametrize(('group', 'code', 'level'), [
    ('lost', 4, Level.ERROR), ('warned', 3, Level.WARN), ('silent', 3, Level.STALE),
    ('faulty', 4, Level.ERROR)])
def test_a_sick_device_has_a_line_and_an_exit_code(group, code, level):
    robot = SyntheticRobot()
    getattr(robot, group).add(7)
    state = told(robot)
    lines = status_lines(state, 100.0)
    [line] = [line for line in lines if line.what == '007 left_knee']
    assert line.level is level
    assert line.message
    assert lines[-1].what == 'bridge'                   # what is worst comes first
    assert exit_code(state) == code


def test_robots_are_told_apart_and_a_namespace_has_its_own():
    robots = [SyntheticRobot(namespace=f'rover{number}') for number in (1, 2)]
    robots[1].lost = {7}
    state = told(*robots)
    assert table(state, 100.0, 'm')[1].startswith('ERROR')          # it misses most
    lines = screen(status_lines(state, 100.0))
    assert [line for line in lines if ' 007 left_knee ' in line] == [
        'ERROR   rover2  007 left_knee  disconnected: 7 answers missed']
    assert 'rover2' in lines[0]
    alone = told(*robots, state=State('rover1'))
    assert {line.robot for line in status_lines(alone, 100.0)} == {'rover1'}
    assert exit_code(alone) == 0


def test_a_position_that_is_no_angle_has_its_unit():
    state = State()
    for number, unit, value in ((1, 'rad', '1608.49'), (2, 'm', '0.0532')):
        state.store_message(TABLES, serialise([Status(
            f'dxl_monitor: 00{number}', Level.OK, 'connected', str(number), [
                ('Model', ''), ('State', 'connected'), (f'Present Position ({unit})', value)])]),
            100.0)
    assert [line.split()[2:5] for line in table(state, 100.0)[1:]] == [
        ['1608.49', '-', '-'], ['0.053', 'm', '-']]


def test_what_is_no_longer_reported_is_silent_and_then_gone():
    robot = SyntheticRobot({'': ((1, 'MX-64', ''),)})
    state = told(robot)
    lines = status_lines(state, 105.0)
    assert [(line.what, line.message) for line in lines if line.what == 'bus'] == [
        ('bus', 'No report from dxl_monitor: nothing is known of its 1 device; start it again; '
                'last report 5 s ago')]
    assert exit_code(state) == 4       # the rover was driving when its bridge was last heard
    # Its bus is reported, it is not.
    state.store_message(OVERVIEW, serialise(robot.overview(170.0)[:1]), 170.0)
    assert [line.what for line in status_lines(state, 170.0) if line.what == '001'] == []


def test_nothing_of_others_and_no_control_codes():
    state = State()
    assert exit_code(state) == 1
    state.store_message(OVERVIEW, b'\1\2\3', 1.0)
    foreign = Status('cpu: load', Level.ERROR, 'hot', '', [])
    state.store_message(OVERVIEW, serialise([foreign]), 1.0)
    assert status_lines(state, 1.0) == []
    evil = Status('dxl_monitor: 001 \x1b[2Jknee', Level.ERROR, 'lost\nand \x07more', '1',
                  [('Model', 'MX-64'), ('Firmware Version', '1'), ('State', 'disconnected')])
    state.store_message(OVERVIEW, serialise([evil]), 1.0)
    assert all(text.isprintable() for text in screen(status_lines(state, 1.0)))


def test_each_state_fits_or_has_a_row_of_its_own():
    robot = SyntheticRobot()
    robot.lost, robot.warned = {7}, {9}
    state = told(robot)
    heading, *lines = table(state, 100.0, 'w', 59)
    assert heading.endswith(' loss %\n        state (worst first)')
    assert lines[0].startswith('ERROR   007 left_knee  MX-106 ')
    assert lines[0].endswith('100\n        disconnected: 7 answers missed')
    assert [line.split()[:2] for line in lines[:3]] == [
        ['ERROR', '007'], ['WARN', '009'], ['ok', '001']]
    rows = [row for line in lines for row in line.split('\n')]
    assert max(map(len, rows)) == 59
    assert len(rows) == 24 + 2                     # 'connected' has none
    assert all('\n' not in line for line in table(state, 100.0, 'w', 120))


def test_a_program_gets_numbers_under_known_names():
    robot = SyntheticRobot()
    robot.lost = {7}
    robot.findings = (Finding('hardware_error', Level.ERROR, 8, 'overheating; let it cool'),)
    state = told(robot)
    state.store_message(TABLES, serialise(robot.tables(100.0)), 100.0)
    found = json.loads(json.dumps(snapshot(state, 100.0, 1.79e9), allow_nan=False))
    assert (found['time'], found['exit']) == (1.79e9, 4)
    [bridge], [bus] = found['bridges'], found['buses']
    assert (bridge['level'], bridge['live'], bridge['robot']) == ('OK', True, '')
    assert bridge['link']['Port'] == '/dev/ttyAMA0'
    assert (bus['name'], bus['level'], bus['values']['Devices']) == ('', 'ERROR', 24)
    assert [one['id'] for one in bus['devices']] == [*range(1, 21), *range(100, 104)]
    first, lost = bus['devices'][0], bus['devices'][6]
    assert (first['name'], first['model'], first['level']) == ('001 left_hip_yaw', 'MX-106', 'OK')
    assert (lost['state'], lost['level'], lost['live']) == ('disconnected', 'ERROR', False)
    assert lost['position'] is None                # it is not of now
    numbers = ('firmware', 'answers', 'missed', 'loss', 'latency', 'position', 'temperature',
               'voltage', 'load')
    assert {name: first[name] for name in numbers if type(first[name]) not in (int, float)} == {}
    assert first['unit'] == 'A'
    assert {(one['rule'], one['level'], one['device']) for one in bus['findings']} == {
        ('hardware_error', 'ERROR', 8)}


def test_a_program_gets_what_is_no_longer_reported_as_stale():
    state = told(SyntheticRobot({'': ((1, 'MX-64', ''),)}))
    [bus] = snapshot(state, 110.0, 0)['buses']
    assert (bus['level'], bus['live'], bus['devices'][0]['level']) == ('STALE', False, 'STALE')
    assert snapshot(State(), 1.0, 0) == {'time': 0, 'exit': 1, 'bridges': [], 'buses': []}


LEADER = """
import fcntl, termios
fcntl.ioctl(0, termios.TIOCSCTTY, 0)
"""
ON_A_TERMINAL = """
import sys
sys.path.insert(0, 'test')
from synthetic_robot import serialise, SyntheticRobot
from mecarover_dashboard.state import OVERVIEW, State
from mecarover_dashboard.terminal import Display, make_parser
from mecarover_serial.standard_streams import StandardStreams
robot, state = SyntheticRobot(), State()
robot.lost = {number for number, _, _ in robot.buses['']} - {103}
state.store_message(OVERVIEW, serialise(robot.overview(1.0)), 1.0)
display = Display(state, make_parser().parse_args(sys.argv[1:]))
with StandardStreams('mecarover_status'):
    display.show_state(1.0)
    display.show_state(3.0)
"""


def test_as_json_a_terminal_gets_an_object_a_line():
    ours, theirs = pty.openpty()
    with subprocess.Popen([sys.executable, '-c', LEADER + ON_A_TERMINAL, '--json'], cwd=ROOT,
                          stdin=theirs, stdout=theirs, start_new_session=True):
        os.close(theirs)
        with os.fdopen(os.dup(ours)) as terminal:
            lines = shown_on(ours).splitlines()
            assert termios.tcgetattr(terminal)[3] & termios.ECHO       # it waits for no key
    assert [json.loads(line)['exit'] for line in lines] == [4, 4]


def test_what_the_keys_do_is_read_at_60_columns():
    ours, theirs = pty.openpty()
    fcntl.ioctl(theirs, termios.TIOCSWINSZ, struct.pack('4H', 24, 60, 0, 0))
    with subprocess.Popen([sys.executable, '-c', LEADER + ON_A_TERMINAL], cwd=ROOT, stdin=theirs,
                          stdout=theirs, start_new_session=True):
        os.close(theirs)
        text = shown_on(ours)
    rows = text.split('\033[H')[1].split('\033[J')[1].split('\n')
    assert max(len(row.strip()) for row in rows) < 60
    assert ' '.join(' '.join(rows).split()).endswith(
        'arrows: scroll; q: end; sort: w=worst i=ID p=position t=temperature v=voltage l=load '
        'm=missed')
    assert text.split('\033[H')[1].count('\n') < 24


def test_on_a_terminal_it_draws_in_place_and_cuts_no_line():
    """Also where a pipe came in front of stdout meanwhile; the worst is above the fold."""
    ours, theirs = pty.openpty()
    fcntl.ioctl(theirs, termios.TIOCSWINSZ, struct.pack('4H', 12, 60, 0, 0))
    with subprocess.Popen([sys.executable, '-c', ON_A_TERMINAL], cwd=ROOT, stdout=theirs):
        os.close(theirs)
        text = shown_on(ours)
    first, *others = text.split('\033[H')[1:]
    assert len(others) == 1
    rows = [row.replace('\033[K', '').rstrip() for row in first.split('\n')]
    assert 0 < max(len(re.sub(r'\033\[\d*m', '', row)) for row in rows) < 60
    assert rows[0].startswith('\033[31mERROR')
    assert any(row.startswith('\033[31m' + ' ' * 8) for row in rows)  # what did not fit
    assert re.search(r'rows 1 to 10 of \d+; make the terminal larger to see more', rows[-1])
