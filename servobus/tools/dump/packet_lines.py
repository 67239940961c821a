# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""
The lines of dxl_dump: columns that fit the terminal, and colours.

Pure. Time, time since the line before, bus, side where it is known, direction, ID, model,
instruction, meaning. On 80
columns the bus is left out where there is only one. A long meaning loses its `Present`, then it
is cut.
"""

from collections.abc import Sequence
import time

from msg_defs.dxl_instruction import ALERT
from msg_defs.dxl_packet import BROADCAST
from msg_defs.servo_frame import OPEN
from servobus.bus.device import Device
from servobus.tools.dump.decode import Part
from servobus.tools.dump.listing import DAMAGED
from servobus.tools.dump.listing import Entry
from servobus.tools.dump.listing import MISSED
from servobus.tools.dump.text_format import answer_words
from servobus.tools.dump.text_format import damaged_words
from servobus.tools.dump.text_format import missed_words
from servobus.tools.dump.text_format import noise_words
from servobus.tools.dump.text_format import packet_name
from servobus.tools.dump.text_format import request_words

WIDE_MIN_COLUMNS = 110             # columns, from which on there is room for bus and joint
RED, GREEN, YELLOW, CYAN, DIM, BOLD = '31', '32', '33', '36', '2', '1'
TIMES = ('start', 'clock', 'epoch')
_CUT = '..'


def paint(text: str, colour: str | None) -> str:
    return text if colour is None else f'\033[{colour}m{text}\033[m'


def fit(text: str, width: int) -> str:
    """Cut a text that is too long for `width` columns."""
    return text if len(text) <= width else text[:max(0, width - len(_CUT))] + _CUT


class Lines:
    """
    Makes lines from entries, in order. width: they are cut to it, None: as long as they are.

    show_time: 'start' (seconds since the first line), 'clock' (local time) or 'epoch'.
    """

    def __init__(self, colours: bool, show_time: str) -> None:
        self.width: int | None = None
        self.show_bus = False
        self._colours = colours
        self.has_sides = False             # the source knows who put what on the wire
        self._show_time = show_time
        self._first: int | None = None
        self._last = 0
        self._model_width = 10             # grows with the names that come

    def line(self, bus: str, stamp: int, entry: Entry, parts: Sequence[Part]) -> str:
        """Return the line of an entry; stamp in ns, as the time is to be shown."""
        mark, colour, number, name, words = columns_of(entry, parts)
        is_wide = self.width is None or self.width >= WIDE_MIN_COLUMNS
        model = _model(entry.device, is_wide)
        self._model_width = max(self._model_width, len(model))
        front = [self._time(stamp), f'{self._delta(stamp):>7}']
        if self.show_bus or is_wide:
            front.append(fit(bus, 10).ljust(8))
        if self.has_sides or entry.side:
            self.has_sides = True          # a column of its own, from the first side on
            front.append(entry.side.ljust(3))
        size = sum(map(len, front)) + len(front)
        middle = f'{mark} {number:3} {model:{self._model_width}} {name:{14 if is_wide else 10}} '
        if self.width is not None:
            room = self.width - size - len(middle)
            words = fit(words if len(words) <= room else words.replace('Present ', ''), room)
        if not self._colours:
            return ' '.join((*front, middle + words)).rstrip()
        return ' '.join((paint(' '.join(front), DIM), _coloured(middle, words, colour)))

    def _time(self, stamp: int) -> str:
        if self._first is None:
            self._first = self._last = stamp
        seconds, fraction = divmod(stamp // 1000, 1_000_000)
        if self._show_time == 'epoch':
            return f'{seconds}.{fraction:06}'
        if self._show_time == 'clock':
            return f'{time.strftime("%H:%M:%S", time.localtime(seconds))}.{fraction:06}'
        return f'{(stamp - self._first) / 1e9:10.6f}'

    def _delta(self, stamp: int) -> str:
        delta_us, self._last = (stamp - self._last) / 1e3, stamp
        return delta_text(delta_us)


def delta_text(delta_us: float) -> str:
    """Return a time in at most seven characters: +512us, +12.3ms, +4.56s, -1.20s."""
    sign, delta_us = '-' if delta_us < 0 else '+', abs(delta_us)
    for limit, unit, size in ((1e3, 'us', 1.0), (1e6, 'ms', 1e3), (1e11, 's', 1e6)):
        if delta_us < limit * 0.9995:
            number = delta_us / size
            digits = 0 if unit == 'us' or number >= 99.95 else 2 if number < 9.995 else 1
            return f'{sign}{number:.{digits}f}{unit}'
    return 3 * sign


Shown = tuple[str, str, str, str, str]         # mark, colour, ID, instruction, words


def columns_of(entry: Entry, parts: Sequence[Part]) -> Shown:
    """Return what is shown of an entry."""
    packet, device = entry.packet, entry.device
    if entry.kind == MISSED:
        number = '' if device is None else f'{device.number:03}'
        return '!', RED, number, 'missed', missed_words(entry)
    if entry.kind == DAMAGED:
        number = f'{entry.data[0]:03}' if entry.data else ''
        mark = ('?', YELLOW, number, 'undecided') if entry.reason == OPEN \
            else ('!', RED, number, 'damaged')
        return *mark, damaged_words(entry)
    if packet is None:
        return '!', YELLOW, '', 'noise', noise_words(entry)
    number = 'all' if packet.id == BROADCAST else f'{packet.id:03}'
    name = packet_name(packet) + ('*' if packet.repaired else '')
    if packet.error is None:
        colour = YELLOW if entry.request.malformed else CYAN
        return '>', colour, number, name, request_words(packet, entry, parts)
    errors = [packet.error, *(part.error for part in parts)]
    colour = RED if any(error & ~ALERT for error in errors) \
        else YELLOW if packet.error or entry.notes else GREEN
    return '<', colour, number, name, answer_words(packet, entry, parts)


def _model(device: Device | None, is_wide: bool) -> str:
    """Return the column of the model; with its joint where there is room."""
    name = '' if device is None else device.model.known_name
    if not is_wide:
        return fit(name, 10)
    joint = '' if device is None else device.joint
    return fit(f'{name} {joint}'.strip(), 24)


def _coloured(middle: str, words: str, colour: str) -> str:
    """Colour mark and ID always, the words only of what went wrong."""
    middle = paint(middle[:5], f'{BOLD};{colour}') + middle[5:]
    return middle + (paint(words, colour) if colour in (RED, YELLOW) else words)
