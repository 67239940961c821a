# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""Rules about reads of several devices at once that some of them do not know."""

from __future__ import annotations

from msg_defs.dxl1_instruction import DYNAMIXEL_1
from msg_defs.dxl1_instruction import FEETECH
from msg_defs.dxl1_instruction import UNDECIDED
from msg_defs.dxl_instruction import Instruction
from servobus.bus import evidence as ev
from servobus.bus.report import Cycle
from servobus.bus.report import DeviceReport
from servobus.doctor.case import Case
from servobus.doctor.rule import Claim
from servobus.doctor.rule import Claims
from servobus.doctor.rule import Found
from servobus.doctor.rule import Rule
from servobus.doctor.rule import SILENCE

S = 1_000_000_000
FEW = 3
UNKNOWN_TO_IT = 2
OTHERWISE_S = 2.0                  # an answer to something else, so lately: it is there
FAST = (Instruction.FAST_SYNC_READ, Instruction.FAST_BULK_READ)
HAVE_SYNC_READ = ('STS', 'SMS', 'HLS')
# Model numbers, and the firmware from which they know fast reads: MX(2.0) never.
_FAST_SINCE = (((30, 311, 321), 256), (range(1190, 1250), 46), (range(1000, 1400), 45),
               (range(2000, 2130), 12))


def _fast_reads(case: Case) -> Claims:
    """Look at the first device of each fast read that never gave its part of one."""
    known = set()
    for cycle in case.report.cycles:
        if cycle.instruction not in FAST or not cycle.stamps or cycle.asked < FEW \
                or case.now - cycle.stamps[-1] > 2 * S:
            continue
        first = next((number for number in cycle.ids if number in case.devices
                      and not case.devices[number].totals.fast_answers), None)
        found = None if first is None or first in known else \
            _fast_read(case, case.devices[first], cycle)
        if found is not None and first is not None:
            known.add(first)
            yield found


def _fast_read(case: Case, device: DeviceReport, cycle: Cycle) -> Found | None:
    refused = sum(one.detail.instruction in FAST and one.detail.error == UNKNOWN_TO_IT
                  for one in case.incidents(ev.REFUSED, device))
    is_able = device.firmware is not None and not _lacks_fast_reads(device) \
        and case.lately(device, OTHERWISE_S).answers < FEW
    if refused < FEW and (is_able or not device.totals.answers):
        return None                            # perhaps it is not there
    firmware = '' if device.firmware is None else f', firmware {device.firmware}'
    after = cycle.ids[cycle.ids.index(device.id):]
    return Claim('answers, but never a fast read '
                 f'({device.model_name}{firmware}), so devices after it are never read: update it '
                 'or use plain Sync Read',
                 {'fast reads': cycle.asked}, covers=tuple(after), device=device.id)


def _sync_reads(case: Case) -> Claims:
    """Look for Sync Reads that nothing answers, where other instructions are answered."""
    is_feetech = case.report.protocol == FEETECH.name
    if case.count(ev.UNASKED) or not (
            is_feetech or case.report.protocol in (DYNAMIXEL_1.name, UNDECIDED.name)):
        return
    answered = sum(device.totals.answers for device in case.report.devices)
    for cycle in case.report.cycles:
        asked = sum(stamp > case.now - OTHERWISE_S * S for stamp in cycle.stamps)
        if cycle.instruction == Instruction.SYNC_READ and asked >= FEW and answered >= FEW \
                and (not is_feetech or _answer_all_else(case, cycle)):
            yield Claim('the master sends Sync Reads, which Dynamixel has in Protocol 2.0 '
                        'only, and Feetech SCS not at all: none is answered, other instructions '
                        'are; read one after the other',
                        {'Sync Reads': cycle.asked})


def _answer_all_else(case: Case, cycle: Cycle) -> bool:
    """Tell whether Feetech servos may lack Sync Read: each answers, and never this one."""
    members = [case.devices[number] for number in cycle.ids if number in case.devices]
    return cycle.missed >= cycle.asked - 1 and bool(members) and all(
        case.lately(one, OTHERWISE_S).answers >= FEW
        and not one.model_name.startswith(HAVE_SYNC_READ) for one in members)


def _lacks_fast_reads(device: DeviceReport) -> bool:
    """Tell whether its firmware is older than fast reads (e-Manual, Fast Sync Read)."""
    if device.firmware is None or device.model_number is None:
        return False
    since = next((firmware for numbers, firmware in _FAST_SINCE if device.model_number in numbers),
                 0)
    return device.firmware < since


RULES = (
    Rule('fast_read_unsupported', _fast_reads,
         (*SILENCE, 'all_silent', 'noise', 'damaged_answers', 'wrong_address', 'dropout')),
    Rule('sync_read_unsupported', _sync_reads,
         ('jitter', 'missed_answers', 'sync_read_stops')),
)
