# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""
Symptoms that no rule accounts for at the end of a run: the causes left, and what decides.

A user would call such a bus broken, so it is not a sound one; and no cause is proven, so it is not
an accusation either. Pure.
"""

from __future__ import annotations

from collections.abc import Iterator
from collections.abc import Sequence
from collections.abc import Set
from typing import NamedTuple

from msg_defs.diagnostics import Level
from servobus.bus import evidence as ev
from servobus.bus import report as words
from servobus.bus.report import BusReport
from servobus.bus.report import DeviceReport
from servobus.bus.report import Finding
from servobus.doctor.case import DAMAGE_KINDS
from servobus.doctor.facts import is_rate_search
from servobus.doctor.rule import PORT
from servobus.doctor.rule import STOP_OTHERS
from servobus.doctor.rules import BY_NAME
from servobus.doctor.rules.missing import MISSED_MIN_SHARE
from servobus.doctor.rules.noise import NOISE_MIN_PACKETS
from servobus.doctor.rules.noise import NOISE_MIN_SHARE
from servobus.doctor.symptom import Symptom
from servobus.doctor.thresholds import ADAPTER_HOLD_US
from servobus.doctor.thresholds import INCIDENTS_MIN

# Share of all bytes that are no packet: as many are not what damage of a few packets leaves.
NOISE_BYTES_MIN_SHARE = 0.05
NOISE_MIN_BYTES = 30               # three packets
_LOST = (words.DISCONNECTED, words.EXPECTED, words.ASKED)    # one that waits is not the cause


class _Symptom(NamedTuple):
    """What is seen of a bus, or of a device; names: what a rule calls that."""

    names: Set[Symptom]
    seen: str
    causes: str                    # that are left, the likeliest first
    step: str                      # the cheapest that separates them
    device: int | None = None


def open_symptoms(report: BusReport, found: Sequence[Finding]) -> list[Finding]:
    """
    Return what nothing that was found accounts for, each with the step that decides.

    found: the findings of the whole run, and the doubts that have a step. Where one is an error,
    the rest follows from it, as a rule.
    """
    if any(one.level is Level.ERROR for one in found):
        return []
    left = [Finding('', Level.WARN, one.device, f'{one.seen}: {one.causes}', step=one.step)
            for one in _symptoms(report) if not any(_accounts_for(cause, one) for cause in found)]
    if not (left or found) and report.level is Level.WARN:
        damaged = sum(report.kinds.get(kind, 0) for kind in DAMAGE_KINDS)
        seen = f'{damaged} packets damaged' if damaged else report.message
        return [Finding('', Level.WARN, None, seen, step='listen for longer: what comes again '
                        'has a cause that shows')]
    return [one for one in left if one.device is not None] or left


def _accounts_for(cause: Finding, one: _Symptom) -> bool:
    rule = BY_NAME[cause.rule]
    if one.device in (cause.device, *cause.covers):
        return one.device is not None or cause.level is not Level.OK or bool(cause.step)
    return bool(one.names & (rule.symptoms | rule.accounts_for)) \
        and None in (cause.device, one.device)


def _symptoms(report: BusReport) -> Iterator[_Symptom]:
    lost = [one for one in report.devices
            if one.state in _LOST and one.level in (Level.WARN, Level.ERROR)]
    yield from map(_silent, lost) if _was_heard(report) or len(lost) < 2 else [
        _silent_bus(report, lost)]
    if not is_rate_search(report):
        yield from (_missed(report, one) for one in report.devices if _misses_answers(report, one))
    counters = report.counters
    noise = counters.get('Noise Bytes', 0)
    damaged = sum(report.kinds.get(kind, 0) for kind in DAMAGE_KINDS)
    unknown = report.kinds.get(ev.UNKNOWN_INSTRUCTION, 0)
    if 0 < counters['Bytes'] < words.PROTOCOL_SHOWN_BYTES and not counters['Packets']:
        yield _Symptom({'no packets'}, f'{counters["Bytes"]} bytes, but no packet',
                       'too few to know Protocol 1.0 or Feetech by, or no servo bus',
                       'add --protocol 1 or --protocol feetech: if that shows packets, it is that')
    elif counters['Bytes'] and not counters['Packets'] and report.is_answered:
        yield _Symptom({'no packets'}, f'{counters["Bytes"]} bytes, but no packet',
                       'another baud rate, D+ and D- swapped, or no servo bus',
                       'listen with `dxl_doctor run -- COMMAND`, which knows the rate of the '
                       'program: if that shows packets, the rate was wrong')
    elif unknown >= INCIDENTS_MIN and not _was_heard(report):
        yield _Symptom({'silent bus'}, f'{unknown} instructions of an unknown kind, no answer',
                       'an instruction that these servos do not have, or no power',
                       'ping one servo: if it answers, read it with plain Reads')
    elif damaged >= max(NOISE_MIN_PACKETS, NOISE_MIN_SHARE * counters['Packets']):
        yield _damaged(report, damaged)
    elif noise >= max(NOISE_MIN_BYTES, NOISE_BYTES_MIN_SHARE * counters['Bytes']):
        yield _Symptom({'stray bytes', 'damaged packets', 'damaged answers', 'echo'},
                       f'{noise} of {counters["Bytes"]} bytes are no packet',
                       'packets that are wrong, text, or another baud rate now and then',
                       f'look at them: `dxl_dump {PORT}` prints bytes that are no packet')


def _was_heard(report: BusReport) -> bool:
    return any(one.last_heard_s is not None for one in report.devices)


def _silent_bus(report: BusReport, lost: Sequence[DeviceReport]) -> _Symptom:
    causes, step = (
        'no power, or another baud rate, protocol or IDs',
        'measure the supply at the plug of the first servo: if it is right, ping at other rates'
        ) if report.has_sides else (
        'no power, another baud rate, or only the master is heard here',
        'listen with `dxl_doctor run -- COMMAND`: if that hears answers, this adapter does not')
    return _Symptom({'silent bus'}, f'none of {len(lost)} devices answers', causes, step)


def _silent(device: DeviceReport) -> _Symptom:
    totals = device.totals
    if 2 * totals.spoilt > totals.missed:
        return _Symptom(
            {'silent device', 'damaged answers'},
            f'{totals.spoilt} of {totals.asked} answers came damaged',
            'a bad cable, another baud rate, or a second device with its ID',
            f'unplug {device.id:03} and ping it: what answers then is a second device; if '
            'nothing does, try another cable, then other baud rates', device.id)
    step = f'unplug all but {device.id:03} and ping it: if it answers, its cable is bad or ' \
        'another device disturbs it; if not, it has no power, or another ID or baud rate'
    causes = 'no power, or a bad cable' if device.last_heard_s is not None else \
        'no power, a bad cable, or another ID or baud rate'
    return _Symptom({'silent device'}, device.message, causes, step, device.id)


def _misses_answers(report: BusReport, device: DeviceReport) -> bool:
    """Tell whether a device in use missed more in the run than a sound bus loses."""
    totals = device.totals
    kinds = [one.kind for one in report.incidents if one.device == device.id]
    late = kinds.count(ev.LATE) + kinds.count(ev.SECOND_ANSWER)
    return totals.answers > 0 and ev.REBOOTED not in kinds \
        and device.state == words.CONNECTED and not device.moved_to \
        and totals.missed - late >= max(INCIDENTS_MIN, MISSED_MIN_SHARE * totals.asked)


def _missed(report: BusReport, device: DeviceReport) -> _Symptom:
    seen = f'{device.totals.missed} of {device.totals.asked} answers missed'
    waits = [one.us for one in report.waits if one.device == device.id]
    if not report.has_sides:
        causes, step = 'a loose plug, or a second program', \
            f'{STOP_OTHERS}: if answers are still missed, check its plugs'
    elif waits and min(waits) < ADAPTER_HOLD_US:
        causes, step = \
            f'a time-out of {min(waits) / 1000:.0f} ms that is too short, or a loose plug', \
            'raise the time-out to 50 ms: if no answer is missed then, it was too short'
    else:
        causes, step = 'a loose plug, or a servo that is busy or restarts', \
            'swap its cable with another servo: if the loss goes with the cable, that is bad'
    return _Symptom({'missed answers', 'damaged answers', 'absence'}, seen, causes, step,
                    device.id)


def _damaged(report: BusReport, damaged: int) -> _Symptom:
    causes, step = (
        'interference, or two devices with one ID',
        'read one servo after the other with its motor off: damage of one alone is its cable or '
        'its ID; none at all, it is the motors') if report.has_sides else (
        'interference, or a second program',
        f'{STOP_OTHERS}: what is damaged then is interference')
    return _Symptom({'damaged packets', 'damaged answers', 'damaged first bytes'},
                    f'{damaged} packets damaged', causes, step)
