# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""The status of a bus: which of its troubles sets the level, and which is told first."""
import pytest

from dxl_monitor.models import Models
from dxl_monitor.monitor import Monitor
from dxl_monitor.status import bus_status
from dxl_monitor.status import PortState
from msg_defs.reports import Level

REPORT = Monitor('arm', Models()).report(0)
FULL = 'capture stopped: bus.txt: No space left on device; make room and start the node again'


@pytest.mark.parametrize(('heard', 'problem', 'level', 'message'), [
    (Level.OK, '', Level.WARN, f'{FULL}; as heard'),
    (Level.WARN, '', Level.WARN, f'as heard; {FULL}'),
    (Level.STALE, '', Level.STALE, f'as heard; {FULL}'),
    (Level.ERROR, '', Level.ERROR, f'as heard; {FULL}'),
    (Level.OK, 'lost', Level.ERROR, f'lost; {FULL}'),
])
def test_what_is_to_be_done_beside_the_bus_is_a_warning(heard, problem, level, message):
    report = REPORT._replace(level=heard, message='as heard')
    port = PortState('port', problem, (), FULL)
    status = bus_status('dxl_monitor', 'arm', report, port, False)
    assert (status.level, status.message) == (level, message)


def test_without_a_warning_it_is_as_heard():
    report = REPORT._replace(level=Level.OK, message='as heard')
    status = bus_status('dxl_monitor', 'arm', report, PortState('port', '', ()), False)
    assert (status.level, status.message) == (Level.OK, 'as heard')
