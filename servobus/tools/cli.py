# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""
How every console tool of this package ends: one line per mistake, no traceback, three exit codes.

0 done or stopped by a signal, 1 could not run, 2 wrong usage (argparse's own code).
"""
from __future__ import annotations

import argparse
from collections.abc import Callable
from collections.abc import Sequence
from contextlib import suppress
import io
import os
import shlex
import shutil
import signal
import sys
import textwrap
from types import FrameType
from typing import TextIO

from mecarover_serial.parameters import Parameter
from mecarover_serial.parameters import split_ros_args
from servobus.errors import ParameterError
from servobus.errors import UsageError
from servobus.plain import plain_streams
from servobus.plain import printable
from servobus.port.port_error import PortError
from servobus.tools.command import take_over
from servobus.tools.version import version_of
from servobus.worker import MORE_TASKS

DONE, COULD_NOT_RUN, WRONG_USAGE = 0, 1, 2
NARROWEST, WIDEST = 30, 99      # columns of a help text
FILES_LEAST = 64                # a node has 31 open
ENDING = tuple(getattr(signal, name) for name in ('SIGINT', 'SIGTERM', 'SIGHUP', 'SIGQUIT')
               if hasattr(signal, name))       # Windows has two of them


def run_tool(tool: str, main: Callable[[list[str]], int | None]) -> int:
    """Run `main(arguments)`, return the exit code; Ctrl-C, SIGTERM and a closed pipe are fine."""
    signal.signal(signal.SIGTERM, _interrupt)
    _open_streams()
    with plain_streams():
        return _run(tool, main)


def _run(tool: str, main: Callable[[list[str]], int | None]) -> int:
    failure: Exception | None = None
    code = DONE
    is_command = False
    try:
        is_command = take_over()
        code = main(sys.argv[1:]) or DONE
    except KeyboardInterrupt:
        pass
    except SystemExit as ending:           # argparse has said all
        code = ending.code if isinstance(ending.code, int) else COULD_NOT_RUN
    except (UsageError, ParameterError) as error:
        failure, code = error, WRONG_USAGE
    except BrokenPipeError:                # the reader of our output (head, less) has left
        pass
    except (PortError, OSError) as error:
        failure, code = error, COULD_NOT_RUN
    lost = _lost_output()
    if lost is not None and not isinstance(lost, BrokenPipeError):
        failure, code = OSError(lost.errno, lost.strerror, 'stdout'), COULD_NOT_RUN
    if failure is not None:
        _complain(tool, failure, code)
    if is_command:                         # all is said: what is left must not be interrupted
        signal.signal(signal.SIGINT, lambda *_: os._exit(code))
    return code


def few_files(name: str) -> int | None:
    """
    Say so where too few files may be open for a node, and return the exit code; None: all is well.

    ROS's libraries end in tracebacks there, or hang.
    """
    with suppress(ImportError):         # Windows has no such limit
        import resource
        files = resource.getrlimit(resource.RLIMIT_NOFILE)[0]
        if files < FILES_LEAST:
            return _complain(name, OSError(
                f'only {files} files may be open; raise the limit to {FILES_LEAST} or more '
                '(ulimit -n, LimitNOFILE=)'), COULD_NOT_RUN)
    return None


def no_process(name: str, error: OSError) -> int:
    """Say that a process that is needed cannot be started; return the exit code."""
    return _complain(name, OSError(
        f'cannot start a process: {error.strerror}; {MORE_TASKS}'), COULD_NOT_RUN)


def _open_streams() -> None:
    """
    Let nothing that is printed raise.

    A character that the terminal does not have becomes '?'. What was closed (>&-) is /dev/null
    now, before a port or a capture gets its number and our messages go there.
    """
    for number, name in enumerate(('stdin', 'stdout', 'stderr')):
        if getattr(sys, name) is None:
            nowhere = os.open(os.devnull, os.O_RDWR)
            if nowhere != number:
                os.dup2(nowhere, number)
                os.close(nowhere)
            setattr(sys, name, os.fdopen(number, 'w' if number else 'r', closefd=False))
    if isinstance(sys.stdout, io.TextIOWrapper):
        sys.stdout.reconfigure(errors='replace')


def _lost_output() -> OSError | None:
    """Write out what stdout still holds; return why not, and the interpreter tries no more."""
    try:
        sys.stdout.flush()
    except OSError as error:
        _discard(sys.stdout)
        return error
    return None


def _discard(stream: TextIO) -> None:
    """Let the interpreter drop what it could not write there: it would end with exit code 120."""
    os.dup2(os.open(os.devnull, os.O_WRONLY), stream.fileno())


def _complain(tool: str, error: Exception, code: int) -> int:
    """Print one line about an error under the name of the tool, and return `code`."""
    text = str(error)
    if isinstance(error, OSError) and error.strerror:
        text = f'{error.filename}: {error.strerror}' if error.filename else error.strerror
    try:
        print(f'{tool}: {printable(text)}', file=sys.stderr, flush=True)
    except OSError:                        # it is full, or its reader has left
        _discard(sys.stderr)
    return code


def hold_signals() -> None:
    """Begin a node: let ending signals wait while it imports ROS; its `run` takes them."""
    _open_streams()
    signal.pthread_sigmask(signal.SIG_BLOCK, ENDING)
    take_over()


def _interrupt(number: int, frame: FrameType | None) -> None:
    raise KeyboardInterrupt


def wrapped(text: str) -> str:
    """Return a text for the terminal; a line that is too long goes on in its last column."""
    width = min(WIDEST, max(NARROWEST, shutil.get_terminal_size().columns - 2))
    return '\n'.join(textwrap.fill(
        line, width, subsequent_indent=' ' * (line.rfind('  ') + 2 if '  ' in line else 0),
        break_long_words=False, break_on_hyphens=False) for line in text.split('\n'))


def node_help(name: str, about: str, parameters: Sequence[Parameter]) -> str:
    """Return what `NAME --help` prints for a node: how it is run and its parameters."""
    lines = [f'usage: ros2 run mecarover_serial {name} --ros-args -p NAME:=VALUE ...', '', about,
             '', 'parameters:']
    for one in parameters:
        limits = ', '.join(text for text in (one.type_name, one.unit, one.range_text) if text)
        lines += [f'  {one.name}  (default {one.default!r}; {limits})',
                  f'      {one.description}']
    return wrapped('\n'.join(lines))


def options_of_node(parser: argparse.ArgumentParser, args: Sequence[str] | None
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
        sys.exit(_complain(parser.prog, error, WRONG_USAGE))
    if code := few_files(parser.prog):
        sys.exit(code)
    return options, [parser.prog, *arguments]


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
        return _complain(name, UsageError(
            f'{outside[0]}: has no effect outside --ros-args; write e.g. --ros-args '
            f'{_meant(outside, parameters)}, or see --help'), WRONG_USAGE)
    return few_files(name)


def _meant(outside: Sequence[str], parameters: Sequence[Parameter]) -> str:
    """Return how the parameter is set that `--NAME VALUE` or `--NAME=VALUE` means."""
    option, _, value = outside[0].partition('=')
    name = option.lstrip('-').replace('-', '_')
    if name in (one.name for one in parameters):
        value = value or ''.join(outside[1:2])
    else:
        name, value = parameters[0].name, ''
    return shlex.join(['-p', f'{name}:={value or "VALUE"}'])


def no_ros(name: str, error: ImportError) -> int:
    """Say that ROS 2 is not there; return the exit code."""
    print(f'{name}: ROS 2 is not sourced ({error}); source /opt/ros/jazzy/setup.bash, or run '
          'scripts/setup and use .venv/bin', file=sys.stderr)
    return COULD_NOT_RUN
