# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""What no node should send and any node can: rclpy raises at it, and both nodes live on."""
from types import SimpleNamespace

from harness import DEADLINE_S
from harness import Program
from harness import wait
import pytest
from running_bridge import bridge

pytestmark = [pytest.mark.ros, pytest.mark.realtime(bears=0.1)]
NO_TYPE = 99                    # a ParameterValue has types up to 9
FLOOD = 3000


@pytest.fixture(params=['vel2d_bridge', 'dxl_monitor'])
def node(request, mcu, tmp_path):
    """Return a node whose clock is that of /clock, and its name."""
    sim = ('-p', 'use_sim_time:=true')
    if request.param == 'vel2d_bridge':
        running = bridge(mcu, *sim)
    else:
        running = Program('dxl_monitor.start', '--ros-args', '-p',
                          f'ports:={tmp_path}/none', *sim)
    with running:
        yield request.param, running
        assert 'Traceback' not in running.text


def is_well(ros, graph, name):
    return graph.call(ros.Trigger, f'/{name}/reset_statistics').success


def test_a_parameter_of_a_type_that_does_not_exist(ros, graph, node):
    name, running = node
    client = graph.node.create_client(ros.SetParameters, f'/{name}/set_parameters')
    assert client.wait_for_service(DEADLINE_S)
    request = ros.SetParameters.Request(parameters=[
        ros.ParameterMessage(name='x', value=ros.ParameterValue(type=NO_TYPE))])
    client.call_async(request)
    line = running.wait_for('WARN', 'set_parameters_callback: ValueError: 99 is not a valid')
    for _ in range(3):
        client.call_async(request)
    assert is_well(ros, graph, name)
    assert running.said('WARN', 'is not a valid') == [line]
    graph.node.destroy_client(client)


def test_a_clock_before_1970(ros, graph, node):
    name, running = node
    publisher = graph.publisher('/clock', ros.Clock, 10)
    try:
        message = ros.Clock()
        message.clock.sec = -1
        with ros.Teleop(publisher, lambda: message, rate=20.0):
            running.wait_for('WARN', 'clock_callback: ValueError: ', 'correct that node')
        assert is_well(ros, graph, name)
    finally:
        graph.node.destroy_publisher(publisher)


def test_a_storm(ros, graph, mcu, cmd_vel, tmp_path):
    """It drives on meanwhile, and its log does not fill."""
    clock = graph.publisher('/clock', ros.Clock, 10, heard=False)
    message = ros.Clock()
    message.clock.sec = -1
    try:
        with bridge(mcu, '-p', 'use_sim_time:=true') as running, \
                ros.Teleop(cmd_vel, lambda: ros.twist(0.3), rate=50.0):
            wait(clock.get_subscription_count)
            wait(lambda: mcu.velocity is not None and mcu.velocity.x > 0)
            with ros.Teleop(clock, lambda: message, rate=1000.0) as storm:
                wait(lambda: storm.sent > FLOOD)
                assert mcu.velocity.x > 0
                assert is_well(ros, graph, 'vel2d_bridge')
            assert len(running.said('clock_callback')) == 1
            graph.wait_status('vel2d_bridge: commands', 'Time-outs=0')
    finally:
        graph.node.destroy_publisher(clock)


def test_bytes_that_are_no_message(ros, graph, mcu, cmd_vel):
    """The middleware may do anything with them: the next command is heard."""
    with bridge(mcu) as running:
        wait(cmd_vel.get_subscription_count)
        for size in (0, 3, 8, 20):
            cmd_vel.publish(bytes(size))
        with ros.Teleop(cmd_vel, lambda: ros.twist(0.3)):
            wait(lambda: mcu.velocity is not None and mcu.velocity.x > 0)
        assert is_well(ros, graph, 'vel2d_bridge')
    assert 'Traceback' not in running.text


def test_a_mistake_of_ours_ends_the_node(ros, graph, mcu):
    """It would do who knows what; a new one is started."""
    script = """
import sys
from vel2d_bridge import main
from vel2d_bridge.bridge_timing import Timing
begins = Timing.reset
Timing.reset = lambda self: 1 / 0 if hasattr(self, 'series') else begins(self)
sys.exit(main.main())"""
    with bridge(mcu, script=script) as running:
        client = graph.node.create_client(ros.Trigger, '/vel2d_bridge/reset_statistics')
        assert client.wait_for_service(DEADLINE_S)
        client.call_async(ros.Trigger.Request())
        assert running.exit_code() == 1
        graph.node.destroy_client(client)
    assert running.said('ZeroDivisionError')


@pytest.fixture
def mishaps(ros):
    """Return what survives errors, of a node with one timer that rclpy is about to call."""
    from mecarover_serial.ros_node import _SpinErrors
    timer = SimpleNamespace(_executor_event=True, callback_group=SimpleNamespace(
        _active_entity='timer'))
    node = SimpleNamespace(lines=[], timers=[timer], **dict.fromkeys(
        ('subscriptions', 'guards', 'clients', 'services', 'waitables'), ()))
    node.get_logger = lambda: SimpleNamespace(warning=node.lines.append)
    return _SpinErrors(SimpleNamespace(node=node))


def test_an_executor_that_only_raises_ends_the_node(ros, mishaps):
    assert all(mishaps._survives(ValueError('1'), now) for now in (100.0, 105.0, 109.9))
    assert not mishaps._survives(ValueError('1'), 110.0)
    mishaps.spin_once(SimpleNamespace(spin_once=lambda: None))
    assert mishaps._survives(ValueError('1'), 111.0)


def test_what_rclpy_was_about_to_call_is_called_the_next_time(mishaps):
    mishaps._survives(ValueError('1'), 100.0)
    [timer] = mishaps._node.timers
    assert not timer._executor_event and timer.callback_group._active_entity is None


def test_a_line_a_minute_for_each_kind(mishaps):
    for tenth in range(1210):
        mishaps._survives(ValueError('1'), tenth / 10)
    assert len(mishaps._node.lines) == 3
    mishaps._survives(MemoryError(), 121.0)
    assert mishaps._node.lines[3:] == [
        'no memory is left, so a call was left out; raise the limit (ulimit -v, MemoryMax=) or '
        'end other programs']
