# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""
Each wheel in a clean Python without ROS: what it needs, what a person sees who runs the doctor.

It installs what the wheel declares, as a person does, so it needs a package index.
"""

import json
import os
from pathlib import Path
import re
import subprocess
import sys
import time

import pytest
from test_packaging import copy_tree
from test_packaging import NAME
from test_packaging import ROOT

from servobus.tools.doctor.issue_report import CAPTURE

pytestmark = [pytest.mark.slow, pytest.mark.realtime(bears=0.1)]
WHEELS = {'dxl-doctor': './packaging/dxl-doctor', NAME: '.'}
DECLARED = {'crcmod-plus', 'pyserial', 'PyYAML', 'setuptools', 'pip'}
SERVOS = ('1:XL430-W250', '2:XL430-W250', '3:XL430-W250')
# A first program of somebody's own: it asks three servos for their position, and prints it.
SCRIPT = """\
import sys, time
import serial

def packet(servo, *content):
    data = bytes([255, 255, 253, 0, servo, len(content) + 2, 0, *content])
    crc = 0
    for byte in data:
        crc ^= byte << 8
        for _ in range(8):
            crc = (crc << 1 ^ 0x8005 if crc & 0x8000 else crc << 1) & 0xFFFF
    return data + bytes([crc & 255, crc >> 8])

port = serial.Serial(sys.argv[1], 1000000, timeout=0.05)
answers = {1: 0, 2: 0, 3: 0}
end = time.monotonic() + 6
while time.monotonic() < end:
    for servo in answers:
        port.reset_input_buffer()
        port.write(packet(servo, 2, 132, 0, 4, 0))
        answers[servo] += port.read(15)[4:5] == bytes([servo])
    time.sleep(0.02)
print('servo 2 answered', answers[2], 'times')
"""


@pytest.fixture(scope='module', params=WHEELS)
def package(request):
    return request.param


@pytest.fixture(scope='module')
def home(package, tmp_path_factory):
    """Return the folder of a person whose Python has a wheel and what it declares, no more."""
    tree = tmp_path_factory.mktemp('tree') / NAME
    copy_tree(tree)
    home = tmp_path_factory.mktemp('home')
    pip = [sys.executable, '-m', 'pip', '--quiet', '--disable-pip-version-check']
    subprocess.run([*pip, 'wheel', '--no-deps', '--no-build-isolation', '-w', home,
                    WHEELS[package]], cwd=tree, check=True)
    subprocess.run([sys.executable, '-m', 'venv', home / 'venv'], check=True)
    subprocess.run([home / 'venv/bin/pip', '--quiet', '--disable-pip-version-check', 'install',
                    *home.glob('*.whl')], check=True)
    return home


def findings(screen):
    return re.findall(r'(?m)^  \d (?:error|warning|advice), .*$', screen)


def environment(home, **more):
    """Return the environment of a shell without ROS, in which this tree is not to be found."""
    return {'HOME': str(home), 'PATH': f'{home}/venv/bin:/usr/bin:/bin', 'LANG': 'C.UTF-8',
            'PYTHONNOUSERSITE': '1', **more}


def run(home, *command, **more):
    return subprocess.run([*map(str, command)], cwd=home, env=environment(home, **more),
                          capture_output=True, text=True, timeout=60, stdin=subprocess.DEVNULL)


def test_it_brings_no_more_than_it_declares(home, package):
    done = run(home, 'python', '-m', 'pip', 'list', '--format', 'json')
    assert {one['name'].replace('-', '_').lower() for one in json.loads(done.stdout)} \
        <= {name.replace('-', '_').lower() for name in {package, *DECLARED}}


@pytest.fixture
def bus(home):
    """Return the port of a simulated bus on which servo 2 is dead."""
    port = home / 'bus'
    process = subprocess.Popen(
        [sys.executable, '-m', 'mecarover_fakes.fake_bus', '--link', port, '--pattern', 'none',
         '--baud', '1000000', '--fault', 'silent:2:0', '--devices', *SERVOS], cwd=ROOT,
        stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True)
    deadline = time.monotonic() + 20
    while not port.exists():
        assert process.poll() is None, process.stderr.read()
        assert time.monotonic() < deadline
        time.sleep(0.05)
    yield port
    process.terminate()
    process.communicate(timeout=20)


def test_a_person_runs_a_script_and_the_dead_servo_is_named(home, bus, meeting_place):
    (home / 'my_script.py').write_text(SCRIPT)
    done = run(home, 'dxl_doctor', '--report', 'report.txt', 'run', '--', 'python',
               'my_script.py', bus, XDG_RUNTIME_DIR=meeting_place)
    print(done.stdout, done.stderr, sep='\n')
    assert 'servo 2 answered 0 times\n' in done.stdout
    assert '1 error, 002: no answer' in done.stdout
    assert 'Heard, Dynamixel 2.0:' in done.stdout
    assert max(map(len, done.stdout.splitlines())) <= 80
    assert done.returncode == 4
    elsewhere = subprocess.run(                        # this tree, another user's home
        [sys.executable, '-m', 'servobus.tools.dxl_doctor', home / 'report.txt'], cwd=ROOT,
        capture_output=True, text=True, timeout=60)
    assert (elsewhere.returncode, elsewhere.stderr) == (4, '')
    assert findings(elsewhere.stdout) == findings(done.stdout) != []
    readable = Path(home / 'report.txt').read_text().split(CAPTURE)[0]
    assert not [secret for secret in (str(home), os.uname().nodename, 'my_script')
                if secret in readable]


def test_the_program_may_have_an_environment_of_its_own(home, bus, meeting_place):
    """The environment of the tool comes first in PATH, and holds nothing but the tool."""
    subprocess.run([sys.executable, '-m', 'venv', home / 'theirs'], check=True)
    subprocess.run([home / 'theirs/bin/pip', '--quiet', '--disable-pip-version-check', 'install',
                    'pyserial'], check=True)
    (home / 'my_script.py').write_text(SCRIPT)
    done = run(home, home / 'venv/bin/dxl_doctor', 'run', '--', 'python', 'my_script.py', bus,
               PATH=f'{home}/venv/bin:{home}/theirs/bin:/bin', XDG_RUNTIME_DIR=meeting_place)
    assert f'{home}/theirs/bin/python is heard' in done.stderr
    assert 'servo 2 answered 0 times\n' in done.stdout
    assert '1 error, 002: no answer' in done.stdout
    assert done.returncode == 4
