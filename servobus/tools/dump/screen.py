# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""What dxl_dump shows in place: a Screen, and the line about a bus."""

from collections.abc import Callable
from collections.abc import Sequence
import os
import shutil
import sys
from typing import TextIO

from msg_defs.diagnostics import Level
from servobus.bus.report import BusReport
from servobus.bus.report import PROTOCOL_2
from servobus.printable_text import on_screen
from servobus.printable_text import plain
from servobus.tools.dump.packet_lines import DIM
from servobus.tools.dump.packet_lines import RED
from servobus.tools.dump.packet_lines import YELLOW

PLAIN_WIDTH = 160                  # where there is no terminal
COLOURS = {Level.WARN: YELLOW, Level.ERROR: RED, Level.STALE: DIM}


def has_colours(wish: str = 'auto') -> bool:
    """Tell whether to print colours; wish: 'always', 'never', or where it is a terminal."""
    return wish == 'always' or (
        wish == 'auto' and sys.stdout.isatty() and not os.environ.get('NO_COLOR')
        and os.environ.get('TERM') != 'dumb')


class Screen:
    """Shows lines in place of the ones before; without a terminal only the last ones."""

    def __init__(self, file: TextIO) -> None:
        self.is_terminal = file.isatty()
        self._file = file
        self._height = 0

    @property
    def width(self) -> int:
        return shutil.get_terminal_size().columns if self.is_terminal else PLAIN_WIDTH

    def paint(self, lines: Sequence[str], is_last: bool = False) -> None:
        if not self.is_terminal:
            if is_last:
                self._file.write(''.join(f'{line}\n' for line in lines))
            return
        rows = shutil.get_terminal_size().lines - 1
        if len(lines) > rows and not is_last:
            lines = [*lines[:rows - 1], f'... and {len(lines) - rows + 1} more lines']
        up = f'\033[{self._height}A' if self._height else ''
        text = ''.join(f'{plain(line)}\033[K\n' for line in lines)
        on_screen(self._file, f'{up}\r{text}\033[J')
        self._height = len(lines)


class ProgressLine:
    """A line on stderr that says each so often what goes on; on a terminal only."""

    def __init__(self, every_s: float) -> None:
        self.is_shown = sys.stderr.isatty()
        self._every_s = self._next_s = every_s

    def show(self, now_s: float, words: Callable[[], str]) -> None:
        """Paint the line again, if it is time; now_s: since the start."""
        if self.is_shown and now_s >= self._next_s:
            self._next_s = now_s + self._every_s
            on_screen(sys.stderr, f'\r{plain(words())[:78]}\033[K\r')

    def clear(self) -> None:
        if self.is_shown:
            on_screen(sys.stderr, '\r\033[K')


def headline(report: BusReport) -> str:
    """Return what a bus does, in a line of less than 80 columns, as a rule."""
    load = next((one.value or 0.0 for one in report.metrics if one.name == 'bus_load'), None)
    rate = 'baud rate not known yet' if load is None else f'{report.baud} baud  load {load:.0f} %'
    # Most buses speak 2.0, and the line is short: only what is less usual is said.
    protocol = '' if report.protocol in ('', PROTOCOL_2) else f'{report.protocol}  '
    return (f'{report.name}  {rate}  {protocol}'
            f'{report.rates["packets"]:.0f} packets/s  {report.rates["errors"]:.1f} errors/s')
