# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""
The deadman against real processes: killed, frozen, woken, ended properly.

The bridge here is link + deadman in a process of its own that drives at 100 Hz, without ROS.
"""
from contextlib import contextmanager
from contextlib import suppress
import json
import os
from pathlib import Path
import signal
import socket
import subprocess
import sys
import time

import pytest

from mecarover_serial.port import open_port
from msg_defs.vel2d import STOP
from vel2d_bridge import deadman
from vel2d_bridge.fake_mcu import FakeMcu

pytestmark = pytest.mark.alone
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
print(deadman.pid, flush=True)
while not select.select([sys.stdin], [], [], 0.01)[0]:
    link.offer(Vel2d(0.5, 0.0, 0.0))
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


def is_alive(pid):
    """Whether a process runs; one that only waits for its parent to look is over."""
    with suppress(OSError):
        return Path(f'/proc/{pid}/stat').read_text().rpartition(')')[2].split()[0] != 'Z'
    return False


@contextmanager
def bridge(mcu):
    """Start a bridge that drives; yield its process and the pid of its deadman."""
    process = subprocess.Popen(
        [sys.executable, '-c', BRIDGE, mcu.path], cwd=Path(__file__).parents[1], text=True,
        stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.PIPE)
    pid = int(process.stdout.readline())
    try:
        wait(mcu, lambda: mcu.receiver.wheels.x == 500.0)
        yield process, pid
    finally:
        process.kill()
        process.communicate()
        wait(mcu, lambda: not is_alive(pid))


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


@pytest.mark.parametrize('number', [signal.SIGKILL, signal.SIGSTOP])
def test_killed_or_frozen_the_rover_stops_within_300_ms(mcu, number):
    # The machine of a test may stall: all must stop, and the fastest shows what is built in.
    assert min(stopping_time(mcu, number) for _ in range(5)) <= 0.3
    assert mcu.totals()['insufficient'] == mcu.totals()['crc_err'] == 0


def assert_stop_burst(mcu):
    """Check that five zeros are the last that arrived."""
    mcu.pump(0.05)
    ending = list(mcu.receiver.arrivals)[-5:]
    assert [arrival.velocity for arrival in ending] == [STOP] * 5


def test_after_a_kill_the_burst_is_out_and_the_port_is_free(mcu):
    with bridge(mcu) as (process, pid):
        process.kill()
        wait(mcu, lambda: not is_alive(pid))
    assert_stop_burst(mcu)
    open_port(mcu.path, 115200).close()


def test_a_launcher_that_waits_for_the_end_of_output_does_not_wait_for_the_deadman(mcu):
    with bridge(mcu) as (process, pid):
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
    with bridge(mcu) as (_, pid):
        for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP, signal.SIGQUIT,
                       signal.SIGTSTP, signal.SIGUSR1, signal.SIGPIPE):
            os.kill(pid, number)
        mcu.pump(0.1)
        assert is_alive(pid)
        assert os.getsid(pid) == pid
        assert Path(f'/proc/{pid}/comm').read_text() == 'vel2d_deadman\n'


def test_it_keeps_nothing_of_the_bridge_but_the_port(mcu):
    with bridge(mcu) as (_, pid):
        folder = Path(f'/proc/{pid}/fd')
        held = sorted(os.readlink(folder / name) for name in os.listdir(folder))
        assert held[:3] == ['/dev/null'] * 3
        assert len(held) == 5
        assert held[3].startswith('/dev/pts/')
        assert held[4].startswith('socket:')


def test_it_leaves_with_the_bridge(mcu):
    with bridge(mcu) as (process, pid):
        out, err = process.communicate('end', timeout=PATIENCE_S)
        assert not is_alive(pid)
    assert (process.returncode, err) == (0, '')
    assert json.loads(out)['freezes'] == 0
    assert_stop_burst(mcu)
    open_port(mcu.path, 115200).close()


def test_unplugged_it_lets_go_of_the_device(mcu):
    with bridge(mcu) as (_, pid):
        folder = Path(f'/proc/{pid}/fd')
        mcu.vanish()
        wait(mcu, lambda: len(os.listdir(folder)) == 4)
        mcu.come_back()
        wait(mcu, lambda: mcu.receiver.wheels.x == 500.0)
        wait(mcu, lambda: len(os.listdir(folder)) == 5)


def test_a_driver_that_counts_whole_transfers_is_not_flushed_in_mid_frame(monkeypatch):
    """The Linux driver cdc-acm calls all of a USB transfer pending, whatever is in it."""
    flushed = []
    counts = iter([64, 64, 0])
    watch = deadman._Watch(memoryview(bytearray(8)), None, 0)
    monkeypatch.setattr(watch, '_pending', lambda: next(counts))
    monkeypatch.setattr(deadman.termios, 'tcflush', lambda *what: flushed.append(what))
    watch._settle()
    assert not flushed


def test_a_socket_whose_peer_confirms_nothing_gets_its_stops(monkeypatch):
    """It cannot be flushed, and need not be: what was written before arrives before."""
    near, far = socket.socketpair()
    with near, far:
        watch = deadman._Watch(memoryview(bytearray(64)).cast('Q'), None, 0)
        watch._fd, watch._stop, watch._character_s = near.fileno(), bytes(28), 1e-5
        monkeypatch.setattr(watch, '_pending', lambda: 28)
        watch._act()
        far.setblocking(False)
        assert far.recv(64) == bytes(28)
