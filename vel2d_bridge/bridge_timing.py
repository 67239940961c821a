# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""The timing metrics of the bridge: what is measured, in which unit. Pure; stamps in ns."""
from __future__ import annotations

from mecarover_serial.resident_memory import resident_memory
from msg_defs.diagnostics import Metric
from msg_defs.nanoseconds import NS_PER_MS
from msg_defs.running_statistics import Rate
from msg_defs.running_statistics import Series
from vel2d_bridge.pacer import Sent


class Timing:
    """Series of the metrics; one thread at a time adds to each of them."""

    def __init__(self) -> None:
        self.reset()
        self._frames = Rate()
        self._last_command: int | None = None

    def add_command(self, now: int, stamp_age: int | None) -> None:
        """Add the time and age (None: no stamp) of a command, accepted or refused."""
        if self._last_command is not None:
            self._add('command_period', now - self._last_command, now)
        self._last_command = now
        if stamp_age is not None:
            self._add('stamp_age', stamp_age, now)

    def add_frame(self, sent: Sent) -> None:
        """Add the timings of a frame."""
        self._add('write', sent.write, sent.stamp)
        self._frames.add(1, sent.stamp)
        if sent.latency is not None:
            self._add('callback_to_write', sent.latency, sent.stamp)

    def _add(self, name: str, duration: int, now: int) -> None:
        self.series[name].add(duration / NS_PER_MS, now)

    def reset(self) -> None:
        """Set the figures since start to zero."""
        self.series = {name: Series() for name in (
            'callback_to_write', 'write', 'command_period', 'stamp_age')}

    def metrics(self, now: int) -> list[Metric]:
        """Return every metric, those without data too: topics do not come and go."""
        return [
            *(Metric(name, 'ms', series.summary(now), series.total())
              for name, series in self.series.items()),
            Metric('frame_rate', 'Hz', value=self._frames.per_second(now)),
            resident_memory(),
        ]
