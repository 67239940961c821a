# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""
Starts vel2d_bridge with a settings file; `ros2 launch mecarover_serial bridge.launch.py -s`.

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
NODE = 'vel2d_bridge'
SETTINGS = os.path.join(get_package_share_directory(PACKAGE), 'config', 'bridge.yaml')
PARAMETERS = (              # arguments that are parameters of the node; '' = as in the file
    ('port', 'the UART to the MCU'),
    ('baud', 'its rate in bit/s'),
)


def generate_launch_description():
    declare = DeclareLaunchArgument
    return LaunchDescription([
        *(declare(name, default_value='', description=f'{text}; default: from the file')
          for name, text in PARAMETERS),
        declare('config', default_value=SETTINGS, description='file with parameters'),
        declare('namespace', default_value='', description='of the node and its topics'),
        declare('log_level', default_value='info', description='debug, info, warn, error'),
        declare('respawn', default_value='true', description='start again when it ends'),
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
