# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""No two processes of this machine share a ROS domain, and none is that of a robot by default."""
import os
import subprocess
import sys

import pytest

from mecarover_fakes.domain_lock import BENCHMARKS
from mecarover_fakes.domain_lock import DEMOS
from mecarover_fakes.domain_lock import ReservedDomain
from mecarover_fakes.domain_lock import TESTS

MINE = range(1000 + os.getpid() * 2, 1002 + os.getpid() * 2)       # never one of ROS
TAKE = 'import sys; from mecarover_fakes.domain_lock import ReservedDomain; print(' \
    'ReservedDomain(range(int(sys.argv[1]), int(sys.argv[1]) + 2)).number)'


def test_the_kinds_share_none():
    every = [*TESTS, *BENCHMARKS, *DEMOS]
    assert len(set(every)) == len(every)
    assert 0 not in every
    assert max(every) <= 101


def test_a_domain_has_one_holder():
    first = ReservedDomain(MINE, start=1)
    assert first.number == MINE[1]
    other = subprocess.run([sys.executable, '-c', TAKE, str(MINE[0])], text=True, check=True,
                           capture_output=True)
    assert int(other.stdout) == MINE[0]
    second = ReservedDomain(MINE, start=1)                  # the other process has ended
    assert second.number == MINE[0]
    with pytest.raises(OSError, match='are in use by other'):
        ReservedDomain(MINE)
    first.release()
    again = ReservedDomain(MINE)
    assert again.number == MINE[1]
    again.release()
    second.release()
