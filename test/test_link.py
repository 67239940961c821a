# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""Link on real ptys: time-outs, loss and return, a stuck port, rates, shutdown."""
import array
from contextlib import contextmanager
import fcntl
import os
import threading
import time

from harness import wait
import pytest
from terminal_server import TerminalServer

from msg_defs.diagnostics import Level
from msg_defs.nanoseconds import NS_PER_MS
from msg_defs.nanoseconds import NS_PER_S
from msg_defs.vel2d import decode
from msg_defs.vel2d import FRAME_SIZE
from msg_defs.vel2d import STOP
from msg_defs.vel2d import Vel2d
from rigs.running_mcu import RunningMcu
from servobus.port.serial_port import open_port
from servobus.port.serial_port import Port
from vel2d_bridge.bridge_status import link_status
from vel2d_bridge.gate import FrameKind
from vel2d_bridge.gate import Gate
from vel2d_bridge.gate import GateSettings
from vel2d_bridge.gate import Outcome
from vel2d_bridge.gate import Stop
from vel2d_bridge.link import Link
from vel2d_bridge.mcu_log import McuLog

pytestmark = pytest.mark.realtime(bears=0.02)

PATIENCE_S = 20
TIOCGEXCL = 0x80045440
DRIVE = Vel2d(0.5, -0.25, 1.0)


@contextmanager
def linked(path, settings=None, **options):
    """Run a link; leaving closes it."""
    link = Link(path, 115200, Gate(settings), **options)
    link.start()
    try:
        yield link
    finally:
        link.close()


@pytest.fixture
def mcu(tmp_path):
    with RunningMcu(str(tmp_path / 'mcu')).running() as mcu:
        yield mcu


def velocities(mcu):
    return [arrival.velocity for arrival in list(mcu.receiver.arrivals)]


def drive(link, mcu, velocity=DRIVE):
    """Command until the MCU follows."""
    def follows():
        link.offer_command(velocity)
        return mcu.receiver.wheels.x == velocity.x * 1000

    wait(follows)


def unplug(link, mcu):
    """Take the port away and wait until the link knows."""
    mcu.vanish()
    wait(lambda: not link.state().is_open)


def test_commands_arrive_and_silence_stops(mcu):
    sent = []
    with linked(mcu.path, on_sent=sent.append) as link:
        wait(lambda: link.state().is_open)
        drive(link, mcu)
        wait(lambda: mcu.receiver.wheels.is_stop)
        frames = mcu.totals()['frames']
        wait(lambda: mcu.totals()['frames'] >= frames + 10)    # zeros go on
        assert mcu.receiver.wheels.is_stop
        assert link.gate.counters.time_outs == 1
        assert link.state().frames == len(sent)
    assert sent[0].velocity == STOP
    commands = [one for one in sent if one.kind is FrameKind.COMMAND]
    assert all(one.latency >= one.write >= 0 for one in commands)
    assert len({one.stamp for one in sent}) == len(sent)


def test_closing_ends_with_a_burst(mcu):
    with linked(mcu.path, GateSettings(resend_rate=0.0)) as link:
        drive(link, mcu)
    wait(lambda: mcu.receiver.wheels.is_stop)
    assert velocities(mcu)[-5:] == [STOP] * 5
    assert link.offer_command(DRIVE) is Outcome.SHUTDOWN
    assert not link.state().is_open
    link.close()


def is_exclusive(path):
    """Ask the kernel; only who is not root would notice at open()."""
    fd = os.open(path, os.O_RDWR | os.O_NOCTTY)
    answer = array.array('i', [-1])
    fcntl.ioctl(fd, TIOCGEXCL, answer)
    os.close(fd)
    return bool(answer[0])


def test_closing_gives_the_port_back_to_everybody(mcu):
    with linked(mcu.path) as link:
        wait(lambda: link.state().is_open)
        assert is_exclusive(mcu.path)
    assert not is_exclusive(mcu.path)


def test_unplugged_and_back_ten_times(mcu):
    changes = []
    with linked(mcu.path, on_change=changes.append) as link:
        for _ in range(10):
            drive(link, mcu)
            unplug(link, mcu)
            assert link.offer_command(DRIVE) is Outcome.NO_PORT
            mcu.receiver.arrivals.clear()
            mcu.come_back()
            wait(lambda: len(mcu.receiver.arrivals) >= 5)
            assert set(velocities(mcu)) == {STOP}
        state = link.state()
    assert (state.openings, state.losses, state.problem) == (11, 10, None)
    assert 'lost' in state.last_error or 'absent' in state.last_error
    assert sum(change is None for change in changes) == 11


def test_a_port_that_is_absent_is_opened_when_it_comes(tmp_path):
    path = str(tmp_path / 'late')
    with linked(path) as link:
        wait(lambda: link.state().problem is not None)
        problem = link.state().problem
        assert problem.kind == 'absent'
        assert problem.reason
        assert problem.remedy
        with RunningMcu(path).running() as mcu:
            drive(link, mcu)
            assert link.state().problem is None


def test_closing_without_a_port_does_not_wait(tmp_path):
    link = Link(str(tmp_path / 'none'), 115200, Gate())
    link.start()
    wait(lambda: link.state().problem is not None)
    link.close()
    assert not link._thread.is_alive()


def test_a_mistake_of_pyserial_does_not_end_the_thread(mcu):
    """It lists all ports to say what is plugged in, and trips over one that vanishes meanwhile."""
    mistakes = [TypeError('expected str, not NoneType'), KeyError('usb')]

    def opener(path, baud):
        if mistakes:
            raise mistakes.pop(0)
        return open_port(path, baud)

    with linked(mcu.path, opener=opener) as link:
        drive(link, mcu)
        assert "KeyError: 'usb'" in link.state().last_error


def test_frozen_while_the_port_is_closed_it_begins_anew_too(mcu, monkeypatch):
    """What was published meanwhile waits in the sockets, and would drive the rover."""
    link = Link(mcu.path, 115200, Gate())
    monkeypatch.setattr(link._pipe, 'sleep', lambda seconds: time.sleep(seconds + 0.25))
    monkeypatch.setattr(link, '_opener', lambda *_: open_port(str(mcu.path) + '-gone', 115200))
    link.start()
    wait(lambda: link.state().problem is not None)
    monkeypatch.setattr(link, '_opener', open_port)
    wait(lambda: link.state().is_open)
    assert link.state().freezes >= 1
    assert link.gate.counters.stops[Stop.FROZEN] >= 1
    link.close()


def test_closing_while_the_port_is_lost_waits_for_it_to_send_the_stop_that_is_owed(mcu):
    with linked(mcu.path) as link:
        drive(link, mcu)
        unplug(link, mcu)
        mcu.receiver.arrivals.clear()
        closing = threading.Thread(target=link.close)
        closing.start()
        wait(lambda: link.gate.is_shut)
        mcu.come_back()
        closing.join()
    wait(lambda: mcu.receiver.wheels.is_stop)
    assert set(velocities(mcu)) == {STOP}
    assert not link._thread.is_alive()


@pytest.mark.parametrize('drives', [True, False])
def test_closing_tells_whether_the_rover_may_be_driving_on(mcu, drives):
    with linked(mcu.path) as link:
        drive(link, mcu)
        if not drives:
            wait(lambda: mcu.receiver.wheels.is_stop and not link.gate.stopping)
        unplug(link, mcu)
        assert link.close() is not drives
        assert link.close()
    assert not link._thread.is_alive()


class Recorder:
    """A port that takes all there is, at once."""

    fd = None

    def __init__(self):
        self.written = []

    def write(self, data):
        self.written.append(decode(data))
        return len(data)

    def pending(self):
        return 0


@pytest.mark.parametrize('act', [
    lambda link: link.enable(True), lambda link: link.apply(GateSettings(max_linear_x=0.3)),
    lambda link: link.stop(Stop.TYPE_SWITCH)])
def test_whatever_comes_first_after_a_freeze_sends_no_old_set_point(act):
    now = NS_PER_S
    port = Recorder()
    link = Link('/dev/none', 115200, Gate(), clock=lambda: now)
    link._begin(port)                                # no thread: it is frozen
    now += 100 * NS_PER_MS
    while STOP not in port.written[2:]:              # the burst
        now += 10 * NS_PER_MS
        link._pacer.turn(now)
    link.offer_command(DRIVE)
    while port.written[-1] == STOP:
        now += 10 * NS_PER_MS
        link._pacer.turn(now)
    assert port.written[-1] == DRIVE
    port.written.clear()
    now += 300 * NS_PER_MS
    act(link)
    for _ in range(10):
        now += 10 * NS_PER_MS
        link._pacer.turn(now)
    assert set(port.written) == {STOP}
    assert link.state().freezes == 1


def push(fd):
    try:
        return os.write(fd, bytes(64))
    except BlockingIOError:
        time.sleep(0.01)                             # the kernel may just be moving its buffers
        return 0


def stuff(path):
    """Fill the pty until it takes nothing more."""
    fd = os.open(path, os.O_RDWR | os.O_NOCTTY | os.O_NONBLOCK)
    while any(push(fd) for _ in range(5)):
        pass
    os.close(fd)


def test_a_stuck_reader_costs_a_write_time_out_and_leads_to_a_stop(tmp_path):
    mcu = RunningMcu(str(tmp_path / 'mcu'))          # it is not pumped yet
    opened = []

    def opener(path, baud):
        stuff(path)
        opened.append(open_port(path, baud))
        return opened[-1]

    with linked(mcu.path, opener=opener) as link:
        wait(lambda: link.state().time_outs >= 1)
        assert link.gate.counters.stops[Stop.WRITE] >= 1
        with mcu.running():
            wait(lambda: mcu.totals()['frames'] >= 3)          # the flush let it go on
            assert set(velocities(mcu)[-3:]) == {STOP}
            drive(link, mcu)
            link.close()


def test_suspending_waits_for_the_stop_that_is_owed_too(mcu):
    with linked(mcu.path) as link:
        drive(link, mcu)
        unplug(link, mcu)
        mcu.receiver.arrivals.clear()
        suspending = threading.Thread(target=link.suspend, args=(PATIENCE_S,))
        suspending.start()
        mcu.come_back()
        suspending.join()
        assert STOP in velocities(mcu)


def test_a_mistake_in_what_is_told_ends_nothing(mcu):
    def fail(problem):
        raise RuntimeError('a mistake')

    with linked(mcu.path, on_change=fail) as link:
        drive(link, mcu)
        unplug(link, mcu)
        mcu.come_back()
        drive(link, mcu)


def test_an_error_while_an_error_is_handled_does_not_end_the_thread(mcu, monkeypatch):
    """As where no memory is left. The port is closed all the same, and opened again."""
    failures = [MemoryError(), RuntimeError("can't start new thread")]

    def drop_output(port):
        if failures:
            raise failures.pop()

    monkeypatch.setattr(Port, 'drop_output', drop_output)
    with linked(mcu.path) as link:
        for opening in (1, 2):
            wait(lambda: link.state().openings == opening)      # noqa: B023
            drive(link, mcu)
            unplug(link, mcu)
            mcu.come_back()
        wait(lambda: link.state().openings == 3)
        assert not failures and link.is_working()


def test_a_thread_that_hangs_or_has_ended_does_not_work(mcu, monkeypatch):
    hangs, goes_on, real = threading.Event(), threading.Event(), Port.read

    def read(port):
        hangs.set()
        goes_on.wait(PATIENCE_S)
        return real(port)

    link = Link(mcu.path, 115200, Gate())
    assert not link.is_working()
    link.start()
    wait(lambda: link.state().is_open)
    assert link.is_working()
    monkeypatch.setattr(Port, 'read', read)
    mcu.send_text(b'hello')
    assert hangs.wait(PATIENCE_S)
    wait(lambda: not link.is_working())
    goes_on.set()
    wait(link.is_working)
    link.close()
    assert not link.is_working()


class Sullen(Port):
    """A port that takes nothing, not even after a flush."""

    def write(self, data):
        return 0


class Stingy(Port):
    """A port that takes 11 bytes of every seventh frame."""

    writes = 0

    def write(self, data):
        self.writes += 1
        return super().write(data if self.writes % 7 else data[:11])


def of_kind(kind):
    """Return an opener for ports of that kind."""
    def opener(path, baud):
        port = open_port(path, baud)
        port.__class__ = kind
        return port
    return opener


def test_a_port_that_stays_stuck_is_reopened_and_closing_is_bounded(mcu):
    with linked(mcu.path, opener=of_kind(Sullen), write_timeout_s=0.005) as link:
        wait(lambda: link.state().is_open and link.state().problem is not None)
        wait(lambda: link.state().losses >= 1)
        assert 'takes no data' in link.state().last_error
        wait(lambda: link.state().openings >= 2)
    assert not link._thread.is_alive()


def test_a_driver_that_takes_its_time_to_close_holds_up_neither_the_news_nor_the_heart(mcu):
    """As cdc_acm does for 30 s when a board hangs."""
    closing, released = threading.Event(), threading.Event()
    beats, news = [], []

    class Slow(Sullen):
        def close(self):
            if not released.is_set():
                closing.set()
                released.wait(PATIENCE_S)
            super().close()

    class Heart:
        def beat(self, now):
            beats.append(now)

        def __getattr__(self, name):
            return lambda *_: name == 'is_alive'

    with linked(mcu.path, opener=of_kind(Slow), write_timeout_s=0.005, deadman=Heart(),
                on_change=news.append) as link:
        wait(closing.is_set)
        assert 'takes no data' in str(news[-1])
        count = len(beats)
        wait(lambda: len(beats) > count + 3)
        assert link.state().openings == 1
        released.set()
        wait(lambda: link.state().openings >= 2)


def test_a_partial_write_is_never_completed(mcu):
    with linked(mcu.path, opener=of_kind(Stingy)) as link:
        wait(lambda: link.state().partial_writes >= 3)
        wait(lambda: mcu.totals()['frames'] >= 20)
    assert {arrival.size for arrival in mcu.receiver.arrivals} <= {11, FRAME_SIZE}
    assert mcu.totals()['crc_err'] == 0


def test_what_the_mcu_says_is_handed_on(mcu):
    heard = []
    with linked(mcu.path, on_received=lambda chunk, stamp: heard.append(chunk)) as link:
        wait(lambda: link.state().is_open)
        mcu.send_text(b'battery low\n')
        wait(lambda: b''.join(heard) == b'battery low\n')


def test_a_callback_that_fails_does_not_end_the_stops(mcu):
    def fail(chunk, stamp):
        raise ValueError('a mistake')

    with linked(mcu.path, on_received=fail) as link:
        drive(link, mcu)
        mcu.send_text(b'x')
        wait(lambda: link.state().losses == 1)
        assert 'ValueError: a mistake' in link.state().last_error
        wait(lambda: mcu.receiver.wheels.is_stop)
        drive(link, mcu)


def test_disable_stop_and_settings_take_effect(mcu):
    with linked(mcu.path) as link:
        drive(link, mcu)
        link.enable(False)
        wait(lambda: mcu.receiver.wheels.is_stop)
        assert link.offer_command(DRIVE) is Outcome.DISABLED
        link.enable(True)
        link.apply(GateSettings(max_linear_x=0.25), write_timeout_s=0.02)
        link.offer_command(DRIVE)
        assert link.gate.velocity == Vel2d(0.25, -0.125, 0.5)
        link.suspend()
        assert link.gate.counters.stops[Stop.SUSPEND] == 1
        wait(lambda: mcu.receiver.wheels.is_stop)
        assert not link.gate.driving


class Alive:
    """A dead man that could."""

    def __getattr__(self, name):
        return lambda *_: name == 'is_alive'


def test_a_terminal_server_drives_the_rover_stops_it_and_has_no_use_for_a_deadman(mcu):
    with TerminalServer(mcu.path) as server:
        with linked(server.url, deadman=Alive()) as link:
            drive(link, mcu)
            server.hang_up()
            wait(lambda: len(server.carried) == 2 and len(server.carried[1]) >= FRAME_SIZE)
            assert decode(bytes(server.carried[1][:FRAME_SIZE])) == STOP
            assert (link.state().losses, link.state().openings) == (1, 2)
            drive(link, mcu)
            state = link.state()
            assert state.deadman == 'no use'
            status = link_status('vel2d_bridge', server.url, state, [], McuLog(), 0)
            assert status.message.startswith('deadman: it cannot write to this kind of URL')
            assert status.level == Level.WARN
        wait(lambda: velocities(mcu)[-5:] == [STOP] * 5)
