# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""
The fault table of docs/reliability.md for the bridge: real processes, real DDS, a scripted cable.

Each test is a row: it breaks one thing, asserts what happens and what the user sees, and notes how
long it took from the end of the fault until a good frame with a command from after it was at the
MCU (fixture `recovery`; --fault-times 10 gives the medians of the document). What holds in every
row is in bridge_faults.py, and checked at the end of each.
"""
from contextlib import contextmanager
from contextlib import suppress
from itertools import cycle
import math
import os
from pathlib import Path
import random
import signal
import time

from bridge_faults import BOUND_S
from bridge_faults import burst
from bridge_faults import CMD_VEL_TIMEOUT_S
from bridge_faults import COMMANDS
from bridge_faults import LINK
from bridge_faults import Rover
from harness import loose_contact
from harness import no_descriptors
from harness import Program
from harness import starving
from harness import wait
import pytest
from running_bridge import bridge
from running_bridge import Mcu

from msg_defs.vel2d import STOP
from rigs.cable import Cable

pytestmark = [pytest.mark.ros, pytest.mark.realtime(bears=0.1)]
RETRY_S = 2.0                   # between attempts to open a port, at most
COUNTED = {'drop': 'insufficient', 'flip': 'crc_err'}       # by the MCU
NONSENSE = math.nan, math.inf, -math.inf


@pytest.fixture(scope='module')
def cable(mcu, tmp_path_factory):
    with Cable(mcu.path, tmp_path_factory.mktemp('cable') / 'port') as cable:
        yield cable


@pytest.fixture(scope='module')
def rover(graph, ros, mcu, cable):
    with bridge(cable.path) as running:
        running.wait_for('open at 115200 baud')
        rover = Rover(graph, ros, mcu, running, cable)
        yield rover
        wait(rover.is_well)
        rover.leave()
        running.signal(signal.SIGTERM)
        assert running.exit_code() == 0
        assert 'Traceback' not in running.text


@pytest.fixture
def row(rover, cable):
    """Begin and end a row; all that it left behind is mended before the next begins."""
    with rover.row() as row:
        try:
            yield row
        finally:
            rover.running.signal(signal.SIGCONT)
            cable.calm()
            cable.reopen()
            if not os.path.lexists(cable.path):
                cable.restore_name()
            if rover.publisher is None:
                rover.publish()


# --- what the user does not see ---

@pytest.mark.parametrize('fault', [{'drop': 0.5}, {'flip': 0.5}, {'drop': 0.3, 'flip': 0.3}],
                         ids=['drop', 'flip', 'both'])
def test_bytes_are_lost_or_turned(mcu, cable, row, recovery, fault):
    row.quiet()
    row.drive()
    begin, before = time.monotonic_ns(), mcu.totals()
    with cable.while_damaged(**fault):
        wait(lambda: len(row.drives(begin)) > 8)
        wait(lambda: all(mcu.totals()[COUNTED[one]] > before[COUNTED[one]] + 2 for one in fault))
        wait(row.moves)
    assert row.drove_on(begin)
    recovery(f'cable: {" and ".join(fault)}', row.until_driving(time.monotonic_ns()))


def test_everything_comes_late(cable, row, recovery):
    """It drives 150 ms late, and stops 150 ms late."""
    row.quiet()
    row.drive()
    row.delay_s = 0.15
    with cable.while_damaged(delay_s=row.delay_s):
        begin = time.monotonic_ns()
        wait(lambda: len(row.drives(begin)) > 8)
        ages = sorted(one.stamp / 1e9 - one.velocity.omega for one in row.drives(begin))
        assert ages[4] > 0.14
        assert row.drove_on(begin)
    recovery('cable: 150 ms late', row.until_driving(time.monotonic_ns()))
    with cable.while_damaged(delay_s=row.delay_s):
        begin = time.monotonic_ns()
        row.until_driving(begin)
        assert row.stops_in_time() > 0.6 or row.was_disturbed()


def test_a_babbling_mcu(cable, rover, row, recovery):
    """The log is bounded: a few lines a second, and a warning every ten."""
    row.quiet()
    row.drive()
    begin = time.monotonic_ns()
    lines = len(rover.running.lines)
    cable.flood(60.0)
    wait(lambda: len(row.drives(begin)) > 25)
    row.counts(LINK, 'Garbage from MCU (B)', at_least=10_000)
    assert row.drove_on(begin)
    assert row.longest_gap(begin) < BOUND_S + row.late_s()
    cable.calm()
    end = time.monotonic_ns()
    recovery('cable: noise from the MCU, 200 kB/s', row.until_driving(end))
    rover.running.wait_for('WARN', 'bytes that are not text; check baud')
    assert len(rover.running.lines) - lines < 20 + 6 * (time.monotonic_ns() - begin) / 1e9


def test_a_flood_of_commands(mcu, rover, row, recovery):
    """5 kHz: newest wins, no more than 30 frames per second, no queue, and the stop in time."""
    rover.leave()
    begin, before = time.monotonic_ns(), mcu.totals()
    with publishing(row, rate=5000, seconds=1.2) as other:
        wait(row.moves)
        row.quiet()
        row.last = int(other.wait_for('end ').split()[1])
        row.stops_in_time()
        row.end_of_quiet()
    frames = row.drives()
    commanded = [one.velocity.omega for one in frames]         # when it was published (s)
    # By the publisher's clock: read late, they stand closer together. The last is sent again.
    seconds = commanded[-1] - commanded[0] + CMD_VEL_TIMEOUT_S
    assert len(frames) < 31 * seconds + 10
    assert commanded == sorted(commanded)
    assert all(one.velocity != STOP for one in row.frames(frames[0].stamp)[:len(frames)]) \
        or row.was_disturbed()
    # A few, when this process is late at reading for the MCU; a flood would be thousands.
    assert mcu.totals()['queue_full'] - before['queue_full'] <= len(frames) // 2
    # What was accepted was sent or replaced.
    assert row.grown(COMMANDS, 'Commands accepted') <= len(row.drives(begin)) + 2 \
        + row.grown(COMMANDS, 'Commands replaced')
    rover.publish()
    begin = time.monotonic_ns()
    row.drive()
    recovery('commands at 5 kHz: until another drives', row.until_driving(begin))


def test_no_cpu_left(rover, row, recovery):
    """The least of all processes among busy ones: it still times out, by the steady clock."""
    row.quiet('refused: waited too long')       # a command that was left lying for 0.5 s
    row.drive()
    threads = [int(one) for one in os.listdir(f'/proc/{rover.running.pid}/task')]
    for one in threads:
        os.setpriority(os.PRIO_PROCESS, one, 10)
    try:
        with starving():
            begin, waited = time.monotonic_ns(), waited_for_a_cpu(rover.running.pid)
            # A machine that is busy without us may leave it so little that it stands, frozen.
            wait(lambda: len(row.drives(begin)) > 8 or time.monotonic_ns() - begin > 10e9)
            assert len(row.drives(begin)) > 8 or row.was_disturbed()
            stopped_s = row.stops_in_time()
            burst(row, row.last)
            waited = waited_for_a_cpu(rover.running.pid) - waited
            assert waited > 0.01
    finally:
        with suppress(PermissionError):     # only root may: the other rows are at nice 10, too
            for one in threads:
                os.setpriority(os.PRIO_PROCESS, one, 0)
    recovery('CPU starved: stop after the last command', stopped_s)
    recovery('CPU starved: the bridge waited for a CPU', waited)


def waited_for_a_cpu(pid):
    """Return how long (s) the threads of a process were ready to run and did not."""
    return sum(int(one.read_text().split()[1])
               for one in Path(f'/proc/{pid}/task').glob('*/schedstat')) / 1e9


# --- what the user sees: the cable ---

def test_the_name_goes_while_it_is_open(cable, rover, row, recovery):
    """A port is known by its descriptor: its name is needed for the next opening only."""
    row.quiet()
    row.drive()
    begin = time.monotonic_ns()
    cable.remove_name()
    wait(lambda: len(row.drives(begin)) > 8)
    wait(row.moves)
    assert row.drove_on(begin)
    recovery('symlink of the port removed: longest gap', row.longest_gap(begin))
    row.end_of_quiet()
    cable.cut()
    cable.reopen(named=False)
    row.sees(LINK, 'is not there; plug it in', 'State=closed', level=2)
    begin = time.monotonic_ns()
    cable.restore_name()
    recovery('symlink of the port back: the next opening', row.until_driving(begin))
    row.counts(LINK, 'Reopenings')


def test_unplugged(cable, rover, row, recovery):
    """Closed, tried again, and its path looked up again: it comes back as another device."""
    row.drive()
    before = os.path.realpath(cable.path)
    cable.cut()
    row.says('ERROR', f'{cable.path}: lost (', 'check plug and power')
    row.sees(LINK, 'State=closed', 'plug', level=2)
    row.sees(COMMANDS, 'no stop could be sent, the rover may be driving', level=2)
    begin = time.monotonic_ns()
    cable.reopen()
    assert os.path.realpath(cable.path) != before
    recovered_s = row.until_driving(begin)
    recovery('cable: unplugged for a moment', recovered_s)
    assert recovered_s < RETRY_S + row.late_s()
    for key in ('Losses', 'Reopenings', 'Stops: port opened'):
        row.counts(COMMANDS if key.startswith('Stops') else LINK, key)


def test_closes_and_reopens_again_and_again(cable, row, recovery):
    row.drive()
    begin = loose_contact(cable)
    recovered_s = row.until_driving(begin)
    recovery('cable: a loose contact, six cuts in a second', recovered_s)
    assert recovered_s < RETRY_S + row.late_s()
    row.counts(LINK, 'Losses')
    row.counts(COMMANDS, 'Refused: port not open')
    wait(lambda: len(row.said('ERROR', ': lost (', 'check plug')) == row.grown(LINK, 'Losses'))


def test_takes_nothing(cable, row, recovery):
    """The line is blocked: the rover holds its last frame, and the first after it is a stop."""
    row.drive()
    cable.stall()
    row.sees(LINK, 'takes no data; check flow control', level=2)
    row.says('ERROR', 'takes no data; check flow control')
    begin = time.monotonic_ns()
    cable.calm()
    recovered_s = row.until_driving(begin)
    recovery('cable: takes nothing, for seconds', recovered_s)
    assert recovered_s < RETRY_S + row.late_s()
    row.counts(LINK, 'Write time-outs', at_least=10)
    row.counts(LINK, 'Losses')
    row.counts(COMMANDS, 'Stops: write timed out')
    row.counts(COMMANDS, 'Refused: port not open')


# --- the system ---

def test_no_descriptors_left(cable, rover, row, recovery):
    """The port is lost and cannot be opened: said, tried again, and back as soon as it can."""
    row.drive()
    cable.cut()
    row.says('ERROR', ': lost (')
    with no_descriptors(rover.running.pid):
        cable.reopen()
        row.sees(LINK, 'no file descriptor is left to open it; raise the limit', level=2)
        row.sees(COMMANDS, 'no stop could be sent, the rover may be driving', level=2)
        begin = time.monotonic_ns()
    recovered_s = row.until_driving(begin)
    recovery('no file descriptors left', recovered_s)
    assert recovered_s < RETRY_S + row.late_s()
    row.counts(LINK, 'Losses')


def test_frozen_and_continued(mcu, rover, row, recovery):
    """The dead man stops the rover; after it only new commands, and after a stop."""
    row.drive()
    begin = time.monotonic_ns()
    rover.running.signal(signal.SIGSTOP)
    assert mcu.stopped_at(begin) / 1e9 < 0.3 + row.late_s()
    stopped = time.monotonic_ns()
    burst(row, stopped)
    assert not row.drives(stopped)
    end = time.monotonic_ns()
    rover.running.signal(signal.SIGCONT)
    recovered_s = row.until_driving(end)
    recovery('SIGSTOP, SIGCONT', recovered_s)
    # What waited in the sockets is not taken; a frame may have been under way when it froze.
    assert recovered_s > 0.15 - row.measured_late_s()
    assert sum(one.velocity != STOP and one.velocity.omega * 1e9 < end
               for one in row.frames(end)) <= 1
    row.counts(LINK, 'Freezes')
    row.counts(COMMANDS, 'Stops: bridge was frozen')
    row.sees(COMMANDS, 'bridge was frozen; newer commands are accepted', level=1)


# --- DDS ---

def test_a_publisher_of_nonsense(rover, row, recovery):
    """NaN and infinity do not touch the time-out of the last good command, which runs on."""
    row.drive()
    values = cycle([rover.ros.twist(*([0.0] * at + [x])) for x in NONSENSE for at in range(3)])
    row.halt()
    last = row.last
    row.drive(lambda: next(values))
    assert row.mcu.stopped_at(last) / 1e9 < BOUND_S + row.late_s()
    row.sees(COMMANDS, 'not finite; correct its publisher', level=1)
    row.says('WARN', 'refused: not finite; correct its publisher')
    row.counts(COMMANDS, 'Refused: not finite', at_least=2 * 3 * len(NONSENSE))
    row.counts(COMMANDS, 'Time-outs')
    begin = time.monotonic_ns()
    row.drive()
    recovery('NaN: until a sane publisher drives', row.until_driving(begin))


def test_a_publisher_changes_its_type(ros, graph, rover, row, recovery):
    """One ends, another sends the other type: a stop, then it is followed; and back again."""
    row.drive()
    with ros.Graph('other_operator') as other:
        row.halt()
        rover.leave()
        rover.publisher = other.publisher(rover.topic, ros.TwistStamped, heard=False)
        try:
            recovery('type changed to TwistStamped', until_followed(row, 'twist_stamped'))
        finally:
            row.halt()
            rover.publisher = None
    rover.publisher = graph.publisher(rover.topic, heard=False)
    recovery('type changed back to Twist', until_followed(row, 'twist'))
    row.counts(COMMANDS, 'Stops: message type switched', at_least=2)


def until_followed(row, name):
    """Drive with that message type; return after how long (s) the rover does."""
    begin = time.monotonic_ns()
    row.drive(row.command)
    followed_s = row.until_driving(begin)
    first = row.drives(begin)[0].stamp
    assert any(one.velocity == STOP and row.last < one.stamp < first for one in row.frames())
    row.says('INFO', f'the message type is {name} now')
    return followed_s


def test_a_publisher_dies(mcu, rover, row, recovery, tmp_path, monkeypatch):
    """Its lease in the graph is 20 s with Fast DDS; here 2 s."""
    profile = Path(os.environ['FASTRTPS_DEFAULT_PROFILES_FILE']).read_text()
    lease = '<leaseDuration><sec>6</sec>'
    assert lease in profile
    (tmp_path / 'lease.xml').write_text(profile.replace(lease, lease.replace('6', '2')))
    monkeypatch.setenv('FASTRTPS_DEFAULT_PROFILES_FILE', str(tmp_path / 'lease.xml'))
    rover.leave()
    with publishing(row) as other:
        wait(row.moves)
        row.forget()
        row.last = time.monotonic_ns()
        other.signal(signal.SIGKILL)
        row.stops_in_time()
        burst(row, row.last)
        row.counts(COMMANDS, 'Time-outs')
        row.counts(COMMANDS, 'Stops: time-out')
        row.sees(COMMANDS, 'no node publishes it; start teleop', level=0)
    rover.publish()
    begin = time.monotonic_ns()
    row.drive()
    recovery('publisher killed: until its successor drives', row.until_driving(begin))


PUBLISHER = """
import signal, sys, time
import rclpy
from geometry_msgs.msg import Twist
rclpy.init(signal_handler_options=rclpy.SignalHandlerOptions.NO)
signal.signal(signal.SIGTERM, lambda *_: sys.exit())
node = rclpy.create_node('other_teleop')
x, rate, seconds = map(float, sys.argv[1:])
publisher = node.create_publisher(Twist, '/cmd_vel', 1)
message = Twist()
message.linear.x = x
try:
    while not publisher.get_subscription_count():
        time.sleep(0.01)
    due = now = time.monotonic()
    end = due + seconds
    while now < end:
        message.angular.z = now = time.monotonic()
        publisher.publish(message)
        due += 1 / rate
        if (left := due - time.monotonic()) > 0:
            time.sleep(left)
    print('end', int(now * 1e9), flush=True)
    signal.pause()
finally:                # take leave of the graph, or its lease has to end first
    node.destroy_node()
    rclpy.shutdown()
"""


@contextmanager
def publishing(row, rate=50.0, seconds=60.0):
    """Publish the commands of a row in a process of its own, instead of ours."""
    with Program('', str(row.speed), str(rate), str(seconds), script=PUBLISHER) as program:
        yield program


# --- all of it ---

def test_all_at_once(cable, rover, row, recovery, request):
    """Eight faults one after the other, each beginning before the last one is mended."""
    mixed = cycle([row.command, lambda: rover.ros.twist(math.nan)])
    row.drive()
    faults = [
        lambda: cable.damage(drop=0.4, flip=0.4), lambda: cable.damage(delay_s=0.1),
        lambda: cable.flood(0.5), lambda: (cable.stall(), time.sleep(0.4), cable.calm()),
        lambda: (cable.cut(), time.sleep(0.1), cable.reopen()), cable.cut,
        lambda: (rover.running.signal(signal.SIGSTOP), time.sleep(0.4)),
        lambda: row.drive(lambda: next(mixed)())]
    chance = random.Random(request.node.name)
    chance.shuffle(faults)
    for fault in faults:
        fault()
        time.sleep(chance.random() * 0.2)
        rover.running.signal(signal.SIGCONT)
        cable.reopen()
    cable.calm()
    begin = time.monotonic_ns()
    row.delay_s = 0.1
    row.drive()
    recovered_s = row.until_driving(begin)
    recovery('cable, process and commands: eight faults in a row', recovered_s)
    assert recovered_s < RETRY_S + row.late_s()
    row.counts(LINK, 'Losses')
    row.counts(COMMANDS, 'Refused: not finite')
    row.counts(COMMANDS, 'Refused: port not open')


# --- the clock: nodes of their own ---

@pytest.mark.parametrize('step_s', [3600, -3600])
def test_the_system_clock_jumps(graph, ros, clock, tmp_path, recovery, step_s):
    """The system clock of the bridge alone is moved; commands and time-outs do not notice."""
    with Mcu(str(tmp_path / 'mcu')).running() as mcu, clock.faked(), \
            bridge(mcu, '-r', '__ns:=/jump', '-r', '__node:=jumper') as running:
        rover = Rover(graph, ros, mcu, running, node='jumper', namespace='/jump')
        with rover.row() as row:
            row.quiet()
            row.drive()
            begin = time.monotonic_ns()
            clock.step(step_s)
            wait(lambda: len(row.drives(begin)) > 15)
            assert row.drove_on(begin)
            recovery(f'system clock {step_s:+} s: longest gap', row.longest_gap(begin))
            heard = len(graph.heard['/diagnostics'])
        assert row.grown(COMMANDS, 'Refused: waited too long') == 0 or row.was_disturbed()
        wait(lambda: any(abs(one.header.stamp.sec - time.time() - step_s) < 60
                         for one in graph.heard['/diagnostics'][heard:]))
        rover.leave()
        running.signal(signal.SIGTERM)
        assert running.exit_code() == 0
        assert 'Traceback' not in running.text
