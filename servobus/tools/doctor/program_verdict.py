# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""What is said of a program that was run, and why it said nothing, if so."""

from __future__ import annotations

from collections.abc import Sequence
import errno
import os
from os.path import exists
from os.path import isfile
import re
import shlex

from servobus.doctor.finding_log import BusSummary
from servobus.port.port_error import Reason
from servobus.port.preflight import ports_here
from servobus.port.preflight import why_not
from servobus.tools.doctor.program_source import Ending
from servobus.tools.doctor.program_source import Program
from servobus.tools.doctor.verdict import make_verdict
from servobus.tools.doctor.verdict import Verdict

_IMPORT_ERRORS = ('ModuleNotFoundError', 'ImportError')

# How pyserial and LeRobot name a port that does not open, and Python a device.
_PORT = re.compile(r"\b(?:open|on|lock) port '?(.+?)'?[:.] |: '(/dev/[^']+)'")


def program_verdict(program: Program, buses: Sequence[BusSummary], seconds: float) -> Verdict:
    """Return what is said of a program after so many seconds."""
    ending = program.ending
    is_quiet = not any(bus.report.counters['Bytes'] for bus in buses)
    return make_verdict(
        shlex.join(program.command), buses, seconds, program.is_timed,
        _why_quiet(program.command, program.ports, ending) if is_quiet else (),
        program.ports, ending.trouble(), ending.unknowns())


def _why_quiet(command: Sequence[str], ports: Sequence[str], ending: Ending) -> list[str]:
    """Return why a program said nothing; ports: those that it opened."""
    ended = f'{command[0]} ended' if ending.is_over else f'{command[0]} runs'
    if ending.error:
        ended += f' with {ending.error.rstrip(".")}'
    elif ending.ended_by:
        ended += f' by a signal ({ending.ended_by})'
    elif ending.code:
        ended += f' with exit code {ending.code}'
    if ending.error.startswith(_IMPORT_ERRORS):
        return [f'{ended}: the Python that ran it, {ending.python}, lacks that package. Name the '
                'Python of your program: run -- /path/to/its/bin/python '
                f'{shlex.join(command[1:]) or "my_script.py"}']
    script = next((word for word in command[1:] if word.endswith('.py')), '')
    if ending.code and script and not isfile(script):
        return [f'{ended}: there is no file {script} in this folder.']
    if ports:
        return [f'{ended}; it opened {", ".join(ports)} and sent nothing'
                f'{ending.unheard and f" through pyserial; {ending.unheard}"}.']
    if (port := _PORT.search(ending.error)) and (why := _why_closed(port[1] or port[2],
                                                                   ending.error)):
        return [f'{ended}.', f'{port[1] or port[2]}: {why.reason}; {why.remedy}.']
    found = [f'{ended}.', f'{ending.unheard or "It sent nothing"}.']
    if ending.code:
        found.insert(1, 'The output of the program says why: often the port is absent or busy, or '
                     f'you may not open it; {ports_here()}.')
    return found


def _why_closed(port: str, text: str) -> Reason | None:
    """Return why a program could not open its port, None where neither text nor system says."""
    number = None if 'Errno' in text else errno.ENOENT if not exists(port) \
        else errno.EACCES if not os.access(port, os.R_OK | os.W_OK) else 0
    return None if number == 0 else why_not(port, OSError(text) if number is None
                                            else OSError(number, text))
