# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""
What dxl_dump shows in place: Screen, and Changes, one line per device.

Lines are made from reports, for a width; Screen puts them where the ones before stood.
"""

from collections.abc import Sequence
import shutil
import textwrap
from typing import TextIO

from dxl_monitor.bus.report import BusReport
from dxl_monitor.bus.report import DeviceReport
from dxl_monitor.bus.report import PROTOCOL_2
from dxl_monitor.bus.table import Observed
from dxl_monitor.joints import POSITION
from dxl_monitor.model.control_table import UNKNOWN
from dxl_monitor.tools.dump.packet_lines import BOLD
from dxl_monitor.tools.dump.packet_lines import DIM
from dxl_monitor.tools.dump.packet_lines import fit
from dxl_monitor.tools.dump.packet_lines import paint
from dxl_monitor.tools.dump.packet_lines import RED
from dxl_monitor.tools.dump.packet_lines import YELLOW
from mecarover_serial.plain import on_screen
from mecarover_serial.plain import plain
from msg_defs.reports import Level
from msg_defs.reports import SEVERITY

NEWS_S = 3.0                       # for so long a rare change comes first
BRIGHT_S = 1.0                     # for so long a change is bold
RARE = 0.25                        # changed in fewer of the paintings than this
NEWS, OFTEN, NEVER = range(3)       # places of a register in its line
MESSAGE_WIDTH = 30                 # columns for what is wrong with a device, at least
PLAIN_WIDTH = 160                  # where there is no terminal
COLOURS = {Level.WARN: YELLOW, Level.ERROR: RED, Level.STALE: DIM}


class Screen:
    """Shows lines in place of the ones before; without a terminal only the last ones."""

    def __init__(self, file: TextIO, colours: bool) -> None:
        self.is_terminal = file.isatty()
        self.colours = colours
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


class Changes:
    """The registers of each device, the ones that change first; remembers when they did."""

    def __init__(self, colours: bool) -> None:
        self._colours = colours
        self._paintings = 0
        self._seen: dict[tuple[str, int, str], tuple[str, int, int]] = {}

    def lines(self, reports: Sequence[BusReport], width: int) -> list[str]:
        self._paintings += 1
        lines = []
        for report in reports:
            lines.append(fit(f'{headline(report)}  {report.message}', width))
            for device in sorted(report.devices, key=lambda one: -SEVERITY.index(one.level)):
                lines += self._device(report, device, width)
        return lines

    def _device(self, report: BusReport, device: DeviceReport, width: int) -> list[str]:
        """Return the line of a device; what is wrong with it is in full."""
        name = f'{device.id:03} {fit(device.model_name, 11):11} {device.joint}'.rstrip()
        colour = COLOURS.get(device.level) if self._colours else None
        words, below = name, []
        if device.level is not Level.OK:
            if len(device.message) <= max(MESSAGE_WIDTH, width // 3):
                words = f'{name}  {device.message}'
            else:
                below = textwrap.wrap(device.message, max(MESSAGE_WIDTH, width - 4))
        words = fit(words, width)
        shown = words if colour is None else paint(words, colour)
        below = ['    ' + (one if colour is None else paint(one, colour)) for one in below]
        room = width - len(words)
        if device.model is UNKNOWN:
            hint = fit(f'  model not known yet; --devices {device.id}:MODEL sets it', room)
            return [shown + (paint(hint, DIM) if self._colours else hint), *below]
        for rank, is_bright, seen in sorted(
                (self._rank(report, device, seen) for seen in device.observed), key=_place):
            text = _short(seen)
            if len(text) + 2 > room or (rank == NEVER and room < width // 3):
                break
            room -= len(text) + 2
            shown += '  ' + (paint(text, BOLD) if is_bright and self._colours else text)
        return [shown, *below]

    def _rank(self, report: BusReport, device: DeviceReport,
              seen: Observed) -> tuple[int, bool, Observed]:
        """Return the place of a register, and whether it has just changed."""
        key = report.name, device.id, seen.field.name
        text, changed, count = self._seen.get(key, (seen.value.text, 0, 0))
        if text != seen.value.text:
            text, changed, count = seen.value.text, report.stamp, count + 1
        self._seen[key] = text, changed, count
        age_s = (report.stamp - changed) / 1e9
        if not count:
            return NEVER, False, seen
        is_news = age_s < NEWS_S and count < RARE * self._paintings
        return NEWS if is_news else OFTEN, age_s < BRIGHT_S, seen


def headline(report: BusReport) -> str:
    """Return what a bus does, in a line of less than 80 columns, as a rule."""
    load = next((one.value or 0.0 for one in report.metrics if one.name == 'bus_load'), None)
    rate = 'baud rate not known yet' if load is None else f'{report.baud} baud  load {load:.0f} %'
    # Most buses speak 2.0, and the line is short: only what is less usual is said.
    protocol = '' if report.protocol in ('', PROTOCOL_2) else f'{report.protocol}  '
    return (f'{report.name}  {rate}  {protocol}'
            f'{report.rates["packets"]:.0f} packets/s  {report.rates["errors"]:.1f} errors/s')


def _place(ranked: tuple[int, bool, Observed]) -> tuple[int, bool, bool, int]:
    """Sort registers: news, what changes, the rest; the position first, then what is measured."""
    rank, _, (field, *_) = ranked
    return (rank, field.name != POSITION, rank == NEVER and not field.name.startswith('Present '),
            field.at)


def _short(seen: Observed) -> str:
    """Spell a register shortly: what is present needs not be said to be."""
    name = seen.field.name.removeprefix('Present ')
    return f'{name} {seen.value.text} {seen.field.unit}'.rstrip()
