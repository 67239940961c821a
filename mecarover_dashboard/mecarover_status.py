# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""mecarover_status: the devices of a port or a recording; without a source those of ROS."""
from __future__ import annotations

import argparse
import os
import sys
import time

from mecarover_dashboard import terminal
from mecarover_dashboard.command_line import is_of_ros
from mecarover_dashboard.command_line import make_run
from mecarover_dashboard.local_monitor import conclusion
from mecarover_dashboard.local_monitor import LocalMonitor
from mecarover_dashboard.state import State
from servobus.errors import UsageError
from servobus.tools.bus_options import add_bus_options
from servobus.tools.bus_options import refuse_run_word
from servobus.tools.cli import run_tool

NAME = terminal.NAME


def main() -> int:
    """Run the command; return the exit code."""
    arguments = sys.argv[1:]
    return terminal.main(arguments) if is_of_ros(_parser(), arguments) else run_tool(NAME, _run)


def _run(arguments: list[str]) -> int:
    parser = _parser()
    refuse_run_word(parser, 'source', arguments)
    options = parser.parse_args(arguments)
    if options.source is None:
        raise UsageError('SOURCE: none given, and ROS 2 is not sourced; name a port or a '
                         'recording')
    if os.path.isfile(options.source) and (options.json or not sys.stdout.isatty()):
        options.once = True                    # to play it is for a person
    options.source = [options.source]
    monitor, state = LocalMonitor(), State()
    monitor.out = lambda topic, statuses: state.store_message(topic, statuses, time.monotonic())
    run = make_run(NAME, options, (), monitor, at_once=options.once)
    display = terminal.Display(state, options, f'{run.words}: nothing heard; dxl_doctor says why')
    run.start()
    try:
        run.play(lambda: display.show_state(time.monotonic()))
        verdict = run.end()
    finally:
        display.close()
    if not options.once:
        print(f'{NAME}: {conclusion(verdict)}', file=sys.stderr)
    return display.code


def _parser() -> argparse.ArgumentParser:
    parser = terminal.make_parser()
    parser.add_argument('source', metavar='SOURCE', nargs='?', help='a port, usb:PORT, '
                        'tap:NAME, or a recording; default: ROS topics')
    add_bus_options(parser, runs=False)
    return parser


if __name__ == '__main__':
    sys.exit(main())
