# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""
What the launch files of both nodes share: a node with a settings file, and arguments over it.

Needs ROS's own package `launch`: imported by launch files only, never by the rest of the package.
"""
from __future__ import annotations

from collections.abc import Sequence
from functools import partial
import os
from typing import Any

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
HOPELESS = 2                # exit code of a wrong parameter


def node_with_settings(name: str, settings: str, parameters: Sequence[tuple[str, str]], *,
                       respawn: bool) -> LaunchDescription:
    """
    Describe the launch of a node with a file of our folder config.

    `parameters`, name and text: arguments that are parameters of the node; one that is given wins
    over the file, one that is not leaves the file as it is.
    """
    declare = DeclareLaunchArgument
    file = os.path.join(get_package_share_directory(PACKAGE), 'config', settings)
    return LaunchDescription([
        *(declare(parameter, default_value='', description=f'{text}; default: from the file')
          for parameter, text in parameters),
        declare('config', default_value=file, description='file with parameters'),
        declare('namespace', default_value='', description='of the node and its topics'),
        declare('log_level', default_value='info', description='debug, info, warn, error'),
        declare('respawn', default_value=str(respawn).lower(),
                description='start again when it ends'),
        OpaqueFunction(function=partial(_node, name=name, parameters=parameters)),
    ])


def _node(context: Any, name: str, parameters: Sequence[tuple[str, str]]) -> list[Any]:
    given = context.launch_configurations
    logger = '.'.join([*filter(None, given['namespace'].split('/')), name])
    return [Node(
        package=PACKAGE, executable=name, namespace=given['namespace'], output='screen',
        parameters=[given['config'], {
            one: yaml.safe_load(given[one]) for one, _ in parameters if given[one]}],
        ros_arguments=['--log-level', f'{logger}:={given["log_level"]}'],
        respawn=given['respawn'].lower() in ('true', '1'), respawn_delay=1.0,
        on_exit=_give_up_if_hopeless)]


def _give_up_if_hopeless(event: Any, context: Any) -> list[Any]:
    """Do not start again what cannot work: that hides what it said."""
    give_up = EmitEvent(event=ShutdownProcess(process_matcher=matches_action(event.action)))
    return [give_up] if event.returncode == HOPELESS else []
