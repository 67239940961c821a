# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""
The receiver of firmware/ on an emulated STM32F405, the bridge as its host: scripts/test-mcu.

Each command has its number as x, so an old one is known. --fault-times N tries each fault N times.
Times are of the SysTick of the MCU: from the last good frame to the stop of its wheels.
"""
import os
import signal
import time

from harness import bridge
from harness import wait
import pytest

from msg_defs.vel2d import STOP
from rigs.harness import family
from rigs.mcu import line as faults
from rigs.mcu.board import Board
from rigs.mcu.board import built
from rigs.mcu.board import sizes
from rigs.mcu.line import Line
from rigs.mcu.line import sometimes

pytestmark = pytest.mark.ros
BOUND_MS = 300 + 60
Y, OMEGA = -0.25, 1.0
LATEST_S = 0.1                      # how old a command may be when the line is well again
VOLUME = 2_000_000                  # bytes each time
LINE_FAULTS = {
    'silence': faults.nothing, 'noise': faults.noise, 'half frames': faults.half,
    'a pause in each frame': faults.paused, 'a byte of each frame lost': faults.dropped,
    'a bit of each frame turned': faults.flipped, 'flood': faults.flooded,
    'baud rate 6 % off': faults.at_rate(0.06)}
HARMLESS = {
    'no fault': faults.whole, 'noise around each frame': faults.surrounded,
    'baud rate 2 % off': faults.at_rate(0.02), 'one frame of four lost': sometimes(faults.nothing),
    'one frame of four without a byte': sometimes(faults.dropped),
    'one frame of four with a wrong bit': sometimes(faults.flipped)}


class Rover:
    """The board, its line, and who commands it."""

    def __init__(self, board, line, ros, cmd_vel):
        self.board = board
        self.line = line
        self.published = [0.0]              # when, by number of the command
        self._ros = ros
        self.teleop = ros.Teleop(cmd_vel, self._command, 50)

    def _command(self):
        self.published.append(time.monotonic())
        return self._ros.twist(len(self.published) - 1, Y, OMEGA)

    def drive(self):
        """Wait until the wheels follow commands that are newer than this call."""
        number = len(self.published)
        wait(lambda: self.board.wheels and self.board.wheels[-1].velocity[0] >= number)

    def stops(self, begin):
        """Return how long (s) after the last good frame the wheels stop when `begin()` is done."""
        self.drive()
        board, known = self.board, len(self.board.wheels)
        begin()
        wait(lambda: any(one.velocity == STOP for one in board.wheels[known:]))
        self.stopped = next(index for index in range(known, len(board.wheels))
                            if board.wheels[index].velocity == STOP)
        stop = board.wheels[self.stopped]
        good = [one.tick for one in board.good if one.tick <= stop.tick and one.velocity != STOP]
        assert stop.tick - good[-1] <= BOUND_MS
        return (stop.tick - good[-1]) / 1000

    def goes_on(self, end):
        """Drive again after `end()`: with the next good command, never with an old one."""
        ended = time.monotonic()
        end()
        self.drive()
        driven = [one.velocity for one in self.board.wheels[self.stopped + 1:]
                  if one.velocity != STOP]
        assert self.published[round(driven[0][0])] >= ended - LATEST_S
        assert driven == sorted(driven)


@pytest.fixture(scope='module')
def board(tmp_path_factory):
    with Board(built(tmp_path_factory.mktemp('board'))) as board:
        yield board
        assert board.other == ''


@pytest.fixture(scope='module')
def rover(board, ros, cmd_vel, tmp_path_factory):
    with Line(tmp_path_factory.mktemp('dev') / 'mcu', board.path) as line:
        rover = Rover(board, line, ros, cmd_vel)
        with rover.teleop:
            yield rover
        wrong = [one for one in board.good if one.velocity not in (STOP, (
            round(one.velocity[0]), Y, OMEGA)) or one.velocity[0] >= len(rover.published)]
        assert wrong == []


class Host:
    """The bridge; it can be started again."""

    def __init__(self, line):
        self._line = line
        self.running = None

    def start(self):
        self.running = bridge(self._line).__enter__()
        self.running.wait_for('open at')

    def signal(self, number):
        """Send a signal to all processes at once."""
        pids = family(self.running.pid)
        assert len(pids) >= 3                       # bridge, server and dead man
        for pid in pids:
            os.kill(pid, number)

    def end(self):
        self.running.__exit__()


@pytest.fixture(scope='module')
def host(rover):
    host = Host(rover.line)
    host.start()
    yield host
    host.end()


@pytest.mark.usefixtures('host')
def test_it_drives_and_reports(rover, graph):
    rover.drive()
    graph.wait_status('vel2d_bridge: link', 'MCU state=running', 'MCU version=1', level=0)


@pytest.mark.usefixtures('host')
@pytest.mark.parametrize('fault', LINE_FAULTS)
def test_the_line(rover, recovery, fault):
    def damage(how):
        rover.line.damage = how
    recovery(fault, rover.stops(lambda: damage(LINE_FAULTS[fault])))
    rover.goes_on(lambda: damage(faults.whole))


@pytest.mark.usefixtures('host')
@pytest.mark.parametrize('fault', HARMLESS)
def test_what_it_drives_through(rover, fault):
    """The watchdog does not act; the bridge itself stops if this machine is too busy."""
    rover.drive()
    known = len(rover.board.wheels)
    rover.line.damage = HARMLESS[fault]
    time.sleep(2.0)
    rover.line.damage = faults.whole
    rover.drive()
    commanded = [one.tick for one in rover.board.good if one.velocity == STOP]
    for stop in (one.tick for one in rover.board.wheels[known:] if one.velocity == STOP):
        assert any(stop - 30 <= tick <= stop for tick in commanded)


def test_the_bridge_says_that_the_mcu_stopped(rover, host, graph):
    rover.stops(lambda: setattr(rover.line, 'damage', faults.nothing))
    rover.goes_on(lambda: setattr(rover.line, 'damage', faults.whole))
    graph.wait_status('vel2d_bridge: link', 'watchdog of the MCU stopped the rover', level=1)
    host.running.wait_for('watchdog of the MCU stopped the rover')


def test_all_processes_of_the_host_freeze(rover, host, recovery):
    recovery('all processes of the host frozen', rover.stops(
        lambda: host.signal(signal.SIGSTOP)))
    rover.goes_on(lambda: host.signal(signal.SIGCONT))


def test_bridge_and_dead_man_are_killed_at_once(rover, host, recovery):
    recovery('bridge and dead man killed at once', rover.stops(
        lambda: host.signal(signal.SIGKILL)))
    host.end()
    rover.goes_on(host.start)


def test_how_many_ticks_the_emulator_loses(board, capsys):
    """On a machine that is too busy it does: then the times above are longer than they say."""
    first, last = board.good[0], board.good[-1]
    ratio = (last.tick - first.tick) / (last.stamp - first.stamp) / 1000
    with capsys.disabled():
        print(f'\nSysTick: {ratio:.3f} s in a second of the host')
    assert ratio < 1.01


def test_no_wrong_frame_in_a_volume_of_damaged_bytes(tmp_path, pytestconfig, capsys):
    """2 million bytes for each of --fault-times; with 50: 10^8."""
    count = VOLUME * pytestconfig.getoption('--fault-times')
    with Board(built(tmp_path, f'-DVOLUME={count}')) as board:
        wait(lambda: board.volume, 60 + count / 50_000)
    size, frames, wrong, bad = board.volume
    with capsys.disabled():
        print(f'\n{size:,} bytes: {frames:,} good frames, {wrong} wrong, {bad:,} damages')
    assert (wrong, frames > size / 60) == (0, True)


def test_sizes(board, tmp_path, capsys):
    built(tmp_path)
    flash, data = sizes(tmp_path / 'receiver.o')
    ram, *stack = wait(lambda: board.memory)
    with capsys.disabled():
        print(f'\nCortex-M4, -O2: {flash} bytes of flash, {ram} of RAM for a receiver; '
              'stack of feed, now, report:', *stack)
    assert data == 0
    assert flash < 2048 and ram < 256 and max(stack) < 256
