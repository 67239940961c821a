# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""
Pacer: how the gate's frames get onto the line.

One write per frame, never before the previous frame has left; a partial write is never
completed. When the line takes nothing for the write time-out, what is pending is thrown away,
and a stop follows once the UART's FIFO must be empty (a flush in mid-frame and a stop without a
gap after it would both be lost at the MCU). How much is pending says nothing: cdc-acm counts
whole USB transfers. After a freeze of the bridge: a stop, and only new commands. Never blocks;
time and line are arguments, so that all of it runs in simulated time.
"""
from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple
from typing import Protocol

from msg_defs.crc import crc32_mpeg2
from msg_defs.nanoseconds import NS_PER_MS
from msg_defs.nanoseconds import NS_PER_S
from msg_defs.vel2d import encode
from msg_defs.vel2d import FRAME_SIZE
from msg_defs.vel2d import Vel2d
from vel2d_bridge.deadman_process import SILENCE
from vel2d_bridge.gate import characters_ns
from vel2d_bridge.gate import Frame
from vel2d_bridge.gate import FrameKind
from vel2d_bridge.gate import GAP_CHARACTERS
from vel2d_bridge.gate import Gate
from vel2d_bridge.gate import NEVER
from vel2d_bridge.gate import Outcome
from vel2d_bridge.gate import Stop

RETRY = 2 * NS_PER_MS
FIFO_CHARACTERS = 128              # the longest transmit FIFO of common UARTs and adapters


class SerialOutput(Protocol):
    """What a pacer needs of a port; all non-blocking, any may raise when the port has gone."""

    def write(self, data: bytes) -> int:
        """Write and return how many bytes were taken, 0 when none."""

    def pending(self) -> int:
        """Return how many bytes have not left yet."""

    def drop_output(self) -> None:
        """Throw away what has not left yet."""


class Sent(NamedTuple):
    """A frame that was written: when the write ended, what, why, and the two timings (ns)."""

    stamp: int
    velocity: Vel2d
    kind: FrameKind
    write: int                     # duration of the write
    latency: int | None            # from the callback to the end of the write, for a command


class Pacer:
    """Gate -> line. The owner serialises the calls and passes the clock (monotonic ns)."""

    def __init__(
            self, gate: Gate, clock: Callable[[], int], *, baud: int = 115200,
            crc: Callable[[bytes], int] = crc32_mpeg2, write_timeout_s: float = 0.05,
            on_sent: Callable[[Sent], None] = lambda sent: None) -> None:
        self.gate = gate
        self.write_timeout_s = write_timeout_s
        self.frames = 0
        self.time_outs = 0
        self.time_outs_in_row = 0                    # since a frame last left
        self.partial_writes = 0
        self.freezes = 0
        self.last: Sent | None = None
        self._clock = clock
        self._crc = crc
        self._on_sent = on_sent
        self._spacing = characters_ns(FRAME_SIZE + GAP_CHARACTERS, baud)
        self._gap = characters_ns(GAP_CHARACTERS, baud)
        self._drain = characters_ns(FIFO_CHARACTERS + GAP_CHARACTERS, baud)
        self._line: SerialOutput | None = None
        self._last_written_at = 0
        self._frame_under_way = False                # it is not known to have left
        self._frame_is_late = False                  # it had not left when it should have
        self._refused_since: int | None = None       # the line takes no frame
        self._last_turn_at = 0                       # the owner's thread called turn()
        self._turn_before_freeze = -1                # a freeze is counted once

    def attach(self, line: SerialOutput, now: int) -> None:
        """Begin on a newly opened line, with a stop."""
        self._line = line
        self._last_turn_at = self._last_written_at = now
        self._refused_since = None
        self._frame_under_way = self._frame_is_late = False
        self.time_outs_in_row = 0
        self.gate.opened(now)

    def detach(self) -> None:
        self._line = None
        self.gate.closed()

    def is_idle(self) -> bool:
        """Whether no stop is under way and everything written has left."""
        return self._line is None or not (self.gate.stopping or self._line.pending())

    @property
    def _patience(self) -> int:
        """How long a frame may take to leave (ns): never less than it takes on the wire."""
        return max(round(self.write_timeout_s * NS_PER_S), 2 * self._spacing)

    def turn(self, now: int, acted: bool = False) -> int:
        """Step in the owner's thread, at least every BEAT; `acted`: the deadman wrote a stop."""
        self.notice_freeze(now, acted)
        self._last_turn_at = now
        return self.step(now)

    def offer_command(
            self, velocity: Vel2d, now: int, *, waited: int = 0, stamp_age: int | None = None,
            acted: bool = False) -> Outcome:
        """Judge a command; a `step` after it writes it at once, if the rate allows."""
        self.notice_freeze(now, acted)
        return self.gate.offer_command(velocity, now, waited=waited, stamp_age=stamp_age)

    def notice_freeze(self, now: int, acted: bool) -> None:
        """
        Begin with a stop when the thread was silent for so long that the deadman acts, or it did.

        Comes before all else: the first `step` after a freeze must not write what
        was commanded before it.
        """
        if self._line is None or not (acted or now - self._last_turn_at >= SILENCE):
            return
        if self._turn_before_freeze != self._last_turn_at:             # counted once
            self._turn_before_freeze = self._last_turn_at
            self.freezes += 1
        self._last_written_at = now  # what is pending may be the deadman's stop
        self.gate.stop(now, Stop.FROZEN)

    def step(self, now: int) -> int:
        """Write the frame that is due, if the line is free; return when to be called again."""
        if self._line is None:
            return NEVER
        pending = self._line.pending()
        busy_since = self._last_written_at if pending else self._refused_since
        if busy_since is not None and now - busy_since >= self._patience:
            self.time_outs += 1
            self.time_outs_in_row += 1
            self._clear(self._line, now)
        elif not pending:
            if self._frame_under_way:                      # what the kernel took has left, too
                self._frame_under_way = False
                self.time_outs_in_row = 0
            if self._frame_is_late:                        # it may have left only now
                self._frame_is_late = False
                self.gate.hold(now + self._gap)
            frame = self.gate.next_frame(now)
            if frame is not None:
                self._write(self._line, frame)
        elif now - self._last_written_at >= self._spacing:
            self._frame_is_late = True
        wake = self.gate.next_deadline(now)
        return max(wake, now + RETRY) if pending or self._refused_since is not None else wake

    def _write(self, line: SerialOutput, frame: Frame) -> None:
        data = encode(frame.velocity, self._crc)
        begin = self._clock()
        taken = line.write(data)
        end = self._clock()
        if not taken:
            self._refused_since = begin if self._refused_since is None else self._refused_since
        elif taken < len(data):
            self.partial_writes += 1
            self._clear(line, end)
        else:
            self._refused_since = None
            self._last_written_at = end
            self._frame_under_way = True
            self._count_frame(frame, begin, end)

    def _count_frame(self, frame: Frame, begin: int, end: int) -> None:
        self.gate.sent(end)
        self.frames += 1
        latency = None if frame.offered is None else end - frame.offered
        self.last = Sent(end, frame.velocity, frame.kind, end - begin, latency)
        self._on_sent(self.last)

    def _clear(self, line: SerialOutput, now: int) -> None:
        """Throw away what is pending, and stop when the rest has left the FIFO."""
        line.drop_output()
        self._refused_since = None
        self._frame_under_way = False
        self._last_written_at = now
        self.gate.stop(now, Stop.WRITE)
        self.gate.hold(now + self._drain)
