# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""MCAP files: read by mcap's own reader, rosbags and ROS; they hold what a node publishes."""
from functools import cache
from importlib.util import find_spec
import math

import pytest
from test_dump import BAUD
from test_dump import bursts
from test_dump import capture
from test_dump import dump
from test_dump import MODELS

from servobus.bus.decoder import Settings
from servobus.bus.expected_devices import parse_all
from servobus.doctor.case import OPTIONS
from servobus.monitor import Monitor
from servobus.status import bus_status
from servobus.status import device_status
from servobus.status import PortState

pytestmark = pytest.mark.skipif(not (find_spec('mcap') and find_spec('rosbags')),
                                reason='skipped: mcap and rosbags are not installed')
TOPICS = {'/dxl/diagnostics': 'diagnostic_msgs/msg/DiagnosticArray',
          '/dxl/timing': 'diagnostic_msgs/msg/DiagnosticArray',
          '/dxl/joint_states': 'sensor_msgs/msg/JointState'}


@pytest.fixture(scope='module')
def recorded(tmp_path_factory):
    """Return the path of a recording, and its messages by topic: (data, time)."""
    from mcap.reader import make_reader
    folder = tmp_path_factory.mktemp('mcap')
    heard = bursts('silent:2:1.0', pattern='sync', seconds=3.0)
    text, path = capture(folder / 'bus.txt', heard), folder / 'bus.mcap'
    dump(text, '-w', path, '--devices', '1:MX-106:left', '--devices', '2:MX-106:right')
    messages = {topic: [] for topic in TOPICS}
    with path.open('rb') as file:
        for schema, channel, message in make_reader(file).iter_messages():
            assert schema.name == TOPICS[channel.topic]
            messages[channel.topic].append((message.data, message.log_time))
    return heard, messages


@cache
def store():
    from rosbags.typesys import get_typestore
    from rosbags.typesys import Stores
    return get_typestore(Stores.ROS2_JAZZY)


def decoded(data, topic):
    return store().deserialize_cdr(data, TOPICS[topic])


def statuses(data):
    return decoded(data, '/dxl/diagnostics').status


def test_it_holds_what_a_node_makes_of_the_same_bytes(recorded):
    heard, messages = recorded
    settings = Settings(BAUD, parse_all(['1:MX-106:left', '2:MX-106:right']))
    monitor, due, expected = Monitor('bus', MODELS, settings, names=OPTIONS), 0, []
    for data, stamp in heard:
        monitor.feed(data, stamp)
        if stamp >= due:
            due = stamp + 500_000_000
            report = monitor.report(stamp)
            expected.append([bus_status('dxl_monitor', '', report, PortState('', '', ()), True), *(
                device_status('dxl_monitor', '', one, report.findings, True)
                for one in report.devices)])
    found = [statuses(data) for data, _ in messages['/dxl/diagnostics']]
    assert [[(one.level, one.name, one.message, [(pair.key, pair.value) for pair in one.values])
             for one in some] for some in found] == [
        [(int(one.level), one.name, one.message, list(one.values)) for one in some]
        for some in expected]
    assert any(one.level == 2 for one in found[-1])
    assert len(messages['/dxl/timing']) == 3


def test_joints_have_their_names_and_the_time_of_the_bus(recorded):
    _, messages = recorded
    joints = [decoded(data, '/dxl/joint_states')
              for data, _ in messages['/dxl/joint_states']]
    assert len(joints) > 50
    assert {name for one in joints for name in one.name} >= {'left', 'right'}
    assert all(math.isfinite(value) for one in joints for value in one.position)
    assert 1_790_000_000 <= joints[0].header.stamp.sec <= joints[-1].header.stamp.sec


@pytest.mark.skipif(find_spec('rclpy') is None, reason='skipped: needs ROS 2')
def test_ros_reads_it(recorded):
    from diagnostic_msgs.msg import DiagnosticArray
    from rclpy.serialization import deserialize_message
    for data, _ in recorded[1]['/dxl/diagnostics']:
        theirs = deserialize_message(data, DiagnosticArray)
        assert [(one.name, one.message) for one in theirs.status] == [
            (one.name, one.message) for one in statuses(data)]


def test_what_it_needs_and_where_it_cannot_go_is_said(tmp_path):
    text = capture(tmp_path / 'bus.txt', bursts(seconds=0.1))
    (tmp_path / 'notes.mcap').write_text('shopping list')
    assert 'is not a recording of dxl_dump' in dump(text, '-w', tmp_path / 'notes.mcap', code=2)
    assert 'needs a file name' in dump(text, '-w', '-', '--format', 'mcap', code=2)
    assert not list(tmp_path.glob('tmp*'))
