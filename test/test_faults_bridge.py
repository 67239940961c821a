# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""
The fault table of docs/reliability.md for the bridge: real processes, real DDS, a scripted cable.

Each test breaks one thing, holds what must stay true meanwhile, and notes how long it took until
all was well again (fixture `recovery`; --fault-times 10 gives the medians of the document).
"""
from contextlib import contextmanager
from itertools import pairwise
import os
import random
import signal
import time

from harness import bridge
from harness import LATE_S
from harness import loose_contact
from harness import Mcu
from harness import no_descriptors
from harness import Program
from harness import starving
from harness import wait
import pytest

from benchmark.cable import Cable
from msg_defs.vel2d import STOP
from msg_defs.vel2d import Vel2d

pytestmark = pytest.mark.ros
LINK, COMMANDS = 'vel2d_bridge: link', 'vel2d_bridge: commands'
BOUND_S = 0.5 + 2 / 20 + 0.05 + 0.3         # cmd_vel_timeout, resends, write_timeout, queue
SPEED = 0.3
DRIVE = Vel2d(SPEED, 0.0, 0.0)


@pytest.fixture(scope='module')
def cable(mcu, tmp_path_factory):
    with Cable(mcu.path, tmp_path_factory.mktemp('cable') / 'port') as cable:
        yield cable


@pytest.fixture(scope='module')
def running(cable):
    with bridge(cable.path) as running:
        running.wait_for('open at 115200 baud')
        yield running
        assert 'Traceback' not in running.text


@pytest.fixture
def cmd_vel(graph, running):
    publisher = graph.publisher()
    yield publisher
    graph.node.destroy_publisher(publisher)


@pytest.fixture
def teleop(ros, mcu, cmd_vel):
    """Drive at 50 Hz; the rover moves when the test begins and stops in time when it ends."""
    with ros.Teleop(cmd_vel, lambda: ros.twist(SPEED), rate=50) as teleop:
        wait(lambda: moves(mcu))
        yield teleop
    assert mcu.stopped_at(teleop.last) / 1e9 < BOUND_S + LATE_S


def moves(mcu):
    return mcu.receiver.wheels.x == SPEED * 1000


def good_since(mcu, stamp):
    return [one for one in mcu.arrivals if one.stamp >= stamp and one.velocity is not None]


def wrong(mcu, stamp):
    """Return the velocities since then that nobody commanded."""
    return {one.velocity for one in good_since(mcu, stamp)} - {DRIVE, STOP}


def until_driving(mcu, begin):
    """Return how long after `begin` (monotonic ns) a good driving frame came."""
    return (wait(lambda: next((one for one in good_since(mcu, begin) if one.velocity == DRIVE),
                              None)).stamp - begin) / 1e9


# --- the cable ---

@pytest.mark.parametrize('fault', [{'drop': 0.5}, {'flip': 0.5}, {'drop': 0.3, 'flip': 0.3}],
                         ids=['drop', 'flip', 'both'])
def test_bytes_are_lost_or_turned(mcu, cable, teleop, recovery, fault):
    begin = time.monotonic_ns()
    with cable.while_damaged(**fault):
        wait(lambda: len(good_since(mcu, begin)) > 20)
        assert moves(mcu)
        before = mcu.totals()
        wait(lambda: mcu.totals()['crc_err'] + mcu.totals()['insufficient']
             > before['crc_err'] + before['insufficient'] + 3)
    end = time.monotonic_ns()
    recovery(f'cable: {" and ".join(fault)}', until_driving(mcu, end))
    assert not wrong(mcu, begin)


def test_everything_comes_late(mcu, cable, teleop, recovery):
    with cable.while_damaged(delay_s=0.15):
        begin = time.monotonic_ns()
        wait(lambda: len(good_since(mcu, begin)) > 20)
    recovery('cable: 150 ms late', until_driving(mcu, time.monotonic_ns()))
    with cable.while_damaged(delay_s=0.15):
        teleop.stop()
        assert mcu.stopped_at(teleop.last) / 1e9 < BOUND_S + 0.15 + LATE_S


def test_unplugged(mcu, cable, running, graph, teleop, recovery):
    cable.cut()
    graph.wait_status(LINK, 'State=closed', level=2)
    begin = time.monotonic_ns()
    cable.reopen()
    first = mcu.since(begin, 1)[0]
    assert first.velocity == STOP
    recovery('cable: unplugged for a moment', until_driving(mcu, begin))
    graph.wait_status(LINK, 'State=open', level=0)


def test_closes_and_reopens_again_and_again(mcu, cable, graph, teleop, recovery):
    begin = loose_contact(cable)
    recovery('cable: a loose contact, six cuts in a second', until_driving(mcu, begin))
    assert not wrong(mcu, begin)


def test_takes_nothing(mcu, cable, running, graph, teleop, recovery):
    """The line is blocked: the rover holds its last frame, and the first after it is a stop."""
    cable.stall()
    graph.wait_status(LINK, 'takes no data', level=2)
    begin = time.monotonic_ns()
    cable.calm()
    assert mcu.since(begin, 1)[0].velocity == STOP
    recovery('cable: takes nothing, for seconds', until_driving(mcu, begin))
    graph.wait_status(LINK, 'State=open', level=0)


def test_a_babbling_mcu(mcu, cable, running, graph, teleop, recovery):
    begin = time.monotonic_ns()
    lines = len(running.lines)
    cable.flood(1.5)
    wait(lambda: len(good_since(mcu, begin)) > 40)
    assert not wrong(mcu, begin)
    gaps = [one.stamp for one in good_since(mcu, begin)]
    assert max(b - a for a, b in pairwise(gaps)) / 1e9 < 0.1 + LATE_S
    end = time.monotonic_ns()
    recovery('cable: noise from the MCU, 200 kB/s', until_driving(mcu, end))
    time.sleep(0.3)
    assert len(running.lines) - lines < 60


def test_the_name_goes_while_it_is_open(mcu, cable, graph, teleop, recovery):
    """A port is known by its descriptor: its name is needed for the next opening only."""
    begin = time.monotonic_ns()
    cable.remove_name()
    wait(lambda: len(good_since(mcu, begin)) > 20)
    assert moves(mcu)
    cable.restore_name()
    recovery('symlink of the port removed', 0.0)


# --- DDS ---

PUBLISHER = """
import os, signal, sys, time
import rclpy
from geometry_msgs.msg import Twist, TwistStamped
rclpy.init(signal_handler_options=rclpy.SignalHandlerOptions.NO)
signal.signal(signal.SIGTERM, lambda *_: sys.exit())
node = rclpy.create_node('other_teleop')
kind, x, rate, seconds = sys.argv[1], float(sys.argv[2]), float(sys.argv[3]), float(sys.argv[4])
publisher = node.create_publisher({'twist': Twist, 'stamped': TwistStamped}[kind], '/cmd_vel', 1)
message = publisher.msg_type()
twist = message if kind == 'twist' else message.twist
twist.linear.x = x
try:
    while not publisher.get_subscription_count():
        time.sleep(0.01)
    print('begin', flush=True)
    end = time.monotonic() + seconds
    due = time.monotonic()
    while time.monotonic() < end:
        publisher.publish(message)
        due += 1 / rate
        if (left := due - time.monotonic()) > 0:
            time.sleep(left)
    print('end', flush=True)
finally:                # take leave of the graph, or its lease has to end first
    node.destroy_node()
    rclpy.shutdown()
"""


@contextmanager
def publishing(kind='twist', x=SPEED, rate=50.0, seconds=60.0):
    with Program('', kind, str(x), str(rate), str(seconds), script=PUBLISHER) as program:
        program.wait_for('begin')
        yield program


def test_a_publisher_changes_its_type(mcu, cable, running, graph, recovery):
    """Before those that are killed: the graph knows a dead publisher for its lease."""
    with publishing():
        wait(lambda: moves(mcu))
    wait(lambda: mcu.receiver.wheels.is_stop)
    begin = time.monotonic_ns()
    with publishing('stamped'):
        recovery('type changed to TwistStamped, its publisher just started',
                 until_driving(mcu, begin))
        running.wait_for('carries twist_stamped now')
    wait(lambda: mcu.receiver.wheels.is_stop)
    with publishing():
        until_driving(mcu, time.monotonic_ns())
    wait(lambda: mcu.receiver.wheels.is_stop)


def test_a_publisher_dies(mcu, cable, running, recovery):
    with publishing() as other:
        wait(lambda: moves(mcu))
        last = time.monotonic_ns()
        other.signal(signal.SIGKILL)
        assert mcu.stopped_at(last) / 1e9 < BOUND_S + LATE_S
    with publishing():
        recovery('publisher killed: until its successor drives', until_driving(
            mcu, time.monotonic_ns()))
    wait(lambda: mcu.receiver.wheels.is_stop)


def test_a_flood_of_commands(mcu, cable, running, graph, recovery):
    """5 kHz: newest wins, no more than 30 frames per second, no queue, and the stop in time."""
    before, begin = mcu.totals(), time.monotonic_ns()
    with publishing(rate=5000, seconds=2.5) as other:
        wait(lambda: moves(mcu))
        other.wait_for('end')
        last = time.monotonic_ns()
        assert mcu.stopped_at(last - 50_000_000) / 1e9 < BOUND_S + LATE_S
    frames = [one for one in good_since(mcu, begin) if one.stamp < last]
    seconds = (frames[-1].stamp - frames[0].stamp) / 1e9
    assert len(frames) < 31 * seconds + 10
    # A few, when this process is late at reading for the MCU; a flood would be thousands.
    assert mcu.totals()['queue_full'] <= before['queue_full'] + 20
    assert not wrong(mcu, begin)
    with publishing():
        recovery('commands at 5 kHz: until another drives', until_driving(
            mcu, time.monotonic_ns()))
    wait(lambda: mcu.receiver.wheels.is_stop)


def test_a_publisher_of_nonsense(mcu, cable, running, graph, recovery):
    with publishing(x=float('nan')):
        graph.wait_status(COMMANDS, 'not finite', level=1)
        assert mcu.receiver.wheels.is_stop
    with publishing():
        recovery('NaN: until a sane publisher drives', until_driving(mcu, time.monotonic_ns()))
    wait(lambda: mcu.receiver.wheels.is_stop)


# --- the system ---

def test_frozen_and_continued(mcu, cable, running, teleop, recovery):
    begin = time.monotonic_ns()
    running.signal(signal.SIGSTOP)
    assert mcu.stopped_at(begin) / 1e9 < 0.3 + LATE_S
    end = time.monotonic_ns()
    running.signal(signal.SIGCONT)
    recovery('SIGSTOP, SIGCONT', until_driving(mcu, end))


def test_no_cpu_left(mcu, cable, running, teleop, recovery):
    """The least of all processes among busy ones: it still times out, by the steady clock."""
    before = {one: os.getpriority(os.PRIO_PROCESS, one) for one in tasks(running.pid)}
    for one in before:
        os.setpriority(os.PRIO_PROCESS, one, 10)
    try:
        with starving():
            begin = time.monotonic_ns()
            wait(lambda: len(good_since(mcu, begin)) > 20)
            assert not wrong(mcu, begin)
            teleop.stop()
            assert mcu.stopped_at(teleop.last) / 1e9 < BOUND_S + 4 * LATE_S
    finally:
        for one, nice in before.items():
            os.setpriority(os.PRIO_PROCESS, one, nice)
    recovery('CPU starved: stop after the last command', mcu.stopped_at(teleop.last) / 1e9)


def tasks(pid):
    return [int(one) for one in os.listdir(f'/proc/{pid}/task')]


def test_no_descriptors_left(mcu, cable, running, graph, teleop, recovery):
    """The port is lost and cannot be opened: said, tried again, and back as soon as it can."""
    cable.cut()
    graph.wait_status(LINK, 'State=closed', level=2)
    with no_descriptors(running.pid):
        cable.reopen()
        graph.wait_status(LINK, 'no file descriptor is left', level=2)
    begin = time.monotonic_ns()
    recovery('no file descriptors left', until_driving(mcu, begin))
    graph.wait_status(LINK, 'State=open', level=0)


@pytest.mark.parametrize('step_s', [3600, -3600])
def test_the_system_clock_jumps(graph, ros, clock, tmp_path, recovery, step_s):
    """The system clock of the bridge alone is moved; commands and time-outs do not notice."""
    with Mcu(str(tmp_path / 'mcu')).running() as mcu, clock.faked(), \
            bridge(mcu, '-r', '__ns:=/jump', '-r', '__node:=jumper') as running:
        publisher = graph.publisher('/jump/cmd_vel')
        with ros.Teleop(publisher, lambda: ros.twist(SPEED), rate=50) as teleop:
            wait(lambda: moves(mcu))
            begin = time.monotonic_ns()
            clock.step(step_s)
            wait(lambda: len(good_since(mcu, begin)) > 30)
            driving = [one.stamp for one in good_since(mcu, begin) if one.velocity == DRIVE]
            gap_s = max(b - a for a, b in pairwise([begin, *driving])) / 1e9
            recovery(f'system clock {step_s:+} s', gap_s)
            assert gap_s < 0.5 + LATE_S
            assert not wrong(mcu, begin)
            wait(lambda: any(abs(one.header.stamp.sec - time.time() - step_s) < 60
                             for one in graph.heard['/diagnostics']))
            values = graph.values('jumper: commands')
            assert (values['Refused: waited too long'], values['Time-outs']) == ('0', '0')
        assert mcu.stopped_at(teleop.last) / 1e9 < BOUND_S + LATE_S
        running.signal(signal.SIGTERM)
        assert running.exit_code() == 0
        assert 'Traceback' not in running.text


def test_all_at_once(mcu, cable, running, teleop, recovery):
    """Random faults one after the other, seeded; whatever comes, nobody's velocity is made up."""
    chance = random.Random(7)
    begin = time.monotonic_ns()
    for _ in range(8):
        chance.choice([
            lambda: cable.damage(drop=0.4, flip=0.4), lambda: cable.flood(0.2), cable.calm,
            lambda: running.signal(signal.SIGSTOP), lambda: (cable.cut(), cable.reopen())])()
        time.sleep(chance.random() * 0.3)
        running.signal(signal.SIGCONT)
    cable.calm()
    recovery('cable and process: eight faults in a row', until_driving(mcu, time.monotonic_ns()))
    assert not wrong(mcu, begin)
