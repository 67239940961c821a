# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""
What happened to the port, from the thread that stops the rover to the one that logs it.

Bounded: a port that comes and goes while the node is held up costs no memory. The oldest is left
out then and counted, so what is logged last is how the port is now. No lock: the port's thread
never waits for a log.
"""
from __future__ import annotations

from collections import deque
from collections.abc import Iterator
from contextlib import suppress

from servobus.port.port_error import PortError

KEPT = 100                      # a port that comes and goes at once fills it in 10 s


class PortLog:
    """Filled by one thread, emptied by any."""

    def __init__(self) -> None:
        self._kept: deque[PortError | None] = deque()
        self._left_out = 0
        self._reported = 0

    def add(self, problem: PortError | None) -> None:
        """Keep that the port was opened (None), or why it is not open."""
        if len(self._kept) >= KEPT:             # room comes first: what is new is never left out
            with suppress(IndexError):          # taken meanwhile
                self._kept.popleft()
                self._left_out += 1
        self._kept.append(problem)

    def take_changes(self) -> Iterator[PortError | None]:
        """Yield what was added and not taken yet, the oldest first."""
        with suppress(IndexError):              # none is left; another thread may take, too
            while True:
                yield self._kept.popleft()

    def left_out(self) -> int:
        """Return how many were left out since the last call."""
        left_out = self._left_out
        new, self._reported = left_out - self._reported, left_out
        return new
