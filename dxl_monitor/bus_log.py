# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""
The lines of a node's log about the devices of a bus: lost and back, too hot, hardware error.

One line for all devices to which the same happens within a moment, the state of the bus first. A
loose contact must not fill a log: so many lines at once, then one in LINE_AGAIN_NS.
"""
from __future__ import annotations

from collections.abc import Callable
from collections.abc import Iterator
from typing import NamedTuple

from msg_defs.diagnostics import Level
from msg_defs.nanoseconds import NS_PER_S
from servobus.bus.report import BusReport
from servobus.bus.report import CONNECTED
from servobus.bus.report import DeviceReport
from servobus.bus.report import DISCONNECTED
from servobus.doctor import first_ids

TOGETHER_NS = NS_PER_S         # without another device: all have come to which it happens
WAIT_NS = 5 * NS_PER_S         # at most, for more devices
LINES_AT_ONCE = 4
LINE_AGAIN_NS = 10 * NS_PER_S
_RECENT_S = 10.0               # an older value says nothing of now


class _LogKind(NamedTuple):
    """What may happen to a device; between its beginning and its end it is not known."""

    begin: str
    end: str
    rule: str                  # the finding that it is; '': a state of the device
    is_over: Callable[[DeviceReport], bool]


def _is_cool(device: DeviceReport) -> bool:
    """Tell whether its temperature, which is not too high, was read lately."""
    return any(one.field.name == 'Present Temperature' and one.source == 'r'
               and one.age_s < _RECENT_S for one in device.observed)


def _is_well(device: DeviceReport) -> bool:
    """Tell whether it answers, without an alert."""
    return device.state == CONNECTED and not device.alert and (
        device.last_heard_s is not None and device.last_heard_s < _RECENT_S)


_KINDS = (
    _LogKind('lost', 'back', '', lambda device: device.state == CONNECTED),
    _LogKind('too hot', 'not too hot any more', 'too_hot', _is_cool),
    _LogKind('hardware error', 'no hardware error any more', 'hardware_error', _is_well))


class BusLog:
    """Makes the lines of one bus, from its reports."""

    def __init__(self, bus: str) -> None:
        self._bus = f'bus {bus}'.strip()
        self._kinds = [_Changes(kind) for kind in _KINDS]

    def lines(self, report: BusReport) -> Iterator[str]:
        """Yield what a person should read now; for reports of an open port."""
        whole = [one.message for one in report.findings
                 if one.device is None and one.level > Level.OK]
        connected = sum(one.state == CONNECTED for one in report.devices)
        for kind in self._kinds:
            if words := kind.words(report):
                yield '; '.join([f'{self._bus}: {connected} of {len(report.devices)} devices '
                                 'connected', *whole[:1], words])


class _Changes:
    """Which devices were logged to be in some trouble, and since when others are or they not."""

    def __init__(self, kind: _LogKind) -> None:
        self._kind = kind
        self._logged: set[int] = set()
        self._new: set[int] = set()        # begun or over, and not logged
        self._first = self._last = 0       # since when there is something new, and the newest
        self._lines = float(LINES_AT_ONCE)  # that may be written now; parts of one come back
        self._now = 0

    def words(self, report: BusReport) -> str:
        """Return what is new, if it is time to say it, else ''."""
        now = report.stamp
        self._lines = min(LINES_AT_ONCE, self._lines + (now - self._now) / LINE_AGAIN_NS)
        self._now = now
        here = self._in_trouble(report)
        devices = {one.id: one for one in report.devices}
        self._logged &= set(devices)       # the statistics were reset: all begins again
        before, self._new = self._new, {one for one in self._logged ^ set(here)
                                        if one in here or self._kind.is_over(devices[one])}
        if not self._new:
            return ''
        if not before:
            self._first = now
        if self._new != before:
            self._last = now
        if (now - self._last < TOGETHER_NS and now - self._first < WAIT_NS) or self._lines < 1:
            return ''
        begun, over = self._new - self._logged, self._new & self._logged
        self._lines -= 1
        self._logged ^= self._new
        self._new = set()
        return '; '.join(
            f'{words}: {_names([devices[one] for one in sorted(some)], here)}'
            for words, some in ((self._kind.begin, begun), (self._kind.end, over)) if some)

    def _in_trouble(self, report: BusReport) -> dict[int, str]:
        """Return what is the matter, by device."""
        if self._kind.rule:
            return {one.device: one.message for one in report.findings
                    if one.rule == self._kind.rule and one.device is not None}
        # Others are only searched for by a scan.
        return {one.id: one.message for one in report.devices if one.state == DISCONNECTED
                and (one.expected or one.totals.reads or one.totals.writes)}


def _names(devices: list[DeviceReport], why: dict[int, str]) -> str:
    """Spell devices; of one alone with its joint, and what is the matter."""
    if len(devices) > 1:
        return first_ids(one.id for one in devices)
    [one] = devices
    return f'{one.name} ({why[one.id]})' if one.id in why else one.name
