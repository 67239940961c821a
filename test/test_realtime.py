# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""A test of real time is run again where its processes waited, and nowhere else."""
import os
from pathlib import Path
import re
import subprocess
import sys

import pytest

from rigs import planted

CONFTEST = """
import realtime

def pytest_configure(config):
    config.addinivalue_line('markers', 'realtime(bears): judges real time')
    config.pluginmanager.register(realtime.Rerun(), 'rerun')
"""
TESTS = """
import os, subprocess, sys
from pathlib import Path
import pytest

TRIED = Path(__file__).with_name('tried')

@pytest.fixture(scope='module')
def shared():
    with TRIED.open('a') as file:
        file.write('x')

def stop_all(seconds):
    # Of another session, so that it goes on while this process and what watches it are stopped.
    family = subprocess.run(['ps', '-o', 'pid=', '--ppid', str(os.getpid())], text=True,
                            capture_output=True).stdout.split()
    pids = ' '.join([str(os.getpid()), *family])
    subprocess.run(['setsid', 'sh', '-c', f'kill -STOP {pids} 2>&-; sleep {seconds}; '
                                          f'kill -CONT {pids} 2>&-'])

@pytest.mark.realtime(bears=0.2)
def test_stopped_once(shared):
    if len(TRIED.read_text()) == 1:
        stop_all(0.5)
        assert False, 'too late'

@pytest.mark.realtime(bears=0.2)
def test_stopped_always():
    stop_all(0.5)
    assert False, 'too late'

@pytest.mark.realtime(bears=0.05)
def test_starved():
    spin = [subprocess.Popen([sys.executable, '-c', 'while True: pass'])
            for _ in range(2 * os.cpu_count())]
    try:
        spin[0].wait(0.5)
    finally:
        for one in spin:
            one.kill()
            one.wait()

@pytest.mark.realtime(bears=60)
def test_wrong():
    assert False, 'a fault'

@pytest.mark.realtime(bears=0.2)
def test_well(shared):
    pass
"""


@pytest.mark.slow
@pytest.mark.parametrize('options', [(), ('-n', '2')], ids=['one process', 'workers'])
def test_what_waited_is_run_again_and_named(tmp_path, options):
    if options:
        pytest.importorskip('xdist', reason='skipped: no pytest-xdist here')
    (tmp_path / 'conftest.py').write_text(CONFTEST)
    (tmp_path / 'test_it.py').write_text(TESTS)
    done = subprocess.run(
        [sys.executable, '-m', 'pytest', '-p', 'no:cacheprovider', '-c', os.devnull, '--rootdir',
         str(tmp_path), *options, 'test_it.py'], cwd=tmp_path, text=True, capture_output=True,
        env={**os.environ, 'PYTHONPATH': str(Path(__file__).parent)})
    said = done.stdout
    assert re.search(r'3 failed, 2 passed', said), said + done.stderr
    again = dict(re.findall(r'test_it\.py::(\w+): (.*)', said))
    assert set(again) == {'test_stopped_once', 'test_stopped_always', 'test_starved'}, said
    waits = {name: re.findall(r'([\d.]+) s\b', line.partition('(')[0])
             for name, line in again.items()}
    assert {name: len(found) for name, found in waits.items()} == {
        'test_stopped_once': 1, 'test_stopped_always': 3, 'test_starved': 3}
    assert all(float(one) > 0.4 for one in waits['test_stopped_always'])
    assert again['test_stopped_once'].startswith('passed in the end')
    assert again['test_starved'].endswith('(it bears 0.05 s)')


def test_the_planted_faults_fit_the_code():
    assert len(planted.faults()) == 12
