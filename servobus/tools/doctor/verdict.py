# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""
What dxl_doctor says of a run: what was heard, what is wrong, what is unknown. Pure.

From the last report of each bus and the log of its findings; answer_screen.py and as_json() show
it.
"""

from __future__ import annotations

from collections.abc import Iterable
from collections.abc import Sequence
from itertools import groupby
import os
from typing import Any
from typing import NamedTuple

from msg_defs.diagnostics import Level
from servobus.bus.expected_devices import spans
from servobus.bus.report import CONNECTED
from servobus.bus.report import DeviceReport
from servobus.bus.report import Finding
from servobus.bus.report import MOVED
from servobus.doctor.device_states import LISTED_AS
from servobus.doctor.facts import is_rate_search
from servobus.doctor.finding_log import BusSummary
from servobus.doctor.finding_log import LoggedFinding
from servobus.doctor.finding_log import NEEDS_TIMES
from servobus.doctor.open_symptoms import open_symptoms
from servobus.doctor.rule import PORT
from servobus.doctor.rules import accounts_for
from servobus.doctor.rules import BY_NAME
from servobus.plain_data import bus_data
from servobus.plain_data import device_data
from servobus.plain_data import finding_data
from servobus.printable_text import printable
from servobus.tools.doctor import explain

WELL, NOTHING_HEARD, WARNING, ERROR = 0, 1, 3, 4      # exit codes; 2 is a wrong command line
PORTS_NAMED_MAX = 2
SMALL_SHARE = 0.005                # share of a cycle that is not worth a word
LOAD_MIN_NS = 2_000_000_000         # the load of a shorter time says nothing
_CAUSE_IN_STATE = CONNECTED, MOVED     # open_symptoms.py has what is left of the others
_CODES = {Level.WARN: WARNING, Level.ERROR: ERROR}
ID = '{:03}'
_UNTIMED = 'waits and periods: this file holds no exact times; record with dxl_dump -w FILE'


class Trouble(NamedTuple):
    """One thing that is wrong. who: a device by name, or the bus; rule '': no rule names it."""

    level: Level
    who: str
    rule: str
    message: str
    evidence: str


class OpenPoint(NamedTuple):
    """What is wrong and has several causes left; rule '': none has it; step: what decides."""

    who: str
    rule: str
    message: str
    step: str


# For a program that its servo library has ended, where nothing that was heard says why.
_LIBRARY_ERROR = OpenPoint(
    'the program', '', 'nothing that was heard accounts for its error: its time-out is too short '
    'for a busy computer, its library is set to another protocol or model, or the program uses '
    'it in the wrong order',
    'read one register of one servo in a program of its own, with the same library: if that '
    'works, it is the order; else the protocol or model')


class DeviceGroup(NamedTuple):
    """Devices alike, one after the other. level: the worst that is said of them."""

    who: str
    what: str
    level: Level


class Verdict(NamedTuple):
    """All that is shown. head: what of the source is known, in parts; quiet: why no byte came."""

    source: str
    head: Sequence[str]
    heard: Sequence[DeviceGroup]
    wrong: Sequence[Trouble]
    unknown: Sequence[str]
    quiet: Sequence[str]
    protocol: str = ''             # what the buses speak, in words; '' unheard
    cycles: Sequence[str] = ()   # where the time of a cycle goes
    not_sure: Sequence[OpenPoint] = ()

    @property
    def code(self) -> int:
        """The exit code that this is worth."""
        if self.quiet:
            return NOTHING_HEARD
        return max([_CODES.get(entry.level, WELL) for entry in self.wrong]
                   + [WARNING] * bool(self.not_sure), default=WELL)


def make_verdict(source: str, buses: Sequence[BusSummary], seconds: float, is_timed: bool,
                 quiet: Sequence[str] = (), ports: Sequence[str] = (),
                 ended: Trouble | None = None,
                 more_unknown: Sequence[str] = ()) -> Verdict:
    """
    Return what is said of a run of so many seconds; quiet: why nothing was heard, if so.

    Of a program: its ports, the error with which it ended, what is unknown of that.
    """
    unknown = [*more_unknown, *([] if is_timed or quiet else [_UNTIMED])]
    not_sure: list[OpenPoint] = []
    port = next(iter(ports), '') or source.removeprefix('usb:')
    device = port if port.startswith('/dev/') else PORT
    for bus in buses:
        found = [one.finding for one in bus.logged]
        doubts = [one for one in bus.report.doubts if (is_timed or one.rule not in NEEDS_TIMES)
                  and not (one.step and any(accounts_for(cause, one) for cause in found))]
        steps = [one for one in doubts if one.step and not any(
            cause.level is Level.ERROR for cause in found)]
        left = open_symptoms(bus.report, [*found, *steps])
        unknown += [f'{one.rule.replace("_", " ")}, {bus.who(one.device)}: {one.message}'
                    for one in doubts if one not in steps]
        unknown += [f'{bus.who(one.id)}: {printable(one.message)}; the cause is unknown'
                    for one in _unnamed(bus)
                    if _is_slight(one) and one.id not in {finding.device for finding in left}]
        not_sure += [OpenPoint(bus.who(one.device), one.rule, printable(one.message),
                               printable(one.step.replace(PORT, device)))
                     for one in [*steps, *left]]
    wrong = [entry for bus in buses for entry in _wrong(bus)]
    if ended:
        known = explain.find(ended.message)
        is_explained = bool(known) and not known[0].findings       # the bus has no part in it
        if not (quiet or not_sure or is_explained
                or any(entry.level > Level.OK for entry in wrong)):
            not_sure.append(_LIBRARY_ERROR)
        wrong.append(ended)
    return Verdict(
        printable(source),
        [*map(os.path.basename, ports[:PORTS_NAMED_MAX]), *_head(buses, seconds, is_timed)],
        [one for bus in buses for one in _heard(bus)],
        sorted(wrong, key=lambda entry: -entry.level), unknown, quiet,
        ' and '.join(dict.fromkeys(bus.report.protocol for bus in buses if bus.report.protocol)),
        [_cycle(bus) for bus in buses if is_timed and bus.report.cycle], not_sure)


def _cycle(bus: BusSummary) -> str:
    times, place = bus.report.cycle, f'{bus.name}: ' if bus.name else ''
    assert times is not None
    parts = sorted([('program', times.program), ('devices', times.device), ('wire', times.wire),
                    ('strace', times.tracer),
                    *((f'waiting for {number:03}', ms) for number, ms in times.waiting)],
                   key=lambda part: -part[1])
    shown = ', '.join(f'{name} {_ms(ms)}' for name, ms in parts if ms > SMALL_SHARE * times.cycle)
    shown += ' (waiting and program are not known apart)' if times.is_blurred else ''
    return f'{place}{_ms(times.cycle)} ms a cycle' + (
        f'; its parts are unknown: {times.unknown}' if times.unknown else f': {shown}')


def _ms(value: float) -> str:
    return f'{value:.2g}' if value < 10 else f'{value:.0f}'


def _head(buses: Sequence[BusSummary], seconds: float, is_timed: bool) -> list[str]:
    reports = [bus.report for bus in buses]
    rates = sorted({report.baud for report in reports})
    parts = [f'{" and ".join(map(str, rates))} baud'] if any(rates) else []
    if any(map(is_rate_search, reports)):
        parts = ['several baud rates']
    if is_timed:
        parts.append(f'{seconds:.1f} s')
    packets = sum(report.counters['Packets'] for report in reports)
    parts.append(f'{packets} packet{"s" * (packets != 1)}')
    loads = [metric.value or 0.0 for report in reports for metric in report.metrics
             if metric.name == 'bus_load' and report.stamp - report.started > LOAD_MIN_NS
             ] if is_timed else []
    return parts + ([f'load {max(loads):.0f} %'] if loads else [])


# --- heard ---------------------------------------------------------------------------------------

def _heard(bus: BusSummary) -> list[DeviceGroup]:
    """Return the devices, those alike in one line."""
    found = []
    for kind, many in groupby(bus.report.devices, key=_kind):
        devices = list(many)
        who = _spans(bus, (one.id for one in devices))
        if len(devices) == 1:
            who = f'{who} {devices[0].joint}'.rstrip()
        found.append(DeviceGroup(printable(who), printable(kind[0]), kind[1]))
    return found


def _spans(bus: BusSummary, ids: Iterable[int]) -> str:
    """Return devices as '001-006, 008', each with its bus where there are several."""
    place = f'{bus.name}/' if bus.name else ''
    return ', '.join(place + span for span in spans(ids, ID))


def _kind(device: DeviceReport) -> tuple[str, Level]:
    firmware = f', firmware {device.firmware}' if device.firmware is not None else ''
    model = 'model unknown' if device.model_name == 'unknown' else device.model_name
    return f'{model}{firmware}: {LISTED_AS.get(device.state, device.state)}', device.level


# --- wrong ---------------------------------------------------------------------------------------

def _wrong(bus: BusSummary) -> list[Trouble]:
    found = [_entry(bus, alike) for alike in _alike(bus.logged)]
    found += [Trouble(device.level, bus.who(device.id), '', printable(device.message), '')
              for device in _unnamed(bus) if device.state in _CAUSE_IN_STATE
              and not _is_slight(device)]
    return found


def _unnamed(bus: BusSummary) -> list[DeviceReport]:
    """Return the devices that are not well, and no finding says why."""
    if any(one.finding.level is Level.ERROR or _explains_loss(one.finding) for one in bus.logged):
        return []                      # that of other devices follows from it, as a rule
    findings = [*bus.report.findings, *(one.finding for one in bus.logged)]
    named = {one.device for one in findings}.union(*(one.covers for one in findings))
    return [one for one in bus.report.devices if one.level in _CODES and one.id not in named]


def _explains_loss(finding: Finding) -> bool:
    return finding.device is None and 'missed answers' in BY_NAME[finding.rule].accounts_for


def _is_slight(device: DeviceReport) -> bool:
    return device.state == CONNECTED and device.level is Level.WARN


def _alike(logged: Sequence[LoggedFinding]) -> list[list[LoggedFinding]]:
    """Return findings of several devices that say the same together, the others alone."""
    groups: dict[tuple[str, Level, str, bool], list[LoggedFinding]] = {}
    for one in logged:
        finding = one.finding
        key = finding.rule, finding.level, finding.message, one.stands
        groups.setdefault(key, []).append(one)
    return list(groups.values())


def _entry(bus: BusSummary, alike: Sequence[LoggedFinding]) -> Trouble:
    first = alike[0].finding
    who = bus.who(first.device)
    if len(alike) > 1:
        numbers = {one.finding.device for one in alike}
        who = _spans(bus, (device.id for device in bus.report.devices if device.id in numbers))
    return Trouble(first.level, who, first.rule, printable(first.message), _evidence(alike[0]))


def _evidence(one: LoggedFinding) -> str:
    """Return the figures of a finding, and its time, as one sentence."""
    figures = [f'{key} {value}' for key, value in one.finding.evidence]
    when = f'seen from {one.first_s:.1f} to {one.last_s:.1f} s, not since' if not one.stands \
        else f'seen from {one.first_s:.1f} s on' if one.read_s is None \
        else f'seen from {one.first_s:.1f} s on, its value is of {one.read_s:.1f} s'
    return printable('; '.join([when, *figures]))


def as_json(verdict: Verdict, buses: Sequence[BusSummary], seconds: float) -> dict[str, Any]:
    """Return a run for programs: seconds from the first byte on, levels in words."""
    return {
        'source': verdict.source, 'seconds': round(seconds, 3), 'exit': verdict.code,
        'wrong': [[one.level.name, one.who, one.rule, one.message] for one in verdict.wrong],
        'not_sure': verdict.not_sure, 'nothing_heard': verdict.quiet,
        'cannot_tell': verdict.unknown,
        'buses': [bus_data(bus.report) | {
            'devices': [device_data(device) for device in bus.report.devices],
            'findings': [_finding_json(one, bus) for one in bus.logged]} for bus in buses]}


def _finding_json(one: LoggedFinding, bus: BusSummary) -> dict[str, Any]:
    finding = one.finding
    return {**finding_data(finding), 'who': bus.who(finding.device),
            'first_s': round(one.first_s, 3), 'last_s': round(one.last_s, 3), 'stands': one.stands,
            'read_s': None if one.read_s is None else round(one.read_s, 3)}
