# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""
The bridge end to end: real DDS, a real process, a real pty.

Bounds are those that the bridge promises; the fake MCU's stamps are from its own thread, which a
busy machine may hold up: LATE_S is added where a bound is shorter than what such a machine does.
"""
import math
import signal
import socket
import threading
import time

from harness import DEADLINE_S
from harness import LATE_S
from harness import wait
import pytest
from running_bridge import bridge
from running_bridge import Mcu

from msg_defs.crc import crc32_mpeg2_words
from msg_defs.vel2d import encode
from msg_defs.vel2d import STOP
from msg_defs.vel2d import Vel2d

pytestmark = [pytest.mark.ros, pytest.mark.realtime(bears=0.1)]
TIME_OUT_BOUND = 0.5 + 2 / 20 + 0.05 + 0.3      # cmd_vel_timeout, resends, write_timeout, queue
LINK, COMMANDS = 'vel2d_bridge: link', 'vel2d_bridge: commands'
DRIVE = Vel2d(0.5, -0.25, 1.0)      # the vector of the thesis


@pytest.fixture(scope='module')
def running(mcu):
    with bridge(mcu) as running:
        running.wait_for('open at 115200 baud')
        yield running
        assert 'Traceback' not in running.text


@pytest.fixture
def standing(graph, mcu, running, cmd_vel):
    """Begin with a rover that stands and a time-out that is over."""
    try:
        wait(lambda: mcu.receiver.wheels.is_stop and mcu.velocity == STOP)
    except AssertionError:
        raise AssertionError(f'{mcu.velocity}, {mcu.totals()}, {graph.statuses[COMMANDS]}, '
                             f'published by {graph.publishers("/cmd_vel")}') from None
    return mcu


def drive(mcu, cmd_vel, message, velocity):
    """Publish until the MCU holds it."""
    def is_there():
        cmd_vel.publish(message)
        return mcu.receiver.wheels[1:] == (velocity.x * 1000, velocity.y * 1000, velocity.omega)
    wait(is_there)


def test_vector_of_the_thesis(ros, standing, cmd_vel):
    drive(standing, cmd_vel, ros.twist(*DRIVE), DRIVE)
    assert standing.totals()['crc_err'] == 0


def test_vector_when_the_crc_unit_is_fed_words(ros, graph, tmp_path):
    with Mcu(str(tmp_path / 'mcu'), crc=crc32_mpeg2_words).running() as mcu, \
            bridge(mcu, '-r', '__ns:=/words', crc_input='words'):
        drive(mcu, graph.publisher('/words/cmd_vel'), ros.twist(*DRIVE), DRIVE)
        assert mcu.totals()['crc_err'] == 0


@pytest.mark.parametrize('watchdog', [False, True])
def test_the_wrong_crc_input_is_named_while_it_drives(ros, graph, tmp_path, watchdog):
    """An MCU that reports what it refuses: a stop passes, no command to drive does."""
    name = f'crc{watchdog:d}'
    status = f'{name}/{COMMANDS}'
    with Mcu(str(tmp_path / 'mcu'), crc=crc32_mpeg2_words, talks=True,
             watchdog=watchdog).running() as mcu, \
            bridge(mcu, '-r', f'__ns:=/{name}') as running:
        graph.wait_status(status, 'stopped', level=0)
        publisher = graph.publisher(f'/{name}/cmd_vel')
        with ros.Teleop(publisher, lambda: ros.twist(*DRIVE), rate=20):
            graph.wait_status(status, 'set crc_input to words if it accepts the stops', level=1)
            assert mcu.receiver.wheels.is_stop
        running.wait_for('WARN', 'the MCU refuses the commands to drive')


@pytest.mark.parametrize('max_rate', [30.0, 100.0])
def test_a_thousand_commands_at_200_hz(ros, graph, standing, cmd_vel, max_rate):
    assert graph.set('/vel2d_bridge', max_rate=max_rate) == ['']
    before, begin = standing.totals(), time.monotonic_ns()
    count = iter(range(1, 10_000))
    with ros.Teleop(cmd_vel, lambda: ros.twist(next(count) / 1000), rate=200) as teleop:
        wait(lambda: teleop.sent >= 1000)
    wait(lambda: standing.velocity == STOP)
    frames = standing.since(begin)
    assert all(frame.size == 28 and frame.velocity is not None for frame in frames)
    driving = [frame for frame in frames if frame.velocity != STOP]
    assert driving[-1].velocity.x == teleop.sent / 1000
    assert [frame.velocity.x for frame in driving] == sorted(
        frame.velocity.x for frame in driving)
    seconds = (driving[-1].stamp - driving[0].stamp) / 1e9
    assert len(driving) <= 1.02 * max_rate * seconds + 2     # as docs/frame.md promises
    assert len(driving) > 0.1 * max_rate * seconds
    after = standing.totals()
    for name in ('crc_err', 'insufficient'):
        assert after[name] == before[name], name
    if max_rate == 30.0:        # a fake MCU that the machine holds up finds several at once
        assert after['queue_full'] - before['queue_full'] < len(frames) / 2
    assert graph.set('/vel2d_bridge', max_rate=30.0) == ['']


@pytest.mark.smoke
def test_silence_stops_the_rover(ros, standing, cmd_vel):
    with ros.Teleop(cmd_vel, lambda: ros.twist(0.3), rate=50) as teleop:
        wait(lambda: not standing.receiver.wheels.is_stop)
    assert standing.stopped_at(teleop.last) / 1e9 < TIME_OUT_BOUND + LATE_S
    # A bridge that was frozen stops first, and may take a command that waited, within the bound.
    bound = teleop.last + int((TIME_OUT_BOUND + LATE_S) * 1e9)
    zeros = standing.since(bound, 10)                           # and it goes on receiving zeros
    assert {frame.velocity for frame in zeros} == {STOP}


@pytest.mark.parametrize('bad', [(math.nan, 0, 0), (0, math.inf, 0), (0, 0, -math.inf)])
def test_what_is_not_finite_neither_drives_nor_keeps_driving(ros, graph, running, standing,
                                                             cmd_vel, bad):
    drive(standing, cmd_vel, ros.twist(0.3), Vel2d(0.3, 0.0, 0.0))
    last = time.monotonic_ns()
    with ros.Teleop(cmd_vel, lambda: ros.twist(*bad), rate=50):
        assert standing.stopped_at(last) / 1e9 < TIME_OUT_BOUND + LATE_S
        graph.wait_status(COMMANDS, 'commands are refused: not finite; correct its publisher',
                          level=1)
    assert all(math.isfinite(part) for frame in standing.arrivals for part in frame.velocity)
    assert running.said('WARN', '/cmd_vel: command (', 'refused: not finite')


def test_enable(ros, graph, standing, cmd_vel):
    with ros.Teleop(cmd_vel, lambda: ros.twist(0.3), rate=50):
        wait(lambda: not standing.receiver.wheels.is_stop)
        switched = time.monotonic_ns()
        assert graph.call(ros.SetBool, '/vel2d_bridge/enable', data=False).success
        standing.stopped_at(switched)
        graph.wait_status(COMMANDS, 'disabled; ros2 service call /vel2d_bridge/enable ', level=1)
        wait(lambda: standing.velocity == STOP)
        zeros = standing.since(time.monotonic_ns(), 5)          # go on
        assert {frame.velocity for frame in zeros} == {STOP}
        assert graph.call(ros.SetBool, '/vel2d_bridge/enable', data=True).success
        wait(lambda: not standing.receiver.wheels.is_stop)
        graph.wait_status(COMMANDS, 'State=driving', level=0)
    assert int(graph.values(COMMANDS)['Refused: disabled']) > 0


def test_diagnostics(ros, graph, standing, cmd_vel):
    with ros.Teleop(cmd_vel, lambda: ros.twist(0.3), rate=50):
        link = graph.wait_status(LINK, 'Last x (m/s)=0.3', level=0)
        commands = graph.wait_status(COMMANDS, 'Message type=twist', 'State=driving', level=0)
    assert link.hardware_id == commands.hardware_id == standing.path
    assert (link.message, commands.message) == ('open', 'driving')
    values = {pair.key: pair.value for pair in [*link.values, *commands.values]}
    assert values['Deadman'] == 'ready'
    assert values['Topic'] == '/cmd_vel'
    for key in ('Frames sent', 'Openings', 'Commands received', 'Commands accepted',
                'Commands replaced', 'Time-outs', 'Stops: port opened'):
        assert int(values[key]) > 0, key
    for key in ('Write time-outs', 'Partial writes', 'Freezes', 'Refused: disabled'):
        assert int(values[key]) >= 0, key


def test_timing_and_its_reset(ros, graph, standing, cmd_vel):
    graph.listen(ros.DiagnosticArray, '/vel2d/timing')
    graph.listen(ros.Float64, '/vel2d/timing/frame_rate_hz')
    write = 'vel2d_bridge: timing/write'
    wait(lambda: int(graph.values(write)['since start count']) > 40
         if write in graph.statuses else False)
    assert float(graph.values(write)['mean (ms)']) < 50
    assert graph.statuses[write].hardware_id == standing.path
    # The window reaches back into the tests before, one of them at 100 Hz.
    assert 10 < wait(lambda: graph.heard['/vel2d/timing/frame_rate_hz'])[-1].data < 110
    assert graph.call(ros.Trigger, '/vel2d_bridge/reset_statistics').success
    wait(lambda: int(graph.values(write)['since start count']) <= 40)


def test_non_planar_parts_are_mentioned_once(ros, running, standing, cmd_vel):
    message = ros.twist(0.1)
    message.linear.z = message.angular.x = 1.0
    for _ in range(3):
        drive(standing, cmd_vel, message, Vel2d(0.1, 0.0, 0.0))
        time.sleep(0.05)
    assert len(running.said('linear.z, angular.x and angular.y are ignored')) == 1


def test_what_the_mcu_says_goes_to_the_log(graph, running, standing):
    standing.send_text(b'\x1b[32mpose loop 30 ms\x1b[0m\r\nbattery\t11.8 V\n')
    running.wait_for('INFO', 'MCU: pose loop 30 ms')
    running.wait_for('MCU: battery 11.8 V')
    standing.send_text(b'line\n' * 500)
    running.wait_for('MCU: ... and', 'more lines')
    assert len(running.said('MCU: line')) <= 10
    standing.send_text(b'\x00\xff\xfe\x80garbage\x07\n')
    running.wait_for('WARN', 'bytes that are not text; check baud')
    graph.wait_status(LINK, 'Garbage from MCU (B)=12', 'Lines from MCU=502')
    assert 'garbage' not in running.text


def test_an_mcu_that_answers_frames_in_text(graph, tmp_path):
    with Mcu(str(tmp_path / 'mcu')).running() as mcu, bridge(mcu, '-r', '__ns:=/text') as running:
        graph.wait_status(f'text/{LINK}', 'open', level=0)

        def is_named():
            mcu.since(time.monotonic_ns(), count=1)
            mcu.send_text(b'ERR\r\n')
            return running.said('the MCU answers frames with "ERR"')
        wait(is_named)
        graph.wait_status(f'text/{LINK}', 'put a receiver as in docs/firmware.md into it', level=1)


def test_unplugged_and_plugged_in_again(ros, graph, running, standing, cmd_vel):
    mcu = standing
    begin, reports = time.monotonic(), len(graph.heard['/diagnostics'])
    for _ in range(10):
        with ros.Teleop(cmd_vel, lambda: ros.twist(0.3), rate=50):
            wait(lambda: not mcu.receiver.wheels.is_stop)
        # What is still under way would be a new command to the port that comes back.
        assert cmd_vel.wait_for_all_acked(ros.Duration(seconds=DEADLINE_S))
        mcu.vanish()
        graph.wait_status(LINK, 'State=closed', level=2)
        back = time.monotonic_ns()
        mcu.come_back()
        first, *more = mcu.since(back, 6)
        assert (first.stamp - back) / 1e9 < 2.5 + LATE_S
        # Stops, and nothing but stops: no command has come since.
        assert {frame.velocity for frame in [first, *more]} == {STOP}
    values = graph.wait_status(LINK, 'State=open', level=0).values
    assert {pair.key: pair.value for pair in values}['Reopenings'] == '10'
    assert len(running.said('ERROR', mcu.path)) >= 10
    # A change of level is reported at once, not at the next second.
    assert len(graph.heard['/diagnostics']) - reports > time.monotonic() - begin + 5


BLOCKING = """
import sys, time
from vel2d_bridge import bridge_node, cmd_vel_subscriber, main
asked = set()

def slow(owner, name):
    original = getattr(owner, name)
    def method(*arguments, **named):
        if name in asked:
            asked.remove(name)
            print('blocked:', name, flush=True)
            time.sleep(3)
        return original(*arguments, **named)
    setattr(owner, name, method)

def on_command(self, twist, *rest):
    # An angular.x of 1, 2, 3 blocks this callback, the diagnostics, the graph scan.
    hooks = [None, '_on_command', '_report', 'follow_graph']
    asked.update(filter(None, [hooks[int(twist.angular.x)]]))
    twist.angular.x = 0.0
    return taken(self, twist, *rest)

slow(bridge_node.Bridge, '_on_command')
taken, bridge_node.Bridge._on_command = bridge_node.Bridge._on_command, on_command
slow(bridge_node.Bridge, '_report')
slow(cmd_vel_subscriber.CmdVelSubscriber, 'follow_graph')
sys.exit(main.main())
"""


def test_what_blocks_the_executor_delays_no_stop(ros, graph, tmp_path):
    with Mcu(str(tmp_path / 'mcu')).running() as mcu, \
            bridge(mcu, '-r', '__ns:=/slow', script=BLOCKING) as running:
        cmd_vel = graph.publisher('/slow/cmd_vel')
        for number, name in enumerate(('_on_command', '_report', 'follow_graph'), start=1):
            drive(mcu, cmd_vel, ros.twist(0.3), Vel2d(0.3, 0.0, 0.0))
            message = ros.twist(0.3)
            message.angular.x = float(number)
            last = time.monotonic_ns()
            cmd_vel.publish(message)
            running.wait_for('blocked:', name)                  # for 3 s from here
            assert mcu.stopped_at(last) / 1e9 < TIME_OUT_BOUND + 0.25 + LATE_S
        # A signal that comes while it is blocked stops the rover before it can end the process.
        assert graph.set('/slow/vel2d_bridge', cmd_vel_timeout=10.0) == ['']
        drive(mcu, cmd_vel, ros.twist(0.3), Vel2d(0.3, 0.0, 0.0))
        message.angular.x = 3.0
        cmd_vel.publish(message)
        wait(lambda: len(running.said('blocked: follow_graph')) == 2)
        signalled = time.monotonic_ns()
        running.signal(signal.SIGINT)
        assert mcu.stopped_at(signalled) / 1e9 < 0.3 + LATE_S
        assert running.exit_code() == 0


def test_a_port_behind_a_socket(ros, graph):
    """A URL of pyserial: the bridge drives through a terminal server too."""
    received = bytearray()

    def receive(connection):
        while chunk := connection.recv(4096):
            received.extend(chunk)

    with socket.create_server(('127.0.0.1', 0)) as server:
        port = f'socket://127.0.0.1:{server.getsockname()[1]}'
        with bridge(port, '-r', '__ns:=/url'):
            connection, _ = server.accept()
            reader = threading.Thread(target=receive, args=(connection,))
            reader.start()
            with ros.Teleop(graph.publisher('/url/cmd_vel'), lambda: ros.twist(*DRIVE), rate=50):
                wait(lambda: encode(DRIVE) in received)
        reader.join()
        connection.close()
    assert received.endswith(5 * encode(STOP))
