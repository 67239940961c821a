# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""
The engine: from a report to its findings.

A claim lasts some seconds longer than its evidence, so that nothing flickers, one about a value
lasts until that is seen again (standing.py), and what another claim accounts for is not said.
"""

from __future__ import annotations

from msg_defs.diagnostics import Level
from msg_defs.diagnostics import worst
from msg_defs.nanoseconds import NS_PER_S
from servobus.bus.decoder import DEFAULTS
from servobus.bus.decoder import Settings
from servobus.bus.report import BusReport
from servobus.bus.report import DeviceReport
from servobus.bus.report import Finding
from servobus.doctor import rules
from servobus.doctor.case import Case
from servobus.doctor.case import History
from servobus.doctor.case import Names
from servobus.doctor.case import PARAMETERS
from servobus.doctor.device_states import judge_states
from servobus.doctor.rule import Claim
from servobus.doctor.rule import Found
from servobus.doctor.rule import Rule
from servobus.doctor.rules import devices
from servobus.doctor.rules import missing
from servobus.doctor.rules import noise
from servobus.doctor.rules import program
from servobus.doctor.standing import dated_claim
from servobus.doctor.standing import kept_claim
from servobus.doctor.standing import standing_claim
from servobus.doctor.standing import StandingClaim
from servobus.internal_fault import survive

IDLE_S = 0.5                       # no byte for so long: there is nothing to judge
WEAK_ONSET_S = 1.5                 # for what one answer says, where many are damaged
HOLD_NS = 3 * NS_PER_S             # a claim lasts so much longer than its evidence


# The rules that work on a bus on which nothing happens any more.
_AT_REST = (missing.sync_read_stops, missing.no_answer, program.master_stopped,
            program.port_lost)
_Key = tuple[str, int | None]


class Doctor:
    """The findings of one bus over time. Not thread-safe: one caller at a time."""

    def __init__(self, settings: Settings = DEFAULTS, names: Names = PARAMETERS) -> None:
        self._settings, self._names = settings, names
        self._history = History(names)
        self._standing: dict[_Key, StandingClaim] = {}
        self._since: dict[_Key, int] = {}          # claimed without a break
        self._doubts: tuple[Finding, ...] = ()

    def examine(self, report: BusReport) -> BusReport:
        """Return the report with states, findings, levels and messages."""
        report = judge_states(report, self._settings, self._names)
        case = self._history.make_case(report)
        if case.quiet_s and (report.last_byte_s or 0.0) > IDLE_S:
            findings = self._report_claims_at_rest(case)
            return _report_with(case, findings, self._doubts or tuple(
                Finding('noise', Level.OK, found.device, found.reason)
                for found in noise.source_lost(case)))
        doubts: list[Finding] = []
        since: dict[_Key, int] = {}
        seen = case.incidents_by_kind.keys()
        for rule in rules.RULES:
            if rule.needs_incident and seen.isdisjoint(rule.needs_incident):
                continue
            for found in found_by(rule, case):
                if isinstance(found, Claim):
                    key = rule.name, found.device
                    since[key] = self._since.get(key, case.now)
                    onset_s = max(rule.onset_s, WEAK_ONSET_S) \
                        if rule in devices.RULES and case.is_weak else rule.onset_s
                    if found.is_certain or case.now - since[key] >= onset_s * NS_PER_S:
                        self._standing[key] = standing_claim(case, rule, found,
                                                      self._standing.get(key))
                else:
                    doubts.append(Finding(rule.name, Level.OK, found.device, found.reason,
                                          step=found.step))
        self._since = since
        self._standing = {
            key: lasting for key, one in self._standing.items()
            if (lasting := one if _lasts(case, one) or (key in since and one.reading is not None)
                else kept_claim(case, one)) is not None}
        findings = self._report_claims(case)
        named = {(finding.rule, finding.device) for finding in findings}
        causes = [finding for finding in findings if finding.level is not Level.OK
                  and rules.BY_NAME[finding.rule].accounts_for] if doubts else []
        self._doubts = tuple([
            one for one in doubts if (one.rule, one.device) not in named
            and not [cause for cause in causes if (cause.device is None or one.device is not None)
                     and rules.accounts_for(cause, one)]])
        return _report_with(case, findings, self._doubts)

    def _report_claims_at_rest(self, case: Case) -> tuple[Finding, ...]:
        """Return what was known when the master asked last: nothing new can be judged."""
        self._standing.pop((program.master_stopped.name, None), None)    # the port may be closed
        for rule in _AT_REST:
            for found in found_by(rule, case):
                if isinstance(found, Claim):
                    self._standing[rule.name, found.device] = standing_claim(
                        case, rule, found, None)
        return self._report_claims(case)

    def _report_claims(self, case: Case) -> tuple[Finding, ...]:
        """Return the standing claims that no other accounts for, the worst and newest first."""
        if not self._standing:
            return ()
        standing = [one if one.reading is None else dated_claim(case, one)
                    for one in self._standing.values()]
        findings = [_finding(one) for one in standing]
        causes = [finding for one, finding in zip(standing, findings, strict=True)
                  if one.rule.accounts_for and not one.claim.stands_alone]
        reported = [effect for effect in findings
                    if not [cause for cause in causes if rules.accounts_for(cause, effect)]]
        return tuple(sorted(reported, key=lambda one: (-one.level, one.read_at > 0,
                                                       rules.RANKS[one.rule])))


def _lasts(case: Case, one: StandingClaim) -> bool:
    """Tell whether a claim was made so lately that it is still reported."""
    return 0 <= case.now - one.stamp <= (HOLD_NS if one.rule.holds else 0)


def _finding(one: StandingClaim) -> Finding:
    claim = one.claim
    return Finding(one.rule.name, one.rule.level if claim.level is None else claim.level,
                   claim.device, claim.message, claim.evidence, claim.covers,
                   one.reading.stamp if one.is_old and one.reading is not None else 0)


def found_by(rule: Rule, case: Case) -> list[Found]:
    """Return what a rule finds, where what it needs is known."""
    try:
        if not rule.each_device:
            return [*rule.check(case)]
        return [found._replace(device=device.id) for device in _devices_to_check(rule, case)
                if (found := rule.check(case, device)) is not None]
    except Exception as mistake:               # the other rules go on
        survive(f'the rule {rule.name}', mistake)
        return []


def _devices_to_check(rule: Rule, case: Case) -> list[DeviceReport]:
    """Return the devices that a rule is asked of."""
    numbers = {one.device for kind in rule.needs_incident for one in case.incidents(kind)}
    return [device for device in case.devices
            if (not rule.needs_incident or device.id in numbers)
            and (not rule.needs_registers
                 or rule.needs_registers <= case.values[device.id].keys())
            and (not rule.protocols or device.model.protocol in rule.protocols)
            and not (rule.needs_model and device.model.number is None)]


def _report_with(case: Case, findings: tuple[Finding, ...],
          doubts: tuple[Finding, ...]) -> BusReport:
    report = case.report
    first: dict[int | None, Finding] = {}
    for finding in findings:
        first.setdefault(finding.device, finding)
    report = report._replace(
        findings=findings, doubts=doubts,
        devices=tuple(_worsened(device, first[device.id]) if device.id in first else device
                      for device in report.devices))
    bus = first.get(None)
    if bus is not None and bus.level is not Level.OK:
        return report._replace(level=worst((report.level, bus.level)), message=bus.message)
    if any(doubt.rule == program.models.name for doubt in doubts):
        return program.with_models_named(report, case.names)
    return report


def _worsened(device: DeviceReport, finding: Finding) -> DeviceReport:
    """Return a device with its worst cause for a message, unless its state is worse still."""
    level = worst((device.level, finding.level))
    if level is not finding.level or level is Level.OK:
        return device._replace(level=level)
    return device._replace(level=level, message=finding.message)
