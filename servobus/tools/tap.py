# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""
dxl_tap: runs a program so that others can hear what it reads from and writes to its serial ports.

The program itself stays as it is. It is a child of this process, which hands signals on and ends
as the child does.
"""

from __future__ import annotations

import sys

from servobus.sources.tap_reader import why_no_name
from servobus.tools.cli import run_tool
from servobus.tools.command_line import Parser
from servobus.tools.start_program import BY
from servobus.tools.start_program import StartedProgram
from servobus.tools.start_program import WAYS

EXAMPLES = """examples:
  dxl_tap arm -- python my_script.py            dynamixel-sdk, pypot, all programs with pyserial
  dxl_tap arm -- lerobot-teleoperate ...        LeRobot; one name for all of its ports
  dxl_tap arm -- ./my_program                   any program, through strace (Linux)
  dxl_tap arm --by strace -- ros2 launch my_robot robot.launch.py
in another terminal, before or after:
  dxl_dump tap:arm
  dxl_dump tap:arm/ttyUSB1                      one of several ports"""


def main() -> int:
    """Run the command `dxl_tap`."""
    return run_tool('dxl_tap', _run)


def _run(arguments: list[str]) -> int:
    parser = _parser()
    mark = arguments.index('--') if '--' in arguments else len(arguments)
    options, command = parser.parse_known_args(arguments[:mark])
    problem = why_no_name(options.name)
    if problem:
        parser.error(problem)
    command += arguments[mark + 1:]
    if not command:
        parser.error('COMMAND: not given; write dxl_tap NAME -- python my_script.py')
    started = StartedProgram('dxl_tap', options.name, command, options.by)
    problem = started.end()
    if problem:
        print(f'dxl_tap: {problem}', file=sys.stderr)
    return started.exit_code


def _parser() -> Parser:
    parser = Parser(
        'dxl_tap', epilog=EXAMPLES,
        usage='dxl_tap NAME [--by WAY] -- COMMAND',
        description='Runs a program and lets other programs listen to what it sends to and '
                    'receives from its serial ports. The program is not changed and never waits '
                    'for a listener.')
    parser.add_argument('name', metavar='NAME', help='name for the listeners: tap:NAME')
    parser.add_argument('--by', choices=WAYS, default='', help=BY)
    return parser


if __name__ == '__main__':
    sys.exit(main())
