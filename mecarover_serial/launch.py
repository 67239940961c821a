# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""
What the launch files share: a node with a settings file, and arguments over it.

Needs ROS's own package `launch`: imported by launch files only, never by the rest of the package.
"""
from __future__ import annotations

from collections.abc import Iterable
from collections.abc import Sequence
from functools import cache
from functools import partial
import os
import sys
import tempfile
from typing import Any

from ament_index_python.packages import get_package_share_directory
from launch import LaunchDescription
from launch.actions import DeclareLaunchArgument
from launch.actions import EmitEvent
from launch.actions import GroupAction
from launch.actions import OpaqueFunction
from launch.events import matches_action
from launch.events.process import ShutdownProcess
from launch.logging import get_logger
from launch_ros.actions import Node
from launch_ros.utilities import make_namespace_absolute
from launch_ros.utilities import prefix_namespace
import yaml

from mecarover_serial.launch_arguments import Argument
from mecarover_serial.launch_arguments import arguments_of
from mecarover_serial.launch_arguments import LaunchedNode
from mecarover_serial.launch_arguments import PACKAGE
from mecarover_serial.launch_arguments import refuse_unknown
from mecarover_serial.launch_arguments import SHARED
from mecarover_serial.launch_arguments import typed_names
from mecarover_serial.launch_arguments import YES
from mecarover_serial.parameters import parse_value
from mecarover_serial.settings_text import check_sections
from mecarover_serial.settings_text import SettingsError
from mecarover_serial.settings_text import without_parameters
from servobus.tools.cli import WRONG_USAGE


class _GivenToInclude(str):
    """The value of an argument that one include was given: it is not meant for the next one."""


def describe_launch_file(file: str, arguments: Sequence[Argument], actions: Sequence[Any]
              ) -> LaunchDescription:
    """
    Describe a launch file `file` that keeps its arguments to itself.

    ROS hands what one include was given, and its defaults, on to the next one. An argument that
    does not exist is refused where the user started this very file: ROS would ignore it.
    """
    names = [one.name for one in arguments]
    own = [one.name for one in arguments if one not in SHARED]

    def begin(context: Any) -> None:
        refuse_unknown(file, names, sys.argv)
        given = context.launch_configurations
        for name in own:
            if isinstance(given.get(name), _GivenToInclude):
                get_logger(os.path.basename(file)).warning(
                    f'{name}:={given.pop(name)} was given to another include, so this one takes '
                    f'its default; give it {name} too if it needs it')

    def end(context: Any) -> None:
        given = context.launch_configurations
        for name in set(own) & given.keys() - typed_names(sys.argv):
            given[name] = _GivenToInclude(given[name])
    return LaunchDescription([
        GroupAction([
            OpaqueFunction(function=begin),
            *(DeclareLaunchArgument(one.name, default_value=_default(one), description=one.text,
                                    choices=list(one.choices) or None) for one in arguments),
            *actions]),
        OpaqueFunction(function=end)])


def _default(argument: Argument) -> str:
    if argument.name.endswith('config'):
        return _shipped(argument.default)
    return argument.default


def _shipped(settings: str) -> str:
    return os.path.join(get_package_share_directory(PACKAGE), 'config', settings)


def describe_nodes(file: str, *nodes: LaunchedNode) -> LaunchDescription:
    """Describe the launch of nodes by a launch file `file`."""
    return describe_launch_file(file, arguments_of(*nodes), [
        OpaqueFunction(function=partial(_start, node=node,
                                        names=node.argument_names(len(nodes) > 1)))
        for node in nodes])


def _start(context: Any, node: LaunchedNode, names: dict[str, str]) -> list[Any]:
    everything = context.launch_configurations
    given = {name: everything[here] for name, here in names.items()}
    full_name = prefix_namespace(make_namespace_absolute(prefix_namespace(
        everything.get('ros_namespace'), everything['namespace'])), given['name'])
    texts = {one: given[one] for one, _ in node.parameters if given[one]}
    settings = _settings_without(given['config'], texts, full_name)
    # ROS puts SetParameter of the user's launch file between the two: it wins over our file.
    is_ours = given['config'] == _shipped(node.settings)
    ours, theirs = ([settings], []) if is_ours else ([], [settings])
    if texts:
        theirs.append(_write_file(yaml.safe_dump(
            {full_name: {'ros__parameters': {
                name: parse_value(text) for name, text in texts.items()}}})))
    return [Node(
        package=PACKAGE, executable=node.node, name=given['name'],
        namespace=everything['namespace'], parameters=theirs,
        remappings=[(one, given[one]) for one, _ in node.remapped if given[one] != one],
        ros_arguments=[
            *(word for file in ours for word in ('--params-file', file)),
            '--log-level', f'{full_name[1:].replace("/", ".")}:={everything["log_level"]}',
            *(['--enclave', given['enclave']] if given['enclave'] else [])],
        respawn=given['respawn'] in YES, respawn_delay=1.0, on_exit=_no_respawn_after_wrong_usage,
        output='screen')]


def _settings_without(file: str, overridden: Iterable[str], node: str) -> str:
    """Return a settings file without what arguments override, as rcl keeps a value per type."""
    try:
        check_sections([file], node)
        rest = without_parameters(file, overridden)
    except SettingsError as error:
        raise SettingsError(f'config: {error}') from error
    return _write_file(rest) if rest else os.path.abspath(file)


def _write_file(text: str) -> str:
    """Return the path of a new file, which is there until the launch ends."""
    with tempfile.NamedTemporaryFile('w', dir=_temporary_folder().name, suffix='.yaml',
                                     delete=False, encoding='utf-8') as new:
        new.write(text)
    return new.name


@cache
def _temporary_folder() -> tempfile.TemporaryDirectory[str]:
    return tempfile.TemporaryDirectory(prefix='mecarover_launch_')


def _no_respawn_after_wrong_usage(event: Any, context: Any) -> list[Any]:
    """Do not start again what cannot work: that hides what it said."""
    give_up = EmitEvent(event=ShutdownProcess(process_matcher=matches_action(event.action)))
    return [give_up] if event.returncode == WRONG_USAGE else []
