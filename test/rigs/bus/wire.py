# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""
A half-duplex line in simulated time: who talks when, and what that makes the others hear.

One talker alone is heard as he talks. Where two overlap, the line is low when either pulls it low,
and a receiver samples the bits of that: 8N1, the middle of each bit (e-Manual, UART). The same
sampling says what a receiver at another rate hears.
"""

from bisect import bisect_right
from collections.abc import Sequence
from heapq import heappop
from heapq import heappush
from itertools import pairwise
from typing import NamedTuple

S = 1_000_000_000
BITS = 10                          # a byte on the line: start, 8 data, stop


class Clock:
    """Simulated time and what is due in it."""

    def __init__(self):
        self.now = 0
        self._due = []
        self._count = 0

    def at(self, stamp, do):
        """Do something at a time; at the same time in the order in which it was asked for."""
        self._count += 1
        heappush(self._due, (max(stamp, self.now), self._count, do))

    def run(self, until):
        while self._due and self._due[0][0] <= until:
            self.now, _, do = heappop(self._due)
            do()
        self.now = until


class Talk(NamedTuple):
    """One talker's bytes, without a gap."""

    start: int
    data: bytes
    byte_ns: float
    who: str = ''

    @property
    def end(self):
        return self.start + round(len(self.data) * self.byte_ns)


class Heard(NamedTuple):
    """What a listener at the line's own rate makes of one or more talkers."""

    data: bytes
    ends: Sequence[int]            # when each byte is over
    talks: tuple[Talk, ...]        # who made it

    @property
    def end(self):
        return max(talk.end for talk in self.talks)


class Wire:
    """The line. Talkers call talk(); listeners are told when a packet ends."""

    def __init__(self, clock, baud):
        self.clock = clock
        self.baud = baud
        self.byte_ns = BITS * S / baud
        self.listeners = []
        self.spoilers = []             # each of (now, talker, bytes), to the bytes on the line
        self._open = []            # those in one collision, or the one that talks
        self._talking = 0

    def talk(self, who, data, baud=0):
        """Begin to talk now; return when it is over."""
        for spoil in self.spoilers:
            data = spoil(self.clock.now, who, data)
        talk = Talk(self.clock.now, data, BITS * S / (baud or self.baud), who)
        if data:
            self._open.append(talk)
            self._talking += 1
            self.clock.at(talk.end, self._ended)
        return talk.end

    def _ended(self):
        self._talking -= 1
        if self._talking:
            return
        talks, self._open = tuple(self._open), []
        heard = render(talks, self.byte_ns)
        for listener in tuple(self.listeners):
            listener(heard)


def render(talks, byte_ns):
    """Return what a receiver at a rate hears of these talkers."""
    if all(one.end <= two.start for one, two in pairwise(talks)) \
            and all(talk.byte_ns == byte_ns for talk in talks):
        data = b''.join(talk.data for talk in talks)
        ends = [talk.start + round((i + 1) * byte_ns) for talk in talks
                for i in range(len(talk.data))]
        return Heard(data, ends, talks)
    found = sample(_lows(talks), byte_ns / BITS)
    return Heard(bytes(byte for byte, _ in found), [end for _, end in found], talks)


def _lows(talks):
    """Return when the line is low, as intervals in order."""
    spans = []
    for talk in talks:
        bit_ns = talk.byte_ns / BITS
        for number, byte in enumerate(talk.data):
            frame = byte << 1 | 1 << 9         # start bit 0, eight data bits, stop bit 1
            begin = talk.start + number * talk.byte_ns
            spans += [(begin + bit * bit_ns, begin + (bit + 1) * bit_ns)
                      for bit in range(BITS) if not frame >> bit & 1]
    spans.sort()
    merged = []
    for low, high in spans:
        if merged and low <= merged[-1][1] + 1e-6:
            merged[-1] = merged[-1][0], max(merged[-1][1], high)
        else:
            merged.append((low, high))
    return merged


def sample(lows, bit_ns):
    """Return (byte, when it is over) as a receiver finds them in a line."""
    begins = [low for low, _ in lows]

    def is_low(when):
        at = bisect_right(begins, when) - 1
        return at >= 0 and when < lows[at][1]

    found = []
    number, free = 0, -1.0                     # the line may be looked at from there
    while number < len(lows):
        begin, _ = lows[number]
        number += 1
        if begin < free:                       # it fell while a byte was received
            continue
        byte = sum((not is_low(begin + (bit + 1.5) * bit_ns)) << bit for bit in range(8))
        found.append((byte, round(begin + BITS * bit_ns)))
        free = begin + 9.5 * bit_ns
        if is_low(free):                       # a break: the next byte needs an edge
            free = lows[bisect_right(begins, free) - 1][1]
    return found
