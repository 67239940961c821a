# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""Starts bridge and monitor; arguments as in bridge.launch.py and monitor.launch.py."""
import os

from ament_index_python.packages import get_package_share_directory
from launch import LaunchDescription
from launch.actions import DeclareLaunchArgument
from launch.actions import GroupAction
from launch.actions import IncludeLaunchDescription
from launch.launch_description_sources import PythonLaunchDescriptionSource
from launch.substitutions import LaunchConfiguration

SHARE = get_package_share_directory('mecarover_serial')
SHARED = (
    ('namespace', '', 'of both nodes and their topics'),
    ('log_level', 'info', 'debug, info, warn, error'),
)
OWN = {                     # launch file: its arguments, by their name here
    'bridge': (
        ('port', 'port', '', 'UART to the MCU; default: from the file'),
        ('baud', 'baud', '', 'its rate in bit/s; default: from the file'),
        ('bridge_config', 'config', f'{SHARE}/config/bridge.yaml', 'parameters of the bridge'),
        ('respawn_bridge', 'respawn', 'true', 'start the bridge again when it ends'),
    ),
    'monitor': (
        ('ports', 'ports', '', 'the Dynamixel bus, or a list; default: from the file'),
        ('bauds', 'bauds', '', 'its rate in bit/s, or a list; default: from the file'),
        ('devices', 'devices', '', 'what is on it, as a list; default: from the file'),
        ('monitor_config', 'config', f'{SHARE}/config/monitor.yaml', 'parameters of the monitor'),
        ('respawn_monitor', 'respawn', 'false', 'start the monitor again when it ends'),
    ),
}


def generate_launch_description():
    declared = [DeclareLaunchArgument(name, default_value=default, description=text)
                for name, default, text in SHARED]
    declared += [DeclareLaunchArgument(name, default_value=default, description=text)
                 for arguments in OWN.values() for name, _, default, text in arguments]
    return LaunchDescription(declared + [_include(name) for name in OWN])


def _include(name):
    """Include a launch file in a scope of its own: both have an argument `config`."""
    arguments = [(its, LaunchConfiguration(here)) for here, its, _, _ in OWN[name]]
    arguments += [(here, LaunchConfiguration(here)) for here, _, _ in SHARED]
    source = PythonLaunchDescriptionSource(os.path.join(SHARE, 'launch', f'{name}.launch.py'))
    return GroupAction([IncludeLaunchDescription(source, launch_arguments=arguments)])
