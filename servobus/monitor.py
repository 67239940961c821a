# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""
Monitor: one bus, from chunks of bytes to a report. No IO, no ROS; one lock, held per chunk.

A port thread feeds, any other thread asks for reports. Stamps and now are monotonic ns; the only
clock here measures how long a chunk takes.
"""

from collections.abc import Callable
from collections.abc import Iterable
from collections.abc import Sequence
from operator import attrgetter
from threading import Lock
from time import monotonic_ns
from typing import Any

from msg_defs.diagnostics import Level
from msg_defs.event import BREAK
from msg_defs.event import Change
from msg_defs.event import CLOSED
from msg_defs.event import FRAMING
from msg_defs.event import OUT
from msg_defs.event import OVERRUN
from msg_defs.event import PARITY
from msg_defs.event import UNKNOWN
from servobus.bus import evidence as ev
from servobus.bus.decoder import BusDecoder
from servobus.bus.decoder import DEFAULTS
from servobus.bus.decoder import Settings
from servobus.bus.device import Device
from servobus.bus.device import report_device
from servobus.bus.plan import Plan
from servobus.bus.report import BusReport
from servobus.bus.report import Cycle
from servobus.bus.report import DeviceReport
from servobus.bus.report import LineErrors
from servobus.bus_statistics import BusStatistics
from servobus.doctor import Doctor
from servobus.doctor.case import Names
from servobus.doctor.case import PARAMETERS
from servobus.internal_fault import survive
from servobus.joints import fresh
from servobus.joints import JointReadings
from servobus.model import control_table
from servobus.model.layers import model_key
from servobus.model.model_guesses import IMPOSSIBLE_USE
from servobus.model.model_guesses import is_contradicted
from servobus.model.model_guesses import ModelGuesses
from servobus.model.models import Models
from servobus.signals import BusSignals

_LINE_ERRORS = {OVERRUN: 'overrun', PARITY: 'parity', FRAMING: 'frame', BREAK: 'breaks'}
PLACE_NS = 100_000_000             # after a report: a joint may go back and forth between two
NEVER_NS = 1 << 63
CYCLES_REPORTED_MAX = 32
FEED_DELAY_NS = 200_000_000        # bytes that were read may wait for so long to be fed
SCAN_MIN_IDS = 8                   # IDs that do not answer a Ping: fewer may be lost devices
LISTENING_GAP_NS = 2_000_000_000   # a listener reports far more often


class Monitor:
    """
    One bus under observation.

    idle_is_told: by flush_if_idle(), again and again while nothing comes. Then time counts only
    while the port is open; else the stamps alone say when the line was idle. decoder: where
    a tool needs more of each packet than a report shows. names: what the doctor's remedies name.

    All is written under the lock, but for doctor, which report() uses under _examining.

    | attributes | who writes them |
    |---|---|
    | _last, _line_errors | feed_chunks() |
    | _listened, _resumed | feed_chunks(), flush_if_idle(), report() where idle is not reported |
    | _deaf | report() |
    | _place_due | feed_chunks(), report() |
    | _failed, _users | end() |
    | doctor | reset_statistics() |
    | all others | set once |
    """

    def __init__(self, name: str, models: Models, settings: Settings = DEFAULTS,
                 clock: Callable[[], int] = monotonic_ns, *, idle_is_told: bool = False,
                 decoder: BusDecoder | None = None, names: Names = PARAMETERS) -> None:
        self.name = name
        self.settings = settings
        self._clock = clock
        self._models = models
        self._guesses = ModelGuesses(models)
        self._lock = Lock()
        self._names = names
        self.doctor = Doctor(settings, names)
        self._examining = Lock()               # the doctor remembers from report to report
        self.decoder = decoder = decoder or BusDecoder(models, settings)
        self._tracker, self._registry = decoder.tracker, decoder.registry
        self._evidence = decoder.evidence
        self.signals = BusSignals(self._registry, self._lock)
        self._line_errors: LineErrors | None = None    # reported by the source
        self._idle_is_told = idle_is_told
        self._last = 0                         # stamp of the last chunk
        self._listened = 0                     # up to when all that came was fed, if known
        self._resumed = 0                      # when somebody listened again
        self._deaf = 0                         # until then no port was open
        self._failed: str | None = None        # how the program that asks ended
        self._users = tuple[str, ...]()        # who else had its port
        self._place_due = NEVER_NS
        self._statistics = BusStatistics(name, decoder)

    def feed(self, chunk: bytes, stamp: int, side: str = UNKNOWN) -> None:
        """
        Take the bytes that were read at stamp, when the last of them had just come in.

        side: who put them on the wire, where the source can tell; then OUT is stamped as written.
        """
        self.feed_chunks(((stamp, '', chunk, side, None),))

    def feed_chunks(self, chunks: Iterable[tuple[int, str, bytes, str, Change | None]]) -> None:
        """Take the Chunks that one read of a source brought: bytes as feed(), and changes."""
        with self._lock:
            began = self._clock()
            statistics = self._statistics
            before = self._last
            size = 0.0                         # a Series adds a float faster
            for stamp, _, data, side, change in chunks:
                if change is not None:
                    self._accept_change(change, stamp)
                    continue
                if self._idle_is_told:
                    self._listen_until(stamp)
                else:
                    self._flush_if_idle(stamp if side == OUT else stamp - int(
                        len(data) * self._registry.byte_ns))
                try:
                    self.decoder.process_chunk(data, stamp, side)
                except Exception as mistake:
                    self._recover(mistake)
                size += len(data)
                if self._registry.new_ids:
                    self.signals.attach_new()
                if stamp >= statistics.next_tick:
                    statistics.tick(stamp)
                if stamp >= self._place_due:
                    self._keep_places()
                self._last = stamp
            if size:                           # not changes alone
                statistics.fed += size
                if before:
                    statistics.between.add((stamp - before) / 1e6, stamp)
                statistics.sizes.add(size, stamp)
                statistics.spent.add((self._clock() - began) / 1e6, stamp)

    def change(self, change: Change, stamp: int) -> None:
        """Take what the source reported besides bytes (msg_defs/event.py)."""
        self.feed_chunks(((stamp, '', b'', UNKNOWN, change),))

    def end(self, now: int, failed: str = '', users: Sequence[str] = ()) -> None:
        """
        Take note that nothing more will come; of a program that failed the last question counts.

        failed: how it ended by itself (report.py). users: who else had its port open.
        """
        self.change(Change(CLOSED, 1), now)
        with self._lock:
            self._failed, self._users = failed, tuple(users)
            self._tracker.unread.judge_last(now, bool(failed))

    def alarms(self) -> int:
        """Return how often so far a device was lost, came back or had an alert."""
        counts = self._evidence.counts
        return counts[ev.DISCONNECTED] + counts[ev.RETURNED] + counts[ev.ALERT]

    def flush_if_idle(self, now: int) -> None:
        """Decide what is pending, if the line was idle too long for more to belong to it."""
        with self._lock:
            self._listen_until(now)
            self._flush_if_idle(now)

    def reset_statistics(self, now: int) -> None:
        """Start all counts and statistics at 0; what is known of the devices stays."""
        with self._lock:
            self._statistics.reset(now)
        with self._examining:
            self.doctor = Doctor(self.settings, self._names)   # the old one remembers old counts

    def report(self, now: int, line_errors: LineErrors | None = None,
               is_listening: bool = True) -> BusReport:
        """
        Return what is known and what it means; the lock is held for less than 1 ms at a time.

        line_errors: what the serial driver counted, where it does. is_listening: False while there
        is no port to tell when the line is idle.
        """
        self._load_models()
        with self._lock:
            if not self._idle_is_told:
                self._flush_if_idle(now - FEED_DELAY_NS)
            if not (self._idle_is_told and is_listening):
                self._listened = now
            if not is_listening:
                self._deaf = now
            statistics = self._statistics
            while now >= statistics.next_tick:
                statistics.tick(now)
            bus = self._bus_report(now)
            self._place_due = now + PLACE_NS
        devices = tuple(self._device_report(device, now) for device in self._by_id()
                        if device.number not in bus.scanned)
        with self._examining:
            return self.doctor.examine(bus._replace(
                devices=devices, line_errors=line_errors or self._line_errors,
                cycle=self.decoder.cycle(now), metrics=statistics.metrics(now, bus.rates)))

    def _device_report(self, device: Device, now: int) -> DeviceReport:
        with self._lock:
            self._registry.resolve(device)
            quiet_ns = self._listened - max(device.heard, device.asked_stamp, self._resumed)
            report, table = report_device(device, now, quiet_ns / 1e9)
        observed = tuple(table.observed(report.model, now))
        if report.model.number is None and is_contradicted(
                report.model, ((one.field, one.value) for one in observed), report.errors):
            with self._lock:
                device.used.add(IMPOSSIBLE_USE)
                self._registry.assume_model(device, control_table.UNKNOWN)
            return self._device_report(device, now)
        return report._replace(observed=observed,
                               unobserved=len(report.model.fields) - len(observed))

    def joints(self, since: int) -> JointReadings:
        """Return what was read of joints after the stamp `since`, without a whole report."""
        found = []
        for device in self._by_id():
            with self._lock:
                if (one := fresh(device, since)) is not None:
                    found.append(one)
        return JointReadings(tuple(joint for joint, _ in found),
                             max((at for _, at in found), default=0))

    def _by_id(self) -> list[Device]:
        """Return the devices known now; the lock is free while somebody goes through them."""
        with self._lock:
            return sorted(self._registry.devices.values(), key=attrgetter('number'))

    def _load_models(self) -> None:
        """Read the files of newly seen models: not under the lock, as that takes a while."""
        with self._lock:
            devices = self._registry.devices.values()
            keys = {model_key(device.identity[0] | device.identity[1] << 8, device.protocol)
                    for device in devices if device.is_unresolved}
            nameless = [(device, device.protocol, device.all_uses()) for device in devices
                        if device.used and device.heard and device.model_number is None]
        for key in keys:
            self._models.get(key)
        guesses = [(device, self._guesses.find_model(protocol, used))
                   for device, protocol, used in nameless]
        with self._lock:
            for device, model in guesses:
                self._registry.assume_model(device, model)

    def _listen_until(self, now: int) -> None:
        if self._listened and now - self._listened > LISTENING_GAP_NS:
            self._resumed = now
        self._listened = now

    def _flush_if_idle(self, now: int) -> None:
        if self._last and now - self._last > self.decoder.idle_ns:
            self._try(self.decoder.process_pause, self._last, now)

    def _accept_change(self, change: Change, stamp: int) -> None:
        field = _LINE_ERRORS.get(change.what)
        if field is None:
            self._try(self.decoder.process_change, change, stamp)
        else:
            before = self._line_errors or LineErrors()
            self._line_errors = before._replace(**{field: getattr(before, field) + change.value})

    def _try(self, call: Callable[..., None], *arguments: Any) -> None:
        try:
            call(*arguments)
        except Exception as mistake:
            self._recover(mistake)

    def _recover(self, mistake: Exception) -> None:
        """Go on with what comes next after a mistake of ours; a tool that cannot write ends."""
        if isinstance(mistake, OSError):
            raise mistake
        survive('the monitor', mistake)
        self._tracker.lose_track(self._last, 0)

    def _keep_places(self) -> None:
        self._place_due = NEVER_NS
        for device in self._registry.devices.values():
            device.keep_place()

    def _bus_report(self, now: int) -> BusReport:
        evidence, statistics, decoder = self._evidence, self._statistics, self.decoder
        return BusReport(                      # updated_plans() brings the counts up to date
            cycles=_cycles(self._tracker.planner.updated_plans()),
            name=self.name, stamp=now, started=statistics.started, baud=decoder.settings.baud,
            level=Level.OK, message='', devices=(),
            rates=statistics.rates(now), counters=statistics.counters(),
            errors=evidence.errors(self._registry.register_name),
            incidents=tuple(evidence.incidents), waits=tuple(evidence.waits),
            metrics=(), noise=decoder.noise,
            noise_side=decoder.noise_side, asked=self._tracker.asked,
            last_byte_s=(now - self._last) / 1e9 if self._last else None, deaf=self._deaf,
            kinds=dict(evidence.counts), protocol=decoder.protocol(), scanned=self._scanned(),
            is_answered=decoder.is_answered, has_sides=OUT in decoder.framers,
            line_mode=decoder.line_mode, users=self._users,
            is_over=self._failed is not None, is_closed=decoder.sessions.is_closed,
            failed=self._failed or '',
            chain=tuple(expected.id for expected in self.settings.devices),
            tried=frozenset(self._registry.tried),
            id_writes=self._registry.report_id_writes() if self._registry.id_writes else ())

    def _scanned(self) -> tuple[int, ...]:
        """Return the IDs that were only pinged and never heard: many are a scan, no devices."""
        found = tuple(device.number for device in self._registry.devices.values()
                      if not (device.heard or device.expected or device.counts.reads
                              or device.counts.writes or device.acks_missing))
        return found if len(found) >= SCAN_MIN_IDS else ()


def _cycles(plans: list[Plan]) -> tuple[Cycle, ...]:
    often = sorted(plans, key=attrgetter('asked'), reverse=True)[:CYCLES_REPORTED_MAX]
    return tuple(
        Cycle((one := plan.request).instruction,
              tuple(access.id for access in one.accesses) or (one.id,),
              one.address if one.accesses else None,
              one.accesses[0].length if one.accesses else 0,
              plan.asked, plan.missed, tuple(plan.stamps))
        for plan in often)
