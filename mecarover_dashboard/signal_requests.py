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
from mecarover_dashboard.cdr import AnyStatus
from mecarover_dashboard.state import State
from msg_defs.signal import POINT
from msg_defs.signal import PointRing
from msg_defs.signal import Points
from msg_defs.signal import SPAN_S

MOST = 8                        # registers of a page
MOST_OF_ALL = 32                # ... of all pages: 32 MB
SAMPLED_S = 0.9                 # least time between two samples of what no page shows
SAMPLES_MAX = 4_000_000         # all registers over ROS: 64 MB
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
        self._sampled: dict[str, _SampledDevice] = {}
        self._chosen: set[_Chosen] = set()

    def clock(self) -> tuple[float, float]:
        """Return now and what to add for Unix time."""
        return time.monotonic(), time.time() - time.monotonic()

    def signal(self, name: str, key: str, after: int) -> Points | None:
        """Return the points of the last minute, and take all of them from now on."""
        self._chosen.add((name, key))
        device = self._sampled.get(name)
        ring = None if device is None else device.rings.get(key)
        return None if ring is None else ring.after(after, time.monotonic() - SPAN_S)

    def drop(self, name: str, key: str) -> None:
        """Go on with one a second."""
        self._chosen.discard((name, key))

    def sample_state(self, state: State) -> None:
        """Take what was reported since."""
        found, chosen = state.whole(), {name for name, _ in self._chosen}
        self._sampled = {name: self._sampled.get(name) or _SampledDevice() for name in found}
        kept = SAMPLES_MAX // (1 + sum(len(one.rings) for one in self._sampled.values()))
        for name, (status, arrived_s) in found.items():
            device = self._sampled[name]
            if arrived_s - device.arrived_s > (0.0 if name in chosen else SAMPLED_S):
                device.sample(status, arrived_s, kept)


class _SampledDevice:
    """The registers of a device."""

    def __init__(self) -> None:
        self.arrived_s = 0.0
        self.rings: dict[str, PointRing] = {}

    def sample(self, status: AnyStatus, arrived_s: float, kept: int) -> None:
        """Take what was seen since the last time."""
        before_s, self.arrived_s = self.arrived_s, arrived_s
        for key, text, at_s, source in rows.samples(status, arrived_s):
            ring = self.rings.get(key)
            if ring is not None:
                seen_s = ring.last_s()
                if source == 'w' and at_s - seen_s < rows.JITTER_S:
                    at_s = arrived_s
                if at_s <= seen_s or at_s < before_s - rows.JITTER_S:       # it was there before
                    continue
            if (value := rows.finite(text)) is not None:
                self.rings.setdefault(key, PointRing()).add(at_s, value, kept)


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
        found = [self._source.signal(name, key, rows.natural(after)) or _NOTHING
                 for name, key, after in asked]
        head = [*self._source.clock(), *(number for one in found for number in (
            (1 + one.is_written) * (one is not _NOTHING), one.first, len(one.data) // POINT.size))]
        return web.Response(
            body=b''.join([struct.pack(f'<{len(head)}d', *head), *(one.data for one in found)]),
            content_type='application/octet-stream', headers={'Cache-Control': 'no-store'})
