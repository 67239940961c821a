# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""
Reports of a bus as diagnostic statuses: one per device, one for the bus.

Pure. The short form goes to /diagnostics, the long one, with the whole control table and the
error log, to dxl/diagnostics. Names and hardware IDs never change with what is learned, so that
every tool keeps one entry per device. Units stand in the key, bare numbers in the value.
"""
from __future__ import annotations

from collections.abc import Iterable
import json
from typing import NamedTuple

from dxl_monitor.report import BusReport
from dxl_monitor.report import DeviceReport
from dxl_monitor.report import Finding
from msg_defs.reports import Level
from msg_defs.reports import Metric
from msg_defs.reports import number
from msg_defs.reports import numbers
from msg_defs.reports import Status
from msg_defs.reports import status_name
from msg_defs.reports import worst


class PortState(NamedTuple):
    """What the node knows about the port of a bus."""

    port: str
    problem: str                # why it is not open; '' when it is
    values: tuple[tuple[str, str], ...]     # further facts: latency timer, overruns, gaps
    warning: str = ''           # what else somebody has to see to, e.g. a capture that stopped


def device_status(node: str, bus: str, device: DeviceReport, findings: tuple[Finding, ...],
                  with_table: bool) -> Status:
    """Return the status of a device; `bus` is '' where there is only one."""
    prefix = f'{bus}/' if bus else ''
    values = [
        ('Model', device.model_name),
        ('Firmware Version', 'unknown' if device.firmware is None else str(device.firmware)),
        ('State', device.state),
        *((name, number(value)) for name, value in device.counters),
        *_latency(device),
        *_findings(one for one in findings if one.device == device.id),
    ]
    if with_table:
        values += _table(device)
    return Status(status_name(node, bus, device.name), device.level, device.message,
                  f'{prefix}{device.id}', values)


def bus_status(node: str, bus: str, report: BusReport, port: PortState,
               with_log: bool) -> Status:
    """Return the status of the bus itself; a port that is not open outdoes what was heard."""
    level, message = report.level, report.message
    if port.problem:
        level, message = Level.ERROR, port.problem
    if port.warning:
        told = (port.warning, message) if level is Level.OK else (message, port.warning)
        level, message = worst([level, Level.WARN]), '; '.join(filter(None, told))
    by_state: dict[str, int] = {}
    for device in report.devices:
        by_state[device.state] = by_state.get(device.state, 0) + 1
    values = [
        ('Port', port.port),
        ('Baud (bit/s)', str(report.baud)),
        ('Devices', str(len(report.devices))),
        *((f'Devices {state}', str(count)) for state, count in sorted(by_state.items())),
        *((name, str(count)) for name, count in report.counters.items()),
        *numbers((f'{name} (1/s)', rate) for name, rate in report.rates.items()),
        *port.values,
        *_findings(one for one in report.findings if one.device is None),
        *_doubts(report.doubts),
    ]
    if with_log:
        values += _errors(report)
    return Status(status_name(node, f'bus {bus}'.strip()), level, message,
                  bus or port.port, values)


def bus_level(report: BusReport) -> Level:
    """Return the worst level of a bus and its devices."""
    return worst([report.level, *(device.level for device in report.devices)])


def _latency(device: DeviceReport) -> list[tuple[str, str]]:
    """Spell the reply latency; a figure only where the chunks resolve it."""
    window = device.latency.window
    return numbers([
        ('Reply latency p50 (ms)', window and window.p50),
        ('Reply latency p95 (ms)', window and window.p95),
        ('Reply latency resolved (%)', round(100 * device.latency.resolved, 1)),
    ])


def _findings(findings: Iterable[Finding]) -> list[tuple[str, str]]:
    return [(f'finding.{finding.rule}', finding.message) for finding in findings]


def _doubts(doubts: Iterable[Finding]) -> list[tuple[str, str]]:
    """Spell what the doctor cannot tell: one line for each rule, whoever it is about."""
    by_rule: dict[str, list[str]] = {}
    for doubt in doubts:
        who = '' if doubt.device is None else f'{doubt.device:03}: '
        by_rule.setdefault(doubt.rule, []).append(who + doubt.message)
    return [(f'cannot tell.{rule}', reasons[0] + (
        f' (and {len(reasons) - 1} more)' if len(reasons) > 1 else ''))
        for rule, reasons in by_rule.items()]


def _table(device: DeviceReport) -> list[tuple[str, str]]:
    """Spell every observed field, then when and how each was seen."""
    values = []
    seen = {}
    for field, value, age_s, source in device.observed:
        values.append((field.key, value.text))
        if field.in_words:
            values.append((f'{field.name} (raw)', number(value.raw)))
        seen[field.name] = [round(age_s, 3), source]
    return [*values, ('Fields not observed', str(device.unobserved)),
            ('observed', json.dumps(seen, separators=(',', ':')))]


def _errors(report: BusReport) -> list[tuple[str, str]]:
    """Spell the last errors, the newest first, with their time since start."""
    return [(f'error {index:02}', f'{(error.stamp - report.started) / 1e9:.3f} s: {error.text}')
            for index, error in enumerate(reversed(report.errors))]


def device_metrics(report: BusReport) -> list[Metric]:
    """Return the reply latency of every device, with how much of it the chunks resolve."""
    return [Metric('reply_latency', 'ms', device.latency.window, device.latency.total,
                   bus=report.name, device=device.name,
                   notes=(('resolved (%)', number(round(100 * device.latency.resolved, 1))),))
            for device in report.devices]
