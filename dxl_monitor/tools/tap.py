# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""
dxl_tap: runs a Python program so that others can hear what it reads and writes.

The program itself stays as it is. It is a child of this process, which hands signals on and ends
as the child does. It runs on Linux, macOS and Windows, with the standard library alone.
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from contextlib import suppress
import os
from pathlib import Path
import shlex
import signal
import subprocess
import sys
import tempfile
from types import FrameType

from dxl_monitor.port.site import __file__ as SITE
from dxl_monitor.port.tap_reader import why_no_name
from dxl_monitor.port.tap_sender import TAP_MARK
from dxl_monitor.port.tap_sender import TAP_NAME
from dxl_monitor.port.tap_sender import USED

COULD_NOT_RUN = 1
HANDED_ON = ('SIGTERM', 'SIGHUP', 'SIGQUIT', 'SIGUSR1', 'SIGUSR2')
EXAMPLES = """examples:
  dxl_tap arm -- python my_script.py            dynamixel-sdk, pypot, all programs with pyserial
  dxl_tap arm -- lerobot-teleoperate ...        LeRobot; one name for all of its ports
in another terminal, before or after:
  dxl_dump tap:arm
  dxl_dump tap:arm/ttyUSB1                      one of several ports"""


def main() -> int:
    """Run the command `dxl_tap`."""
    parser = _parser()
    options = parser.parse_args()
    problem = why_no_name(options.name)
    if problem:
        parser.error(problem)
    command = options.command[1:] if options.command[:1] == ['--'] else options.command
    if not command:
        parser.error('COMMAND: not given; write dxl_tap NAME -- python my_script.py')
    try:
        with tempfile.TemporaryDirectory(prefix='dxl_tap_') as folder:
            mark = Path(folder) / 'mark'
            code = _follow(subprocess.Popen(command, env=environment(options.name, str(mark))))
            problem = why_unheard(command[0], mark)
        if problem:
            print(f'dxl_tap: {problem}', file=sys.stderr)
        return code
    except OSError as error:
        print(f'dxl_tap: {command[0]}: {error.strerror}; {remedy(command)}', file=sys.stderr)
        return COULD_NOT_RUN


def why_unheard(program: str, mark: Path) -> str:
    """Return why a tap heard nothing, '' where a port was opened; mark: the file of the tap."""
    got = mark.read_bytes() if mark.exists() else b''
    if USED in got:
        return ''
    reason = 'opened no port through pyserial' if got else \
        'did not load the tap: it is not Python, or PYTHONPATH did not reach it (python -E or ' \
        '-I, sudo, an emptied environment)'
    return f'{program} {reason}; to hear any program, listen to usb:/dev/ttyUSB0'


def environment(name: str, mark: str = '') -> dict[str, str]:
    """Return the environment in which a Python program is tapped; mark: grows at an opening."""
    paths = [str(Path(SITE).parent)]
    if os.environ.get('PYTHONPATH'):
        paths.append(os.environ['PYTHONPATH'])
    added = {TAP_NAME: name, 'PYTHONPATH': os.pathsep.join(paths)}
    return {**os.environ, **added, **({TAP_MARK: mark} if mark else {})}


def hand_signals_on(child: subprocess.Popen[bytes]) -> None:
    """Let the child have the signals that this process gets."""
    def hand_on(number: int, frame: FrameType | None) -> None:
        with suppress(OSError):
            child.send_signal(number)

    signal.signal(signal.SIGINT, signal.SIG_IGN)       # the terminal sends it to both
    for name in HANDED_ON:
        if hasattr(signal, name):
            signal.signal(getattr(signal, name), hand_on)


def _follow(child: subprocess.Popen[bytes]) -> int:
    """Hand signals on to the child; return its exit code, as a shell would."""
    hand_signals_on(child)
    code = child.wait()
    return 128 - code if code < 0 else code


def with_python(command: Sequence[str]) -> list[str]:
    """Return a command as it was meant: a script of Python needs it in front."""
    return ['python', *command] if command[0].endswith('.py') else list(command)


def remedy(command: Sequence[str]) -> str:
    """Return what to do about a command that cannot be started."""
    meant = with_python(command)[:2]
    return f'write {shlex.join(meant)}' if meant[0] != command[0] \
        else 'check the name of the program'


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog='dxl_tap', formatter_class=argparse.RawDescriptionHelpFormatter, epilog=EXAMPLES,
        description='Runs a Python program and lets other programs listen to what it sends and '
                    'receives through pyserial. The program is not changed and never waits for a '
                    'listener.')
    parser.add_argument('name', metavar='NAME', help='name for the listeners: tap:NAME')
    parser.add_argument('command', metavar='COMMAND', nargs=argparse.REMAINDER,
                        help='the program and its arguments, after --')
    return parser


if __name__ == '__main__':
    sys.exit(main())
