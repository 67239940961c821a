# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""
Which commands the bridge hears: types, QoS, several publishers, stamps; and what it says of them.

Operators of their own, because one participant cannot have two types on one topic either.
"""
from contextlib import contextmanager
from functools import partial
import time

from harness import LATE_S
from harness import wait
import pytest
from running_bridge import bridge
from running_bridge import Mcu

from msg_defs.vel2d import STOP
from msg_defs.vel2d import Vel2d
from servobus.port.pty import Pty

pytestmark = [pytest.mark.ros, pytest.mark.realtime(bears=0.1)]
COMMANDS = 'rover/vel2d_bridge: commands'


@pytest.fixture(scope='module')
def running(graph, mcu):
    """Run a bridge with message_type auto, in a namespace and with a remapped topic."""
    with bridge(mcu, '-r', '__ns:=/rover', '-r', 'cmd_vel:=/teleop/cmd_vel') as running:
        yield running
        assert 'Traceback' not in running.text


@pytest.fixture
def operator(ros, graph, running):
    """
    Return a context: an operator that publishes, and no other; its publisher and its Graph.

    `name` becomes the node's name; what it publishes is a Twist or a TwistStamped.
    """
    @contextmanager
    def operator(name, kind, profile=1):
        with ros.Graph(name) as operator:
            yield operator.publisher('/teleop/cmd_vel', kind, profile, heard=False)

    graph.wait_status(COMMANDS, '/teleop/cmd_vel: no node publishes it', level=0)
    return operator


def drives(ros, mcu, publisher, message, velocity=None):
    """Publish at 50 Hz until the MCU has got it; return how long that took (s)."""
    velocity = velocity or Vel2d(0.3, 0.0, 0.0)
    begin = time.monotonic_ns()
    with ros.Teleop(publisher, message, rate=50):
        wait(lambda: mcu.velocity == velocity)
        return (time.monotonic_ns() - begin) / 1e9


@pytest.mark.usefixtures('again')
def test_auto_follows_a_teleop_that_changes_its_type(ros, graph, mcu, running, operator):
    """Both ways, within 1 s of the new publisher, the old command stopped first."""
    for kind, message, velocity in ((ros.TwistStamped, ros.stamped, Vel2d(0.1, 0.0, 0.0)),
                                    (ros.Twist, ros.twist, Vel2d(0.2, 0.0, 0.0))):
        mcu.receiver.arrivals.clear()
        with operator('teleop', kind) as publisher:
            taken_s = drives(ros, mcu, publisher, partial(message, *velocity), velocity)
            assert taken_s < 1.0 + LATE_S
        frames = [frame.velocity for frame in mcu.arrivals]
        assert frames[frames.index(velocity) - 1] == STOP
    assert running.said('/teleop/cmd_vel: the message type is twist_stamped now')


def test_two_types_at_once(ros, graph, mcu, running, operator):
    with operator('teleop_old', ros.Twist) as old, \
            ros.Teleop(old, lambda: ros.twist(0.3), rate=50):
        wait(lambda: mcu.velocity == Vel2d(0.3, 0.0, 0.0))
        with operator('teleop_new', ros.TwistStamped) as new, \
                ros.Teleop(new, lambda: ros.stamped(0.9), rate=50):
            graph.wait_status(
                COMMANDS, '/teleop_new is not heard, as it publishes', 'msg/TwistStamped',
                'the bridge subscribes twist; make all publishers agree', 'Complaint 1', level=1)
            running.wait_for('WARN', '/teleop_new is not heard')
            assert mcu.velocity == Vel2d(0.3, 0.0, 0.0)         # it stays with the old one
        graph.wait_status(COMMANDS, level=0)
    assert Vel2d(0.9, 0.0, 0.0) not in {frame.velocity for frame in mcu.arrivals}


def is_subscribed(graph, reliability):
    found = graph.node.get_subscriptions_info_by_topic('/teleop/cmd_vel')
    return [one.qos_profile.reliability.name for one in found] == [reliability]


def test_reliability_follows(ros, graph, mcu, operator):
    for reliable, name in ((False, 'BEST_EFFORT'), (True, 'RELIABLE')):
        with operator('teleop', ros.Twist, ros.qos(1, reliable)) as publisher:
            wait(partial(is_subscribed, graph, name))
            drives(ros, mcu, publisher, lambda: ros.twist(0.3))


def test_limits_keep_the_direction(ros, graph, mcu, operator):
    assert graph.set('/rover/vel2d_bridge', max_linear_x=0.5, max_angular_z=1.0) == ['', '']
    with operator('teleop', ros.Twist) as publisher:
        drives(ros, mcu, publisher, lambda: ros.twist(1.0, 0.5, 1.0), Vel2d(0.5, 0.25, 0.5))
        drives(ros, mcu, publisher, lambda: ros.twist(0.1, 0.5, 2.0), Vel2d(0.05, 0.25, 1.0))
        drives(ros, mcu, publisher, lambda: ros.twist(-0.5, 0.5, 1.0), Vel2d(-0.5, 0.5, 1.0))
    wait(lambda: int(graph.values(COMMANDS)['Commands limited']) > 0)
    assert graph.set('/rover/vel2d_bridge', max_linear_x=0.0, max_angular_z=0.0) == ['', '']


def test_stamps(ros, graph, mcu, running, operator):
    assert graph.set('/rover/vel2d_bridge', max_stamp_age=0.3) == ['']
    with operator('teleop', ros.TwistStamped) as publisher:
        drives(ros, mcu, publisher, lambda: ros.stamped(0.3))
        for late_s, reason in ((5.0, 'stamp too old'), (-5.0, 'stamp in the future')):
            with ros.Teleop(publisher, partial(ros.stamped, 0.9, late_s=late_s), rate=50):
                graph.wait_status(COMMANDS, f'commands are refused: {reason}',
                                  'set the clocks of both computers', level=1)
            running.wait_for('WARN', f'refused: {reason}')
        before = int(graph.values(COMMANDS)['Zero stamps'])
        drives(ros, mcu, publisher, lambda: ros.stamped(0.3, late_s=None))
        wait(lambda: int(graph.values(COMMANDS)['Zero stamps']) > before)
    assert Vel2d(0.9, 0.0, 0.0) not in {frame.velocity for frame in mcu.arrivals}
    assert graph.set('/rover/vel2d_bridge', max_stamp_age=0.0) == ['']


def test_stamps_without_a_clock(ros, graph, tmp_path):
    """use_sim_time without /clock: it is not the clocks of two machines that differ."""
    with Pty(str(tmp_path / 'mcu')) as pty, bridge(
            pty, '-r', '__ns:=/simulated', use_sim_time='true', max_stamp_age=0.3) as running:
        publisher = graph.publisher('/simulated/cmd_vel', ros.TwistStamped, heard=False)
        with ros.Teleop(publisher, partial(ros.stamped, 0.3), rate=50):
            line = running.wait_for('refused: stamp in the future')
            assert line.endswith('; start what publishes /clock, or set use_sim_time false')
            graph.wait_status('simulated/vel2d_bridge: commands', 'use_sim_time: it is true and '
                              'no node publishes /clock', 'start what publishes /clock', level=1)
        graph.node.destroy_publisher(publisher)


def test_overridden_qos_and_a_fixed_type(ros, graph, tmp_path):
    """The reliability is ours then, the type too: who does not fit is named. Without a /clock."""
    with Mcu(str(tmp_path / 'mcu')).running() as mcu, bridge(
            mcu, '-p', 'qos_overrides./fixed/cmd_vel.subscription.reliability:=reliable',
            '-r', '__ns:=/fixed', '-r', '__node:=base', '--log-level', 'fixed.base:=debug',
            message_type='twist', use_sim_time='true') as running:
        commands = 'fixed/base: commands'
        with ros.Graph('lossy') as lossy, ros.Graph('stamping') as stamping:
            best_effort = lossy.publisher('/fixed/cmd_vel', ros.Twist, ros.qos(1, False), False)
            stamping.publisher('/fixed/cmd_vel', ros.TwistStamped, heard=False)
            status = graph.wait_status(commands, '/lossy is not heard, as its QoS',
                                       'Best effort publisher and reliable subscription',
                                       '/stamping is not heard', 'Complaint 2', level=1)
            assert status.message.endswith('(and 1 more)')
            best_effort.publish(ros.twist(0.9))
        publisher = graph.publisher('/fixed/cmd_vel')
        drives(ros, mcu, publisher, lambda: ros.twist(0.5, -0.25, 1.0), Vel2d(0.5, -0.25, 1.0))
        running.wait_for('sending [0.5, -0.25, 1.0], crc: 3455344474')
        running.wait_for('sending [0.0, 0.0, 0.0], crc: ')
        assert Vel2d(0.9, 0.0, 0.0) not in {frame.velocity for frame in mcu.arrivals}


def test_best_effort_although_the_publisher_is_reliable(ros, graph, tmp_path):
    """As docs/teleop.md advises over Wi-Fi: then a lost command is not sent again, late."""
    with Mcu(str(tmp_path / 'mcu')).running() as mcu, bridge(
            mcu, '-p', 'qos_overrides./far/cmd_vel.subscription.reliability:=best_effort',
            '-r', '__ns:=/far', '-r', '__node:=base'):
        publisher = graph.publisher('/far/cmd_vel', profile=ros.qos(10))
        drives(ros, mcu, publisher, lambda: ros.twist(0.3))
        [ours] = graph.node.get_subscriptions_info_by_topic('/far/cmd_vel')
        assert ours.qos_profile.reliability == ros.qos(1, False).reliability
        graph.wait_status('far/base: commands', 'Reliability=best effort')
