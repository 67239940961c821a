# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""
What the launch files share: a node with a settings file, and arguments over it.

Needs ROS's own package `launch`: imported by launch files only, never by the rest of the package.
"""
from __future__ import annotations

from collections.abc import Iterable
from collections.abc import Sequence
from functools import partial
import os
import sys
import tempfile
from typing import Any

from ament_index_python.packages import get_package_share_directory
from launch import LaunchDescription
from launch.actions import DeclareLaunchArgument
from launch.actions import EmitEvent
from launch.actions import OpaqueFunction
from launch.events import matches_action
from launch.events.process import ShutdownProcess
from launch_ros.actions import Node

from mecarover_serial.launch_arguments import Argument
from mecarover_serial.launch_arguments import arguments_of
from mecarover_serial.launch_arguments import Launched
from mecarover_serial.launch_arguments import refuse_unknown
from mecarover_serial.launch_arguments import YES
from mecarover_serial.parameters import typed
from mecarover_serial.settings_file import SettingsError
from mecarover_serial.settings_file import without

PACKAGE = 'mecarover_serial'
HOPELESS = 2                # exit code of a wrong parameter


def declared(file: str, arguments: Sequence[Argument]) -> list[Any]:
    """
    Return the actions that declare the arguments of a launch file `file`.

    When `file` is the one that the user started, an argument that it does not have is refused:
    ROS would ignore it.
    """
    names = [one.name for one in arguments]

    def check(context: Any) -> None:
        refuse_unknown(os.path.basename(file), names, sys.argv)
    return [OpaqueFunction(function=check), *(
        DeclareLaunchArgument(one.name, default_value=_default(one), description=one.text,
                              choices=list(one.choices) or None) for one in arguments)]


def _default(argument: Argument) -> str:
    if argument.name.endswith('config'):
        return os.path.join(get_package_share_directory(PACKAGE), 'config', argument.default)
    return argument.default


def description(file: str, *nodes: Launched) -> LaunchDescription:
    """Describe the launch of nodes by a launch file `file`."""
    return LaunchDescription([
        *declared(file, arguments_of(*nodes)),
        *(OpaqueFunction(function=partial(_start, node=node, spelt=node.spelt(len(nodes) > 1)))
          for node in nodes),
    ])


def _start(context: Any, node: Launched, spelt: dict[str, str]) -> list[Any]:
    everything = context.launch_configurations
    given = {name: everything[here] for name, here in spelt.items()}
    namespace = everything['namespace']
    logger = '.'.join([*filter(None, namespace.split('/')), given['name']])
    texts = {one: given[one] for one, _ in node.parameters if given[one]}
    return [Node(
        package=PACKAGE, executable=node.node, name=given['name'], namespace=namespace,
        parameters=[_settings(given['config'], texts), _values(node.node, texts)],
        remappings=[(one, given[one]) for one, _ in node.remapped if given[one] != one],
        ros_arguments=['--log-level', f'{logger}:={everything["log_level"]}',
                       *(['--enclave', given['enclave']] if given['enclave'] else [])],
        respawn=given['respawn'] in YES, respawn_delay=1.0, on_exit=_give_up_if_hopeless,
        output='screen')]


def _values(node: str, texts: dict[str, str]) -> dict[str, Any]:
    """Return the values of parameters as they are after -p on a command line."""
    words = [word for name, text in texts.items() for word in ('-p', f'{name}:={text}')]
    return typed(['--ros-args', *words], node)


def _settings(file: str, overridden: Iterable[str]) -> str:
    """Return a settings file without what arguments override, as rcl keeps a value per type."""
    try:
        with open(file, encoding='utf-8') as settings:
            text = settings.read()
        rest = without(text, overridden)
    except (OSError, UnicodeDecodeError, SettingsError) as error:
        reason = getattr(error, 'strerror', None) or error
        raise SettingsError(f'config: {file}: {reason}; give a file with parameters') from error
    if rest == text:
        return os.path.abspath(file)
    with tempfile.NamedTemporaryFile('w', prefix='launch_params_', suffix='.yaml',
                                     delete=False, encoding='utf-8') as copy:
        copy.write(rest)
    return copy.name


def _give_up_if_hopeless(event: Any, context: Any) -> list[Any]:
    """Do not start again what cannot work: that hides what it said."""
    give_up = EmitEvent(event=ShutdownProcess(process_matcher=matches_action(event.action)))
    return [give_up] if event.returncode == HOPELESS else []
