# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""
Reports of a bus as diagnostic statuses: one per device, one for the bus.

Pure. The short form goes to /diagnostics, the long one, with the whole control table and the
error log, to dxl/diagnostics. Names and hardware IDs never change with what is learned, so that
every tool keeps one entry per device. Units stand in the key, bare numbers in the value.
"""
from __future__ import annotations

from collections import Counter
from collections.abc import Iterable
from itertools import groupby
import json
from typing import NamedTuple

from msg_defs import status_keys as keys
from msg_defs.diagnostics import BUS_HARDWARE_PREFIX
from msg_defs.diagnostics import hardware_id
from msg_defs.diagnostics import Level
from msg_defs.diagnostics import Metric
from msg_defs.diagnostics import number
from msg_defs.diagnostics import Pairs
from msg_defs.diagnostics import pairs
from msg_defs.diagnostics import PORT_CLOSED
from msg_defs.diagnostics import PORT_OPEN
from msg_defs.diagnostics import SEVERITY
from msg_defs.diagnostics import Status
from msg_defs.diagnostics import status_name
from msg_defs.diagnostics import worst
from servobus.bus.expected_devices import spans
from servobus.bus.report import BusReport
from servobus.bus.report import DeviceReport
from servobus.bus.report import Finding

SICK_MAX = 5                    # devices in the status of a bus


class PortState(NamedTuple):
    """What the node knows about the port of a bus."""

    port: str
    problem: str                # why it is not open; '' when it is
    values: tuple[tuple[str, str], ...]     # further facts: latency timer, overruns, gaps
    warning: str = ''           # what else somebody has to see to, e.g. a capture that stopped
    bus: str = ''               # name of the bus, also where it is the only one


def device_status(node: str, bus: str, device: DeviceReport, findings: tuple[Finding, ...],
                  with_table: bool, is_listening: bool = True, bus_name: str = '') -> Status:
    """
    Return the status of a device; `bus` is '' where there is only one, bus_name is not.

    While the port is closed (not is_listening) nothing is known of a device that answered
    before: its values are the last ones.
    """
    level, message = device.level, device.message
    if not is_listening and level is not Level.ERROR:
        level, message = Level.STALE, 'not listening: the port of its bus is closed'
    window = device.latency.window
    values = pairs({
        keys.MODEL: device.model_name,
        keys.FIRMWARE: 'unknown' if device.firmware is None else device.firmware,
        keys.STATE: device.state,
        **device.totals.published(),
        'Missed in a Row': device.missed_in_a_row,
        keys.LOSS: round(100 * device.window.loss, 2),
        keys.LATENCY_P50: window and window.p50,       # only where the chunks resolve it
        'Reply latency p95 (ms)': window and window.p95,
        'Reply latency resolved (%)': round(100 * device.latency.resolved, 1),
    })
    if not with_table:
        values += [(field.key, value.text) for field, value, _, _ in device.observed
                   if field.name in keys.TEMPERATURES + keys.VOLTAGES]
    values += _findings(one for one in findings if one.device == device.id)
    if with_table:
        values += _table(device)
    return Status(status_name(node, bus, device.name), level, message,
                  _hardware_id(node, bus_name or bus, device), values)


def bus_status(node: str, bus: str, report: BusReport, port: PortState,
               with_log: bool) -> Status:
    """Return the status of the bus itself; a port that is not open outdoes what was heard."""
    level, message = report.level, report.message
    if port.problem:
        level, message = Level.ERROR, port.problem
    if port.warning:
        both = (port.warning, message) if level is Level.OK else (message, port.warning)
        level, message = worst([level, Level.WARN]), '; '.join(filter(None, both))
    by_state = Counter(device.state for device in report.devices)
    values = pairs({
        keys.PORT: port.port,
        keys.STATE: PORT_CLOSED if port.problem else PORT_OPEN,
    })
    values += _findings(one for one in report.findings if one.device is None)
    values += [(keys.COVERS + one.rule, ', '.join(spans(one.covers, '{:03}')))
               for one in report.findings if one.device is None and one.covers]
    if not port.problem:
        values += _sick(report.devices)
    values += pairs({
        'Baud (bit/s)': report.baud or 'not known yet',
        'Protocol': report.protocol or 'not known yet',
        'Devices': len(report.devices),
        **{f'Devices {state}': count for state, count in sorted(by_state.items())},
        'Models': _models(report.devices) or None,
        **report.counters,
        **{f'{name} (1/s)': rate for name, rate in report.rates.items()},
    })
    values += port.values
    values += _doubts(report.doubts)
    if with_log:
        if report.started:             # how old the times of the errors are: they can be dated
            values.append((keys.RUNNING, number(round((report.stamp - report.started) / 1e9, 1))))
        values += _errors(report)
    return Status(status_name(node, f'bus {bus}'.strip()), level, message,
                  _hardware_id(node, _bus_name(bus, port)), values)


def statuses_of(node: str, bus: str, report: BusReport, port: PortState,
                whole: bool) -> list[Status]:
    """Return the status of a bus and those of its devices; whole: with tables and error log."""
    return [bus_status(node, bus, report, port, whole),
            *(device_status(node, bus, device, report.findings, whole, not port.problem,
                            _bus_name(bus, port)) for device in report.devices)]


def _bus_name(bus: str, port: PortState) -> str:
    return port.bus or bus or port.port


def _hardware_id(node: str, bus: str, device: DeviceReport | None = None) -> str:
    return hardware_id(node, f'{BUS_HARDWARE_PREFIX}{bus}', f'ID {device.id}' if device else '')


def _sick(devices: Iterable[DeviceReport]) -> Pairs:
    """Spell what is wrong with the worst devices: their own statuses are further down."""
    sick = sorted((one for one in devices if one.level is not Level.OK),
                  key=lambda one: -SEVERITY.index(one.level))
    return [(keys.DEVICE_PROBLEM + one.name, f'{one.level.name.lower()}: {one.message}')
            for one in sick[:SICK_MAX]]


def _models(devices: Iterable[DeviceReport]) -> str:
    """Spell who is on the bus: IDs, model and model number, '001-018 MX-106 (321), 019 ...'."""
    return ', '.join(f'{span} {model}' for model, alike in groupby(devices, key=_model)
                     for span in spans((one.id for one in alike), '{:03}'))


def _model(device: DeviceReport) -> str:
    if device.model_number is None or device.model_name.startswith('unknown'):
        return device.model_name
    return f'{device.model_name} ({device.model_number})'


def _findings(findings: Iterable[Finding]) -> Pairs:
    """Spell findings, and after each one how bad it is: a rule may be a warning or an error."""
    return [pair for finding in findings for pair in (
        (keys.FINDING + finding.rule, finding.message),
        (keys.SEVERITY + finding.rule, finding.level.name.lower()))]


def _doubts(doubts: Iterable[Finding]) -> Pairs:
    """Spell what the doctor cannot tell: one line for each rule, for the bus and its devices."""
    by_rule: dict[str, list[str]] = {}
    for doubt in doubts:
        who = '' if doubt.device is None else f'{doubt.device:03}: '
        by_rule.setdefault(doubt.rule, []).append(who + doubt.message)
    return [(keys.DOUBT + rule, reasons[0] + (
        f' (and {len(reasons) - 1} more)' if len(reasons) > 1 else ''))
        for rule, reasons in by_rule.items()]


def _table(device: DeviceReport) -> Pairs:
    """Spell every observed field, then when and how each was seen."""
    values = []
    seen = {}
    for field, value, age_s, source in device.observed:
        values.append((field.key, value.text))
        if field.in_words:
            values.append((keys.raw(field.name), number(value.raw)))
        seen[field.name] = [round(age_s, 3), source]
    return [*values, (keys.UNOBSERVED_FIELDS, str(device.unobserved)),
            (keys.OBSERVED, json.dumps(seen, separators=(',', ':')))]


def _errors(report: BusReport) -> Pairs:
    """Spell the last errors, the newest first, with their time since start."""
    return [(f'{keys.ERROR}{index:02}',
             f'{(error.stamp - report.started) / 1e9:.3f} s: {error.text}')
            for index, error in enumerate(reversed(report.errors))]


def timing_metrics(node: str, report: BusReport, port: PortState) -> list[Metric]:
    """Return those of a bus, and the reply latency of each device, as far as chunks resolve it."""
    bus = _bus_name(report.name, port)
    return [*(one._replace(bus_name=bus, hardware_id=_hardware_id(node, bus))
              for one in report.metrics),
            *(Metric('reply_latency', 'ms', device.latency.window, device.latency.total,
                     bus=report.name, device=device.name, bus_name=bus,
                     hardware_id=_hardware_id(node, bus, device),
                     notes=(('resolved (%)', number(round(100 * device.latency.resolved, 1))),))
              for device in report.devices)]
