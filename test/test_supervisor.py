# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""
The bridge as the first process of a container, or as the child of an init that ends with it.

A PID namespace is what a container is to the kernel: when its first process ends, all others in it
are killed. The bridge here is supervisor, link and dead man, without ROS.
"""
from contextlib import contextmanager
from contextlib import suppress
import os
from pathlib import Path
import shutil
import signal
import subprocess
import sys
import time

from harness import LATE_S
from harness import wait
import pytest

from rigs.harness import family
from rigs.running_mcu import RunningMcu

ROOT = Path(__file__).parents[1]
INSIDE = ['unshare', '--pid', '--fork', '--mount-proc', '--kill-child']
CAN_UNSHARE = shutil.which('unshare') is not None and subprocess.run(
    [*INSIDE, 'true'], capture_output=True).returncode == 0
pytestmark = [pytest.mark.realtime(bears=0.1), pytest.mark.skipif(
    not CAN_UNSHARE, reason='skipped: not allowed to make a PID namespace')]
BRIDGE = """
from mecarover_serial.node_command_line import hold_signals
from msg_defs.vel2d import Vel2d
import signal, sys, time
from vel2d_bridge.deadman import Deadman
from vel2d_bridge.gate import Gate
from vel2d_bridge.link import Link
from vel2d_bridge.supervisor import supervise

hold_signals()
code = supervise()
if code is not None:
    sys.exit(code)
deadman = Deadman()
link = Link(sys.argv[1], 115200, Gate(), deadman=deadman)
link.start()
while signal.sigtimedwait({signal.SIGTERM}, 0.01) is None:
    link.offer_command(Vel2d(0.5, 0.0, 0.0))
link.close()
sys.exit(7)
"""
# An init as docker's: it ends as soon as its child does.
INIT = 'import subprocess, sys; sys.exit(subprocess.run(sys.argv[1:]).returncode)'
PYTHON = [sys.executable, '-c']


@contextmanager
def container(mcu, *command):
    """Start a bridge that drives, in a namespace of its own; yield the process outside."""
    with subprocess.Popen([*INSIDE, *command, mcu.path], cwd=ROOT) as process:
        try:
            wait(lambda: mcu.receiver.wheels.x == 500.0)
            yield process
        finally:
            for pid in family(process.pid):
                with suppress(ProcessLookupError):
                    os.kill(pid, signal.SIGKILL)


def named(process, text):
    """Return the pids in the container with `text` in their command lines, the oldest first."""
    return [pid for pid in family(process.pid)
            if text in Path(f'/proc/{pid}/cmdline').read_text()
            and Path(f'/proc/{pid}/exe').resolve().name != 'unshare']


@pytest.fixture
def mcu(tmp_path):
    with RunningMcu(str(tmp_path / 'mcu')).running() as mcu:
        yield mcu


@pytest.mark.usefixtures('again')
@pytest.mark.parametrize('init', [[], [*PYTHON, INIT]], ids=['first process', 'below an init'])
def test_killed_in_a_container_the_rover_stops(mcu, init):
    """All that carry the name are killed, as `pkill -9 -f` does inside and outside."""
    with container(mcu, *init, *PYTHON, BRIDGE) as process:
        victims = named(process, 'vel2d_bridge.supervisor')
        if init:                                     # it carries the text of its child
            victims = victims[1:]
        assert len(victims) == 1
        begin = time.monotonic_ns()
        os.kill(victims[0], signal.SIGKILL)
        wait(lambda: mcu.receiver.wheels.is_stop)
        assert (mcu.receiver.wheels.stamp - begin) / 1e9 <= 0.3 + LATE_S
        assert process.wait() == 128 + signal.SIGKILL


def test_signals_are_forwarded_and_the_exit_code_comes_back(mcu):
    with container(mcu, *PYTHON, BRIDGE) as process:
        [supervisor] = [pid for pid in family(process.pid)[1:] if first_in_namespace(pid)]
        os.kill(supervisor, signal.SIGTERM)
        assert process.wait() == 7
        wait(lambda: mcu.receiver.wheels.is_stop)


def first_in_namespace(pid):
    status = Path(f'/proc/{pid}/status').read_text()
    return any(line.startswith('NSpid:') and line.split()[-1] == '1'
               for line in status.splitlines())


def test_on_a_machine_there_is_no_supervisor():
    code = 'from vel2d_bridge.supervisor import supervise; import sys; sys.exit(supervise() or 0)'
    assert subprocess.run([*PYTHON, code], cwd=ROOT).returncode == 0
