# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""
Bytes that a text or the lines of a logic analyser show, and who sent them.

A word next to bytes may be wrong, or be meant for all below it. A packet with a right checksum
says more: a Status is always to the master. What neither decides is not claimed.
"""
from __future__ import annotations

from collections.abc import Iterator
from collections.abc import Mapping
from collections.abc import Sequence
from itertools import islice
import re
from typing import NamedTuple

from msg_defs.dxl1_packet import Dxl1Framer
from msg_defs.dxl_packet import Framer
from msg_defs.dxl_packet import HEADER
from msg_defs.dxl_packet import STATUS
from msg_defs.event import Change
from msg_defs.event import IN
from msg_defs.event import LOST
from msg_defs.event import OUT
from msg_defs.event import UNKNOWN

PACKET_MAX_BYTES, HEADERS_MAX = 1100, 10_000     # looked at for a right packet
MISLED_MIN_SHARE = 0.25            # share of what is marked as sent: so many answers are no bug
MARKED_MIN_SHARE = 0.25            # share of the parts: fewer are a word in passing
PURE_MIN_SHARE = 0.75              # share of a line's packets: some answers have error bits
NAMED_MAX = 4
_OTHER = {OUT: IN, IN: OUT, UNKNOWN: UNKNOWN}
_NAMES = {OUT: re.compile(r'\btx\b', re.IGNORECASE), IN: re.compile(r'\brx\b', re.IGNORECASE)}
_SWAPPED = 'what is marked as sent are answers: TX and RX were swapped'
_MIXED = 'what is marked as sent holds answers: TX and RX were not used'


class TextBytes(NamedTuple):
    """Bytes of one place; time: ns since any moment, None: not said. change: noted after them."""

    data: bytes
    side: str = UNKNOWN
    time: int | None = None
    change: Change | None = None
    file: str = ''                 # strace: the number of a file or its path


class ByteText(NamedTuple):
    """
    What a text shows; problem: why it cannot be used.

    unused: lines that show no bytes, by number. notes: what a person should know. baud: 0 unknown.
    """

    shape: str
    parts: Sequence[TextBytes]
    unused: Mapping[int, str]
    problem: str = ''
    notes: Sequence[str] = ()
    baud: int = 0

    @property
    def cut(self) -> str:
        """Say that strace left out bytes, '' where it did not."""
        lost = sum(one.change.value for one in self.parts if one.change is not None
                   and one.change.what == LOST) if 'strace' in self.shape else 0
        return f'; strace left out {lost} bytes, where it prints "...": add -s 4096' * (lost > 0)

    @property
    def flawed(self) -> int:
        """How many bytes had a parity or framing error."""
        return sum(one.change is not None and one.change.what != LOST for one in self.parts)

    @property
    def data(self) -> bytes:
        """Return all bytes."""
        return _joined(self.parts)

    @property
    def is_timed(self) -> bool:
        """Tell whether all bytes have times that never go back."""
        times = [one.time for one in self.parts]
        known = [one for one in times if one is not None]
        return len(known) == len(times) and known == sorted(known)


def holds_packet(data: bytes) -> bool:
    """Tell whether there is a packet with a right checksum among bytes."""
    return any(packets(data))


def packets(data: bytes) -> Iterator[bytes]:
    """Yield the packets with a right checksum among bytes."""
    end = 0
    for found in islice(re.finditer(b'(?=\xff\xff)', data), HEADERS_MAX):
        begin = found.start()
        if begin >= end and (size := packet_size(data[begin:begin + PACKET_MAX_BYTES])):
            end = begin + size
            yield data[begin:end]


def packet_size(data: bytes) -> int:
    """Return the size of the right packet with which data begin, 0 for none."""
    if data.startswith(HEADER):
        return 7 + int.from_bytes(data[5:7], 'little') if Framer().is_whole(data) else 0
    return 4 + data[3] if data[2:3] != b'\xff' and Dxl1Framer().is_whole(data) else 0


def _is_status(packet: bytes) -> bool:
    """Tell whether a packet can only be a status; of the 1.0 family one without an error."""
    return packet[7] == STATUS if packet.startswith(HEADER) else packet[4] == 0


def _count(data: bytes) -> tuple[int, int]:
    """Return how many packets there are, and how many can only be a status."""
    found = [_is_status(one) for one in packets(data)]
    return len(found), sum(found)


def _joined(parts: Sequence[TextBytes]) -> bytes:
    return b''.join(one.data for one in parts)


# --- sides of a text -----------------------------------------------------------------------------

def settle_sides(parts: Sequence[TextBytes]) -> tuple[Sequence[TextBytes], str]:
    """Return the parts with the sides that their packets allow, and what was done about them."""
    marked = {one.side for one in parts if one.side and one.data}
    if not marked or sum(bool(one.side) for one in parts) < MARKED_MIN_SHARE * len(parts):
        return _with_sides(parts, dict.fromkeys(_OTHER, UNKNOWN)), ''
    parts = list(_filled(parts, marked))
    (sent, misled), (received, answers) = (
        _count(_joined([one for one in parts if one.side == side])) for side in (OUT, IN))
    if {one.side for one in parts} == {IN}:        # a heading above both
        return _with_sides(parts, dict.fromkeys(_OTHER, UNKNOWN)), ''
    if misled < max(1, MISLED_MIN_SHARE * sent):
        return parts, ''
    if answers or 2 * misled < sent or not received:
        return _with_sides(parts, dict.fromkeys(_OTHER, UNKNOWN)), _MIXED
    return _with_sides(parts, _OTHER), _SWAPPED


def _with_sides(parts: Sequence[TextBytes], sides: Mapping[str, str]) -> list[TextBytes]:
    return [one._replace(side=sides[one.side]) for one in parts]


def _filled(parts: Sequence[TextBytes], marked: set[str]) -> Iterator[TextBytes]:
    """Yield the parts, those without a mark as what they hold; else as the other side."""
    only, last = _OTHER[min(marked)] if len(marked) == 1 else UNKNOWN, UNKNOWN
    for one in parts:
        if not one.side and one.data:
            number, answers = _count(one.data)
            one = one._replace(side=IN if answers else only or (OUT if number else last))
        last = one.side
        yield one


# --- lines of an analyser ------------------------------------------------------------------------

class OneBus(NamedTuple):
    """
    Bytes of the line or the two lines that are one bus; rivals: lines to choose from, else.

    names: of those that were taken. note: what was done about sides or other lines.
    """

    parts: Sequence[TextBytes]
    names: Sequence[str] = ()
    note: str = ''
    rivals: Sequence[str] = ()


def one_bus(lines: Mapping[str, Sequence[TextBytes]]) -> OneBus:
    """Return what is one bus: TX and RX by name or by what they hold, or the line with both."""
    sides = {name: _named_side(name) for name in lines}
    if len(lines) < 2 or {*sides.values()} != {OUT, IN}:
        streams = {_joined(lines[name]): name for name in [*lines][::-1]}     # alike ones once
        sides = {name: side for name in lines if name in streams.values()
                 and (side := _side_of(_joined(lines[name]))) is not None}
        both = [name for name, side in sides.items() if not side]
        if len(both) == 1 or len(sides) == 1:      # the others are a part of it
            sides = dict.fromkeys(both or sides, UNKNOWN)
        elif both or sorted(sides.values()) != [IN, OUT]:
            return OneBus((), rivals=[*sides])
    parts = [one._replace(side=side) for name, side in sides.items() for one in lines[name]]
    left = [name for name in lines if name not in sides]
    settled, note = settle_sides(sorted(parts, key=lambda one: one.time or 0))
    notes = [note] * bool(note) + [f'not used: {", ".join(left[:NAMED_MAX])}'] * bool(left)
    return OneBus(settled, [*sides], '; '.join(notes))


def _named_side(name: str) -> str:
    """Return the side that the name of a line says."""
    return next((side for side, named in _NAMES.items() if named.search(name)), UNKNOWN)


def _side_of(data: bytes) -> str | None:
    """Return the side that sent the packets of a line, UNKNOWN for both, None without packets."""
    number, answers = _count(data)
    if not number:
        return None
    return IN if answers >= PURE_MIN_SHARE * number else UNKNOWN if answers else OUT
