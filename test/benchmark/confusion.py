# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""
The doctor and the faults of `fake_bus`, in simulated time: Protocol 2.0, Feetech and Protocol 1.0.

The monitor gets each burst by itself, which is finer than most adapters deliver; or it gets what
the master's own port has, with the sides known. The seed is fixed: each machine gets the same
results. `scripts/python -m benchmark.baseline` plays all cases.
"""

from __future__ import annotations

from operator import itemgetter
from typing import NamedTuple

from benchmark.confusion_cases import CASES
from benchmark.confusion_cases import Key
from mecarover_fakes.fake_bus import make_devices
from mecarover_fakes.fake_bus import make_line
from mecarover_fakes.faults import parse
from mecarover_fakes.line import wire_ns
from mecarover_fakes.master import Master
from mecarover_fakes.traffic import PATTERNS
from msg_defs.event import IN
from msg_defs.event import OUT
from msg_defs.event import UNKNOWN
from servobus.bus.decoder import Settings
from servobus.bus.expected_devices import parse_all
from servobus.bus.report import Finding
from servobus.model.models import Models
from servobus.monitor import Monitor

S = 1_000_000_000
SEED = 1
REPORT_NS = S // 2
ONSET_S = 2.0
WITHIN_S = 5.0
MODELS = Models()


class Result(NamedTuple):
    """The findings at the end, and when the last expected one came first (s after the fault)."""

    told: tuple[Key, ...]
    after_s: float
    findings: tuple[Finding, ...]


# The simulated bus has the latency timer in the master's pace; at its port, answers come late.
SIDED = tuple(case for case in CASES if case.told[:1] not in (
    (('wrong_baud', None),), (('latency_timer', None),)))


def reports(faults, scene, seconds, has_sides=False, silence_s=0.0):
    """
    Yield the reports of a monitor on a simulated bus, two per second of its time.

    has_sides: it hears the master's own port, as usb: and tap: do. silence_s: then the master has
    stopped, for so long.
    """
    devices = make_devices(list(scene.devices), MODELS, scene.baud, dialect=scene.dialect)
    line = make_line(devices, scene.baud, scene.dialect, waits_in_line=scene.waits_in_line)
    master = Master(line, PATTERNS[scene.pattern], rate=scene.rate, seed=SEED,
                    faults=[parse(fault) for fault in faults])
    monitor = Monitor('bus', MODELS, Settings(
        baud=scene.baud, devices=tuple(parse_all(list(scene.devices)))))
    report_at, end = REPORT_NS, round(seconds * S)
    heard = own_port(master, end) if has_sides else chunks(master, end, scene.gather)
    for chunk, stamp, side in heard:
        while stamp > report_at:
            yield monitor.report(report_at)
            report_at += REPORT_NS
        monitor.feed(chunk, stamp, side)
    while report_at <= end + silence_s * S:
        yield monitor.report(report_at)
        report_at += REPORT_NS


def own_port(master, end):
    """Return what the port of the master writes and reads, in order of time."""
    told = [(stamp, side, data) for burst in master.bursts(end)
            for stamp, side, data in by_sides(burst, master.line.baud)]
    return [(data, stamp, side) for stamp, side, data in sorted(told, key=itemgetter(0))]


def by_sides(burst, baud):
    """
    Yield (time, side, bytes) of a burst as the master's own port has it.

    What it writes is whole also where the wire damages it, and while it sends it hears nothing.
    """
    yield from ((start, OUT, data) for start, data in burst.written)
    deaf = [(start, start + wire_ns(len(data), baud)) for start, data in burst.written]
    middles = (burst.start + wire_ns(2 * at + 1, 2 * baud) for at in range(len(burst.data)))
    heard = bytes(byte for byte, middle in zip(burst.data, middles, strict=True)
                  if not any(begin <= middle < end for begin, end in deaf))
    if heard:
        yield burst.end, IN, heard


def chunks(master, end, gather):
    """Yield the bursts as an adapter hands them over: each at once, or some time's together."""
    gathered, due = b'', 0
    for burst in master.bursts(end):
        if gathered and burst.end > due:
            yield gathered, due, UNKNOWN
            gathered = b''
        if burst.data and not gather:
            yield burst.data, burst.end, UNKNOWN
        elif burst.data:
            due = due if gathered else (burst.end // gather + 1) * gather
            gathered += burst.data
    if gathered:
        yield gathered, due, UNKNOWN


def told(report):
    """Return what a report claims, without the words."""
    return tuple((finding.rule, finding.device) for finding in report.findings)


def examine(case, has_sides=False):
    """Play a fault and see what is told."""
    at = ONSET_S if '{at}' in case.fault else 0.0
    first = {}
    findings = ()
    for report in reports([case.fault.format(at=at)], case.scene, at + WITHIN_S, has_sides):
        findings = report.findings
        for key in told(report):
            first.setdefault(key, report.stamp / S - at)
    # The time-out that a silent device costs is advice, no second cause.
    return Result(tuple((one.rule, one.device) for one in findings
                        if one.rule != 'cycle_time' or one.device is None),
                  max((first[key] for key in case.told if key in first), default=-1.0), findings)


def label(case):
    """Return the name of a case, as in test/baseline."""
    name = case.fault.replace(':{at}', '').removesuffix(':0').rstrip(':')
    return f'{name} ({case.about})' if case.about else name
