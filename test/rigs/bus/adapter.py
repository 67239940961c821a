# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""
How a listener gets the bytes: through an adapter that gathers them, on a computer with other work.

Chunks have the stamp of the moment at which they were read. Pauses hold back the delivery, not
the wire: no byte is lost, but one packet may come in two chunks far apart. Two kinds: the
computer stops the reader (it says nothing meanwhile), or the adapter holds the bytes back while
the reader sees an idle line.
"""

from typing import NamedTuple

from rigs.bus.wire import BITS
from rigs.bus.wire import render
from rigs.bus.wire import S

MS = 1_000_000
IDLE = 20 * MS                     # a reader says that nothing came, this often


class Kind(NamedTuple):
    """An adapter and its computer."""

    gather_ms: float = 0.0         # bytes are handed over so long after the first of them
    size: int = 4095               # or when there are as many
    pause_ms: tuple[float, float] = (0.0, 0.0)     # how long delivery stands still
    every_s: float = 0.0           # about how often; 0: never
    is_reader_stopped: bool = True     # in a pause; else it sees an idle line
    baud: int = 0                  # it listens at; 0: the bus's


FINE = Kind()
FULL_SPEED = Kind(gather_ms=1.0, size=62)          # an FTDI adapter with a latency timer of 1 ms
COARSE = Kind(gather_ms=16.0, size=62)             # and of 16 ms
LUMPS = Kind(gather_ms=8.0)
BUSY = Kind(gather_ms=1.0, pause_ms=(25.0, 80.0), every_s=0.25)
WRONG_RATE = Kind(gather_ms=1.0, baud=57_600)
HUB = Kind(gather_ms=1.0, size=62, pause_ms=(25.0, 60.0), every_s=0.25, is_reader_stopped=False)


class Adapter:
    """hear(bytes, stamp) gets each chunk; idle(stamp): until then nothing came."""

    def __init__(self, clock, baud, kind, random, hear, idle):
        self._clock = clock
        self._kind = kind
        self._random = random
        self._byte_ns = BITS * S / (kind.baud or baud)
        self._is_own_rate = kind.baud in (0, baud)
        self._hear = hear
        self._idle = idle
        self._held = []     # bytes that are not handed over
        self._due = 0                  # when they are
        self._told = 0                 # stamp of what was said last
        self._pause = (0, 0)           # from, to: the next one or the one under way
        if kind.every_s:
            self._plan_pause(0)
        clock.at(IDLE, self._tick)

    def receive_bytes(self, heard):
        """Listen to the wire."""
        if not self._is_own_rate:
            heard = render(heard.talks, self._byte_ns)
        last, together = heard.end, len(self._held) + len(heard.data)
        if self._held and last <= self._due and together <= self._kind.size \
                and not self._kind.every_s:
            self._held += heard.data           # one chunk with what is held
            return
        for end, byte in zip(heard.ends, heard.data, strict=True):
            self._receive_byte(end, byte)
        if not self._kind.gather_ms:
            self._deliver(self._clock.now)

    def _receive_byte(self, end, byte):
        """Take a byte; the adapter may have handed over what was before it, at its own time."""
        begin, over = self._pause
        if self._kind.every_s and end > over:
            self._plan_pause(end)
            begin, over = self._pause
        if self._kind.every_s and begin < end:
            if self._due < over:
                self._deliver(min(self._due, begin))   # perhaps half a packet, and then nothing
                self._due = over
        elif self._kind.gather_ms and (end > self._due or len(self._held) >= self._kind.size):
            self._deliver(min(self._due, end))
        if not self._held:
            self._due = max(self._due, end + round(self._kind.gather_ms * MS))
            self._clock.at(self._due, self._flush)
        self._held.append(byte)

    def _flush(self):
        if self._clock.now >= self._due:
            self._deliver(self._clock.now)

    def _deliver(self, stamp):
        if not self._held:
            return
        data = bytes(self._held)
        self._held.clear()
        self._told = max(stamp, self._told)
        self._hear(data, self._told)

    def _plan_pause(self, after):
        begin = after + round(self._random.expovariate(1 / self._kind.every_s) * S)
        self._pause = begin, begin + round(self._random.uniform(*self._kind.pause_ms) * MS)

    def _tick(self):
        now, (begin, over) = self._clock.now, self._pause
        is_paused = begin <= now < over
        if now - self._told >= IDLE and (not self._held or is_paused) \
                and not (is_paused and self._kind.is_reader_stopped):
            self._told = now
            self._idle(now)
        self._clock.at(now + IDLE // 4, self._tick)
