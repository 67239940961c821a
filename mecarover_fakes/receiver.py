# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""
Receiver: the rover's MCU as its firmware behaves, on simulated time, and a cable with faults.

"Receive to idle" into 28 bytes: the callback comes when the buffer is full or the line was idle
for one character, and only a count of 28 with a good CRC becomes a set-point. These queue first
in, first out, 10 deep, the newest dropped when full; one is taken per 30 ms; the last is held for
ever. Source: the mecarover thesis. Any bytes are accepted, nothing raises; times are ns.
"""
from __future__ import annotations

from collections import deque
from dataclasses import dataclass
import random
from typing import NamedTuple

from msg_defs.crc import Checksum
from msg_defs.crc import crc32_mpeg2
from msg_defs.nanoseconds import NS_PER_S
from msg_defs.vel2d import decode
from msg_defs.vel2d import FRAME_SIZE
from msg_defs.vel2d import Vel2d

LOOP = 30_000_000                  # the pose loop takes one set-point in this time
QUEUE_DEPTH = 10
_CHARACTER_BITS = 10
_KEPT_ARRIVALS = 20_000


class SetPoint(NamedTuple):
    """What the wheels follow: taken at `stamp`, x and y in mm/s, omega in rad/s."""

    stamp: int
    x: float
    y: float
    omega: float

    @property
    def is_stop(self) -> bool:
        return not (self.x or self.y or self.omega)


class Arrival(NamedTuple):
    """One callback: when, how many bytes, and the velocity if size and CRC were right."""

    stamp: int
    size: int
    velocity: Vel2d | None


@dataclass
class Totals:
    """What the receiver counted since start."""

    received: int = 0              # bytes
    frames: int = 0                # good ones
    insufficient: int = 0          # callbacks with another count than 28
    crc_err: int = 0
    queue_full: int = 0
    taken: int = 0                 # set-points
    overruns: int = 0
    unheard: int = 0               # bytes after an overrun
    refused: int = 0               # by a GuardedReceiver, as its stops
    stops: int = 0


class Receiver:
    """Bytes in, set-points out."""

    def __init__(self, start: int = 0, *, baud: int = 115200,
                 crc: Checksum = crc32_mpeg2) -> None:
        """Begin with an idle line and an empty queue; the pose loop runs from `start` on."""
        self.totals = Totals()
        self.wheels = SetPoint(start, 0.0, 0.0, 0.0)
        self.arrivals: deque[Arrival] = deque(maxlen=_KEPT_ARRIVALS)
        self.character = -(-_CHARACTER_BITS * NS_PER_S // baud)
        self.line_free = start     # when the last byte has ended
        self._crc = crc
        self._buffer = b''
        self._deaf = False
        self._words = ''
        self._good: deque[tuple[int, Vel2d]] = deque()     # on the line, not yet in the queue
        self._queue: deque[Vel2d] = deque()
        self._next_loop = start + LOOP

    def feed(self, chunk: bytes, now: int) -> None:
        """Send bytes from `now` on, or after those still on the line, without a gap inside."""
        self.totals.received += len(chunk)
        if self._deaf:
            self.totals.unheard += len(chunk)
            return
        self._notice_idle(now)
        if chunk:
            self.line_free = max(self.line_free, now)
        while chunk:
            taken = chunk[:FRAME_SIZE - len(self._buffer)]
            chunk = chunk[len(taken):]
            self._buffer += taken
            self.line_free += len(taken) * self.character
            if len(self._buffer) == FRAME_SIZE:
                self._call_back(self.line_free)

    def advance(self, now: int) -> list[SetPoint]:
        """Let time pass and return the set-points taken up to `now`."""
        self._notice_idle(now)
        taken = []
        while self._next_loop <= now:
            self._enqueue(self._next_loop)
            if (velocity := self._next(self._next_loop)) is not None:
                x, y, omega = velocity
                self.wheels = SetPoint(self._next_loop, x * 1000.0, y * 1000.0, omega)
                self.totals.taken += 1
                taken.append(self.wheels)
            self._next_loop += LOOP
        self._enqueue(now)
        return taken

    def overrun(self) -> None:
        """Go deaf: reception is re-armed in the callback only, which no longer comes."""
        self.totals.overruns += 1
        self._deaf = True
        self._buffer = b''

    def text_to_host(self, now: int) -> str:
        """Return what it sends to the host: as the firmware of the thesis, what it refuses."""
        words, self._words = self._words, ''
        return words

    def _notice_idle(self, now: int) -> None:
        if self._buffer and now - self.line_free >= self.character:
            self._call_back(self.line_free + self.character)

    def _call_back(self, stamp: int) -> None:
        frame, self._buffer = self._buffer, b''
        velocity = decode(frame, self._crc)
        self.arrivals.append(Arrival(stamp, len(frame), velocity))
        if len(frame) != FRAME_SIZE:
            self.totals.insufficient += 1
            self._words += 'insufficient bytes received\r\n'
        elif velocity is None:
            self.totals.crc_err += 1
            self._words += 'crc mismatch!\r\n'
        else:
            self.totals.frames += 1
            self._good.append((stamp, velocity))

    def _enqueue(self, now: int) -> None:
        while self._good and self._good[0][0] <= now:
            self._put(*self._good.popleft())

    def _put(self, stamp: int, velocity: Vel2d) -> None:
        if len(self._queue) >= QUEUE_DEPTH:
            self.totals.queue_full += 1
        else:
            self._queue.append(velocity)

    def _next(self, now: int) -> Vel2d | None:
        """Return the velocity that the pose loop takes now, if there is a new one."""
        return self._queue.popleft() if self._queue else None


@dataclass
class BadCable:
    """Damages frames on request, seeded: 0 = never, N = each Nth frame (or after N frames)."""

    drop: int = 0
    flip: int = 0
    deaf_after: int = 0
    seed: int = 0
    frames: int = 0
    damaged: int = 0

    def __post_init__(self) -> None:
        self._random = random.Random(self.seed)

    def carry(self, frame: bytes) -> bytes:
        """Return what arrives of a frame."""
        self.frames += 1
        arriving = bytearray(frame)
        if arriving and self.drop and self.frames % self.drop == 0:
            del arriving[self._random.randrange(len(arriving))]
        if arriving and self.flip and self.frames % self.flip == 0:
            bit = self._random.randrange(8 * len(arriving))
            arriving[bit // 8] ^= 1 << bit % 8
        self.damaged += arriving != frame
        return bytes(arriving)

    def overruns(self) -> bool:
        """Whether the receiver is overrun by the frame carried last."""
        return self.frames == self.deaf_after > 0
