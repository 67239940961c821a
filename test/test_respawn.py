# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""Which ends of a node a launch file takes for good, and after which it starts the node again."""
from contextlib import contextmanager
import os
import re
import signal

from harness import installed_share
from harness import Program
from harness import wait
import pytest

SHARE, WHY = installed_share('rclpy', 'launch_ros', 'ament_index_python')
pytestmark = [pytest.mark.ros, pytest.mark.slow, pytest.mark.skipif(bool(WHY), reason=WHY)]
LAUNCH = """
import sys
from launch import LaunchDescription
from launch import LaunchService
from launch.actions import IncludeLaunchDescription
from launch.launch_description_sources import PythonLaunchDescriptionSource

file, *arguments = sys.argv[1:]
service = LaunchService()
service.include_launch_description(LaunchDescription([IncludeLaunchDescription(
    PythonLaunchDescriptionSource(file),
    launch_arguments=[tuple(one.split(':=')) for one in arguments])]))
sys.exit(service.run())
"""


@contextmanager
def launched(name, *arguments):
    """Launch; at the end with Ctrl-C, as a launch that is ended otherwise leaves its nodes."""
    with Program('', f'{SHARE}/launch/{name}.launch.py', *arguments, script=LAUNCH) as launch:
        try:
            yield launch
        finally:
            launch.signal(signal.SIGINT)
            launch.exit_code()
    assert 'Traceback' not in launch.text


def pids(launch):
    """Return the pids of what was started, oldest first."""
    return [int(pid) for pid in re.findall(r'process started with pid \[(\d+)\]', launch.text)]


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
