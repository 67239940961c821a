# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""
mecarover_status: bridges, buses and devices in a terminal, in place, the worst first.

Without a terminal: a line each for what matters, whenever that changes; or JSON.
"""
from __future__ import annotations

from argparse import Namespace
from collections.abc import Sequence
import json
import math
import os
import sys
import textwrap
import time

from mecarover_dashboard.keyboard import Keyboard
from mecarover_dashboard.snapshot import snapshot
from mecarover_dashboard.state import State
from mecarover_dashboard.status_lines import exit_code
from mecarover_dashboard.status_lines import INDENT
from mecarover_dashboard.status_lines import screen
from mecarover_dashboard.status_lines import SORTS
from mecarover_dashboard.status_lines import status_lines
from mecarover_dashboard.status_lines import table
from mecarover_serial.node_command_line import begin_node
from mecarover_serial.node_command_line import complain_no_ros
from servobus.printable_text import on_screen
from servobus.printable_text import plain_streams
from servobus.tools.command_line import number
from servobus.tools.command_line import Parser

NAME = 'mecarover_status'
SETTLED_S = 1.5             # without a new name: all have come, as reports come once a second
LEAST_S = 3.5               # discovery takes up to 2.5 s, a report a second
WAIT_S = 6.0
SHOW_S = 0.5
JSON_S = 1.0                # as often as reports come
NO_REPORT = ('no report on /diagnostics; start the nodes, with the same ROS_DOMAIN_ID, discovery '
             'range and namespace as here')
_HOME, _CLEAR_LINE, _CLEAR_BELOW = '\033[H', '\033[K', '\033[J'
_COLOURS = {'ERROR': '\033[31m', 'WARN': '\033[33m'}
_KEYS = 'arrows: scroll; q: end; sort: ' + ' '.join(
    f'{key}={what.split()[0]}' for key, what in SORTS.items())
_STEPS = {'UP': -1, 'DOWN': 1, 'k': -1, 'j': 1, 'PAGE_UP': -10, 'PAGE_DOWN': 10, ' ': 10}


class Display:
    """
    Shows a state until it is ended, or once; `code` is what that came to.

    Made before ROS starts: what reads stdout is asked for now, a pipe to it comes then.
    """

    def __init__(self, state: State, options: Namespace, nothing: str = NO_REPORT,
                 least_s: float = 0.0) -> None:
        """Take the options of make_parser(), and the shortest wait with --once."""
        self._state = state
        self._options = options
        self._least_s = least_s
        self._nothing = nothing
        self._terminal = os.dup(sys.stdout.fileno()) \
            if sys.stdout.isatty() and not options.json else None
        self._keys = Keyboard(not options.once and self._terminal is not None)
        self._sort = 'w'
        self._top = 0               # the first row shown
        self._begin = time.monotonic()
        self._shown_s = -math.inf
        self._last: list[str] = []
        self.code = 0

    def show_state(self, now_s: float) -> bool:
        """Show what is due; return whether that was all."""
        if self._options.once:
            return self._once(now_s)
        for key in self._keys.pressed():
            if key == 'q':
                return True
            self._sort = key if key in SORTS else self._sort
            self._top += _STEPS.get(key, 0)
            self._shown_s = -math.inf
        is_json = self._options.json
        if now_s - self._shown_s >= (JSON_S if is_json else SHOW_S):
            self._shown_s = now_s
            (self._print_json if is_json else self._show_lines)(now_s)
        return False

    def _print_json(self, now_s: float) -> None:
        print(json.dumps(snapshot(self._state, now_s, time.time())), flush=True)

    def _show_lines(self, now_s: float) -> None:
        lines = screen(status_lines(
            self._state, now_s, self._options.all if self._terminal is None else None))
        if self._terminal is not None:
            width, height = os.get_terminal_size(self._terminal)
            lines += table(self._state, now_s, self._sort, width - 1)
            self._paint(lines or [self._nothing], width, height)
        elif lines != self._last:       # a file or a pipe gets what is new
            print('\n'.join([*lines, '']) if lines else self._nothing, flush=True)
        self._last = lines or [self._nothing]

    def close(self) -> None:
        """Give the keyboard back, and go below what was shown."""
        self._keys.close()
        if self._terminal is not None and self._last:
            print(flush=True)

    def _once(self, now_s: float) -> bool:
        grown = self._state.grown_s
        waited_s = now_s - self._begin
        is_settled = grown and now_s - grown > SETTLED_S and waited_s > self._least_s
        if waited_s < self._options.wait and not is_settled:
            return False
        found = status_lines(self._state, now_s, self._options.all)
        self.code = exit_code(self._state)
        if self._options.json:
            self._print_json(now_s)
        elif found:
            print('\n'.join(screen(found)), flush=True)
        else:
            print(f'{NAME}: {self._nothing}', file=sys.stderr)
        return True

    def _paint(self, lines: list[str], width: int, height: int) -> None:
        """Write the lines over the last ones, in full: long ones take several rows."""
        width = max(20, width - 1)
        rows = [_coloured(line, row) for line in lines for part in line.split('\n')
                for row in textwrap.wrap(part, width, subsequent_indent=INDENT)]
        hint = _KEYS if self._keys.is_on else 'make the terminal larger to see more'
        longest = f'rows {len(rows)} to {len(rows)} of {len(rows)}; {hint}'
        room = max(1, height - 1 - len(textwrap.wrap(longest, width)))
        is_cut = len(rows) > room
        self._top = max(0, min(self._top, len(rows) - room))
        shown = rows[self._top:self._top + room]
        foot = [f'rows {self._top + 1} to {self._top + len(shown)} of {len(rows)}'] * is_cut \
            + [hint] * (is_cut or self._keys.is_on)
        begin = _HOME if self._last else f'\033[2J{_HOME}'
        text = '\n'.join(row + _CLEAR_LINE for row in shown)
        last = '\n'.join(textwrap.wrap('; '.join(foot), width))
        on_screen(sys.stdout, f'{begin}{text}\n{_CLEAR_BELOW}{last}\r')


def _coloured(line: str, row: str) -> str:
    colour = '' if os.environ.get('NO_COLOR') else _COLOURS.get(line.partition(' ')[0], '')
    return f'{colour}{row}\033[m' if colour else row


@plain_streams()
def main(args: Sequence[str] | None = None) -> int:
    """Run the command with ROS; return the exit code."""
    options, arguments = begin_node(make_parser(), args)
    try:
        from mecarover_dashboard.status_subscriber import StatusSubscriber
        from mecarover_serial.ros_node import run
    except ImportError as error:
        return complain_no_ros(NAME, error)
    state = State()
    display = Display(state, options, least_s=LEAST_S)
    try:
        return run(NAME, lambda: StatusSubscriber(
            state, display.show_state, options.json or not options.once),
            arguments) or display.code
    finally:
        display.close()


def make_parser() -> Parser:
    """Return the options, with and without ROS."""
    parser = Parser(
        NAME, description='Prints a line for each bridge, each bus and each device with a '
                               'problem, of every robot in the ROS domain. In a namespace '
                               '(--ros-args -r __ns:=/rover1): of the robots below it.',
        epilog='Exit codes with --once: 0 no problem, 1 no report or could not run, 2 wrong '
               'usage, 3 a warning or a silent part, 4 an error.')
    parser.add_argument('--once', action='store_true', help='print the lines once and end')
    parser.add_argument('--all', action='store_true', help='every device, not only those with a '
                        'problem')
    parser.add_argument('--json', action='store_true', help='for programs: all devices and '
                        'findings as a JSON object a line, every second; with --once: one')
    parser.add_argument('--wait', type=number(float, 0.1), default=WAIT_S, metavar='S',
                        help='with --once: longest wait for reports (default %(default)g)')
    return parser


if __name__ == '__main__':
    sys.exit(main())
