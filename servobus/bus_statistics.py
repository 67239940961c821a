# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""
BusStatistics: the counters, rates and timing of one bus.

Its monitor holds its lock over each call, but for metrics(). Stamps and now are monotonic ns.
"""

from collections import deque

from msg_defs.diagnostics import Metric
from msg_defs.dxl_packet import REASONS
from msg_defs.running_statistics import Series
from msg_defs.running_statistics import WINDOW_S
from servobus.bus import evidence as ev
from servobus.bus.decoder import BusDecoder

TICK_NS = 1_000_000_000
_SERIES = ('time_per_buffer', 'ms'), ('time_between_buffers', 'ms'), ('bytes_per_buffer', 'B')


class BusStatistics:
    """
    What was counted and measured on one bus since its start, or since reset().

    fed: bytes that the monitor was given, also where a mistake of ours left some out.
    """

    def __init__(self, bus: str, decoder: BusDecoder) -> None:
        self._bus = bus
        self._decoder = decoder
        self._planner, self._evidence = decoder.tracker.planner, decoder.evidence
        self.fed = 0.0
        self._noise_seen = 0
        self.reset(0)

    def reset(self, now: int) -> None:
        """Start all at 0, of the devices too."""
        self.started = now
        self.next_tick = 0
        self._planner.updated_plans()  # brings counts up to date that shall end here
        self._evidence.counts.clear()
        self._base: dict[str, int] = {}
        self._base = self.counters()
        self._base['Bytes'] -= self._base.pop('Pending Bytes')     # these are counted again
        self._ticks: deque[tuple[int, dict[str, int]]] = deque(maxlen=WINDOW_S)
        self._series = [Series() for _ in _SERIES]     # one value for each read
        self.spent, self.between, self.sizes = self._series
        self._decoder.clock.reset()
        for device in self._decoder.registry.devices.values():
            device.reset_statistics()

    def tick(self, now: int) -> None:
        """Once a second: snapshots for the last 10 s, and a look at what was no packet."""
        decoder, devices = self._decoder, self._decoder.registry.devices.values()
        noise_bytes = decoder.total('noise_bytes')
        if self._ticks and noise_bytes != self._noise_seen:
            self._evidence.search_noise(decoder.noise, noise_bytes - self._noise_seen, now)
        self._noise_seen = noise_bytes
        if not self.next_tick or now - self.next_tick > WINDOW_S * TICK_NS:
            self.next_tick = now
            self._ticks.clear()                # they are older than the window
            for device in devices:
                device.snapshots.clear()
        self.next_tick += TICK_NS
        self.started = self.started or now
        for device in devices:
            device.snapshots.append(device.counts.copy())
        decoder.clock.choose_leader(self._planner.known.values(), now)
        self._ticks.append((now, self._activity()))

    def _activity(self) -> dict[str, int]:
        """Return what a rate is worked out from: totals since start."""
        total = self._decoder.total
        return {'bytes': total('bytes'), 'packets': total('packets'),
                'errors': sum(map(self._decoder.damaged, REASONS))}

    def counters(self) -> dict[str, int]:
        """Return the counters of the bus."""
        total = self._decoder.total
        damaged, counts = self._decoder.damaged, self._evidence.counts
        fed = int(self.fed)
        now = {
            'Bytes': fed,
            'Packet Bytes': total('packet_bytes'),
            'Noise Bytes': total('noise_bytes') + fed - total('bytes'),    # mistakes of ours
            'Pending Bytes': total('pending'),
            'Packets': total('packets'),
            'Instructions': self._planner.instruction_count(),
            'Repaired Packets': total('repaired'),
            'CRC Errors': damaged('crc'),
            'Truncated Packets': damaged('cut'),
            'Bad Lengths': damaged('length'),
            'Unasked Answers': counts[ev.UNASKED] + counts[ev.SECOND_ANSWER] + counts[ev.LATE],
            'Unknown Instructions': counts[ev.UNKNOWN_INSTRUCTION],
        }
        return {name: n - self._base.get(name, 0) for name, n in now.items()}

    def rates(self, now: int) -> dict[str, float]:
        """Return the rates of the last 10 s, in 1/s."""
        totals = self._activity()
        since, before = self._ticks[0] if self._ticks else (now, totals)
        return {name: (n - before[name]) / (now - since) * 1e9 if now > since else 0.0
                for name, n in totals.items()}

    def metrics(self, now: int, rates: dict[str, float]) -> tuple[Metric, ...]:
        """Return the timing metrics of the bus, with these rates()."""
        clock, byte_ns = self._decoder.clock, self._decoder.registry.byte_ns
        values = [('byte_rate', 'B/s', rates['bytes']), ('packet_rate', 'Hz', rates['packets']),
                  ('error_rate', 'Hz', rates['errors'])]
        if byte_ns:                            # the rate is known
            values.append(('bus_load', '%', rates['bytes'] * byte_ns / 1e7))
        return (*(Metric(name, unit, one.summary(now), one.total(), bus=self._bus)
                  for (name, unit), one in zip(_SERIES, self._series, strict=True)),
                *clock.metrics(now, self._bus),
                *(Metric(name, unit, value=value, bus=self._bus) for name, unit, value in values))
