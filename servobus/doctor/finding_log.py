# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""
What the doctor reported of one bus, from the first report to the last, for the end of a run. Pure.

A fault of two seconds is still worth a word at the end. What a later finding accounts for is not,
nor the silence of a bus that answers at a rate that was tried since.
"""

from __future__ import annotations

from typing import NamedTuple

from servobus.bus.report import BusReport
from servobus.bus.report import Finding
from servobus.doctor.rules import accounts_for
from servobus.doctor.rules import RANKS
from servobus.doctor.rules import timing
from servobus.printable_text import printable

_Key = tuple[str, int | None]
_SILENT = 'all_silent', None
NEEDS_TIMES = frozenset(rule.name for rule in timing.RULES)


class LoggedFinding(NamedTuple):
    """
    A finding; first_s, last_s: its times from the first byte; stands: there at the end.

    read_s: when the value that it rests on was seen last, where that is not read any more.
    """

    finding: Finding
    first_s: float
    last_s: float
    stands: bool
    read_s: float | None = None


class FindingLog:
    """The findings of one bus over time; takes its reports in order."""

    def __init__(self) -> None:
        self._entries: dict[_Key, LoggedFinding] = {}
        self._rates_tried = 0          # how many were tried when nothing answered
        self.last: BusReport | None = None

    def add_report(self, report: BusReport) -> None:
        """Remember what this report says."""
        now_s = max(0, report.stamp - report.started) / 1e9 if report.started else 0.0
        reported = {(finding.rule, finding.device): finding for finding in report.findings}
        self._entries = {key: one._replace(stands=False, read_s=None)
                         for key, one in self._entries.items()}
        if _SILENT in reported:
            if _SILENT not in self._entries:
                self._rates_tried = len(report.tried)
        elif report.is_answered and len(report.tried) > self._rates_tried:
            self._entries.pop(_SILENT, None)           # it searched, and has found them
        for key, finding in reported.items():
            before = self._entries.get(key)
            self._entries[key] = LoggedFinding(
                finding, before.first_s if before else now_s, now_s, True,
                max(0, finding.read_at - report.started) / 1e9 if finding.read_at else None)
        self.last = report

    def entries(self) -> list[LoggedFinding]:
        """Return the findings: the worst first, then those that still stand, causes first."""
        return sorted((one for one in self._entries.values() if not self._is_explained(one)),
                      key=lambda one: (-one.finding.level, not one.stands,
                                       RANKS[one.finding.rule]))

    def _is_explained(self, one: LoggedFinding) -> bool:
        """Tell whether another finding accounts for one that is over."""
        return not one.stands and any(accounts_for(cause.finding, one.finding)
                                      for cause in self._entries.values())


class BusSummary(NamedTuple):
    """One bus at the end of a run; name '' where there is only one."""

    name: str
    report: BusReport
    logged: tuple[LoggedFinding, ...]

    @classmethod
    def of(cls, name: str, report: BusReport, log: FindingLog, is_timed: bool) -> BusSummary:
        """Return what is reported of a bus; without times nothing that needs them."""
        return cls(name, report, tuple(one for one in log.entries()
                                       if is_timed or one.finding.rule not in NEEDS_TIMES))

    def who(self, number: int | None) -> str:
        """Return a device as a person knows it: '003 left_knee, MX-64'."""
        place = f'{self.name}/' if self.name else ''
        if number is None:
            return f'bus {self.name}' if self.name else 'the bus'
        device = next((one for one in self.report.devices if one.id == number), None)
        if device is None:
            return f'{place}{number:03}'
        model = '' if device.model_name == 'unknown' else f', {device.model_name}'
        return printable(f'{place}{device.name}{model}')
