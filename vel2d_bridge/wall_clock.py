# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""
Wall clock: how long a message waited in the middleware, by a clock that may be stepped.

The middleware stamps reception with the system clock. A step of that clock (NTP, a Pi without a
battery) must neither refuse good commands nor let old ones pass for long. A suspend of the machine
is not a step: `now` is CLOCK_BOOTTIME, which goes on meanwhile. Pure; all times ns.
"""
from __future__ import annotations

_STEP = 100_000_000


class WallClock:
    """Compares system time (`wall`) with time since boot (`now`), distrusts it after a step."""

    def __init__(self) -> None:
        self._offset: int | None = None
        self._stepped: int | None = None

    def observe(self, wall: int, now: int) -> None:
        """Look for a step; call it once in a while, or slewing will look like one."""
        offset = wall - now
        if self._offset is not None and abs(offset - self._offset) > _STEP:
            self._stepped = now
        self._offset = offset

    def waited(self, received: int, wall: int, now: int) -> int:
        """Return the time since `received`, 0 where it is unknown or claims to span a step."""
        self.observe(wall, now)
        waited = max(0, wall - received) if received else 0
        spans_step = self._stepped is not None and now - self._stepped < waited
        return 0 if spans_step else waited
