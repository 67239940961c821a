# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""Half a minute of `scripts/bench --soak`, within the soak's limits; and what must fail it."""
import os
from pathlib import Path
import signal
import subprocess
import sys

import pytest

from rigs.harness import family
from rigs.harness import Figure

pytestmark = [pytest.mark.ros, pytest.mark.realtime(bears=0.1)]
COMMAND = [sys.executable, '-m', 'benchmark', '--soak', '0.5']
ROOT = Path(__file__).parents[1]


def test_half_a_minute_with_faults(ros):
    done = subprocess.run(COMMAND, text=True, capture_output=True, cwd=ROOT)
    assert done.returncode == 0, done.stdout + done.stderr
    assert 'stops too late' in done.stdout


def test_a_bridge_that_is_killed_fails_it(ros):
    with subprocess.Popen(COMMAND, text=True, cwd=ROOT, stdout=subprocess.PIPE,
                          stderr=subprocess.PIPE) as soak:
        try:
            assert any('faults from now on' in line for line in soak.stderr)
            os.kill(child_of(soak.pid, 'vel2d_bridge.main'), signal.SIGKILL)
            out, err = soak.communicate()
        finally:
            soak.terminate()        # it ends its nodes; nothing if it has ended
    assert soak.returncode == 1, out + err
    assert 'soak: vel2d_bridge: ended with signal 9' in err
    assert 'nodes ended: 1, at most 0 is right' in err


def child_of(pid, module):
    [found] = [one for one in family(pid)
               if module in Path(f'/proc/{one}/cmdline').read_text().split('\0')]
    return found


def test_what_exceeds_a_limit_is_a_problem(ros):
    from rigs import soak
    names = ('growth of memory, bridge', 'faults', 'nodes ended')
    assert soak.problems([Figure('soak', name, '', [5.0]) for name in names]) == [
        'nodes ended: 5, at most 0 is right']
    assert soak.problems([Figure('soak', 'nodes ended', '', [float('nan')])])
