# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""Half a minute of `scripts/bench --soak`: both nodes with faults, within the soak's limits."""
from pathlib import Path
import subprocess
import sys

import pytest

from benchmark.harness import Figure


@pytest.mark.ros
def test_half_a_minute_with_faults(ros):
    done = subprocess.run([sys.executable, '-m', 'benchmark', '--soak', '0.5'], text=True,
                          capture_output=True, cwd=Path(__file__).parents[1])
    assert done.returncode == 0, done.stdout + done.stderr
    assert 'stops too late' in done.stdout


@pytest.mark.ros
def test_what_exceeds_a_limit_is_a_problem(ros):
    from benchmark import soak
    names = ('growth of memory, bridge', 'faults', 'nodes ended')
    assert soak.problems([Figure('soak', name, '', [5.0]) for name in names]) == [
        'nodes ended: 5 , at most 0 is right']
    assert soak.problems([Figure('soak', 'nodes ended', '', [float('nan')])])
