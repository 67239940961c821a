# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""
What to say of a device, and of a bus: the state, a level, a few words to act on.

Levels come from the last 10 s, never from counts since start: a fault that is over is over.
"""

from collections.abc import Sequence
from typing import NamedTuple

from dxl_monitor.bus import report as words
from dxl_monitor.bus.device import Device
from dxl_monitor.bus.device import WINDOW_S
from dxl_monitor.bus.report import BusReport
from dxl_monitor.bus.report import Counts
from dxl_monitor.bus.report import DeviceReport
from dxl_monitor.bus.table import Observed
from dxl_monitor.bus.table import Table
from dxl_monitor.model.control_table import UNKNOWN
from msg_defs.dxl_instruction import error_text
from msg_defs.reports import Level
from msg_defs.reports import number
from msg_defs.reports import worst

_CRC_ERRORS_PER_S = 1.0
_LOST = (words.DISCONNECTED, words.EXPECTED)
_NAMED = 5                     # lost devices in the message of a bus
HARDWARE_ERROR = 'Hardware Error Status'


class Thresholds(NamedTuple):
    """The parameters that a judgement depends on; warn_loss in %, times in s."""

    missed_limit: int
    warn_loss: float
    silent_after: float


class Assessment(NamedTuple):
    state: str
    level: Level
    message: str


class Snapshot(NamedTuple):
    """A device as it was at one moment under the lock; the rest can be worked out without."""

    report: DeviceReport           # without what is decoded from the table
    table: Table


def judge(device: Device, window: Counts, quiet_s: float, limits: Thresholds) -> Assessment:
    """Return the state of a device from what happened on the wire alone."""
    if device.moved_to:
        return Assessment(words.MOVED, Level.WARN, f'moved to {device.moved_to} by a write')
    if device.missed_in_a_row > limits.missed_limit:
        return Assessment(words.DISCONNECTED, Level.ERROR,
                          f'disconnected: {device.missed_in_a_row} answers missed')
    if not device.heard:
        return _never_heard(device)
    if quiet_s > limits.silent_after:
        return Assessment(words.SILENT, Level.STALE, f'silent: not asked for {quiet_s:.0f} s')
    if device.waiting_behind is not None:
        return Assessment(words.WAITING, Level.WARN,
                          f'asked but not served: waiting behind {device.waiting_behind:03}')
    return Assessment(words.CONNECTED, *_degraded(device, window, limits))


def _never_heard(device: Device) -> Assessment:
    if device.expected:
        return Assessment(words.EXPECTED, Level.ERROR, 'expected, but never heard')
    if device.missed_in_a_row or device.counts.not_served:
        return Assessment(words.ASKED, Level.WARN, 'asked, but never heard')
    return Assessment(words.ASKED, Level.STALE, 'addressed, but never asked and never heard')


def _degraded(device: Device, window: Counts, limits: Thresholds) -> tuple[Level, str]:
    if device.alert:
        return Level.WARN, 'alert: read Hardware Error Status'
    if window.loss * 100 > limits.warn_loss:
        return Level.WARN, f'{window.missed} of {window.asked} answers missed'
    if window.damaged > _CRC_ERRORS_PER_S * WINDOW_S:
        return Level.WARN, f'{number(window.damaged / WINDOW_S)} damaged answers per second'
    return Level.OK, 'connected'


def snapshot(device: Device, now: int, quiet_s: float, limits: Thresholds) -> Snapshot:
    """
    Return all of a device that the table has no part in, and a copy of the table.

    quiet_s: for how long the port was open and the device was neither heard nor asked.
    """
    window = device.window()
    verdict = judge(device, window, quiet_s, limits)
    report = DeviceReport(
        id=device.number, name=_name(device), joint=device.joint,
        protocol=device.dialect.name if device.dialect is not None else words.PROTOCOL_2,
        model=device.model, model_number=device.model_number, model_name=_model_name(device),
        firmware=device.firmware, state=verdict.state, level=verdict.level,
        message=verdict.message, totals=device.counts.copy(),
        window=window, missed_in_a_row=device.missed_in_a_row,
        waiting_behind=device.waiting_behind,
        last_heard_s=(now - device.heard) / 1e9 if device.heard else None, alert=device.alert,
        last_error=error_text(device.last_error), status_return_level=device.return_level,
        acks=device.acks, acks_missing=device.acks_missing, observed=(),
        unobserved=len(device.model.fields),
        latency=device.latency_report(now), errors=dict(device.errors))
    return Snapshot(report, device.table.copy())


def complete(shot: Snapshot, now: int) -> DeviceReport:
    """Return the report with the decoded table, and with what that says about the device."""
    report, table = shot
    observed = table.observed(report.model, now)
    level, message = report.level, report.message
    fault = _hardware_error(observed)
    if fault and report.state not in (words.DISCONNECTED, words.SILENT):
        message = f'hardware error: {fault}' + (f'; {message}' if level is Level.ERROR else '')
        level = worst((level, Level.ERROR))
    return report._replace(level=level, message=message, observed=tuple(observed),
                           unobserved=len(report.model.fields) - len(observed))


def judge_bus(bus: BusReport, devices: Sequence[DeviceReport]) -> tuple[Level, str]:
    """Return the level of the bus itself, and the state of its devices in a few words."""
    if not bus.counters['Bytes'] and bus.last_byte_s is None:
        return Level.STALE, 'nothing heard yet'
    connected = sum(device.state == words.CONNECTED for device in devices)
    lost = [device.name for device in devices if device.state in _LOST]
    message = f'{connected} of {len(devices)} devices connected' + _lost_words(lost)
    if not bus.counters['Packets']:
        return Level.WARN, 'bytes, but no packets: wrong baud rate?'
    if bus.rates['errors'] > 1:
        return Level.WARN, f'{bus.rates["errors"]:.1f} damaged packets per second; {message}'
    if devices and not connected:
        asked = any(device.state != words.SILENT for device in devices)
        return Level.WARN if asked else Level.STALE, message
    return Level.WARN if lost else Level.OK, message


def _lost_words(names: Sequence[str]) -> str:
    """Return '; lost: 007 left_knee, 008' for the message of a bus, '' when nothing is lost."""
    more = f' and {len(names) - _NAMED} more' if len(names) > _NAMED else ''
    return f'; lost: {", ".join(names[:_NAMED])}{more}' if names else ''


def _hardware_error(observed: Sequence[Observed]) -> str:
    """Return the bits of Hardware Error Status in words, '' if none is set or it was not read."""
    for seen in observed:
        if seen.field.name == HARDWARE_ERROR:
            return seen.value.text if seen.value.raw else ''
    return ''


def _name(device: Device) -> str:
    return f'{device.number:03} {device.joint}' if device.joint else f'{device.number:03}'


def _model_name(device: Device) -> str:
    if device.model is not UNKNOWN or device.model_number is None:
        return device.model.name
    return f'unknown ({device.model_number})'
