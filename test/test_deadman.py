# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""
The dead man against real processes: killed, frozen, woken, ended properly, with a lost port.

The bridge here is link + dead man in a process of its own that drives at 100 Hz, without ROS.
"""
from contextlib import contextmanager
from itertools import product
import json
import os
from pathlib import Path
import signal
import socket
import subprocess
import sys
import time

from bridge_family import holds_port
from bridge_family import living
from harness import LATE_S
import pytest

from mecarover_fakes.fake_mcu import FakeMcu
from msg_defs.vel2d import STOP
from rigs.harness import family
from rigs.harness import is_alive
from servobus.port.serial_port import open_port
from vel2d_bridge import deadman_process as watching
from vel2d_bridge.deadman_process import Watch
from vel2d_bridge.shared_memory import BEATEN
from vel2d_bridge.shared_memory import PortRecord
from vel2d_bridge.shared_memory import SharedBoard

pytestmark = pytest.mark.realtime(bears=0.05)
PATIENCE_S = 20
BRIDGE = """
import json, select, sys, time
from msg_defs.vel2d import Vel2d
from vel2d_bridge.deadman import Deadman
from vel2d_bridge.gate import Gate
from vel2d_bridge.link import Link

deadman = Deadman()
link = Link(sys.argv[1], 115200, Gate(), deadman=deadman)
link.start()
while len(deadman.pids) < 2:
    time.sleep(0.01)
print(*deadman.pids, flush=True)
while not select.select([sys.stdin], [], [], 0.01)[0]:
    link.offer_command(Vel2d(0.5, 0.0, 0.0))
link.close()
state = link.state()
print(json.dumps({'freezes': state.freezes, 'deadman': state.deadman}), flush=True)
"""


def wait(mcu, condition):
    """Pump until the condition holds; fail when patience ends."""
    deadline = time.monotonic() + PATIENCE_S
    while not condition():
        assert time.monotonic() < deadline
        mcu.pump(0.005)


def start(mcu):
    return subprocess.Popen(
        [sys.executable, '-c', BRIDGE, mcu.path], cwd=Path(__file__).parents[1], text=True,
        stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.PIPE)


@contextmanager
def bridge(mcu):
    """Start a bridge that drives; yield its process and the pids of dead man and server."""
    process = start(mcu)
    pids = [int(pid) for pid in process.stdout.readline().split()]
    try:
        wait(mcu, lambda: mcu.receiver.wheels.x == 500.0)
        yield process, pids
    finally:
        process.kill()
        process.communicate()
        mcu.come_back()
        wait(mcu, lambda: not any(map(is_alive, pids)))


@pytest.fixture
def mcu(tmp_path):
    mcu = FakeMcu(str(tmp_path / 'mcu'))
    yield mcu
    mcu.close()


def stopping_time(mcu, signal_number):
    """Send a signal to a driving bridge; return the seconds until the wheels hold zero."""
    with bridge(mcu) as (process, _):
        begin = time.monotonic()
        process.send_signal(signal_number)
        wait(mcu, lambda: mcu.receiver.wheels.is_stop)
        return mcu.receiver.wheels.stamp / 1e9 - begin


@pytest.mark.smoke
@pytest.mark.parametrize('number', [signal.SIGKILL, signal.SIGSTOP])
def test_killed_or_frozen_the_rover_stops_within_300_ms(mcu, number):
    assert stopping_time(mcu, number) <= 0.3
    assert mcu.totals()['insufficient'] == mcu.totals()['crc_err'] == 0


def assert_stop_burst(mcu):
    """Check that five zeros are the last that arrived."""
    mcu.pump(0.05)
    ending = list(mcu.receiver.arrivals)[-5:]
    assert [arrival.velocity for arrival in ending] == [STOP] * 5


@pytest.mark.usefixtures('again')
def test_pkill_of_all_that_carry_the_name_stops_the_rover(mcu):
    """As `pkill -9 -f vel2d_bridge`; the name is the path, which no other test has."""
    with bridge(mcu) as (process, pids):
        assert set(family(process.pid)) == {process.pid, *pids}
        for pid in pids:
            assert Path(f'/proc/{pid}/comm').read_text() == 'deadman\n'
            assert Path(f'/proc/{pid}/cmdline').read_bytes().strip(b'\0') == b'deadman'
        begin = time.monotonic()
        subprocess.run(['pkill', '-9', '-f', mcu.path], check=True)
        wait(mcu, lambda: mcu.receiver.wheels.is_stop)
        assert mcu.receiver.wheels.stamp / 1e9 - begin <= 0.3 + LATE_S


@pytest.mark.parametrize('victims', [[0], [1], [0, 1], [1, 0], [0, 0, 1, 1, 0]])
def test_killed_itself_it_is_replaced_and_stops_the_rover_then(mcu, victims):
    """0 is the dead man, 1 its server; the other one sees to it that both are there again."""
    with bridge(mcu) as (process, pids):
        family = pids
        for victim in victims:
            family = replaced(mcu, pids, family[victim])
        assert not mcu.receiver.wheels.is_stop
        begin = time.monotonic()
        process.kill()
        wait(mcu, lambda: mcu.receiver.wheels.is_stop)
        assert mcu.receiver.wheels.stamp / 1e9 - begin <= 0.3 + LATE_S
        wait(mcu, lambda: not any(map(is_alive, family)))


def replaced(mcu, pids, victim):
    """Kill one of the two; return both as they are when there are two again."""
    os.kill(victim, signal.SIGKILL)
    wait(mcu, lambda: not is_alive(victim))
    wait(mcu, lambda: len(living(pids[1])) == 2 and holds_port(living(pids[1])[0]))
    return living(pids[1])


@pytest.mark.parametrize('number', [signal.SIGKILL, signal.SIGSTOP])
def test_a_port_that_comes_back_to_a_dead_or_frozen_bridge_is_found_and_the_rover_stops(
        mcu, number):
    with bridge(mcu) as (process, pids):
        mcu.vanish()
        process.send_signal(number)
        time.sleep(0.5)                              # the dead man looks for it, again and again
        assert not mcu.receiver.wheels.is_stop
        mcu.come_back()
        wait(mcu, lambda: mcu.receiver.wheels.is_stop)
        zeros = mcu.totals()['frames'] + 4           # and not a single one, which could be lost
        wait(mcu, lambda: mcu.totals()['frames'] >= zeros)
        if number == signal.SIGSTOP:
            process.send_signal(signal.SIGCONT)
            wait(mcu, lambda: mcu.receiver.wheels.x == 500.0)   # the bridge has it again
            process.kill()
            wait(mcu, lambda: mcu.receiver.wheels.is_stop)
        wait(mcu, lambda: not any(map(is_alive, pids)))
    open_port(mcu.path, 115200).close()


def test_looking_for_a_port_ends_where_the_next_bridge_has_it(mcu):
    with bridge(mcu) as (process, pids):
        mcu.vanish()
        process.kill()
        process.wait()
        with bridge_that_waits(mcu) as successor:
            mcu.come_back()
            wait(mcu, lambda: mcu.receiver.wheels.is_stop)
            wait(mcu, lambda: not any(map(is_alive, pids)))
            successor.communicate('end', timeout=PATIENCE_S)


@contextmanager
def bridge_that_waits(mcu):
    """Start a bridge while its port is away."""
    process = start(mcu)
    process.stdout.readline()
    try:
        yield process
    finally:
        process.kill()
        process.communicate()


def test_half_of_a_heartbeat_is_not_believed():
    """On a 32-bit machine the two halves of a word are written one after the other."""
    watch = Watch(SharedBoard(), None, None)
    words = watch.board.words
    second = 1_000_000_000
    now = 7 * second
    words[BEATEN] = now - second // 20
    assert watch._last_beat(now) == now - second // 20
    for torn in (now + 4 * second, now - 4 * second):
        words[BEATEN] = torn
        assert watch._last_beat(now) == now - second // 20
    words[BEATEN] = now
    assert watch._last_beat(now) == now


UNBORN = """
from vel2d_bridge.deadman import Deadman
from vel2d_bridge.shared_memory import WATCH

deadman = Deadman()
deadman._words[WATCH] = 0            # as if it took longer than the bridge waits for it
deadman._is_gone = lambda: False
deadman.leave()
print('done')
"""


def test_one_that_is_not_born_yet_leaves_the_group_of_the_bridge_alone():
    done = subprocess.run([sys.executable, '-c', UNBORN], cwd=Path(__file__).parents[1], text=True,
                          capture_output=True, timeout=PATIENCE_S, start_new_session=True)
    assert (done.returncode, done.stdout) == (0, 'done\n')


def test_after_a_kill_the_burst_is_out_and_the_port_is_free(mcu):
    with bridge(mcu) as (process, pids):
        process.kill()
        wait(mcu, lambda: not any(map(is_alive, pids)))
    assert_stop_burst(mcu)
    open_port(mcu.path, 115200).close()


def test_a_launcher_that_waits_for_the_end_of_output_does_not_wait_for_the_deadman(mcu):
    with bridge(mcu) as (process, [pid, _]):
        os.kill(pid, signal.SIGSTOP)
        process.kill()
        assert process.stdout.read() == ''           # returns although the child lives
        assert is_alive(pid)
        os.kill(pid, signal.SIGCONT)


def test_frozen_it_goes_on_with_zeros_and_woken_begins_anew(mcu):
    with bridge(mcu) as (process, _):
        process.send_signal(signal.SIGSTOP)
        wait(mcu, lambda: mcu.receiver.wheels.is_stop)
        taken = mcu.totals()['taken']
        wait(mcu, lambda: mcu.totals()['taken'] >= taken + 10)
        assert mcu.receiver.wheels.is_stop
        process.send_signal(signal.SIGCONT)
        wait(mcu, lambda: mcu.receiver.wheels.x == 500.0)       # by commands that are new
        out, _ = process.communicate('end', timeout=PATIENCE_S)
    assert json.loads(out)['freezes'] >= 1


def test_it_ignores_signals(mcu):
    with bridge(mcu) as (_, pids):
        for pid, number in product(pids, (
                signal.SIGINT, signal.SIGTERM, signal.SIGHUP, signal.SIGQUIT, signal.SIGTSTP,
                signal.SIGUSR1, signal.SIGPIPE)):
            os.kill(pid, number)
        mcu.pump(0.1)
        assert all(map(is_alive, pids))
        assert {os.getsid(pid) for pid in pids} == {pids[1]}


def test_it_keeps_nothing_of_the_bridge_but_the_port(mcu):
    with bridge(mcu) as (_, [pid, server]):
        assert not holds_port(server)
        folder = Path(f'/proc/{pid}/fd')
        held = sorted(os.readlink(folder / name) for name in os.listdir(folder))
        assert held[:3] == ['/dev/null'] * 3
        assert held[3].startswith('/dev/pts/')
        assert [name[:7] for name in held[4:]] == ['socket:'] * 3


def test_it_leaves_with_the_bridge(mcu):
    with bridge(mcu) as (process, pids):
        out, err = process.communicate('end', timeout=PATIENCE_S)
        assert not any(map(is_alive, pids))
    assert (process.returncode, err) == (0, '')
    assert json.loads(out)['freezes'] == 0
    assert_stop_burst(mcu)
    open_port(mcu.path, 115200).close()


def test_unplugged_it_lets_go_of_the_device(mcu):
    with bridge(mcu) as (_, [pid, _]):
        mcu.vanish()
        wait(mcu, lambda: not holds_port(pid))
        mcu.come_back()
        wait(mcu, lambda: mcu.receiver.wheels.x == 500.0)
        wait(mcu, lambda: holds_port(pid))


def test_a_driver_that_counts_whole_transfers_is_not_flushed_in_mid_frame(monkeypatch):
    """The Linux driver cdc-acm calls all of a USB transfer pending, for any content."""
    flushed = []
    counts = iter([64, 64, 0])
    watch = Watch(SharedBoard(), None, None)
    watch._record = PortRecord(baud=1_000_000)         # else it waits for 300 s: 1 baud
    monkeypatch.setattr(watch, '_pending', lambda: next(counts))
    monkeypatch.setattr(watching.termios, 'tcflush', lambda *what: flushed.append(what))
    watch._await_idle_line()
    assert not flushed


def test_a_socket_whose_peer_confirms_nothing_gets_its_stops(monkeypatch):
    """It cannot be flushed, and need not be: what was written before arrives before."""
    near, far = socket.socketpair()
    with near, far:
        watch = Watch(SharedBoard(), None, None)
        watch._fd, watch._record = near.fileno(), PortRecord(stop=bytes(28), baud=1_000_000)
        monkeypatch.setattr(watch, '_pending', lambda: 28)
        watch._write_stop()
        far.setblocking(False)
        assert far.recv(64) == bytes(28)
