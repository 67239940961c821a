# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""The question on which a program ended, and what of its questions nothing ever answered."""

from __future__ import annotations

from msg_defs.dxl_instruction import Instruction
from msg_defs.reports import Level
from servobus.bus import evidence as ev
from servobus.bus import report as words
from servobus.bus.report import DeviceReport
from servobus.bus.report import Incident
from servobus.bus.report import Wait
from servobus.bus.unread import HUNG_NS
from servobus.doctor.case import Case
from servobus.doctor.rule import Claim
from servobus.doctor.rule import Claims
from servobus.doctor.rule import Doubt

S = 1_000_000_000
MANY = 4                           # as `missed_limit`
FEW = 3                            # vain waits that show it


def ended_on(case: Case) -> Wait | None:
    """Return the vain wait on which a program ended with an error, None if that is unknown."""
    last = case.last_wait
    if not case.report.failed or last is None or last.is_spoilt or read_late(case):
        return None
    if case.report.failed == words.RAISED:
        return last
    answered = min((one.last_heard_s for one in case.report.devices
                    if one.last_heard_s is not None), default=0.0)
    is_ping = last.instruction == Instruction.PING
    silent = sum(one.last_heard_s is None for one in case.report.devices)
    if is_ping and silent > 1:
        return None                    # a search
    alike = [one.stamp for one in case.report.waits
             if (one.instruction == Instruction.PING) == is_ping]
    return None if len(alike) > 1 and alike[0] < case.now - answered * S else last


def read_late(case: Case) -> Incident[ev.Lateness] | None:
    """Return the late answer that a program got for its last question, on which it ended."""
    last = case.last_wait
    asked = [one.stamp - 1000 * one.detail.us for one in case.incidents(ev.LEFT_OPEN)] \
        if last is None else [last.stamp - 1000 * last.us]
    return next((one for one in case.incidents(ev.LATE) if case.report.failed
                 and asked and one.stamp > asked[-1]), None)


def left_open(case: Case) -> Claims:
    """Look at what a program waited for when it was heard last."""
    hung = [(one.device, one.detail.us / 1e6) for one in case.incidents(ev.HUNG)]
    last = case.last_wait
    if last is not None and not last.is_spoilt and last.instruction != Instruction.PING \
            and case.report.is_over and case.now - last.stamp > HUNG_NS:
        hung.append((last.device, (case.now - last.stamp) / S))
    for number, seconds in hung:
        yield Claim('did not answer the last question, and the program asked nothing more for '
                    f'{seconds:.0f} s: check its power and cable, and let the program read '
                    'with a time-out', device=number)
    for one in case.incidents(ev.LEFT_OPEN):
        yield Doubt(f'the program ended {one.detail.us / 1000:.0f} ms after it asked: '
                    'whether this answers is unknown', device=one.device)


def is_used(device: DeviceReport) -> bool:
    """Tell whether a program asked a device for more than Pings."""
    totals = device.totals
    return bool(totals.reads or totals.writes or totals.data_missed or device.acks_missing)


def unacknowledged(case: Case) -> Claims:
    """Look for devices that were only written to, and never heard."""
    if not case.report.is_answered and any(one.acks_missing for one in case.report.devices) \
            and case.report.is_over and not case.report.failed and len(case.report.waits) < FEW:
        yield Doubt('writes are sent, and not one byte comes back: no power, another baud '
                    'rate, or Status Return Level below 2; let your program read once')
    for device in case.report.devices if any(one.acks for one in case.report.devices) else ():
        if device.last_heard_s is None and device.acks_missing \
                and not (device.id in case.gone and device.totals.data_missed) \
                and not device.window.spoilt and not device.moved_to:
            says = (f'never heard, and did not acknowledge {device.acks_missing} writes, as '
                    'others do: check its power, cable and ID, or its Status Return Level if it '
                    'answers a Ping')
            failed, is_over = case.report.failed, case.report.is_over
            yield Claim(says, level=None if failed else Level.WARN, device=device.id) \
                if failed or (is_over and device.acks_missing > MANY) \
                else Doubt(says, device.id)
