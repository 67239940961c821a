# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""
The state of a device and of a bus: a word, a level, a few words to act on.

From the last 10 s, never from counts since start: a fault that is over is over. What the rules
find comes on top (Doctor.examine).
"""

from __future__ import annotations

from collections.abc import Sequence

from msg_defs.diagnostics import Level
from msg_defs.diagnostics import number
from msg_defs.running_statistics import WINDOW_S
from servobus.bus import report as words
from servobus.bus.decoder import Settings
from servobus.bus.report import BusReport
from servobus.bus.report import DeviceReport
from servobus.doctor.case import Names
from servobus.doctor.facts import is_rate_search
from servobus.doctor.rules.devices import latched_error
from servobus.doctor.rules.noise import first_words
from servobus.doctor.rules.noise import NO_PACKETS

_DAMAGED_WARN_PER_S = 1.0
_LOST = (words.DISCONNECTED, words.EXPECTED)
SEARCH_PINGS_MAX = 2                      # an ID that is only searched for gets so many
_NAMED_MAX = 5                     # lost devices in the message of a bus
# What a list of devices says of some states.
LISTED_AS = {words.CONNECTED: 'answers', words.EXPECTED: 'expected, never heard',
             words.ASKED: 'asked, never heard', words.SILENT: 'not asked at present',
             words.DISCONNECTED: 'no valid answer', words.WAITING: 'asked, not served'}


def judge_states(report: BusReport, settings: Settings, names: Names) -> BusReport:
    """Return a report with the state, level and message of each device and of the bus."""
    if is_rate_search(report):      # a search: most answers are missed
        settings = settings._replace(warn_loss=100.0)
    devices = tuple(_device(one, settings) for one in report.devices)
    level, message = _bus(report, devices, names)
    return report._replace(devices=devices, level=level, message=message)


def _device(device: DeviceReport, settings: Settings) -> DeviceReport:
    totals = device.totals
    is_wanted = device.missed_in_a_row > SEARCH_PINGS_MAX and (totals.reads or totals.writes)
    if device.moved_to and (is_wanted or not device.moved_to.startswith(words.NEW_ID)):
        found = words.MOVED, Level.WARN, f'set to {device.moved_to} by a write'
    elif device.missed_in_a_row > settings.missed_limit:
        found = (words.DISCONNECTED, Level.ERROR,
                 f'disconnected: {device.missed_in_a_row} answers missed')
    elif device.last_heard_s is None:
        found = _never_heard(device)
    elif device.quiet_s > settings.silent_after:
        found = words.SILENT, Level.STALE, f'silent: not asked for {device.quiet_s:.0f} s'
    elif device.waiting_behind is not None:
        found = (words.WAITING, Level.WARN,
                 f'asked but not served: {device.waiting_behind:03} before it does not answer')
    else:
        found = words.CONNECTED, *_degraded(device, settings)
    state, level, message = found
    return device._replace(state=state, level=level, message=message)


def _never_heard(device: DeviceReport) -> tuple[str, Level, str]:
    if device.expected:
        return words.EXPECTED, Level.ERROR, 'expected, but never heard'
    totals = device.totals
    if totals.not_served or device.missed_in_a_row > (0 if totals.reads or totals.writes
                                                      else SEARCH_PINGS_MAX):
        return words.ASKED, Level.WARN, 'asked, but never heard'
    return words.ASKED, Level.STALE, 'addressed, but never asked and never heard'


def _degraded(device: DeviceReport, settings: Settings) -> tuple[Level, str]:
    fault = latched_error(device)
    window = device.window
    if fault is not None:
        return fault.level or Level.ERROR, fault.message
    if window.loss * 100 > settings.warn_loss:
        return Level.WARN, f'{window.missed} of {window.asked} answers missed'
    if window.damaged > _DAMAGED_WARN_PER_S * WINDOW_S:
        return Level.WARN, f'{number(window.damaged / WINDOW_S)} damaged answers per second'
    return Level.OK, 'connected'


def _bus(bus: BusReport, devices: Sequence[DeviceReport], names: Names) -> tuple[Level, str]:
    if not bus.counters['Bytes'] and bus.last_byte_s is None:
        return Level.STALE, 'nothing heard yet'
    if not bus.counters['Packets'] and bus.is_answered:
        text = first_words(bus.noise)
        return Level.WARN, f'text, but no packet: `{text}`' if text \
            else NO_PACKETS.format(bauds=names.bauds)
    connected = sum(device.state == words.CONNECTED for device in devices)
    lost = [device.name for device in devices if device.state in _LOST]
    message = (f'none of {len(devices)} devices answers' if lost and not connected
               else f'{connected} of {len(devices)} devices connected') + _lost_words(lost)
    if bus.rates['errors'] > 1:
        return Level.WARN, f'{bus.rates["errors"]:.1f} damaged packets per second; {message}'
    if devices and not connected:
        is_asked = any(device.level is not Level.STALE for device in devices)
        return Level.WARN if is_asked else Level.STALE, message
    return Level.WARN if lost else Level.OK, message


def _lost_words(names: Sequence[str]) -> str:
    """Return '; lost: 007 left_knee, 008' for the message of a bus, '' when nothing is lost."""
    more = f' and {len(names) - _NAMED_MAX} more' if len(names) > _NAMED_MAX else ''
    return f'; lost: {", ".join(names[:_NAMED_MAX])}{more}' if names else ''
