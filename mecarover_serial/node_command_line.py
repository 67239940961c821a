# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""
The command line of a node, up to the moment when ROS takes it over.

Exit codes as of every tool (servobus/tools/cli.py).
"""
from __future__ import annotations

import argparse
from collections.abc import Sequence
from contextlib import suppress
import shlex
import signal
import sys

from mecarover_serial.parameters import Parameter
from mecarover_serial.parameters import split_ros_args
from servobus.errors import UsageError
from servobus.tools.cli import complain
from servobus.tools.cli import open_streams
from servobus.tools.cli import run_tool
from servobus.tools.cli import wrapped
from servobus.tools.command import take_over
from servobus.tools.version import version_of
from servobus.worker import MORE_TASKS

OPEN_FILES_MIN = 64             # a node has 31 open
ENDING_SIGNALS = tuple(getattr(signal, name) for name in ('SIGINT', 'SIGTERM', 'SIGHUP', 'SIGQUIT')
               if hasattr(signal, name))       # Windows has two of them


def hold_signals() -> None:
    """Begin a node: let ending signals wait while it imports ROS; its `run` takes them."""
    open_streams()
    signal.pthread_sigmask(signal.SIG_BLOCK, ENDING_SIGNALS)
    take_over()


def answer(name: str, about: str, parameters: Sequence[Parameter],
           args: Sequence[str] | None) -> int | None:
    """
    Answer a command line that needs no node, for help or by mistake; None: run the node.

    ROS ignores what is outside --ros-args: the node would go on with another port than the
    one that was meant. args: None for those of the process.
    """
    arguments = sys.argv[1:] if args is None else args
    if wanted := {'-h', '--help', '--version'} & {*arguments}:
        return run_tool(name, lambda _: print(
            version_of(name) if '--version' in wanted else node_help(name, about, parameters)))
    _, outside = split_ros_args(arguments)
    if outside:
        return complain(name, UsageError(
            f'{outside[0]}: has no effect outside --ros-args; write e.g. --ros-args '
            f'{_meant(outside, parameters)}, or see --help'))
    return refuse_few_files(name)


def _meant(outside: Sequence[str], parameters: Sequence[Parameter]) -> str:
    """Return how the parameter is set that `--NAME VALUE` or `--NAME=VALUE` means."""
    option, _, value = outside[0].partition('=')
    name = option.lstrip('-').replace('-', '_')
    if name in (one.name for one in parameters):
        value = value or ''.join(outside[1:2])
    else:
        name, value = parameters[0].name, ''
    return shlex.join(['-p', f'{name}:={value or "VALUE"}'])


def node_help(name: str, about: str, parameters: Sequence[Parameter]) -> str:
    """Return what `NAME --help` prints for a node: how it is run and its parameters."""
    lines = [f'usage: ros2 run mecarover_serial {name} --ros-args -p NAME:=VALUE ...', '', about,
             '', 'parameters:']
    for one in parameters:
        limits = ', '.join(text for text in (one.type_name, one.unit, one.range_text) if text)
        lines += [f'  {one.name}  (default {one.default!r}; {limits})',
                  f'      {one.description}']
    return wrapped('\n'.join(lines))


def begin_node(parser: argparse.ArgumentParser, args: Sequence[str] | None
                    ) -> tuple[argparse.Namespace, list[str]]:
    """
    Begin a node with options of its own: return these, and the command line for ROS.

    Ends the process after --help, for a wrong option, and where too few files may be open.
    """
    hold_signals()
    arguments = sys.argv[1:] if args is None else args
    try:
        options = parser.parse_args(split_ros_args(arguments)[1])
    except UsageError as error:
        sys.exit(complain(parser.prog, error))
    if code := refuse_few_files(parser.prog):
        sys.exit(code)
    return options, [parser.prog, *arguments]


def refuse_few_files(name: str) -> int | None:
    """
    Say so where too few files may be open for a node, and return the exit code; None: all is well.

    ROS's libraries end in tracebacks there, or hang.
    """
    with suppress(ImportError):         # Windows has no such limit
        import resource
        files = resource.getrlimit(resource.RLIMIT_NOFILE)[0]
        if files < OPEN_FILES_MIN:
            return complain(name, OSError(
                f'only {files} files may be open; raise the limit to {OPEN_FILES_MIN} or more '
                '(ulimit -n, LimitNOFILE=)'))
    return None


def complain_no_process(name: str, error: OSError) -> int:
    """Say that a process that is needed cannot be started; return the exit code."""
    return complain(name, OSError(
        f'cannot start a process: {error.strerror}; {MORE_TASKS}'))


def complain_no_ros(name: str, error: ImportError) -> int:
    """Say that ROS 2 is not there; return the exit code."""
    return complain(name, OSError(
        f'ROS 2 is not sourced ({error}); source /opt/ros/jazzy/setup.bash, or run scripts/setup '
        'and use .venv/bin'))
