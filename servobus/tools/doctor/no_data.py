# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""Why a program said nothing, as far as is known; sources/silence.py: why a source did."""

from __future__ import annotations

from collections.abc import Sequence
from os.path import isfile
import re
import shlex

from servobus.port.preflight import ports_here
from servobus.port.preflight import why_not
from servobus.tools.doctor.program_source import Ending

_IMPORT_ERRORS = ('ModuleNotFoundError', 'ImportError')


def of_program(command: Sequence[str], ports: Sequence[str], ending: Ending) -> list[str]:
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
    if port := re.search(r"could not open port '?(.+?)'?: ", ending.error):      # pyserial
        why = why_not(port[1], OSError(ending.error))
        return [f'{ended}.', f'{port[1]}: {why.reason}; {why.remedy}.']
    found = [f'{ended}.', f'{ending.unheard or "It sent nothing"}.']
    if ending.code:
        found.insert(1, 'The output of the program says why: often the port is absent or busy, or '
                     f'you may not open it; {ports_here()}.')
    return found
