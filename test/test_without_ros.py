# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""The tools of the servo bus where there is no ROS, and where there is no fcntl either."""

import os
from pathlib import Path
import subprocess
import sys

import pytest

from msg_defs.dxl_instruction import Instruction
from msg_defs.dxl_packet import encode
from msg_defs.dxl_packet import STATUS

ROOT = Path(__file__).parents[1]
NEEDS_ROS = ('rclpy', 'rcl_interfaces', 'std_msgs', 'diagnostic_msgs', 'launch', 'aiohttp',
             'sqlite3', 'numpy')
UNIX = ('fcntl', 'termios', 'pty', 'tty', 'grp', 'pwd', 'resource')
DIALOGUE = 50 * (encode(1, Instruction.READ, bytes([132, 0, 4, 0]))
                 + encode(1, STATUS, bytes(4), error=0))
# Imports of ours are refused; those of the standard library and of pyserial are its own matter.
START = f"""
import builtins, runpy, sys

refused, module = sys.argv[1].split(','), sys.argv[2]
import_as_usual = builtins.__import__

def import_ours(name, globals=None, locals=None, fromlist=(), level=0):
    importer = (globals or {{}}).get('__name__', '').partition('.')[0]
    if name.partition('.')[0] in refused and importer in (
            '__main__', 'msg_defs', 'servobus'):
        raise ImportError(f'there is no {{name}} here')
    return import_as_usual(name, globals, locals, fromlist, level)

builtins.__import__ = import_ours
sys.argv = [module, *sys.argv[3:]]
try:
    runpy.run_module(module, run_name='__main__', alter_sys=True)
finally:
    found = [name for name in {NEEDS_ROS!r} if name in sys.modules]
    print('imported:', ' '.join(found), file=sys.stderr)
"""


@pytest.fixture
def recording(tmp_path):
    path = tmp_path / 'bus.bin'
    path.write_bytes(DIALOGUE)
    return path


def run(refused, module, *arguments, meeting_place=''):
    done = subprocess.run(
        [sys.executable, '-c', START, ','.join(refused), module, *map(str, arguments)], cwd=ROOT,
        capture_output=True, text=True, timeout=60, stdin=subprocess.DEVNULL,
        env={**os.environ, 'XDG_RUNTIME_DIR': meeting_place})
    assert 'Traceback' not in done.stderr, done.stderr
    assert done.stderr.rstrip().endswith('imported:'), done.stderr
    return done


@pytest.mark.parametrize('refused', [NEEDS_ROS, UNIX], ids=['no ROS', 'no fcntl'])
def test_files_are_judged_and_listed(recording, refused):
    done = run(refused, 'servobus.tools.dxl_doctor', recording)
    assert done.returncode == 0
    assert '001  model unknown: answers' in done.stdout
    done = run(refused, 'servobus.tools.dxl_dump', recording)
    assert (done.returncode, done.stdout.count('Status')) == (0, 50)


@pytest.mark.realtime(bears=0.5)
@pytest.mark.parametrize('refused', [NEEDS_ROS, UNIX], ids=['no ROS', 'no fcntl'])
def test_programs_are_run(refused, meeting_place):
    done = run(refused, 'servobus.tools.dxl_doctor', 'run', '--', sys.executable, '-c',
               'print("hello")', meeting_place=meeting_place)
    assert (done.returncode, done.stdout.splitlines()[0]) == (1, 'hello')
    done = run(refused, 'servobus.tools.tap', 'arm', '--', sys.executable, '-c', 'pass',
               meeting_place=meeting_place)
    assert done.returncode == 0


def test_a_recording_is_played_without_ros():
    assert run(NEEDS_ROS, 'servobus.tools.replay', '--help').returncode == 0
