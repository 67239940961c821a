# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""Which ends of a node a launch file takes for good, and after which it starts the node again."""
import os
import signal

from harness import wait
from launched import launched
from launched import pids
from launched import WHY
import pytest

pytestmark = [pytest.mark.ros, pytest.mark.realtime(bears=0.1), pytest.mark.slow,
              pytest.mark.skipif(bool(WHY), reason=WHY)]
@pytest.mark.parametrize(('name', 'arguments'), [
    ('bridge', ['baud:=1']),
    ('monitor', ['bauds:=1', 'respawn:=true']),
    ('suite', ['baud:=1', 'bauds:=1', 'respawn_monitor:=true']),
])
def test_a_wrong_parameter_is_not_tried_again(name, arguments):
    """The launch ends by itself, and says once for each node why."""
    with launched(name, *arguments) as launch:
        launch.exit_code()
    nodes = 2 if name == 'suite' else 1
    assert len(launch.said('exit code 2')) == len(pids(launch)) == nodes, launch.text
    assert len(launch.said('is not possible; set ')) == nodes


@pytest.mark.parametrize('name', ['bridge', 'suite'])
def test_a_node_that_died_is_started_again(tmp_path, name):
    with launched(name, f'port:={tmp_path}/mcu') as launch:
        launch.wait_for('vel2d_bridge', 'is not there')
        [bridge] = [pid for pid in pids(launch) if launch.said(f'[{pid}]', 'vel2d_bridge')]
        os.kill(bridge, signal.SIGKILL)
        wait(lambda: len(launch.said('vel2d_bridge', 'is not there')) == 2)
