# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""
The receiver of firmware/ on an emulated STM32F405, the bridge as its host: scripts/test-mcu.

Each command has its number as x, so an old one is known. --fault-times N tries each fault N times.
Times are of the SysTick of the MCU: from the last good frame to the stop of its wheels.
"""
import os
import signal
import subprocess
import time

from harness import LATE_S
from harness import wait
import pytest
from running_bridge import bridge

from msg_defs.vel2d import STOP
from rigs.harness import family
from rigs.mcu.board import Board
from rigs.mcu.board import built
from rigs.mcu.uart import FAULTS
from rigs.mcu.uart import HARMLESS
from rigs.mcu.uart import Uart
from rigs.mcu.uart import whole

pytestmark = [pytest.mark.ros, pytest.mark.realtime(bears=0.1)]
BOUND_MS = 300 + 60
TIMEOUT_S = 0.5                     # cmd_vel_timeout: no older command leaves the bridge
Y, OMEGA = -0.25, 1.0
VOLUME = 2_000_000                  # bytes each time


class Rover:
    """The board, its line, its host, and who commands it."""

    def __init__(self, board, line, ros, cmd_vel):
        self.board, self.line = board, line
        self.published = [0.0]              # when, by number of the command
        self.ages = []                      # s: the first command after each fault
        self._ros = ros
        self.teleop = ros.Teleop(cmd_vel, self._command, 50)
        self.start()

    def start(self):
        self.host = bridge(self.line).__enter__()
        self.host.wait_for('open at')

    def _command(self):
        self.published.append(time.monotonic())
        return self._ros.twist(len(self.published) - 1, Y, OMEGA)

    def signal(self, number):
        """Send a signal to all processes of the host at once."""
        wait(lambda: len(family(self.host.pid)) >= 3)           # bridge, server and dead man
        for pid in family(self.host.pid):
            os.kill(pid, number)

    def drive(self):
        """Wait until the wheels follow commands that are newer than this call."""
        number = len(self.published)
        wait(lambda: self.board.wheels and self.board.wheels[-1].velocity[0] >= number)

    def survives(self, begin, end):
        """
        Let a fault begin, and end when the wheels stop; return after how many s these did.

        Then it drives again, with a command that is newer than any before and not old.
        """
        self.drive()
        board, known = self.board, len(self.board.wheels)

        def stops():
            return [at for at, one in enumerate(board.wheels) if one.velocity == STOP
                    and at >= known]
        begin()
        stop = board.wheels[wait(stops)[0]]
        good = [one.tick for one in board.good if one.tick <= stop.tick and one.velocity != STOP]
        assert stop.tick - good[-1] <= BOUND_MS
        end()
        self.drive()
        driven = [one for one in board.wheels if one.velocity != STOP]
        assert driven == sorted(driven, key=lambda one: one.velocity)
        first = next(one for one in driven if one.tick > stop.tick)
        self.ages.append(first.stamp - self.published[round(first.velocity[0])])
        assert self.ages[-1] < TIMEOUT_S + LATE_S
        return (stop.tick - good[-1]) / 1000


@pytest.fixture(scope='module')
def rover(ros, cmd_vel, tmp_path_factory):
    folder = tmp_path_factory.mktemp('board')
    with Board(built(folder)) as board, Uart(board.path, folder / 'mcu') as line:
        rover = Rover(board, line, ros, cmd_vel)
        with rover.teleop:
            yield rover
        rover.host.__exit__()
        for _, velocity, _ in board.good:           # nothing that was not sent
            assert velocity == STOP or (velocity[1:] == (Y, OMEGA)
                                        and velocity[0] in range(len(rover.published)))


def test_it_drives_and_reports(rover, graph):
    rover.drive()
    graph.wait_status('vel2d_bridge: link', 'MCU state=running', 'MCU version=1', level=0)


@pytest.mark.parametrize('fault', FAULTS)
def test_the_line(rover, recovery, fault):
    recovery(fault, rover.survives(lambda: setattr(rover.line, 'fault', FAULTS[fault]),
                                   lambda: setattr(rover.line, 'fault', whole)))


def test_the_bridge_says_that_the_mcu_stopped(rover, graph):
    graph.wait_status('vel2d_bridge: link', 'watchdog of the MCU stopped the rover', level=1)
    rover.host.wait_for('watchdog of the MCU stopped the rover')


@pytest.mark.parametrize('fault', HARMLESS)
def test_what_it_drives_through(rover, fault):
    line, board = rover.line, rover.board
    rover.drive()
    line.fault, share = HARMLESS[fault]
    frames, good = line.frames, len(board.good)
    time.sleep(2.0)
    frames = line.frames - frames
    line.fault = FAULTS['silence']
    wait(lambda: board.good[-1].stamp < time.monotonic() - 0.5)         # all have arrived
    good = len(board.good) - good
    line.fault = whole
    assert good >= share * frames > 0


def test_all_processes_of_the_host_freeze(rover, recovery):
    recovery('all processes of the host frozen', rover.survives(
        lambda: rover.signal(signal.SIGSTOP), lambda: rover.signal(signal.SIGCONT)))


def test_bridge_and_dead_man_are_killed_at_once(rover, recovery):
    def restart():
        rover.host.__exit__()
        rover.start()
    recovery('bridge and dead man killed at once', rover.survives(
        lambda: rover.signal(signal.SIGKILL), restart))


def test_a_volume_of_damaged_bytes(rover, tmp_path, pytestconfig, capsys):
    """2 million for each of --fault-times: 10^8 with 50. And what the receiver needs."""
    count = VOLUME * pytestconfig.getoption('--fault-times')
    with Board(built(tmp_path, f'-DVOLUME={count}')) as board:
        size, frames, wrong, bad = wait(lambda: board.figures.get('V'), 60 + count / 50_000)
        ram, *stack = board.figures['M']
    flash = subprocess.check_output(['arm-none-eabi-size', tmp_path / 'receiver.o']).split()[6]
    first, last = rover.board.good[0], rover.board.good[-1]
    ticks = (last.tick - first.tick) / (last.stamp - first.stamp) / 1000
    with capsys.disabled():
        print(f'\n{size:,} bytes: {frames:,} good frames, {wrong} wrong, {bad:,} damages\n'
              f'-O2: {int(flash)} bytes of flash, {ram} of RAM; stack of feed, now, report: '
              f'{stack}\nSysTick: {ticks:.3f} s in a second of the host; it loses some if that is '
              f'too busy\nThe oldest first command after a fault: {max(rover.ages):.2f} s old')
    assert wrong == 0
    assert frames > size / 60
