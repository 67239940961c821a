# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""
A log that is not read stops no stop: not while the cable is lost and comes back, not at the end.

A launcher that hangs leaves the pipe full, Ctrl-S stops the terminal. rclpy logs with the lock of
the interpreter, so one line that blocked would hold up all threads of the bridge.
"""
from contextlib import contextmanager
import math
import os
import pty
import signal
import subprocess
import sys
import termios
import time

from bridge_faults import BOUND_S
from harness import LATE_S
from harness import ROOT
from harness import wait
import pytest

from msg_defs.vel2d import STOP

pytestmark = [pytest.mark.ros, pytest.mark.realtime(bears=0.1)]


def full_pipe():
    """Return a pipe's two ends and what fills it."""
    reader, writer = os.pipe()

    def fill():
        again = os.open(f'/proc/self/fd/{writer}', os.O_WRONLY | os.O_NONBLOCK)
        try:
            while True:
                os.write(again, b'.')
        except BlockingIOError:
            os.close(again)

    return reader, writer, fill


def stopped_terminal():
    """Return a terminal's two ends and what stops its output, as Ctrl-S does."""
    master, slave = pty.openpty()
    return master, slave, lambda: termios.tcflow(slave, termios.TCOOFF)


@contextmanager
def driving(ros, mcu, cmd_vel, output, deadman):
    """Start a bridge that drives, then block its output; yield process and publisher."""
    reader, writer, block = output()
    options = [f'port:={mcu.path}', f'deadman:={deadman}']
    begin = time.monotonic_ns()
    process = subprocess.Popen(
        [sys.executable, '-m', 'vel2d_bridge.main', '--ros-args',
         *(part for option in options for part in ('-p', option))],
        stdin=subprocess.DEVNULL, stdout=writer, stderr=writer, cwd=ROOT)
    command = [ros.twist(0.3)]
    try:
        with ros.Teleop(cmd_vel, lambda: command[0], rate=50) as teleop:
            mcu.wait_drive(begin, 300.0)
            block()
            yield process, teleop, command
    finally:
        process.kill()
        process.wait()
        os.close(reader)
        os.close(writer)
        wait(lambda: mcu.receiver.wheels.is_stop)


@pytest.mark.parametrize('ending', [signal.SIGTERM, signal.SIGKILL, math.nan], ids=str)
@pytest.mark.parametrize('output', [full_pipe, stopped_terminal])
def test_cable_lost_and_back_while_the_log_is_blocked(ros, mcu, cmd_vel, output, ending):
    with driving(ros, mcu, cmd_vel, output, 'true') as (process, teleop, command):
        mcu.vanish()
        time.sleep(0.5)                              # it tries again, and has something to say
        back = time.monotonic_ns()
        mcu.come_back()
        first = mcu.since(back, 1)[0]
        assert first.velocity == STOP
        assert (first.stamp - back) / 1e9 < 0.6 + LATE_S
        mcu.wait_drive(back, 300.0)
        end(process, teleop, command, ending, mcu)


def end(process, teleop, command, ending, mcu):
    """End the drive, and look whether the rover stops in time."""
    begin = time.monotonic_ns()
    if ending is math.nan:                           # each is refused, and that is logged
        command[0].linear.x = math.nan
        assert mcu.stopped_at(begin) / 1e9 < BOUND_S + LATE_S
        return
    process.send_signal(ending)
    assert mcu.stopped_at(begin) / 1e9 < 0.3 + LATE_S
    assert process.wait(2.0 + LATE_S) == (0 if ending == signal.SIGTERM else -ending)


def test_without_a_deadman_a_refused_command_stops_the_rover_all_the_same(ros, mcu, cmd_vel):
    with driving(ros, mcu, cmd_vel, full_pipe, 'false') as (process, teleop, command):
        end(process, teleop, command, math.nan, mcu)
        end(process, teleop, command, signal.SIGTERM, mcu)
