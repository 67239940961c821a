# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""
Monitor: one bus, from chunks of bytes to a report. No IO, no ROS; one lock, held per chunk.

A port thread feeds, any other thread asks for reports. Stamps and now are monotonic ns; the only
clock here measures how long a chunk takes.
"""

from collections import deque
from collections.abc import Callable
from operator import attrgetter
from threading import Lock
from time import monotonic_ns
from typing import NamedTuple

from dxl_monitor import assess
from dxl_monitor import evidence as ev
from dxl_monitor.device import Device
from dxl_monitor.devices import Device as Expected
from dxl_monitor.doctor import Doctor
from dxl_monitor.evidence import Evidence
from dxl_monitor.joints import fresh
from dxl_monitor.joints import Joints
from dxl_monitor.models import Models
from dxl_monitor.plan import Plan
from dxl_monitor.report import BusReport
from dxl_monitor.report import Cycle
from dxl_monitor.roster import Roster
from dxl_monitor.tap_driver import LineErrors
from dxl_monitor.tracker import Tracker
from msg_defs.dxl_packet import Frame
from msg_defs.dxl_packet import Framer
from msg_defs.reports import Joint
from msg_defs.reports import Level
from msg_defs.reports import Metric
from msg_defs.timing import Series

WINDOW_S = 10
TICK_NS = 1_000_000_000
BITS_PER_BYTE = 10
CYCLES_REPORTED = 32
IDLE_CHARACTERS = 20
IDLE_NS = 20_000_000               # at least, and two latency timers of a USB adapter
LAG_NS = 200_000_000               # bytes that were read may wait for so long to be fed
ANSWER_NS = 1_000_000_000          # a broadcast Ping may take 0.8 s; nothing pending takes longer
DEAF_NS = 2_000_000_000            # a tap that listens says something far more often


class Settings(NamedTuple):
    """The parameters of a bus (design section 4). latency_timer_ms: of the adapter."""

    baud: int = 2_000_000
    devices: tuple[Expected, ...] = ()
    missed_limit: int = 4
    warn_loss: float = 1.0
    silent_after: float = 5.0
    write_acks: str = 'auto'
    latency_timer_ms: float = 0.0


DEFAULTS = Settings()


class Monitor:
    """
    One bus under observation.

    idle_is_told: by flush_if_idle(), again and again while nothing comes. Then time counts only as
    far as somebody listened; else the stamps alone say when the line was idle.
    """

    def __init__(self, name: str, models: Models, settings: Settings = DEFAULTS,
                 clock: Callable[[], int] = monotonic_ns, *, idle_is_told: bool = False) -> None:
        self.name = name
        self.settings = settings
        self._clock = clock
        self._models = models
        self._lock = Lock()
        self.doctor = Doctor()
        self._examining = Lock()               # the doctor remembers from report to report
        self._byte_ns = byte_ns = BITS_PER_BYTE * 1e9 / settings.baud
        self.idle_ns = int(max(IDLE_NS, 2e6 * settings.latency_timer_ms,
                               IDLE_CHARACTERS * byte_ns))
        self._framer = Framer()
        self._evidence = Evidence()
        self._roster = Roster(models, settings.devices, settings.baud, self._evidence)
        self._tracker = Tracker(self._roster, self._evidence, byte_ns, settings.missed_limit,
                                settings.write_acks)
        self._limits = assess.Limits(settings.missed_limit, settings.warn_loss,
                                     settings.silent_after)
        self._idle_is_told = idle_is_told
        self._last = 0                         # stamp of the last chunk
        self._listened = 0                     # up to when all that came was fed, if told
        self._resumed = 0                      # when somebody listened again
        self._noise_seen = 0
        self._start_statistics(0)

    def feed(self, chunk: bytes, stamp: int) -> None:
        """Take the bytes that were read at stamp, when the last of them had just come in."""
        with self._lock:
            began = self._clock()
            if self._idle_is_told:
                self._listen_until(stamp)
            else:
                self._flush_if_idle(stamp - int(len(chunk) * self._byte_ns))
            framer = self._framer
            self._track(framer.frames(chunk), stamp)
            if stamp >= self._next_tick:
                self._tick(stamp)
            if self._last:
                self._time_between.add((stamp - self._last) / 1e6, stamp)
            self._last = stamp
            self._buffer_size.add(len(chunk), stamp)
            self._time_per_buffer.add((self._clock() - began) / 1e6, stamp)

    def flush_if_idle(self, now: int) -> None:
        """Decide what is pending, if the line was idle too long for more to belong to it."""
        with self._lock:
            self._listen_until(now)
            self._flush_if_idle(now)

    def reset_statistics(self, now: int) -> None:
        """Start all counts and statistics anew; what is known of the devices stays."""
        with self._lock:
            self._start_statistics(now)
            for device in self._roster.devices.values():
                device.reset_statistics()
        with self._examining:
            self.doctor = Doctor()             # it compares with what was counted before

    def report(self, now: int, line_errors: LineErrors | None = None,
               is_listening: bool = True) -> BusReport:
        """
        Return what is known and what it means; the lock is held for less than 1 ms at a time.

        line_errors: what the serial driver counted, where it does. is_listening: False while there
        is no port that could tell when the line is idle.
        """
        self._load_models()
        with self._lock:
            if not self._idle_is_told:
                self._flush_if_idle(now - LAG_NS)
            if not (self._idle_is_told and is_listening):
                self._listened = now
            while now >= self._next_tick:
                self._tick(now)
            cycles = _cycles(self._tracker.plans())
            bus = self._bus_report(now, cycles)
        devices = tuple(assess.complete(self._snapshot(device, now), now)
                        for device in self._by_id())
        level, message = assess.judge_bus(bus, devices)
        with self._examining:
            return self.doctor.examine(bus._replace(
                devices=devices, level=level, message=message, line_errors=line_errors,
                metrics=self._metrics(now, bus.rates)))

    def _snapshot(self, device: Device, now: int) -> assess.Snapshot:
        with self._lock:
            self._roster.resolve(device)
            quiet_ns = self._listened - max(device.heard, device.asked_stamp, self._resumed)
            return assess.snapshot(device, now, quiet_ns / 1e9, self._limits)

    def joints(self, since: int) -> Joints:
        """Return what was read of joints after the stamp `since`, without a whole report."""
        found = [one for device in self._by_id() if (one := self._fresh(device, since))]
        return Joints(tuple(joint for joint, _ in found), max((at for _, at in found), default=0))

    def _fresh(self, device: Device, since: int) -> tuple[Joint, int] | None:
        with self._lock:
            return fresh(device, since)

    def _by_id(self) -> list[Device]:
        """Return the devices known now; the lock is free while somebody goes through them."""
        with self._lock:
            return sorted(self._roster.devices.values(), key=attrgetter('number'))

    def _load_models(self) -> None:
        """Read the files of newly seen models: not under the lock, as that takes a while."""
        with self._lock:
            said = {device.identity for device in self._roster.devices.values()
                    if device.unresolved}
        for identity in said:
            self._models.get(identity[0] | identity[1] << 8)

    def _start_statistics(self, now: int) -> None:
        self._started = now
        self._next_tick = 0
        self._tracker.plans()                  # brings counts up to date that shall end here
        self._evidence.counts.clear()
        self._base: dict[str, int] = {}
        self._base = self._counters()
        self._base['Bytes'] -= self._base.pop('Pending Bytes')     # these are counted anew
        self._ticks: deque[tuple[int, int, int, int]] = deque(maxlen=WINDOW_S)
        self._time_per_buffer = Series(WINDOW_S)
        self._time_between = Series(WINDOW_S)
        self._buffer_size = Series(WINDOW_S)

    def _track(self, frames: list[Frame], stamp: int) -> None:
        """Take what the framer found in the chunk of this stamp."""
        self._tracker.track(frames, stamp, self._framer.bytes)

    def _listen_until(self, now: int) -> None:
        if self._listened and now - self._listened > DEAF_NS:
            self._resumed = now
        self._listened = now

    def _flush_if_idle(self, now: int) -> None:
        idle = now - self._last
        if not self._last or idle <= self.idle_ns:
            return
        framer = self._framer
        if framer.pending:
            self._track(framer.flush_frames(), self._last)
        if idle > ANSWER_NS:
            self._tracker.settle(now)

    def _tick(self, now: int) -> None:
        """Once a second: snapshots for the last 10 s, and a look at what was no packet."""
        if not self._next_tick or now - self._next_tick > WINDOW_S * TICK_NS:
            self._next_tick = now
        self._next_tick += TICK_NS
        if not self._started:
            self._started = now
        for device in self._roster.devices.values():
            device.tick()
        framer = self._framer
        if self._ticks and framer.noise_bytes != self._noise_seen:
            self._evidence.look_at_noise(framer.noise, framer.noise_bytes - self._noise_seen, now)
        self._noise_seen = framer.noise_bytes
        self._ticks.append((now, *self._rated()))

    def _rated(self) -> tuple[int, int, int]:
        framer = self._framer
        errors = framer.crc_errors + framer.truncated + framer.bad_length
        return framer.bytes, framer.packets, errors

    def _counters(self) -> dict[str, int]:
        framer = self._framer
        counts = self._evidence.counts
        now = {
            'Bytes': framer.bytes,
            'Packet Bytes': framer.packet_bytes,
            'Noise Bytes': framer.noise_bytes,
            'Pending Bytes': framer.pending,
            'Packets': framer.packets,
            'Instructions': self._tracker.instructions(),
            'Repaired Packets': framer.repaired,
            'CRC Errors': framer.crc_errors,
            'Truncated Packets': framer.truncated,
            'Bad Lengths': framer.bad_length,
            'Unasked Answers': counts[ev.UNASKED] + counts[ev.SECOND_ANSWER] + counts[ev.LATE],
            'Unknown Instructions': counts[ev.UNKNOWN_INSTRUCTION],
        }
        return {name: n - self._base.get(name, 0) for name, n in now.items()}

    def _rates(self, now: int) -> dict[str, float]:
        if not self._ticks or now <= self._ticks[0][0]:
            return {'bytes': 0.0, 'packets': 0.0, 'errors': 0.0}
        since, *past = self._ticks[0]
        seconds = (now - since) / 1e9
        return {name: (n - before) / seconds for name, n, before
                in zip(('bytes', 'packets', 'errors'), self._rated(), past, strict=True)}

    def _bus_report(self, now: int, cycles: tuple[Cycle, ...]) -> BusReport:
        evidence = self._evidence
        rates = self._rates(now)
        return BusReport(
            name=self.name, stamp=now, started=self._started, baud=self.settings.baud,
            level=Level.OK, message='', devices=(), counters=self._counters(), rates=rates,
            errors=evidence.errors(), incidents=evidence.incidents(), waits=evidence.waits(),
            cycles=cycles, metrics=(),
            noise=self._framer.noise, last_byte_s=(now - self._last) / 1e9 if self._last else None,
            kinds=dict(evidence.counts),
            chain=tuple(expected.id for expected in self.settings.devices))

    def _metrics(self, now: int, rates: dict[str, float]) -> tuple[Metric, ...]:
        series = (('time_per_buffer', 'ms', self._time_per_buffer),
                  ('time_between_buffers', 'ms', self._time_between),
                  ('bytes_per_buffer', 'B', self._buffer_size))
        load = 100 * BITS_PER_BYTE * rates['bytes'] / self.settings.baud
        values = (('byte_rate', 'B/s', rates['bytes']), ('packet_rate', 'Hz', rates['packets']),
                  ('error_rate', 'Hz', rates['errors']), ('bus_load', '%', load))
        return (*(Metric(name, unit, one.summary(now), one.total(), bus=self.name)
                  for name, unit, one in series),
                *(Metric(name, unit, value=value, bus=self.name) for name, unit, value in values))


def _cycles(plans: list[Plan]) -> tuple[Cycle, ...]:
    often = sorted(plans, key=attrgetter('asked'), reverse=True)[:CYCLES_REPORTED]
    return tuple(
        Cycle(plan.request.instruction, tuple(access.id for access in plan.request.accesses)
              or (plan.request.id,), plan.address if plan.address >= 0 else None,
              plan.request.accesses[0].length if plan.request.accesses else 0,
              plan.asked, plan.missed, tuple(plan.stamps))
        for plan in often)
