# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""
What command lines of several tools have in common: options about a bus, `run -- COMMAND`.

Some tools start a program; the others say what to type instead.
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
import os
import shlex
import shutil

from servobus.bus.decoder import DEFAULTS
from servobus.bus.decoder import PROTOCOL_CHOICES
from servobus.errors import UsageError
from servobus.model.models import Models
from servobus.settings import check_devices
from servobus.settings import load_models
from servobus.sources.capture import BAUD_MAX
from servobus.sources.opening import how_to_hear
from servobus.tools.command_line import baud_rate
from servobus.tools.command_line import number
from servobus.tools.start_program import BY
from servobus.tools.start_program import WAYS
from servobus.tools.start_program import with_python

RUN = 'run'
BAUD = number(baud_rate, 1, BAUD_MAX, 'Bd')
_ANY = ('my_script.py',)


def refuse_run_word(parser: argparse.ArgumentParser, where: str, arguments: Sequence[str]) -> None:
    """Raise UsageError if `run` is where `parser` has a source; `where`: what it calls that."""
    if RUN not in arguments:
        return
    options, left = parser.parse_known_args(arguments)
    if getattr(options, where) != RUN or (not left and os.path.exists(RUN)):
        return                                  # a file may have that name
    own, command = _parted(arguments, left)
    raise UsageError(f'{RUN}: {parser.prog} starts no program; write: ' + how_to_hear(
        parser.prog, shlex.join(with_python(command or _ANY)), own))


def _parted(arguments: Sequence[str], words: Sequence[str]) -> tuple[list[str], list[str]]:
    """Return the options of the tool, and the command after `run`; words: no options of it."""
    at = arguments.index(RUN)
    own, rest = list(arguments[:at]), list(arguments[at + 1:])
    at = next((rest.index(word) for word in ('--', *words) if word in rest), len(rest))
    return own + rest[:at], rest[at + ('--' in rest):]


def parse_run(parser: argparse.ArgumentParser,
              arguments: Sequence[str]) -> tuple[argparse.Namespace, Sequence[str]]:
    """Return the options, and the command after --; `source` is one, or a list of them."""
    mark = arguments.index('--') if '--' in arguments else len(arguments)
    options, left = parser.parse_known_args(arguments[:mark])
    sources = options.source if isinstance(options.source, list) else [options.source]
    first = next(iter(sources), None)
    if first == RUN and mark == len(arguments) and (left or sources[1:]):
        own, command = _parted(arguments, left or sources[1:])
        raise UsageError(f'{RUN}: -- is missing in front of the program; write {parser.prog} '
                         + shlex.join([*own, RUN, '--', *with_python(command)]))
    if left and first and mark == len(arguments) and shutil.which(first):
        raise UsageError(f'{first}: a program; write {parser.prog} {RUN} -- '
                         + shlex.join(arguments[arguments.index(first):]))
    if left:
        wrong = [one for one in left if one.startswith('-')] or left
        parser.error(f'unrecognized arguments: {" ".join(wrong)}')
    command = list(arguments[mark + 1:])
    if options.by and not command:
        raise UsageError(f'--by {options.by}: only for run -- COMMAND; leave it out')
    if (first == RUN) != bool(command):
        raise UsageError(f'{first or RUN}: the program to run goes after --; write {parser.prog} '
                         'run -- python my_script.py')
    return options, command


def add_bus_options(parser: argparse.ArgumentParser, runs: bool = True) -> None:
    """Add the options that say what is on a bus and how it is heard; runs: a program too."""
    add = parser.add_argument
    if runs:
        add('--by', choices=WAYS, default='', help=BY)
    add('-b', '--baud', type=BAUD, help='baud rate of the bus, e.g. 57.6k or 1M (default: that of '
        'the source, else 2000000)')
    add('--protocol', choices=PROTOCOL_CHOICES, default=DEFAULTS.protocol,
        help='protocol of the bus: auto, 2, 1 (Dynamixel) or feetech (default: auto, learned '
             'from the traffic)')
    add('--adapter', metavar='BUS.DEVICE', help='which adapter, if a pcap file holds several')
    add('--devices', action='append', metavar='ID:MODEL:JOINT', default=[],
        help="devices on the bus, in the order along the cable, e.g. '1-6:XL430-W250'")
    add('--model-dirs', action='append', metavar='DIR', default=[],
        help='one more folder of model files')


def models_of(options: argparse.Namespace) -> Models:
    """Return the models, when the options about devices can be used."""
    for text in options.devices:
        if not text.isprintable():
            raise UsageError(f'--devices {text!r}: control codes; give plain text')
    models = load_models(options.model_dirs)
    check_devices(options.devices, models)
    return models
