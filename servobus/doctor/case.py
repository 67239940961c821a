# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""
Case: what the rules look at. One report, the incidents of the last 10 s, what changed since.

History is what one report cannot say by itself; it is bounded, and it forgets: a case never
rests on anything older than the window.
"""

from collections import defaultdict
from collections import deque
from collections.abc import Callable
from collections.abc import Sequence
from dataclasses import dataclass
from dataclasses import field
from functools import cached_property
from typing import Any
from typing import NamedTuple

from msg_defs.nanoseconds import NS_PER_MS
from msg_defs.nanoseconds import NS_PER_S
from servobus.bus import evidence as ev
from servobus.bus import report as words
from servobus.bus.report import BusReport
from servobus.bus.report import Counts
from servobus.bus.report import Cycle
from servobus.bus.report import D
from servobus.bus.report import DeviceReport
from servobus.bus.report import Incident
from servobus.bus.report import IncidentKind
from servobus.bus.report import Wait
from servobus.bus.table import Observed
from servobus.doctor.bit_errors import count_overlaid
from servobus.doctor.bit_errors import damaged_packets
from servobus.doctor.bit_errors import DamagedPacket
from servobus.doctor.bit_errors import describe_damage
from servobus.doctor.bit_errors import expected_packets
from servobus.doctor.rhythm import find_late_cycles
from servobus.doctor.rhythm import LATE_DECIDED_AFTER
from servobus.doctor.rhythm import loop_of
from servobus.doctor.rhythm import PeriodicTimer
from servobus.doctor.rhythm import Rhythm
from servobus.doctor.rhythm import rhythms
from servobus.doctor.rhythm import two_timers
from servobus.doctor.thresholds import BLUR_FACTOR
from servobus.doctor.thresholds import GONE_S
from servobus.doctor.thresholds import STILL_MAX_STEPS
from servobus.doctor.thresholds import WINDOW_NS
from servobus.doctor.thresholds import WINDOW_S

HISTORY_MAX = 1000                 # incidents of a kind; and as many marks of time
RHYTHM_EVERY_NS = 750 * NS_PER_MS  # rhythms cost most
PAUSE_MIN_NS = 625 * NS_PER_MS     # without an instruction: nothing new is judged
RUN_GAP_NS = 10 * NS_PER_S         # without an instruction: what comes then is another run
PAUSES_KEPT_NS = 60 * NS_PER_S     # so far back pauses of the master are usual ones
GARBLED_MIN_SHARE = 0.5            # share of its missing answers: it speaks, and noise spoils that
GARBLED_ALL_SHARE = 0.9            # the same where noise may have come in its place
WEAK_MIN_DAMAGED = 5               # answers in the window; of as many one may have a right sum
SPEED_AT_REST = 2                  # units of Present Velocity: as much noise has one at rest
SIGN_BIT = 0x8000

DAMAGE_KINDS = (ev.DAMAGED_STATUS, ev.DAMAGED_INSTRUCTION, ev.CUT, ev.BAD_LENGTH)
_SAMPLED = ('Goal Position', 'Present Position', 'Realtime Tick', 'Present Input Voltage',
            'Torque Enable')


Key = tuple[int, tuple[int, ...], int | None]  # a cycle's instruction, IDs, address


class Names(NamedTuple):
    """
    What a remedy asks a person to set, as it is called there: a parameter or an option.

    time_of_day: spells a stamp ('20:46:30'); None where stamps are not of now.
    """

    bauds: str
    devices: str
    folders: str
    time_of_day: Callable[[int], str] | None = None


PARAMETERS = Names('`bauds`', '`devices`', '`model_dirs`')
OPTIONS = Names('-b', '--devices', '--model-dirs')
ARGUMENTS = Names('`baud`', '`devices`', '`models`')     # those of listen()


class TwoClocks(NamedTuple):
    """One instruction that two loops repeat; when that was seen last."""

    stamp: int
    cycle: Cycle
    timers: tuple[PeriodicTimer, PeriodicTimer]


class Mark(NamedTuple):
    """What was counted up to a moment."""

    stamp: int
    bytes: int
    packet_bytes: int
    packets: int
    instructions: int
    answers: int                   # all devices together
    stray_packets: int             # after a stray byte
    echoes: int
    overruns: int
    framing: int                   # errors that the driver counted
    totals: dict[int, Counts]      # by device


class Sample(NamedTuple):
    """The moving registers of a device at one moment: raw, None where unknown."""

    stamp: int
    goal: float | None
    position: float | None
    tick: float | None
    voltage: float | None          # V
    torque: float | None = None


@dataclass(eq=False)
class Case:
    """One bus at one moment, with its last ten seconds."""

    report: BusReport
    incidents_by_kind: dict[str, deque[Incident[Any]]]
    marks: deque[Mark]
    samples: dict[int, deque[Sample]]
    repeats: dict[int, int]            # stamp and instruction: asked again at once
    rhythms: list[Rhythm]              # what the master repeats, most frequent first
    steady: set[Key]                   # instructions that kept time, once
    names: Names = PARAMETERS
    quiet_s: float = 0.0               # since the last instruction, where that is unusual
    has_overlaps: bool = False         # questions were inside something else, in the window
    run_from: int = 0                  # stamp of the first instruction since a long pause
    damaged_packets: Sequence[DamagedPacket] = ()       # damaged packets that are recognised
    clocks: Sequence[TwoClocks] = ()   # instructions that two loops repeat
    highest: dict[int, float] = field(default_factory=dict)    # V of each device, since the start
    turned: set[int] = field(default_factory=set)      # devices that were seen turning
    loop: Sequence[tuple[int, int]] = ()    # cycles of the fastest: when each ended, how long
    late: Sequence[int] = ()           # when one of these began late

    def __post_init__(self) -> None:
        report = self.report
        self.now = report.stamp
        self.devices, self.cycles = report.devices, report.cycles
        self.has_sides, self.failed = report.has_sides, report.failed

    def incidents(self, kind: IncidentKind[D],
                  device: DeviceReport | None = None) -> list[Incident[D]]:
        """Return the incidents of a kind in the window, those of one device or all."""
        if device is None:
            return list(self.incidents_by_kind.get(kind, ()))
        return self._by_device.get((kind, device.id), [])

    def count(self, kind: IncidentKind[Any], device: DeviceReport | None = None) -> int:
        """Return how many incidents of a kind there were in the window."""
        return len(self.incidents_by_kind.get(kind, ()) if device is None
                   else self.incidents(kind, device))

    @cached_property
    def _by_device(self) -> defaultdict[tuple[str, int], list[Incident[Any]]]:
        found: defaultdict[tuple[str, int], list[Incident[Any]]] = defaultdict(list)
        for many in self.incidents_by_kind.values():
            for one in many:
                found[one.kind, one.device].append(one)
        return found

    @cached_property
    def damage(self) -> int:
        """How many frames in the window were damaged."""
        return sum(self.count(kind) for kind in DAMAGE_KINDS)

    @cached_property
    def packets(self) -> int:
        """How many packets in the window were whole; a recording may have but one report."""
        if len(self.marks) > 1:
            return self.increase_of('packets')
        return round(self.report.rates.get('packets', 0.0) * min(WINDOW_S, self.heard_s))

    @property
    def is_weak(self) -> bool:
        """Whether a damaged answer may pass for a whole one: many are, and sums have one byte."""
        return self.report.protocol != words.PROTOCOL_2 \
            and self.damage + self.spoilt >= WEAK_MIN_DAMAGED

    @cached_property
    def damage_s(self) -> float:
        """For how long the damage has gone on, s."""
        stamps = [one.stamp for kind in DAMAGE_KINDS
                  for one in self.incidents_by_kind.get(kind, ())]
        return (max(stamps) - min(stamps)) / NS_PER_S if stamps else 0.0

    def damage_picture(self, device: DeviceReport | None = None) -> dict[str, str]:
        """Return what the damage of a device or of all looks like, as a figure; {} if unclear."""
        picture = describe_damage([one for one in self.damaged_packets
                                   if device is None or one.device == device.id])
        return {'looks like': picture} if picture else {}

    @cached_property
    def spoilt(self) -> int:
        """How many answers were missed where there was damage or noise."""
        return sum(device.window.spoilt for device in self.devices)

    @cached_property
    def by_id(self) -> dict[int, DeviceReport]:
        return {device.id: device for device in self.devices}

    @cached_property
    def gone(self) -> list[int]:
        """Devices that were asked again and again and say nothing any more."""
        return [device.id for device in self.devices if is_gone(device, self.has_sides)]

    @cached_property
    def values(self) -> dict[int, dict[str, Observed]]:
        """The observed fields by device and name."""
        return {device.id: {one.field.name: one for one in device.observed}
                for device in self.devices}

    @cached_property
    def blur_ms(self) -> float:
        """How finely the chunks tell time: the usual time between two of them."""
        return _blur_ms(self.report)

    def stamp_ago(self, seconds: float) -> int:
        """Return the stamp (ns) of so long ago."""
        return self.now - int(seconds * NS_PER_S)

    def times_asked(self, cycle: Cycle, seconds: float = WINDOW_S) -> int:
        """Return how often an instruction was repeated since so long ago."""
        since = self.stamp_ago(seconds)
        return sum(stamp > since for stamp in cycle.stamps)

    def was_anything_asked(self, begin: int, end: int, but: Cycle) -> bool:
        """Tell whether anything else was asked between two stamps, or in the same chunks."""
        return any(begin <= stamp <= end for cycle in self.cycles if cycle is not but
                   for stamp in cycle.stamps)

    def recent_counts(self, device: DeviceReport, seconds: float) -> Counts:
        """Return what happened to a device since so long ago, or since it is known."""
        return device.totals.since(self.mark(seconds).totals.get(device.id, Counts()))

    def mark(self, seconds: float) -> Mark:
        """Return the counts of so long ago, or the oldest there are."""
        before = self.now - int(seconds * NS_PER_S)    # without a call: many ask
        return next((mark for mark in reversed(self.marks) if mark.stamp <= before),
                    self.marks[0])

    def increase_of(self, name: str, seconds: float = WINDOW_S) -> int:
        """Return how much a count of a Mark grew in so long a time."""
        return int(getattr(self.mark(0), name) - getattr(self.mark(seconds), name))

    @property
    def heard_s(self) -> float:
        """For how long the bus was heard."""
        return (self.now - self.report.started) / NS_PER_S

    @property
    def last_wait(self) -> Wait | None:
        """The vain wait after which the master asked nothing more, None if there is none."""
        waits = self.report.waits
        return waits[-1] if waits and waits[-1].stamp > self.report.asked else None

    def waits(self, seconds: float) -> list[Wait]:
        """Return the vain waits of the master since so long ago."""
        since = self.stamp_ago(seconds)
        return [wait for wait in self.report.waits if wait.stamp >= since]


def key_of(cycle: Cycle) -> Key:
    """Return what makes two repeated instructions differ."""
    return cycle.instruction, cycle.ids, cycle.address


def is_gone(device: DeviceReport, has_sides: bool) -> bool:
    """Tell whether a device is asked and gives no sign of life for longer than a start takes."""
    silent = device.state == words.DISCONNECTED or (
        device.state in (words.EXPECTED, words.ASKED) and device.missed_in_a_row > 4)
    # Damaged is not silent; of one that was never heard, noise may have come in its place.
    least = GARBLED_MIN_SHARE if has_sides or device.last_heard_s is not None \
        else GARBLED_ALL_SHARE
    speaks = device.window.garbled > least * device.window.missed
    return silent and not speaks and (device.last_heard_s is None or device.last_heard_s > GONE_S)


def is_waiting(device: DeviceReport) -> bool:
    """Tell whether a device never gets its turn, because one in front of it says nothing."""
    return device.waiting_behind is not None and device.state != words.CONNECTED


def speed_of(seen: Observed) -> float:
    """Return a velocity without its sign; bit 15 is that where two bytes have one (Feetech)."""
    return abs(seen.value.raw) % SIGN_BIT if seen.field.size == 2 else abs(seen.value.raw)


def _blur_ms(report: BusReport) -> float:
    return next((one.window.p50 for one in report.metrics
                 if one.name == 'time_between_buffers' and one.window is not None), 0.0)


class History:
    """What is remembered from report to report."""

    def __init__(self, names: Names = PARAMETERS) -> None:
        self._names = names
        self.clear()

    def clear(self) -> None:
        """Forget everything: the counts begin at 0."""
        self._last: Incident[Any] | None = None
        self._seen: dict[str, deque[Incident[Any]]] = {}
        self._marks: deque[Mark] = deque(maxlen=HISTORY_MAX)
        self._samples: dict[int, deque[Sample]] = {}
        self._repeats: dict[int, int] = {}
        self._rhythms: tuple[int, list[Rhythm]] = (0, [])
        self._steady: set[Key] = set()
        self._highest: dict[int, float] = {}
        self._turned: set[int] = set()
        self._clocks: dict[Key, TwoClocks] = {}
        self._loop: deque[tuple[int, int]] = deque(maxlen=HISTORY_MAX)
        self._late: deque[int] = deque(maxlen=HISTORY_MAX)
        self._asked = self._pause = 0  # stamp of the last instruction, and how old it was
        self._run_from = self._overlapped = 0
        self._pauses: deque[tuple[int, int]] = deque(maxlen=HISTORY_MAX)
        self._wrecks: deque[tuple[int, DamagedPacket]] = deque(maxlen=HISTORY_MAX)
        self._noise = 0                # bytes of it that were looked at

    def make_case(self, report: BusReport) -> Case:
        """Remember a report; return it with what belongs to it."""
        mark = mark_of(report)
        if self._marks and mark.bytes < self._marks[-1].bytes:
            self.clear()
        self._store_incidents(report.incidents)
        before = report.stamp - WINDOW_NS
        self._marks.append(mark)
        while self._marks[0].stamp < before:
            self._marks.popleft()
        for many in self._seen.values():
            while many and many[0].stamp < before:
                many.popleft()
        fresh = report.stamp - self._rhythms[0] >= RHYTHM_EVERY_NS
        if fresh:
            self._rhythms = (report.stamp, rhythms(report.cycles, report.stamp, report.baud))
            self._steady |= {key_of(one.cycle) for one in self._rhythms[1] if one.is_even}
            self._find_clocks(report, before)
            self._store_loop(report, before)
        case = Case(report, self._seen, self._marks, self._samples, self._repeats,
                    self._rhythms[1], self._steady, self._names,
                    self._quiet_s(report),
                    damaged_packets=self._recognise_damage(report, before),
                    run_from=self._run_from,
                    has_overlaps=0 < self._overlapped > before,
                    clocks=[*self._clocks.values()], highest=self._highest,
                    turned=self._turned, loop=self._loop, late=self._late)
        self._store_samples(case, before)
        for rhythm in case.rhythms if fresh else ():
            self._repeats.update(
                (again, rhythm.cycle.instruction) for before_that, again in rhythm.repeats
                if not case.was_anything_asked(before_that, again, rhythm.cycle))
        for stamp in [stamp for stamp in self._repeats if stamp < before]:
            del self._repeats[stamp]
        return case

    def _find_clocks(self, report: BusReport, before: int) -> None:
        """
        Remember which instructions two loops repeat.

        Where they run into each other the timers have gaps; what was seen before that counts.
        """
        self._clocks = {key: one for key, one in self._clocks.items() if one.stamp >= before}
        for rhythm in self._rhythms[1]:
            timers = None if rhythm.is_even else two_timers(rhythm.cycle.stamps,
                                                          NS_PER_MS * _blur_ms(report))
            if timers is not None:
                self._clocks[key_of(rhythm.cycle)] = TwoClocks(report.stamp, rhythm.cycle, timers)

    def _store_loop(self, report: BusReport, before: int) -> None:
        """Remember the last cycles of the fastest loop; the newest are decided later."""
        last = self._loop[-1][0] if self._loop else 0
        if self._rhythms[1]:
            loop = loop_of(self._rhythms[1])
            self._loop.extend([one for one in zip(
                loop.cycle.stamps[1:], loop.periods[:-LATE_DECIDED_AFTER], strict=False)
                if one[0] > last])
            self._late.extend([stamp for stamp in find_late_cycles(
                loop, report.cycles, report.baud, BLUR_FACTOR * NS_PER_MS * _blur_ms(report),
                report.has_sides) if stamp > last])
        while self._loop and self._loop[0][0] < before:
            self._loop.popleft()
        while self._late and self._late[0] < before:
            self._late.popleft()

    def _recognise_damage(self, report: BusReport, before: int) -> list[DamagedPacket]:
        """Return the damaged packets of the window; those of this report are looked at now."""
        fresh = report.counters['Noise Bytes'] - self._noise
        self._noise = report.counters['Noise Bytes']
        if fresh > 0:
            found = damaged_packets(report.noise[-fresh:], expected_packets(report))
            self._wrecks.extend((report.stamp, one) for one in found)
            if count_overlaid(report):
                self._overlapped = report.stamp
        while self._wrecks and self._wrecks[0][0] < before:
            self._wrecks.popleft()
        return [one for _, one in self._wrecks]

    def _quiet_s(self, report: BusReport) -> float:
        """Return for how long the master has asked nothing, 0 if it often pauses like that."""
        if not report.asked:
            return 0.0
        pause = report.stamp - report.asked
        if report.asked != self._asked:
            self._pauses.append((report.stamp, self._pause))
            self._store_run_start(report)
            self._asked = report.asked
        self._pause = pause
        while self._pauses and self._pauses[0][0] < report.stamp - PAUSES_KEPT_NS:
            self._pauses.popleft()
        usual = max((one for _, one in self._pauses), default=0)
        return pause / NS_PER_S if pause > max(PAUSE_MIN_NS, 2 * usual) else 0.0

    def _store_run_start(self, report: BusReport) -> None:
        """Note where the master began again, after a long pause or for the first time."""
        if self._asked and report.asked - self._asked < RUN_GAP_NS:
            return
        since = max(self._asked + 1, report.started)
        first = min([stamp for cycle in report.cycles for stamp in cycle.stamps
                     if stamp >= since], default=report.asked)
        if not self._asked or first - self._asked >= RUN_GAP_NS:
            self._run_from = first

    def _store_incidents(self, incidents: tuple[Incident[Any], ...]) -> None:
        new = []
        for incident in reversed(incidents):
            if incident is self._last:
                break
            new.append(incident)
        seen = self._seen
        for incident in reversed(new):
            if incident.kind not in seen:
                seen[incident.kind] = deque(maxlen=HISTORY_MAX)
            seen[incident.kind].append(incident)
        self._last = incidents[-1] if incidents else None

    def _store_samples(self, case: Case, before: int) -> None:
        for device in case.devices:
            values = case.values[device.id]
            is_new = device.id not in self._turned
            if is_new and 'Present Velocity' in values \
                    and speed_of(values['Present Velocity']) > SPEED_AT_REST:
                self._turned.add(device.id)
            if 'Present Position' not in values and 'Present Input Voltage' not in values:
                if device.id in self._samples:     # it restarted, so they say nothing of now
                    del self._samples[device.id]
                continue
            goal, position, tick, voltage, torque = (values.get(name) for name in _SAMPLED)
            samples = self._samples.setdefault(device.id, deque(maxlen=HISTORY_MAX))
            if samples and position and samples[-1].position is not None:
                self._note_motion(device, position, samples, samples[-1].position)
            samples.append(Sample(case.now, goal and goal.value.raw,
                                  position and position.value.raw,
                                  tick and tick.value.number, voltage and voltage.value.number,
                                  torque and torque.value.raw))
            self._highest[device.id] = max(self._highest.get(device.id, 0.0),
                                           samples[-1].voltage or 0.0)
            while samples[0].stamp < before:
                samples.popleft()

    def _note_motion(self, device: DeviceReport, now: Observed, samples: deque[Sample],
                     before: float) -> None:
        """Keep where a joint was between two reports, if it was at neither of their places."""
        raw = device.place or b''
        place = now.field.decode(raw).raw if len(raw) == now.field.size else now.value.raw
        if min(abs(place - before), abs(place - now.value.raw)) > STILL_MAX_STEPS:
            samples.append(Sample(samples[-1].stamp, None, place, None, None))
        if abs(place - before) > STILL_MAX_STEPS or abs(now.value.raw - before) > STILL_MAX_STEPS:
            self._turned.add(device.id)


def mark_of(report: BusReport) -> Mark:
    counters, errors = report.counters, report.line_errors
    return Mark(report.stamp, counters['Bytes'], counters['Packet Bytes'], counters['Packets'],
                counters['Instructions'],
                sum(device.totals.answers for device in report.devices),
                report.kinds.get(ev.GLITCH, 0), report.kinds.get(ev.ECHO, 0),
                errors.overrun + errors.buf_overrun if errors else 0,
                errors.frame + errors.breaks if errors else 0,
                {one.id: one.totals for one in report.devices})
