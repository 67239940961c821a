# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""mecarover_status: the state of all robots in a terminal, one line each for what matters."""
from __future__ import annotations

import argparse
from collections.abc import Sequence
import math
import shutil
import sys
import time

from mecarover_dashboard.status_lines import Board
from mecarover_dashboard.status_lines import screen
from mecarover_serial.cli import no_ros
from mecarover_serial.cli import options_of_node
from mecarover_serial.plain import on_screen
from mecarover_serial.plain import plain_streams

NAME = 'mecarover_status'
SETTLED_S = 1.5             # without a new name: all have come, as reports come once a second
WAIT_S = 6.0                # discovery takes up to 2.5 s
SHOW_S = 1.0
NO_REPORT = ('no report on /diagnostics; start the nodes, with the same ROS_DOMAIN_ID and '
             'discovery range as here')
_HOME, _CLEAR_LINE, _CLEAR_BELOW = '\033[H', '\033[K', '\033[J'


class Display:
    """Shows a board until it is ended, or once; `code` is what that came to."""

    def __init__(self, board: Board, wait_s: float | None) -> None:
        self._board = board
        self._wait_s = wait_s
        self._begin = time.monotonic()
        self._shown_s = -math.inf
        self._last: list[str] = []
        self.code = 0

    def look(self, now_s: float) -> bool:
        """Show what is due; return whether that was all."""
        if self._wait_s is not None:
            return self._once(now_s, self._wait_s)
        if now_s - self._shown_s >= SHOW_S:
            self._shown_s = now_s
            self._show(screen(self._board.lines(now_s)) or [NO_REPORT])
        return False

    def _once(self, now_s: float, wait_s: float) -> bool:
        changed = self._board.changed
        if now_s - self._begin < wait_s and not (changed and now_s - changed > SETTLED_S):
            return False
        self.code = self._board.code(now_s)
        lines = screen(self._board.lines(now_s))
        if lines:
            print('\n'.join(lines), flush=True)
        else:
            print(f'{NAME}: {NO_REPORT}', file=sys.stderr)
        return True

    def _show(self, lines: list[str]) -> None:
        """Write the lines over the last ones; into a file or a pipe only when they change."""
        if not sys.stdout.isatty():
            if lines != self._last:
                print('\n'.join([*lines, '']), flush=True)
        else:
            width, height = shutil.get_terminal_size()
            if len(lines) >= height:
                more = len(lines) - height + 2
                lines = [*lines[:height - 2], f'... and {more} more lines']
            begin = _HOME if self._last else f'\033[2J{_HOME}'
            text = '\n'.join(line[:width - 1] + _CLEAR_LINE for line in lines)
            on_screen(sys.stdout, f'{begin}{text}\n{_CLEAR_BELOW}')
        self._last = lines


@plain_streams()
def main(args: Sequence[str] | None = None) -> int:
    """Run the command; return the exit code."""
    options, arguments = options_of_node(_parser(), args)
    try:
        from mecarover_dashboard.dashboard_node import StatusNode
        from mecarover_serial.ros_node import run
    except ImportError as error:
        return no_ros(NAME, error)
    board = Board(every_device=options.all)
    display = Display(board, options.wait if options.once else None)
    return run(NAME, lambda: StatusNode(board, display.look), arguments) or display.code


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog=NAME, description='Prints a line for each bridge, each bus and each device with a '
                               'problem, of every robot in the ROS domain. In a namespace '
                               '(--ros-args -r __ns:=/rover1): of the robots below it.',
        epilog='Exit codes with --once: 0 no problem, 1 no report or could not run, 2 wrong '
               'usage, 3 a warning or a silent part, 4 an error.')
    parser.add_argument('--once', action='store_true', help='print the lines once and end')
    parser.add_argument('--all', action='store_true', help='every device, not only those with a '
                        'problem')
    parser.add_argument('--wait', type=_seconds, default=WAIT_S, metavar='S',
                        help='with --once: longest wait for reports (default %(default)g)')
    return parser


def _seconds(text: str) -> float:
    seconds = float(text)
    if not 0 < seconds < math.inf:
        raise argparse.ArgumentTypeError('give a time above 0 s')
    return seconds


if __name__ == '__main__':
    sys.exit(main())
