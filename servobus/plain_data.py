# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""A report as plain data: dicts, lists, numbers and strings, ready for json.dumps."""
from __future__ import annotations

from typing import Any

from servobus.bus.report import BusReport
from servobus.bus.report import DeviceReport
from servobus.bus.report import Finding


def report_data(report: BusReport) -> dict[str, Any]:
    """
    Return a report as plain data.

    Levels are words (OK, WARN, ERROR, STALE), baud is in bit/s, times are in the unit that their
    key names.
    """
    return bus_data(report) | {
        'devices': [device_data(device) | {'registers': registers_of(device)}
                    for device in report.devices],
        'findings': [finding_data(finding) for finding in report.findings]}


def bus_data(report: BusReport) -> dict[str, Any]:
    """Return what is known of a bus, without its devices and findings."""
    return {'name': report.name, 'baud': report.baud, 'protocol': report.protocol,
            'level': report.level.name, 'message': report.message,
            'counters': dict(report.counters),
            'cycle': report.cycle and report.cycle._asdict()}


def device_data(device: DeviceReport) -> dict[str, Any]:
    """Return what is known of a device, without its registers."""
    return {'id': device.id, 'name': device.name, 'model': device.model_name,
            'firmware': device.firmware, 'state': device.state, 'level': device.level.name,
            'message': device.message, 'answers': device.totals.answers,
            'missed': device.totals.missed, 'damaged': device.totals.damaged}


def registers_of(device: DeviceReport) -> dict[str, dict[str, Any]]:
    """Return each register that was seen: value in `unit`, how old it is, who said it."""
    return {one.field.name: {'value': one.value, 'unit': one.field.unit,
                             'age_s': round(one.age_s, 3),
                             'from': 'device' if one.source == 'r' else 'master'}
            for one in device.observed}


def finding_data(finding: Finding) -> dict[str, Any]:
    """Return a finding; device None: the bus."""
    return {'rule': finding.rule, 'level': finding.level.name, 'device': finding.device,
            'message': finding.message, 'evidence': dict(finding.evidence)}
