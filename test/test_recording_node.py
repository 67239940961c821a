# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""The monitor as a node: it records and replays alike, and says what it reads of joints."""
from itertools import pairwise
import math
import signal

from harness import Program
from harness import wait
import pytest

from servobus.sources.capture import Reader

pytestmark = [pytest.mark.ros, pytest.mark.realtime(bears=0.05)]
DEVICES = "['1-3:MX-106']"
TICK = 0.0015339807879             # rad: the resolution of the encoder
STALL_S = 0.1


def monitor(port, **parameters):
    options = [part for name, value in {'ports': port, **parameters}.items()
               for part in ('-p', f'{name}:={value}')]
    return Program('dxl_monitor.start', '--ros-args', *options)


def fake_bus(link, *arguments):
    return Program('mecarover_fakes.fake_bus', '--link', str(link), *arguments)


@pytest.fixture
def heard(graph):
    """Forget what earlier tests left."""
    graph.statuses.clear()
    graph.heard.clear()
    return graph


def test_a_capture_of_the_node_replayed_to_the_node(tmp_path, heard):
    path = tmp_path / 'bus.txt'
    with fake_bus(tmp_path / 'bus', '--devices', '1-3:MX-106'), \
            monitor(tmp_path / 'bus', capture=path, devices=DEVICES) as node:
        node.wait_for('recording to')
        heard.wait_status('dxl_monitor: 003', 'connected', level=0)
        heard.wait_status('dxl_monitor: bus', 'Capture=recording to')
        node.signal(signal.SIGINT)
        assert node.exit_code() == 0
    size = sum(len(chunk.data) for chunk in Reader(path.open('rb')))
    assert size > 1000
    heard.statuses.clear()
    link = tmp_path / 'replayed'
    with Program('servobus.tools.replay', str(path), '--link', str(link), '--stay') as replay, \
            monitor(link, devices=DEVICES):
        replay.wait_for('played')
        heard.wait_status('dxl_monitor: bus', f'Bytes={size}')
        assert heard.values('dxl_monitor: 003')['Missed Answers'] == '0'


def test_a_full_disk_stops_the_capture_and_not_the_node(tmp_path, heard):
    with fake_bus(tmp_path / 'bus', '--devices', '1:MX-106'), \
            monitor(tmp_path / 'bus', capture='/dev/full') as node:
        node.wait_for('capture stopped: /dev/full: No space left on device')
        heard.statuses.clear()
        heard.wait_status('dxl_monitor: bus', 'Capture=capture stopped', '1 of 1', level=1)
        stopped = 'No space left on device; make room and restart the node'
        assert stopped in heard.statuses['dxl_monitor: bus'].message
        count = int(heard.values('dxl_monitor: bus')['Packets'])
        wait(lambda: int(heard.values('dxl_monitor: bus')['Packets']) > count)
        assert heard.statuses['dxl_monitor: bus'].level == b'\x01'     # for as long as it lasts
        assert len(node.said('capture stopped')) == 1


@pytest.mark.parametrize(('path', 'reason'), [
    ('/does/not/exist/x', 'No such file or directory'), ('/', 'is a directory')])
def test_a_capture_that_cannot_be_is_one_line(ros, path, reason):
    with monitor('/dev/null-port', capture=path) as node:
        assert node.exit_code() == 2
        assert node.lines == [f'dxl_monitor: capture: {path}: {reason}; give another file name']


def test_joint_states_of_a_sine(tmp_path, heard):
    from rclpy.qos import qos_profile_sensor_data
    from sensor_msgs.msg import JointState
    told = []
    subscription = heard.node.create_subscription(
        JointState, '/dxl/joint_states', told.append, qos_profile_sensor_data)
    try:
        with fake_bus(tmp_path / 'bus', '--devices', '1-3:MX-106', '--fault', 'silent:2:3:1'), \
                monitor(tmp_path / 'bus', joint_state_rate='50.0',
                        devices="['1:MX-106:hip','2:MX-106:knee','3:MX-106:foot']"):
            wait(lambda: len(told) > 150)
    finally:
        heard.node.destroy_subscription(subscription)
    stamps = [message.header.stamp.sec + message.header.stamp.nanosec / 1e9 for message in told]
    assert stamps == sorted(set(stamps))
    assert {name for message in told for name in message.name} == {'hip', 'knee', 'foot'}
    for message in told:
        assert len(message.position) == len(message.velocity) == len(message.effort) \
            == len(message.name) > 0
    hip = [(stamp, message.position[message.name.index('hip')])
           for stamp, message in zip(stamps, told, strict=True) if 'hip' in message.name]
    # What a joint says at a time, to the encoder, is held in test_joints.py, in simulated time.
    # Here the bus itself may stand still for a moment: no joint moves faster than the sine does.
    fastest = 0.6 * math.tau / 3.0
    jumps = [abs(here - there) - fastest * (now - then + STALL_S)
             for (then, there), (now, here) in pairwise(hip)]
    assert sorted(jumps)[int(0.95 * len(jumps))] <= 2 * TICK
    assert max(position for _, position in hip) - min(position for _, position in hip) > 0.1
