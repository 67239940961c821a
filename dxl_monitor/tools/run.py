# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""`run -- COMMAND`: dxl_doctor starts a program; other tools say what to type instead."""

from __future__ import annotations

import argparse
from collections.abc import Sequence
import os
import shlex

from dxl_monitor.record.opening import how_to_hear
from dxl_monitor.tools.start_program import with_python
from mecarover_serial.cli import UsageError

RUN = 'run'
_ANY = ('my_script.py',)


def refuse_run(parser: argparse.ArgumentParser, where: str, arguments: Sequence[str]) -> None:
    """Raise UsageError if `run` is where `parser` has a source; `where`: what it calls that."""
    if RUN not in arguments:
        return
    options, left = parser.parse_known_args(arguments)
    if getattr(options, where) != RUN or (not left and os.path.exists(RUN)):
        return                                  # a file may have that name
    command = list(arguments[arguments.index(RUN) + 1:])
    if command[:1] == ['--']:
        del command[0]
    meant = shlex.join(with_python(command or _ANY))
    raise UsageError(f'{RUN}: {parser.prog} starts no program; write: '
                     + how_to_hear(parser.prog, meant))
