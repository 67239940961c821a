# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""
Starts dxl_monitor with a settings file; `ros2 launch mecarover_serial monitor.launch.py -s`.

An argument that is given wins over the file; one that is not leaves the file as it is.
"""
import os

from ament_index_python.packages import get_package_share_directory
from launch import LaunchDescription
from launch.actions import DeclareLaunchArgument
from launch.actions import EmitEvent
from launch.actions import OpaqueFunction
from launch.events import matches_action
from launch.events.process import ShutdownProcess
from launch_ros.actions import Node
import yaml

PACKAGE = 'mecarover_serial'
NODE = 'dxl_monitor'
SETTINGS = os.path.join(get_package_share_directory(PACKAGE), 'config', 'monitor.yaml')
PARAMETERS = (              # arguments that are parameters of the node; '' = as in the file
    ('ports', "the bus, or a list: \"['/dev/ttyUSB0','/dev/ttyUSB1']\""),
    ('bauds', 'its rate in bit/s, or a list'),
    ('devices', "what is on it, as a list: \"['1:MX-106:left_knee','2-20:MX-64']\""),
)


def generate_launch_description():
    declare = DeclareLaunchArgument
    return LaunchDescription([
        *(declare(name, default_value='', description=f'{text}; default: from the file')
          for name, text in PARAMETERS),
        declare('config', default_value=SETTINGS, description='file with parameters'),
        declare('namespace', default_value='', description='of the node and its topics'),
        declare('log_level', default_value='info', description='debug, info, warn, error'),
        declare('respawn', default_value='false', description='start again when it ends'),
        OpaqueFunction(function=_node),
    ])


def _node(context):
    given = context.launch_configurations
    logger = '.'.join([*filter(None, given['namespace'].split('/')), NODE])
    return [Node(
        package=PACKAGE, executable=NODE, namespace=given['namespace'], output='screen',
        parameters=[given['config'], {
            name: yaml.safe_load(given[name]) for name, _ in PARAMETERS if given[name]}],
        ros_arguments=['--log-level', f'{logger}:={given["log_level"]}'],
        respawn=given['respawn'].lower() in ('true', '1'), respawn_delay=1.0,
        on_exit=_give_up_if_hopeless)]


def _give_up_if_hopeless(event, context):
    """Exit code 2 is a wrong parameter: starting again cannot help, and hides what it said."""
    give_up = EmitEvent(event=ShutdownProcess(process_matcher=matches_action(event.action)))
    return [give_up] if event.returncode == 2 else []
