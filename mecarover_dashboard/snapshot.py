# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""
What mecarover_status --json prints: all bridges and buses, for programs.

Pure. Names are those of dxl_doctor --json, else of the page's rows; None is unknown.
"""
from __future__ import annotations

from collections.abc import Iterable
from typing import Any

from mecarover_dashboard import rows
from mecarover_dashboard.robot_parts import device_name
from mecarover_dashboard.robot_parts import level_of
from mecarover_dashboard.robot_parts import place_of
from mecarover_dashboard.robot_parts import RobotPart
from mecarover_dashboard.state import RowReport
from mecarover_dashboard.state import State
from mecarover_dashboard.status_lines import exit_code
from msg_defs import status_keys as keys

Data = dict[str, Any]


def snapshot(state: State, now_s: float, unix_s: float) -> Data:
    """Return what is known, the worst bus first, ready for json.dumps."""
    state.expire(now_s)
    parts = state.parts()
    return {'time': round(unix_s, 3), 'exit': exit_code(state),
            'bridges': [_bridge(state, part) for part in parts if part.bus is None],
            'buses': [_bus(state, part) for part in parts if part.bus is not None]}


def _bridge(state: State, part: RobotPart) -> Data:
    return _head(part) | {one.row['part']: _figures(one.row['values'])
                          for one in _reports(state, 'bridge', part)}


def _bus(state: State, part: RobotPart) -> Data:
    own, devices = (_reports(state, section, part) for section in ('buses', 'devices'))
    return {'name': part.bus} | _head(part) | {
        'values': _figures(pair for one in own for pair in one.row['values']),
        'devices': [_device(state, one) for one in sorted(devices, key=lambda one: one.row['id'])],
        'findings': [
            {'rule': rule, 'level': severity.upper(), 'device': one.row.get('id'), 'message': text}
            for one in (*own, *devices) for rule, text, severity in one.row['findings']]}


def _head(part: RobotPart) -> Data:
    return {'robot': part.robot, 'node': part.node, 'level': part.level.name,
            'message': part.text, 'live': part.is_known}


def _reports(state: State, section: str, part: RobotPart) -> list[RowReport]:
    return [one for one in state.reports(section) if place_of(one.row) == part.place]


def _device(state: State, report: RowReport) -> Data:
    row, values = report.row, report.values
    return {
        'id': row['id'], 'name': device_name(row), 'model': row['model'],
        'firmware': _number(row['firmware']), 'state': row['state'],
        'level': level_of(row).name, 'message': row['message'], 'live': row['live'],
        'answers': _number(state.fact(report.row_name, keys.ANSWERS)),
        'missed': _number(state.fact(report.row_name, keys.MISSED_ANSWERS)),
        **{one.name: _number(row[one.name]) for one in keys.FIGURES},
        **{name: _number(getattr(values, name))
           for name in ('position', 'temperature', 'voltage', 'load')},
        'unit': values.unit}


def _number(text: str) -> float | None:
    found = rows.finite(text)
    return int(found) if found is not None and found.is_integer() else found


def _figures(pairs: Iterable[tuple[str, str]]) -> Data:
    found = ((key, text, _number(text)) for key, text in pairs)
    return {key: text if number is None else number for key, text, number in found}
