# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""
Values of chosen registers over HTTP, each as it came: /signals, in binary.

Query: for each register `of` (name of a device status), `register` (its key), `after` (the
number of the first point that the page does not have). The answer, all f64, little-endian: now
(s), what to add to times for Unix time (in a recording: for s since its beginning); for each
register how it is known (0 not yet, 1 read or sampled, 2 written, and it holds until the next),
the number of the first point, how many there are; then all points, as (s, value).
"""
from __future__ import annotations

import struct
import time
from typing import Protocol

from aiohttp import web

from mecarover_dashboard import rows
from mecarover_dashboard.state import State
from msg_defs.signal import POINT
from msg_defs.signal import PointRing
from msg_defs.signal import Points
from msg_defs.signal import SPAN_S

MOST = 8                        # registers of a page
MOST_OF_ALL = 32                # ... of all pages: 32 MB
_NOTHING = Points(0, False, b'')
_Chosen = tuple[str, str]       # the name of a device's status, the key of a register


class SignalSource(Protocol):
    """What records chosen registers; called from the server's thread."""

    def clock(self) -> tuple[float, float]: ...

    def signal(self, name: str, key: str, after: int) -> Points | None: ...

    def drop(self, name: str, key: str) -> None: ...


class ReportedSignals:
    """
    Registers as the nodes report them, which is all that there is over ROS: samples.

    What the master wrote between two reports is not known, so that nothing is held from one to
    the next; a value that was not written again since is still the goal when it is reported.
    """

    def __init__(self) -> None:
        self._rings: dict[_Chosen, PointRing] = {}
        self._seen: dict[_Chosen, tuple[float, float]] = {}     # when reported, when observed

    def clock(self) -> tuple[float, float]:
        """Return now and what to add for Unix time."""
        return time.monotonic(), time.time() - time.monotonic()

    def signal(self, name: str, key: str, after: int) -> Points:
        """Return the points of the last minute."""
        ring = self._rings.setdefault((name, key), PointRing())
        return ring.after(after, time.monotonic() - SPAN_S)

    def drop(self, name: str, key: str) -> None:
        """Record a register no more."""
        self._rings.pop((name, key), None)
        self._seen.pop((name, key), None)

    def sample_state(self, state: State) -> None:
        """Take what was reported since."""
        for (name, key), ring in self._rings.items():
            arrived_s, seen_s = self._seen.get((name, key), (0.0, 0.0))
            arrived_s, fields = state.fields_after(name, arrived_s)
            for field in fields:
                value = rows.finite(field.value)
                value = rows.finite(field.raw) if value is None else value
                at_s = field.seen or 0.0
                if field.source == 'w' and at_s - seen_s < rows.JITTER_S:
                    at_s = arrived_s
                if field.key == key and value is not None and at_s > seen_s:
                    seen_s = at_s
                    ring.add(seen_s, value)
            self._seen[name, key] = arrived_s, seen_s


class SignalRequests:
    """Answers pages with what a source has; after a minute without a question it is dropped."""

    def __init__(self, source: SignalSource) -> None:
        self._source = source
        self._asked: dict[_Chosen, float] = {}

    def forget(self, now_s: float) -> None:
        """Drop what no page asked for in the last minute."""
        for chosen, at_s in list(self._asked.items()):
            if now_s - at_s > SPAN_S:
                del self._asked[chosen]
                self._source.drop(*chosen)

    async def answer(self, request: web.Request) -> web.StreamResponse:
        """Answer /signals."""
        asked = list(zip(*(request.query.getall(name, []) for name in (
            'of', 'register', 'after')), strict=False))
        if not 0 < len(asked) <= MOST:
            return web.Response(status=400, text=f'Choose 1 to {MOST} registers.\n')
        chosen = dict.fromkeys(((name, key) for name, key, _ in asked), time.monotonic())
        if len(self._asked | chosen) > MOST_OF_ALL:
            reason = f'All pages together may show {MOST_OF_ALL} registers; close one of them.'
            return web.Response(status=503, text=f'{reason}\n')
        self._asked |= chosen
        found = [self._source.signal(name, key, int(after) if after.isdecimal()
                                     and len(after) < 17 else 0) or _NOTHING
                 for name, key, after in asked]
        head = [*self._source.clock(), *(number for one in found for number in (
            (1 + one.is_written) * (one is not _NOTHING), one.first, len(one.data) // POINT.size))]
        return web.Response(
            body=b''.join([struct.pack(f'<{len(head)}d', *head), *(one.data for one in found)]),
            content_type='application/octet-stream', headers={'Cache-Control': 'no-store'})
