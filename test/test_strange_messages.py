# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""What no node should send and any node can: rclpy raises at it, and both nodes live on."""
from harness import bridge
from harness import Program
from harness import wait
import pytest

pytestmark = pytest.mark.ros
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
    assert client.wait_for_service(10.0)
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
    """Whatever the middleware makes of them: the next command is heard."""
    with bridge(mcu) as running:
        wait(cmd_vel.get_subscription_count)
        for size in (0, 3, 8, 20):
            cmd_vel.publish(bytes(size))
        with ros.Teleop(cmd_vel, lambda: ros.twist(0.3)):
            wait(lambda: mcu.velocity is not None and mcu.velocity.x > 0)
        assert is_well(ros, graph, 'vel2d_bridge')
    assert 'Traceback' not in running.text
