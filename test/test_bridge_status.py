# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""What /diagnostics and the log say of the bridge: levels, messages, keys. No ROS here."""
import math
from pathlib import Path
import re
from types import SimpleNamespace

import pytest
import yaml

from mecarover_fakes.guarded_receiver import GuardedReceiver
from mecarover_fakes.receiver import Receiver
from msg_defs.crc import crc32_mpeg2
from msg_defs.crc import crc32_mpeg2_words
from msg_defs.diagnostics import Level
from msg_defs.nanoseconds import NS_PER_S
from msg_defs.running_statistics import Series
from msg_defs.vel2d import encode
from msg_defs.vel2d import STOP
from msg_defs.vel2d import Vel2d
from servobus.port.port_error import PortError
from servobus.port.port_error import Reason
from vel2d_bridge.bridge_settings import PARAMETERS
from vel2d_bridge.bridge_settings import removed_limits
from vel2d_bridge.bridge_settings import warnings
from vel2d_bridge.bridge_status import Commands
from vel2d_bridge.bridge_status import commands_status
from vel2d_bridge.bridge_status import link_status
from vel2d_bridge.bridge_status import refusal
from vel2d_bridge.gate import Counters
from vel2d_bridge.gate import Outcome
from vel2d_bridge.graph import Choice
from vel2d_bridge.link import LinkState
from vel2d_bridge.mcu_log import McuLog

PORT = '/dev/ttyAMA0'
OPEN = LinkState(
    is_open=True, since=0, problem=None, last_error='', openings=1, losses=0, frames=7,
    time_outs=0, partial_writes=0, freezes=0, last=None, driving=True,
    enabled=True, deadman='ready', owes_stop=False)
HEARD = Commands('/cmd_vel', Choice('twist', True), 0.5, [], None, 0, None)
FIGHT = '/cmd_vel: 2 publishers compete; use twist_mux'
ROWS = yaml.safe_load(Path(__file__).with_name('bridge_status.yaml').read_text())


def changed(changes):
    problem = changes.get('problem')
    return OPEN._replace(**{**changes, 'problem': problem and PortError(
        PORT, Reason('absent', *problem))})


def link(state=OPEN, warnings=(), mcu=None, now=5 * NS_PER_S):
    return link_status('vel2d_bridge', PORT, state, warnings, mcu or McuLog(), now)


def commands(state=OPEN, heard=HEARD, counters=None):
    return commands_status('vel2d_bridge', PORT, state, counters or Counters(), heard)


def periods(*seconds):
    series = Series()
    for period in seconds:
        series.add(1000 * period, 5 * NS_PER_S)
    return series.summary(5 * NS_PER_S)


@pytest.mark.parametrize(('changes', 'warnings', 'level', 'message'), ROWS['link'])
def test_link(changes, warnings, level, message):
    status = link(changed(changes), warnings)
    assert (status.name, status.hardware_id) == ('vel2d_bridge: link', PORT)
    assert status.level is Level[level]
    assert status.message.startswith(message)


@pytest.mark.parametrize(('changes', 'heard', 'level', 'message'), ROWS['commands'])
def test_commands(changes, heard, level, message):
    made = {'period': lambda one: periods(*one), 'choice': lambda one: Choice(*one),
            'refused': lambda one: Outcome[one]}
    status = commands(changed(changes), HEARD._replace(**{
        name: made.get(name, lambda one: one)(value) for name, value in heard.items()}))
    assert status.level is Level[level]
    assert status.message.startswith(message)


def test_all_complaints_are_there():
    status = commands(OPEN._replace(enabled=False), HEARD._replace(
        complaints=[FIGHT], period=periods(0.8, 0.8, 0.8)))
    values = dict(status.values)
    assert status.message.endswith('(and 2 more)')
    assert values['Complaint 1'].startswith('/cmd_vel: disabled')
    assert values['Complaint 2'] == FIGHT
    assert 'stops in between' in values['Complaint 3']


@pytest.mark.parametrize('verdict', [one for one in Outcome if one is not Outcome.ACCEPTED])
def test_every_refusal_has_a_remedy(verdict):
    line = refusal('vel2d_bridge', '/cmd_vel', Vel2d(math.nan, -0.0, math.inf), verdict,
                   False)
    assert line.startswith(f'/cmd_vel: command (nan, -0, inf) refused: {verdict.value}; ')
    assert commands(OPEN, HEARD._replace(refused=verdict)).level is Level.WARN


# What the MCU says

def test_lines_of_the_mcu():
    mcu = McuLog()
    mcu.feed(b'pose \x1b[1;31mloop\x1b[0m\r\n\r\nbat')
    assert mcu.take_lines(NS_PER_S) == ['pose loop']
    mcu.feed(b'tery\t12 V\n')
    assert mcu.take_lines(NS_PER_S + 1) == []                             # throttled
    assert mcu.take_lines(2 * NS_PER_S) == ['battery 12 V']
    assert (mcu.lines, mcu.bytes, mcu.garbage_bytes) == (2, 37, 0)


def test_a_babbling_mcu():
    mcu = McuLog()
    for _ in range(100):
        mcu.feed(b'the same again\n' * 10)
    lines = mcu.take_lines(NS_PER_S)
    assert lines[-1] == f'... and {1000 - len(lines) + 1} more lines'
    assert len(lines) < 10
    assert mcu.take_lines(2 * NS_PER_S) == []
    mcu.feed(b'x' * 100_000)                                        # no end of line at all
    assert all(len(line) <= 200 for line in mcu.take_lines(3 * NS_PER_S))


def test_garbage_is_counted_and_not_printed():
    mcu = McuLog()
    mcu.feed(bytes(range(128, 256)) + b'\n' + b'\x00\x07bell\n' + b'good\n')
    assert mcu.take_lines(NS_PER_S) == ['good']
    assert mcu.garbage_bytes == 134
    assert '134 bytes that are not text; check baud' in mcu.garbage(NS_PER_S)
    assert mcu.garbage(2 * NS_PER_S) == ''                          # nothing new
    mcu.feed(b'\xff\n')
    assert mcu.garbage(3 * NS_PER_S) == ''                          # said just now
    assert '1 bytes' in mcu.garbage(12 * NS_PER_S)


def test_what_the_mcu_refuses_is_counted_and_a_complaint():
    """As the firmware of the thesis says it, between other lines; for 10 s after the last one."""
    mcu = McuLog()
    mcu.feed(b'crc mismatch!\r\nboot\r\nCRC Mismatch!\r\ninsufficient bytes received\r\n')
    assert mcu.take_lines(NS_PER_S) == ['boot']
    crc, short = mcu.complaints(NS_PER_S, 'words')
    assert 'crc_input' not in crc       # it refuses stops too
    assert 'no console' in short
    values = dict(link(mcu=mcu).values)
    assert values['Refused by MCU: crc mismatch'] == '2'
    assert values['Refused by MCU: insufficient bytes'] == '1'
    mcu.feed(b'crc mismatch!\n')
    assert mcu.complaints(9 * NS_PER_S, 'words') == [crc, short]
    assert mcu.complaints(12 * NS_PER_S, 'words') == [crc]
    assert mcu.complaints(19 * NS_PER_S, 'words') == []
    mcu.reset()
    assert (mcu.lines, set(mcu.refused.values())) == (0, {0})
    assert mcu.complaints(20 * NS_PER_S, 'words') == []
    assert link(warnings=[crc], mcu=mcu).level is Level.WARN


def send(mcu, velocity, frames, at):
    """Send frames to an MCU, 50 ms apart from `at`; return when the last was sent."""
    for _ in range(frames):
        at += NS_PER_S // 20
        mcu.receiver.feed(encode(velocity), at)
        mcu.receiver.advance(at + NS_PER_S // 40)
        mcu.log.drives += velocity != STOP
        mcu.log.feed(mcu.receiver.text_to_host(at + NS_PER_S // 40).encode(), at)
    return at


@pytest.mark.parametrize('receiver', [Receiver, GuardedReceiver])
@pytest.mark.parametrize(('crc', 'is_refused'), [(crc32_mpeg2_words, True), (crc32_mpeg2, False)])
def test_an_mcu_that_accepts_stops_only(receiver, crc, is_refused):
    """With the wrong crc_input the stops pass, and no command to drive does."""
    mcu = SimpleNamespace(log=McuLog(), receiver=receiver(crc=crc))
    at = send(mcu, STOP, 60, NS_PER_S)
    assert mcu.receiver.totals.crc_err == 0
    assert mcu.log.complaints(at, 'words') == []
    at = send(mcu, Vel2d(0.5, -0.25, 1.0), 60, at)
    refused = mcu.log.refused_drives(at, 'words')
    assert [line for line in refused if 'set crc_input to words' in line] == refused
    assert bool(refused) is is_refused
    assert mcu.log.complaints(at, 'words') == refused       # the cause alone, not the watchdog too
    heard = HEARD._replace(complaints=refused)
    assert commands(heard=heard).level is (Level.WARN if is_refused else Level.OK)
    at = send(mcu, STOP, 30, at)
    assert mcu.log.refused_drives(at, 'words') == refused
    at = send(mcu, STOP, 200, at)
    assert mcu.log.refused_drives(at, 'words') == []        # nothing refused for 10 s
    mcu.log.reset()
    assert mcu.log.refused_drives(at, 'words') == []


def test_a_bad_cable_is_not_the_crc_input():
    """Every third frame is damaged."""
    mcu = McuLog()
    for _ in range(100):
        mcu.drives += 3
        mcu.feed(b'crc mismatch!\r\n')
    [line] = mcu.complaints(NS_PER_S, 'words')
    assert line.endswith('check cable and ground')
    assert mcu.refused_drives(NS_PER_S, 'words') == []


def answers(mcu, said, frames=40, every=1, period=NS_PER_S // 20):
    """Send frames; the MCU says `said` after each `every`th. Return its complaints."""
    at = NS_PER_S
    for frame in range(frames):
        at += period
        mcu.frames += 1
        if frame % every == 0:
            mcu.feed(said, at)
    return mcu.complaints(at, 'words')


@pytest.mark.parametrize('said', [
    b'Invalid Command\r\n', b'Unknown command: \x00\xb9?\n',
    b'echo:Unknown command: "M9"\r\nok\r\n',
    b'sh: v: command not found\n', b'>>> SyntaxError: invalid syntax\r\n', b'ERR\r\n', b'?\r\n',
    b'\r\nERROR\r\n', b'\x1b[31mcmd unknown\x1b[0m\n'])
def test_an_mcu_that_reads_commands_in_text(said):
    mcu = McuLog()
    assert answers(mcu, said, 9) == []
    [line] = answers(mcu, said)
    assert re.fullmatch('the MCU answers frames with "[ -~]{1,20}", .*docs/firmware.md.*', line)
    assert mcu.complaints(20 * NS_PER_S, 'words') == []     # it has the right firmware by now
    mcu.reset()
    assert answers(mcu, said, 9) == []


def test_few_frames_have_the_byte_that_ends_a_command():
    assert answers(McuLog(), b'Invalid Command\r\n', 400, every=30)


@pytest.mark.parametrize(('said', 'every'), [
    (b'cmd timeout\n', 1), (b'err 0.01 command 0.5\n', 1), (b'ERR: imu not found\r\n', 1),
    (b'crc error\r\n', 1), (b'error 5\n', 1), (b'insufficient bytes\nunknown command\n', 1),
    (b'vel2d receiver 1: running, 9 good, 0 bad, 0 refused, 0 stops\r\nERR\n', 1),
    (b'rst:0x1 (POWERON_RESET),boot:0x13\r\ninvalid header: 0xffffffff\n', 1),
    (b'pose 1\npose 2\nUnknown command\n', 1), (b'ERROR\n', 3), (b'ERROR\n' * 3, 1)])
def test_an_mcu_that_speaks_the_frame_and_says_so_much(said, every):
    lines = answers(McuLog(), said, 400, every)
    assert [line for line in lines if 'commands in text' in line] == []


def test_a_word_now_and_then_is_no_answer():
    assert answers(McuLog(), b'unknown command\n', 40, period=10 * NS_PER_S) == []


def test_what_the_mcu_reports():
    """A report is values, not a line of the log; a stop by itself is a complaint."""
    mcu = McuLog()

    def hear(now_s, said):
        mcu.feed(f'vel2d receiver {said}\r\n'.encode(), now_s * NS_PER_S)
        return [line.split(',')[0] for line in mcu.complaints(now_s * NS_PER_S, 'words')]

    stopped = ['the watchdog of the MCU stopped the rover']
    assert mcu.report_values(0) == {}                               # silent, as most are
    assert hear(1, '1: running, 70 good, 3 bad, 1 refused, 2 stops') == []
    assert dict(link(mcu=mcu, now=3 * NS_PER_S).values).items() >= {
        'MCU version': '1', 'MCU state': 'running', 'MCU good frames': '70',
        'MCU bad frames': '3', 'MCU refused frames': '1', 'MCU watchdog stops': '2',
        'MCU report age (s)': '2.0'}.items()
    assert hear(2, '1: stopped, 70 good, 3 bad, 1 refused, 3 stops') == stopped
    assert hear(20, '1: stopped, 70 good, 3 bad, 1 refused, 3 stops') == stopped
    assert hear(29, '1: running, 70 good, 3 bad, 1 refused, 4 stops') == stopped
    assert mcu.complaints(39 * NS_PER_S, 'words') == []             # it says nothing any more
    assert hear(40, '1: running, 70 good, 3 bad, 1 refused, 4 stops') == []
    assert hear(41, '1: waiting, 0 good, 0 bad, 0 refused, 0 stops') == []      # it restarted
    assert mcu.take_lines(NS_PER_S) == []
    assert hear(42, '2: running on') == ['the receiver of the MCU has version 2']
    assert len(mcu.report_values(0)) == 2                           # no figures


@pytest.mark.parametrize('text', ['1: running, 5 good', ': hello', '9999999999: running'])
def test_what_is_no_report_is_logged_as_ever(text):
    mcu = McuLog()
    mcu.feed(f'vel2d receiver {text}\n'.encode())
    assert mcu.take_lines(NS_PER_S) == [f'vel2d receiver {text}']
    assert not mcu.report_values(NS_PER_S)
    assert mcu.complaints(NS_PER_S, 'words') == []


@pytest.mark.parametrize(('name', 'value', 'begin'), ROWS['warnings'])
def test_what_is_possible_and_probably_not_meant_is_doubted(name, value, begin):
    values = {parameter.name: parameter.default for parameter in PARAMETERS}
    assert warnings(values) == []
    [line] = warnings({**values, name: value})
    assert line.startswith(begin)
    assert '; set ' in line


@pytest.mark.parametrize('rate', range(2, 40))
def test_the_timeout_that_is_advised_is_long_enough(rate):
    values = {parameter.name: parameter.default for parameter in PARAMETERS}
    values |= {'cmd_vel_timeout': 0.05, 'max_rate': float(rate)}
    [line] = [line for line in warnings(values) if line.startswith('cmd_vel_timeout')]
    values['cmd_vel_timeout'] = float(re.search(r'set cmd_vel_timeout to ([\d.]+) s', line)[1])
    assert not [line for line in warnings(values) if line.startswith('cmd_vel_timeout')]


@pytest.mark.parametrize('enabled', [True, False])
def test_a_stop_that_is_owed_is_an_error_whatever_else_is_so(enabled):
    status = commands(OPEN._replace(is_open=False, driving=False, owes_stop=True, enabled=enabled))
    assert status.level == Level.ERROR
    assert status.message.startswith('no stop could be sent, the rover may be driving')
    assert dict(status.values)['State'] == 'unknown'


def test_a_limit_that_is_taken_away_is_said():
    before = {'max_linear_x': 0.5, 'max_linear_y': 0.0, 'max_angular_z': 1.0, 'max_stamp_age': 0.0}
    assert removed_limits(before, before | {'max_linear_x': 0.0, 'max_angular_z': 0.5}) == [
        'max_linear_x: now 0, so there is no limit any more; it was 0.5']
