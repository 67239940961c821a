# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""What the dashboard makes of messages: rows, changes since a version, tables, age, limits."""

import pytest
from synthetic_robot import serialise
from synthetic_robot import SyntheticRobot

from mecarover_dashboard import cdr
from mecarover_dashboard.rows import rounded
from mecarover_dashboard.state import FORGET_S
from mecarover_dashboard.state import MOST_OF_MESSAGE
from mecarover_dashboard.state import MOST_OF_STATUS
from mecarover_dashboard.state import MOST_ROWS
from mecarover_dashboard.state import State
from mecarover_dashboard.state import TABLES
from msg_defs import status_keys as keys
from msg_defs.diagnostics import Level
from msg_defs.diagnostics import Status
from servobus.bus.report import Finding

KNEE = 'dxl_monitor: 007 left_knee'


@pytest.fixture
def robot():
    return SyntheticRobot()


def told(robot, state=None, now_s=100.0):
    state = State() if state is None else state
    robot.tell(state, now_s)
    return state


def one_device(values=(), **fields):
    status = Status('dxl_monitor: 011', Level.OK, 'connected', '11',
                    [('Model', 'MX-106'), ('Firmware Version', '44'), ('State', 'connected'),
                     *values])
    return status._replace(**fields)


def take_one(status, topic=TABLES, state=None, now_s=1.0):
    state = State() if state is None else state
    state.store_message(topic, serialise([status]), now_s)
    return state


@pytest.mark.ros
def test_the_format_is_that_of_ros(robot, ros):
    from rclpy.serialization import deserialize_message
    from rclpy.serialization import serialize_message
    data = serialise(robot.tables(3.0))
    message = deserialize_message(data, ros.DiagnosticArray)
    assert len(message.status) == len(robot.tables(3.0))
    again = cdr.statuses(serialize_message(message))
    assert [one.pairs() for one in again] == [one.pairs() for one in cdr.statuses(data)]


def test_buses_are_told_apart():
    robot = SyntheticRobot({'left': ((1, 'MX-64', ''),), 'right': ((1, 'MX-64', 'hand'),)})
    changes = told(robot).changes(0)
    assert {(row['bus'], row['id'], row['joint']) for row in changes['devices'].values()} \
        == {('left', 1, ''), ('right', 1, 'hand')}
    assert {row['bus'] for row in changes['buses'].values()} == {'left', 'right'}
    assert {row['of'] for row in changes['timing'].values()} == {'left', 'right', ''}


def test_robots_are_told_apart():
    robots = [SyntheticRobot(namespace=name) for name in ('rover1', 'rover2')]
    robots[1].lost = {7}
    everything, one = State(), State('rover1')
    for robot in robots:
        told(robot, everything)
        for topic, message in robot.messages(100.0):
            if topic == '/diagnostics' or robot is robots[0]:
                one.store_message(topic, message, 100.0)
    found = everything.changes(0)
    assert {section: len(rows) for section, rows in found.items()} \
        == {'devices': 48, 'buses': 2, 'bridge': 4, 'timing': 28}
    assert found['devices'][f'rover1/{KNEE}']['state'] == 'connected'
    assert found['devices'][f'rover2/{KNEE}']['state'] == 'disconnected'
    assert {row['bus'] for row in found['devices'].values()} == {''}
    assert {row['robot'] for rows in one.changes(0).values() for row in rows.values()} \
        == {'rover1'}
    assert len(one.changes(0)['devices']) == 24


def test_buses_of_robots_are_told_apart():
    robot = SyntheticRobot({'left': ((1, 'MX-64', ''),)}, namespace='fleet/rover1')
    [device] = told(robot).changes(0)['devices'].values()
    assert (device['robot'], device['bus'], device['id']) == ('fleet/rover1', 'left', 1)


@pytest.mark.parametrize(('name', 'bus', 'hardware_id'), [
    ('r/m: 011', '', 'r/servo bus left/ID 11'), ('r/m: 011', '', 'r/11'),
    ('r/m: left/011', 'left', 'r/servo bus left/ID 11'), ('r/m: left/011', 'left', 'r/left/11'),
    ('m: a/b 1/011 knee', 'a/b 1', 'servo bus a/b 1/ID 11')])
def test_the_bus_of_a_device_in_new_and_old_recordings(name, bus, hardware_id):
    state = State()
    pairs = [('Model', 'MX-64'), ('Firmware Version', '1'), ('State', 'connected')]
    take_one(Status(name, Level.OK, '', hardware_id, pairs), state=state)
    [device] = state.changes(0)['devices'].values()
    assert (device['bus'], device['id']) == (bus, 11)


def test_statuses_of_others_are_none_of_ours():
    state = State()
    others = [Status('cpu_monitor: usage', Level.OK, 'fine', 'pi', [('Load', '3')]),
              Status('no colon', Level.ERROR, '', '', []),
              Status('camera: bus', Level.OK, 'usb', '', [('Speed', '480')]),
              Status('camera: link', Level.OK, '', '', [])]
    state.store_message('/diagnostics', serialise(others), 1.0)
    assert state.changes(0) == {}


def test_the_short_form_keeps_what_only_the_long_one_says(robot):
    robot.lost = {7}
    state = told(robot)
    robot_bus = state.changes(0)['buses']['dxl_monitor: bus']
    assert robot_bus['errors'][0][1].endswith('007: no answer to Read at Present Position')
    assert any(field.key == 'Present Position (rad)' for field in state.table(KNEE).fields)


def test_an_error_of_no_possible_time_has_none():
    """An infinite one is no JSON: no page got anything more."""
    lines = [f'{"9" * 400}.0 s: noise', '2.5 s: noise']
    state = take_one(Status('m: bus', Level.OK, '', '', [
        (keys.PORT, ''), (keys.RUNNING, '10'),
        *((f'{keys.ERROR}{at}', line) for at, line in enumerate(lines))]), now_s=100.0)
    [bus] = state.changes(0)['buses'].values()
    assert bus['errors'] == [(None, lines[0]), (92.5, 'noise')]


def test_a_lost_device_does_not_hide_another_with_an_error(robot):
    robot.lost, robot.faulty, robot.warned = {7}, {8, 9}, {10}
    part = told(robot).parts()[0]
    assert (part.problems, part.number, part.mark, part.ids) \
        == (('lost', 'error'), 3, '007 silent; 008, 009 hardware error', (7, 8, 9))
    assert part.headline == f'3 problems: {part.mark}'
    assert part.text == ('Lost: 007 left_knee, disconnected: 7 answers missed; '
                         'Error: 008 right_knee, 009 left_ankle_pitch')


def test_all_devices_are_called_all(robot):
    robot.warned = {number for number, *_ in robot.buses['']}
    part = told(robot).parts()[0]
    assert (part.mark, part.text) == ('all 24 12 of 310 answers missed', 'Warning: all 24')


def test_which_devices_suffer_from_what_a_bus_has_is_in_its_row(robot):
    robot.findings = [Finding('brown_out', Level.ERROR, None, 'all restarted',
                              covers=(*range(1, 21), 100))]
    bus = told(robot).changes(0)['buses']['dxl_monitor: bus']
    assert bus['covers'] == dict.fromkeys([*range(1, 21), 100], ('error', 'brown_out'))
    assert not any('covers' in key for key, _ in bus['values'])


def test_what_is_after_a_broken_cable_is_no_problem_of_its_own(robot):
    robot.lost = {7, 8, 9}
    part = told(robot).parts()[0]
    assert (part.number, part.mark) == (3, '007, 008, 009 silent')
    robot.findings = (Finding('broken_cable', Level.ERROR, 7, 'the cable is unplugged'),)
    part = told(robot).parts()[0]
    assert (part.number, part.mark, part.ids) == (1, '007 broken cable', (7,))


@pytest.mark.parametrize(('level', 'message', 'problems'), [
    (Level.STALE, 'silent: the master stopped', ('silent', 'error')),
    (Level.WARN, 'none of 2 devices answers', ('no device answers', 'error'))])
def test_a_problem_of_the_bus_does_not_hide_what_was_found_of_a_device(level, message, problems):
    """What was found of it stays so while nothing is read of it any more."""
    hot = '82 \u00b0C, last read at 20:46:30'
    kind = [('Model', 'MX-106'), ('Firmware Version', '44')]
    state = State()
    state.store_message(TABLES, serialise([
        Status('dxl_monitor: bus', level, message, '', [('Port', '/dev/ttyUSB0')]),
        Status('dxl_monitor: 003', Level.ERROR, 'disconnected', '3',
               [*kind, ('State', 'disconnected')]),
        Status('dxl_monitor: 005', Level.ERROR, hot, '5',
               [*kind, ('State', 'waiting'), (f'{keys.FINDING}too_hot', hot),
                (f'{keys.SEVERITY}too_hot', 'error')])]), 1.0)
    [part] = state.parts()
    assert (part.level, part.problems, part.text) \
        == (Level.ERROR, problems, f'{message}; Error: 005, {hot}')


def test_table(robot):
    state = told(robot)
    table = state.table(KNEE)
    fields = {field.key: field for field in table.fields}
    assert len(fields) == len(table.fields) == 60
    assert fields['Goal Position (rad)'].source == 'w'
    assert fields['Present Position (rad)'].source == 'r'
    assert fields['Present Position (rad)'].seen == pytest.approx(100 - 0.01, abs=0.01)
    assert fields['Operating Mode'].raw == '0'
    assert dict(table.facts)['Firmware Version'] == '44'
    assert dict(table.facts)['Fields not observed'] == '9'
    assert state.table('unknown') is None
    assert state.table(KNEE) is table
    state.keep_tables(set())
    assert state.table(KNEE) is not table


def test_a_field_that_was_not_seen_again_keeps_its_time():
    values = [('ID', '11'), ('observed', '{"ID":[20.0,"r"]}')]
    state = take_one(one_device(values), now_s=100.0)
    first = state.table('dxl_monitor: 011')
    values[1] = ('observed', '{"ID":[20.4,"r"]}')
    take_one(one_device(values), state=state, now_s=100.55)
    assert state.table('dxl_monitor: 011') == first


def test_the_last_300_points_of_a_metric_are_kept():
    state = take_one(one_device())
    names = ('dxl_monitor: timing/011/reply_latency', 'dxl_monitor: timing/write')
    for at in range(310):
        for name in names:
            take_one(Status(name, Level.OK, '', '', [('p50 (ms)', '1')]), 'dxl/timing', state, at)
    assert len(state.latency('dxl_monitor: 011', 0.0)) == 300
    [write] = state.changes(0)['timing'].values()
    assert len(write['points']) == 300


def test_silence_is_judged_by_arrival(robot):
    state = told(robot, now_s=100.0)
    state.expire(103.0)
    before = state.version
    assert 'quiet_since' not in state.changes(0)['devices'][KNEE]
    state.expire(105.0)
    assert state.changes(before)['devices'][KNEE]['quiet_since'] == 100.0
    before = state.version
    state.expire(300.0)                         # the node itself is silent: last values stay
    assert state.changes(before) == {}
    told(robot, state, 301.0)
    assert 'quiet_since' not in state.changes(before)['devices'][KNEE]


def test_a_slow_monitor_is_not_silent():
    state = State()
    for now_s in (10.0, 20.0, 20.01, 30.0, 30.01):
        take_one(one_device(), state=state, now_s=now_s)
    state.expire(40.0)
    assert 'quiet_since' not in state.changes(0)['devices']['dxl_monitor: 011']
    state.expire(60.0)
    assert 'quiet_since' in state.changes(0)['devices']['dxl_monitor: 011']


def test_what_its_node_does_not_know_any_more_goes(robot):
    state = told(robot)
    fewer = SyntheticRobot({'': ((1, 'MX-106', 'left_hip_yaw'),)})
    later = 100.0 + FORGET_S + 1
    told(fewer, state, later)
    before = state.version
    state.expire(later)
    assert state.changes(before)['devices'][KNEE] is None
    assert set(state.changes(0)['devices']) == {'dxl_monitor: 001 left_hip_yaw'}
    assert (state.table(KNEE), state.changes(state.version)) == (None, {})
    told(robot, state, later + 1)
    assert state.changes(before)['devices'][KNEE]['id'] == 7


def test_long_rows_cannot_fill_the_memory(monkeypatch):
    """Names are few here: it is the bytes that are bounded."""
    state = State()
    monkeypatch.setattr('mecarover_dashboard.state.MOST_BYTES', 4_000_000)
    for at in range(20):
        take_one(Status(f'x: bus {at}', Level.OK, '', '', [('Port', '')] + [
            (f'{key}' * 50, 'x' * 400) for key in range(1000)]), '/diagnostics', state)
    assert state.refused
    assert 2_000_000 < state.bytes <= 4_000_000
    assert 0 < len(state.changes(0)['buses']) < 10


def test_what_is_kept_of_a_message_is_what_is_shown_of_it():
    """A row kept the whole message it came in, with all else that was in it."""
    state = State()
    filler = Status('x: other', Level.OK, 'z' * 100, '', [('a', 'b' * 1000)])
    state.store_message(TABLES, serialise([filler] * 100 + [one_device([('a', 'b')])]), 1.0)
    [(name, _)] = state.changes(0)['devices'].items()
    assert len(state._entries['devices'][name].whole.data) < 200
    assert state.table(name).facts[-1] == ('a', 'b')


def test_the_silent_make_room_where_bytes_are_short_too(monkeypatch):
    monkeypatch.setattr('mecarover_dashboard.state.MOST_BYTES', 1_000_000)
    state = State()
    for at in range(20):
        take_one(Status(f'x: timing/{at}', Level.OK, '', '', [('value (%)', '1')]), state=state)
    before = state.refused
    assert before
    take_one(Status('x: timing/new', Level.OK, '', '', [('value (%)', '1')]), state=state,
             now_s=FORGET_S + 2)
    assert state.refused == before
    assert len(state.changes(0)['timing']) == 1


def test_messages_of_others_are_bounded_too():
    state = take_one(one_device(message='z' * MOST_OF_MESSAGE))
    assert state.refused == 1
    take_one(one_device([('z' * MOST_OF_STATUS, '')]), state=state)
    assert state.refused == 2
    state.store_message(TABLES, serialise([one_device(name=f'a: 011 {n}') for n in range(
        2 * cdr.STATUSES_READ_MAX)]), 1.0)
    assert state.refused == 2 + cdr.STATUSES_READ_MAX - MOST_ROWS


def test_a_crowd_that_has_left_makes_room():
    state = State()
    for at in range(0, MOST_ROWS, 100):
        state.store_message('/diagnostics', serialise(
            [one_device(name=f'node{at + i}: 011') for i in range(100)]), 1.0)
    take_one(one_device(name='dxl_monitor: 012'), state=state, now_s=FORGET_S)
    assert state.refused == 1
    take_one(one_device(name='dxl_monitor: 012'), state=state, now_s=FORGET_S + 2)
    assert [*state.changes(0)['devices']] == ['dxl_monitor: 012']
    assert state.bytes < 10_000
    assert state.changes(1)['devices']['node0: 011'] is None


@pytest.mark.parametrize(('unit', 'limits'), [('rad', ('-3.14', '3.14')), ('m', ('', ''))])
def test_a_position_has_its_unit_and_is_exact_many_turns_away(unit, limits):
    """Three significant digits of 256 turns are wrong by 86 degrees; a gripper moves by metres."""
    state = take_one(one_device([
        (f'Present Position ({unit})', '1608.49'), ('Min Position Limit (rad)', '-3.14'),
        ('Max Position Limit (rad)', '3.14')]))
    [values] = state.values().values()
    assert (values.position, values.position_unit) == ('1608.49', unit)
    assert values.limits[:2] == limits
    assert rounded('0.05321', 3) == '0.053'
    assert rounded('NaN', 3) == 'NaN'
