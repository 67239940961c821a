# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""
A launch file started as `ros2 launch` does it, in a process of its own.

It starts vel2d_bridge.main or dxl_monitor.start.
"""
from contextlib import contextmanager
import re
import signal

from harness import installed_share
from harness import Program

SHARE, WHY = installed_share('rclpy', 'launch_ros', 'ament_index_python')
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
    """Launch a file of ours, or a path; at the end Ctrl-C: else a launch leaves its nodes."""
    file = name if '/' in name else f'{SHARE}/launch/{name}.launch.py'
    with Program('', file, *arguments, script=LAUNCH) as launch:
        try:
            yield launch
        finally:
            launch.signal(signal.SIGINT)
            launch.exit_code()
    assert 'Traceback' not in launch.text


def pids(launch):
    """Return the pids of what was started, oldest first."""
    return [int(pid) for pid in re.findall(r'process started with pid \[(\d+)\]', launch.text)]
