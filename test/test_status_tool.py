# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""mecarover_status: which lines it shows and its exit codes."""
import fcntl
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

from mecarover_dashboard.state import OVERVIEW
from mecarover_dashboard.state import State
from mecarover_dashboard.state import TABLES
from mecarover_dashboard.status_lines import exit_code
from mecarover_dashboard.status_lines import screen
from mecarover_dashboard.status_lines import status_lines
from mecarover_dashboard.status_lines import table
from msg_defs.diagnostics import Level
from msg_defs.diagnostics import Status


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
        ('bus', 'No report from dxl_monitor: nothing is known of its 1 device; last report 5 s '
                'ago')]
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


ON_A_TERMINAL = """
import sys
sys.path.insert(0, 'test')
from synthetic_robot import serialise, SyntheticRobot
from mecarover_dashboard.state import OVERVIEW, State
from mecarover_dashboard.terminal import Display
from mecarover_serial.standard_streams import StandardStreams
robot, state = SyntheticRobot(), State()
robot.lost = {number for number, _, _ in robot.buses['']} - {103}
state.store_message(OVERVIEW, serialise(robot.overview(1.0)), 1.0)
display = Display(state, None, False)
with StandardStreams('mecarover_status'):
    display.show_state(1.0)
    display.show_state(3.0)
"""


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
