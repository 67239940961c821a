# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""
How the bridge ends, is suspended, is killed and is frozen: the rover stops every time.

--times N repeats each (the figures in docs/reliability.md are from 25). The bridge promises 2 s
for its end and 0.3 s for the deadman; LATE_S is what a busy machine may add to the latter.
"""
from contextlib import contextmanager
import os
from pathlib import Path
import signal
import sys
import time

from bridge_family import FULL
from bridge_family import OUTLIVE_S
from harness import LATE_S
from harness import wait
import pytest
from running_bridge import bridge

from msg_defs.vel2d import STOP
from msg_defs.vel2d import Vel2d
from rigs.harness import family
from rigs.harness import is_alive

pytestmark = [pytest.mark.ros, pytest.mark.realtime(bears=0.1)]
ENDINGS = {
    'SIGINT': [signal.SIGINT],
    'SIGTERM': [signal.SIGTERM],
    'SIGHUP': [signal.SIGHUP],
    'SIGQUIT': [signal.SIGQUIT],
    'SIGINT twice': [signal.SIGINT, signal.SIGINT],
    'SIGINT, SIGTERM': [signal.SIGINT, signal.SIGTERM],
}


@contextmanager
def driving(ros, mcu, cmd_vel, rate=200):
    """Start a bridge, publish at `rate` (Hz), wait until the rover moves; yield both."""
    with bridge(mcu) as running, \
            ros.Teleop(cmd_vel, lambda: ros.twist(0.3, 0.1, 0.5), rate) as teleop:
        running.wait_for('open at')
        begin = time.monotonic_ns()
        mcu.since(begin, 1)
        wait(lambda: mcu.velocity == Vel2d(0.3, 0.1, 0.5))
        wait(lambda: not mcu.receiver.wheels.is_stop)
        yield running, teleop


def stops_only(frames):
    return {frame.velocity for frame in frames} == {STOP}


@pytest.mark.usefixtures('again')
@pytest.mark.parametrize('signals', ENDINGS.values(), ids=ENDINGS)
def test_ending_signals(ros, mcu, cmd_vel, signals):
    with driving(ros, mcu, cmd_vel) as (running, _):
        begin = time.monotonic_ns()
        for number in signals:
            running.signal(number)
            time.sleep(0.05 if len(signals) > 1 else 0)         # as `ros2 launch` does
        assert running.exit_code() == 0, running.text
        assert (time.monotonic_ns() - begin) / 1e9 < 2.0 + LATE_S
    wait(lambda: mcu.receiver.wheels.is_stop)
    assert stops_only(mcu.since(begin)[-5:])
    assert 'Traceback' not in running.text
    assert not running.said('Error'), running.text


@pytest.mark.parametrize('comes_back', [True, False])
def test_ended_while_the_port_is_lost(ros, mcu, cmd_vel, comes_back):
    """It waits a moment for the port, to send the stop that it owes; else it says so."""
    with driving(ros, mcu, cmd_vel) as (running, _):
        mcu.vanish()
        running.wait_for('lost')
        begin = time.monotonic_ns()
        running.signal(signal.SIGINT)
        if comes_back:
            mcu.come_back()
        assert running.exit_code() == 0, running.text
    warned = running.said('no stop could be sent, the rover may be driving on; switch it off')
    if comes_back:
        assert stops_only(mcu.since(begin, 5))
        wait(lambda: mcu.receiver.wheels.is_stop)
    else:
        assert len(warned) == 1, running.text
        assert not mcu.receiver.wheels.is_stop
        mcu.come_back()
    assert 'Traceback' not in running.text


@pytest.mark.parametrize('delay_s', [0.05, 0.1, 0.2, 0.3])
def test_signal_while_it_starts(mcu, delay_s):
    """It comes while ROS is imported, or the node made: the start is finished, then ended."""
    with bridge(mcu) as running:
        wait(running.children)                      # the deadman: main() has begun
        time.sleep(delay_s)
        running.signal(signal.SIGINT)
        assert running.exit_code() == 0, running.text
    assert 'Traceback' not in running.text


@pytest.mark.usefixtures('again')
def test_suspended_and_continued(ros, graph, mcu, cmd_vel):
    with driving(ros, mcu, cmd_vel) as (running, teleop):
        begin = time.monotonic_ns()
        running.signal(signal.SIGTSTP)
        wait(lambda: running.state() == 'T')
        assert mcu.stopped_at(begin) / 1e9 < 0.3 + LATE_S
        assert stops_only(mcu.since(time.monotonic_ns(), 10))
        teleop.stop()
        # What waits in the sockets is from before: it must not drive the rover.
        continued = time.monotonic_ns()
        running.signal(signal.SIGCONT)
        assert stops_only(mcu.since(continued, 10))
        # It stopped by itself, not only by its deadman.
        graph.wait_status('vel2d_bridge: commands', 'Stops: suspended=1')
        with ros.Teleop(cmd_vel, lambda: ros.twist(0.2), rate=50):
            wait(lambda: mcu.velocity == Vel2d(0.2, 0.0, 0.0))
        running.signal(signal.SIGINT)
        assert running.exit_code() == 0


@pytest.mark.usefixtures('again')
def test_killed(ros, mcu, cmd_vel):
    """The rover stops, nothing is left, and the next start, of the next test, finds the port."""
    with driving(ros, mcu, cmd_vel) as (running, _):
        [deadman] = running.children()
        begin = time.monotonic_ns()
        running.signal(signal.SIGKILL)
        assert mcu.stopped_at(begin) / 1e9 < 0.3 + LATE_S
        assert running.exit_code() == -signal.SIGKILL
        wait(lambda: not is_alive(deadman))


def stops_and_leaves(mcu, pids, *killed):
    begin = time.monotonic_ns()
    for pid in killed:
        os.kill(pid, signal.SIGKILL)
    assert mcu.stopped_at(begin) / 1e9 < 0.3 + LATE_S
    wait(lambda: not any(map(is_alive, pids)), OUTLIVE_S)


CLOSED = ['>&- 2>&-', '>/dev/null 2>&-', '<&- >&-']


@pytest.mark.usefixtures('again')
@pytest.mark.parametrize('streams', CLOSED)
def test_killed_with_closed_streams(ros, mcu, cmd_vel, streams):
    """As daemons start their programs; what is opened next must not get these numbers."""
    with bridge(mcu, prefix=['sh', '-c', f'exec "$@" {streams}', 'sh']) as running, \
            ros.Teleop(cmd_vel, lambda: ros.twist(0.3, 0.1, 0.5), 50):
        wait(lambda: mcu.velocity == Vel2d(0.3, 0.1, 0.5))
        pids = family(running.pid)
        assert len(pids) == 3
        assert all(os.path.exists(f'/proc/{pid}/fd/{fd}') for pid in pids for fd in range(3))
        stops_and_leaves(mcu, pids, running.pid)


@pytest.mark.usefixtures('again')
def test_killed_with_more_than_a_thousand_descriptors(ros, graph, mcu, cmd_vel):
    """What it says of its dead man is true then too."""
    with bridge(mcu, prefix=[sys.executable, '-c', FULL]) as running, \
            ros.Teleop(cmd_vel, lambda: ros.twist(0.3, 0.1, 0.5), 50):
        wait(lambda: mcu.velocity == Vel2d(0.3, 0.1, 0.5))
        graph.wait_status('vel2d_bridge: link', 'Deadman=ready')
        pids = family(running.pid)
        stops_and_leaves(mcu, pids, running.pid)


@pytest.mark.usefixtures('again')
def test_a_guard_that_does_not_respond_is_reported(ros, graph, mcu, cmd_vel):
    """While its server is stopped too; else another one takes its place."""
    with driving(ros, mcu, cmd_vel) as (running, _):
        _, server, deadman = family(running.pid)
        os.kill(server, signal.SIGSTOP)
        os.kill(deadman, signal.SIGSTOP)
        graph.wait_status('vel2d_bridge: link', 'deadman: its process is not responding', level=2)
        os.kill(server, signal.SIGCONT)
        graph.wait_status('vel2d_bridge: link', 'Deadman=ready')
        assert deadman not in family(running.pid)
        running.signal(signal.SIGINT)
        assert running.exit_code() == 0, running.text


@pytest.mark.usefixtures('again')
def test_every_process_that_carries_the_name_is_killed(ros, mcu, cmd_vel):
    """`pkill -9 -f vel2d_bridge`, for this bridge alone."""
    with driving(ros, mcu, cmd_vel) as (running, _):
        pids = family(running.pid)
        carry = [pid for pid in pids if b'vel2d' in Path(f'/proc/{pid}/cmdline').read_bytes()
                 or 'vel2d' in Path(f'/proc/{pid}/comm').read_text()]
        stops_and_leaves(mcu, pids, *carry)


@pytest.mark.usefixtures('again')
def test_frozen(ros, mcu, cmd_vel):
    with driving(ros, mcu, cmd_vel) as (running, _):
        [deadman] = running.children()
        begin = time.monotonic_ns()
        running.signal(signal.SIGSTOP)
        assert mcu.stopped_at(begin) / 1e9 < 0.3 + LATE_S
        assert stops_only(mcu.since(time.monotonic_ns(), 10))
        running.signal(signal.SIGCONT)
        # Commands go on coming: it drives again, after a stop of its own.
        wait(lambda: mcu.velocity == Vel2d(0.3, 0.1, 0.5))
        running.signal(signal.SIGSTOP)
        running.signal(signal.SIGKILL)
        wait(lambda: mcu.receiver.wheels.is_stop)
        wait(lambda: not is_alive(deadman))


@pytest.mark.parametrize('number', [signal.SIGSTOP, signal.SIGTSTP], ids=['SIGSTOP', 'SIGTSTP'])
def test_what_was_published_before_a_thaw_is_not_heard(ros, graph, mcu, number):
    """A reliable publisher sends again what a frozen reader missed, up to 3 s later."""
    publisher = graph.publisher(profile=ros.qos(10), heard=False)
    with driving(ros, mcu, publisher, rate=800) as (running, teleop):
        running.signal(number)
        frozen = teleop.sent
        wait(lambda: teleop.sent > frozen + 600)    # more than its sockets take
        assert mcu.receiver.wheels.is_stop
        teleop.stop()
        continued = time.monotonic_ns()
        running.signal(signal.SIGCONT)
        time.sleep(3.5)                             # Fast DDS's heartbeat period, and some
        assert stops_only(mcu.since(continued, 10))
        with ros.Teleop(publisher, lambda: ros.twist(0.2), rate=50):
            wait(lambda: mcu.velocity == Vel2d(0.2, 0.0, 0.0))
    graph.node.destroy_publisher(publisher)


def test_a_deadman_whose_server_was_killed_too_is_reported(ros, graph, mcu, cmd_vel):
    with driving(ros, mcu, cmd_vel) as (running, _):
        _, server, deadman = family(running.pid)
        os.kill(server, signal.SIGKILL)
        os.kill(deadman, signal.SIGKILL)
        graph.wait_status('vel2d_bridge: link', 'deadman: its process has ended', level=2)
        running.signal(signal.SIGINT)
        assert running.exit_code() == 0, running.text


def test_without_a_deadman(ros, mcu, cmd_vel):
    with bridge(mcu, deadman='false') as running:
        running.wait_for('deadman: false, so the rover drives on when this process is killed')
        assert running.children() == []
        with ros.Teleop(cmd_vel, lambda: ros.twist(0.3), rate=50):
            wait(lambda: mcu.velocity == Vel2d(0.3, 0.0, 0.0))
        running.signal(signal.SIGINT)
        assert running.exit_code() == 0, running.text
