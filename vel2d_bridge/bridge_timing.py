# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""The timing metrics of the bridge: what is measured, in which unit. Pure; stamps in ns."""
from __future__ import annotations

from mecarover_serial.process import resident_memory_mb
from msg_defs.reports import Metric
from msg_defs.timing import Rate
from msg_defs.timing import Series
from vel2d_bridge.pacer import Sent

_NS_PER_MS = 1e6


class Timing:
    """Series of the metrics; one thread at a time adds to each of them."""

    def __init__(self) -> None:
        self.callback_to_write = Series()
        self.write = Series()
        self.command_period = Series()
        self.stamp_age = Series()
        self._frames = Rate()
        self._last_command: int | None = None

    def command_came(self, now: int, stamp_age: int | None) -> None:
        """Note the time and age (None: no stamp) of a command, accepted or refused."""
        if self._last_command is not None:
            self.command_period.add((now - self._last_command) / _NS_PER_MS, now)
        self._last_command = now
        if stamp_age is not None:
            self.stamp_age.add(stamp_age / _NS_PER_MS, now)

    def sent(self, sent: Sent) -> None:
        """Note the timings of a frame."""
        self.write.add(sent.write / _NS_PER_MS, sent.stamp)
        self._frames.add(1, sent.stamp)
        if sent.latency is not None:
            self.callback_to_write.add(sent.latency / _NS_PER_MS, sent.stamp)

    def reset(self) -> None:
        """Set the figures since start to zero."""
        for series in (self.callback_to_write, self.write, self.command_period, self.stamp_age):
            series.reset()

    def metrics(self, now: int) -> list[Metric]:
        """Return every metric, those without data too: topics do not come and go."""
        return [
            *(Metric(name, 'ms', series.summary(now), series.total()) for name, series in (
                ('callback_to_write', self.callback_to_write), ('write', self.write),
                ('command_period', self.command_period), ('stamp_age', self.stamp_age))),
            Metric('frame_rate', 'Hz', value=self._frames.per_second(now)),
            Metric('resident_memory', 'MB', value=resident_memory_mb()),
        ]
