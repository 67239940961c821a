# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""Run the benchmarks: a table to the terminal, all figures to a JSON file if asked."""

import argparse
from importlib import import_module
from importlib.util import find_spec
from pathlib import Path
import shlex
import sys

from rigs.harness import as_json
from rigs.harness import machine
from rigs.harness import Options
from rigs.harness import table
from servobus.errors import UsageError
from servobus.tools.cli import run_tool

# Each is a module with run(options) -> list of figures.
PLAIN = ('parsing', 'parsing_1', 'library', 'usb', 'tap', 'node_cost', 'bridge',
         'start_up', 'dashboard', 'page')
RIGS = {'soak': 'rigs'}     # in another folder than this one
ALONE = ('thesis', 'soak')      # run when asked for by an option of that name
NEEDS_ROS = ('node_cost', 'bridge', 'start_up', 'dashboard', *ALONE)


class Failed(OSError):
    """A figure that must not be: exit code 1."""


def main(arguments):
    options = _parser().parse_args(arguments)
    if options.trace is not None and not options.trace.is_file():
        raise UsageError(f'--trace: {options.trace} is not a file; give the raw bytes of a bus')
    if options.rounds is not None and options.rounds < 1:
        raise UsageError('--rounds: nothing is measured in fewer than 1; give 1 or more')
    settings = Options(quick=options.quick, trace=options.trace,
                       seconds=2.0 if options.quick else options.seconds,
                       asked_rounds=options.rounds,
                       soak_minutes=options.soak or 0.0)
    print(', '.join(f'{key}: {value}' for key, value in machine().items()), flush=True)
    figures = []
    for section in _sections(options):
        figures += _run(section, settings)
    if options.json is not None:
        options.json.write_text(as_json(figures, _command(arguments)) + '\n')


def _parser():
    parser = argparse.ArgumentParser(prog='scripts/bench', description=(
        'Measure the nodes and what they are made of; docs/benchmarks.md explains each figure.'))
    parser.add_argument('--json', type=Path, metavar='FILE', help='write all figures to FILE')
    parser.add_argument('--quick', action='store_true', help='few and short rounds: a smoke test')
    parser.add_argument('--rounds', type=int, metavar='N',
                        help='how often each case is measured (9, or as the section needs)')
    parser.add_argument('--only', choices=PLAIN, action='append', help='one section (repeatable)')
    parser.add_argument('--thesis', action='store_true',
                        help='only the six experiments; with --only, those sections too')
    parser.add_argument('--soak', type=float, metavar='MINUTES',
                        help='only: both nodes for so long, with faults')
    parser.add_argument('--trace', type=Path, metavar='FILE', help='raw bytes of a real bus')
    parser.add_argument('--seconds', type=float, default=10.0,
                        help='measured per experiment (%(default)s; the thesis: 60)')
    return parser


def _sections(options):
    alone = [name for name in ALONE if getattr(options, name)]
    if alone:
        return [*alone, *(options.only or ())]
    return options.only or PLAIN


def _run(section, settings):
    if section in NEEDS_ROS and find_spec('rclpy') is None:
        print(f'{section}: skipped: no rclpy here; source ROS 2 first', file=sys.stderr)
        return []
    print(f'{section} ...', file=sys.stderr)
    module = import_module(f'{RIGS.get(section, "benchmark")}.{section}')
    figures = module.run(settings)
    print(table(figures), flush=True)
    if found := getattr(module, 'problems', lambda figures: [])(figures):
        raise Failed(f'{section}: ' + '\n'.join(found))
    return figures


def _command(arguments):
    """Return the command as typed, without anybody's folders."""
    return shlex.join(['scripts/bench', *(Path(part).name for part in arguments)])


if __name__ == '__main__':
    sys.exit(run_tool('bench', main))
