# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""
How every console tool of this package ends: one line per mistake, no traceback, three exit codes.

0 done or stopped by a signal, 1 could not run, 2 wrong usage (argparse's own code).
"""
from __future__ import annotations

from collections.abc import Callable
from collections.abc import Iterable
import io
import os
import shutil
import signal
import sys
import textwrap
from types import FrameType
from typing import TextIO

from servobus.errors import ParameterError
from servobus.errors import UsageError
from servobus.port.port_error import PortError
from servobus.printable_text import plain_streams
from servobus.printable_text import printable
from servobus.tools.command import take_over

DONE, COULD_NOT_RUN, WRONG_USAGE = 0, 1, 2
WIDTH_MIN, WIDTH_MAX = 30, 99      # columns of a help text


def run_tool(tool: str, main: Callable[[list[str]], int | None]) -> int:
    """Run `main(arguments)`, return the exit code; Ctrl-C, SIGTERM and a closed pipe are fine."""
    signal.signal(signal.SIGTERM, _interrupt)
    open_streams()
    with plain_streams():
        return _run(tool, main)


def _run(tool: str, main: Callable[[list[str]], int | None]) -> int:
    failure: Exception | None = None
    code = DONE
    is_command = False
    try:
        is_command = take_over()
        code = main(sys.argv[1:]) or DONE
    except (KeyboardInterrupt, BrokenPipeError):
        pass                               # the reader of our output (head, less) has left
    except SystemExit as ending:           # argparse has said all
        code = ending.code if isinstance(ending.code, int) else COULD_NOT_RUN
    except (UsageError, ParameterError, PortError, OSError) as error:
        failure = error
    failure = _lost_output() or failure
    if failure is not None:
        code = complain(tool, failure)
    # All is said: what is left must not be interrupted.
    if is_command and signal.getsignal(signal.SIGINT) != signal.SIG_IGN:
        signal.signal(signal.SIGINT, lambda *_: os._exit(code))
    return code


def open_streams() -> None:
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
        if not isinstance(error, BrokenPipeError):
            return OSError(error.errno, error.strerror, 'stdout')
    return None


def _discard(stream: TextIO) -> None:
    """Let the interpreter drop what it could not write there: it would end with exit code 120."""
    os.dup2(os.open(os.devnull, os.O_WRONLY), stream.fileno())


def complain(tool: str, error: Exception) -> int:
    """Print one line about an error under the name of the tool; return the exit code."""
    try:
        print(f'{tool}: {one_line(error)}', file=sys.stderr, flush=True)
    except OSError:                        # it is full, or its reader has left
        _discard(sys.stderr)
    return exit_code(error)


def exit_code(error: Exception) -> int:
    """Return the exit code of a tool that an error ends."""
    return WRONG_USAGE if isinstance(error, (UsageError, ParameterError)) else COULD_NOT_RUN


def one_line(error: Exception) -> str:
    """Return what is printed of an error."""
    text = str(error)
    if isinstance(error, OSError) and error.strerror:
        text = f'{error.filename}: {error.strerror}' if error.filename else error.strerror
    return printable(text)


def print_problems(tool: str, problems: Iterable[str]) -> None:
    """Print a line about each problem under the name of the tool, which goes on."""
    for problem in problems:
        print(f'{tool}: {printable(problem)}', file=sys.stderr)


def _interrupt(number: int, frame: FrameType | None) -> None:
    raise KeyboardInterrupt


def wrapped(text: str) -> str:
    """Return a text for the terminal; a line that is too long goes on in its last column."""
    width = min(WIDTH_MAX, max(WIDTH_MIN, shutil.get_terminal_size().columns - 2))
    return '\n'.join(textwrap.fill(
        line, width, subsequent_indent=' ' * (line.rfind('  ') + 2 if '  ' in line else 0),
        break_long_words=False, break_on_hyphens=False) for line in text.split('\n'))
