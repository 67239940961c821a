# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""
What shows that two talked at the same time, which no cable and no ground can mend.

A line that two drive is low where either pulls it low: of what both send, bits get lost and none
is added. And what began later goes on alone when the other is over, so that the end of a question
is in the noise after the answer that it ran into, without the header that it had.
"""

from __future__ import annotations

from functools import lru_cache

from msg_defs.dxl_instruction import Instruction
from servobus.bus import evidence as ev
from servobus.bus.report import Cycle
from servobus.bus.report import PROTOCOL_2
from servobus.doctor.bits import FLIPPED
from servobus.doctor.bits import GROUPS
from servobus.doctor.bits import laid_over
from servobus.doctor.bits import packet_of
from servobus.doctor.bits import SPEAKERS
from servobus.doctor.bits import wrong_bits
from servobus.doctor.case import Case

FEW = 3
MOSTLY = 0.3                       # among damaged instructions; bits turned over by chance: 0.1
TAIL = 6                           # bytes: the CRC is among them, so they are not there by chance
_WRITES = (Instruction.WRITE, Instruction.REG_WRITE)


def may_overlap(case: Case) -> bool:
    """Tell whether damage in answers may be packets that overlap, so that it is no cable's."""
    if is_collision(case) or case.has_overlaps:
        return True
    # Where the sides are known, it would have been seen that somebody did not wait.
    return not case.report.has_sides \
        and case.looks_like().get('looks like', '').startswith(SPEAKERS)


@lru_cache(maxsize=1)              # several rules ask it of one case
def is_collision(case: Case) -> bool:
    """
    Tell whether damage is what two talkers at once make.

    Two loops repeat one instruction, and a question was laid over something; or questions are in
    the noise with bits lost and none added; or damaged instructions of Protocol 2.0 are.
    """
    if laid_over_answers(case) or (
            case.clocks and case.damage >= FEW and ran_into_answers(case)):
        return True
    if case.report.protocol != PROTOCOL_2:
        return False
    damaged = case.incidents(ev.DAMAGED_INSTRUCTION)
    if len(damaged) < FEW:
        return False
    used = {front for cycle in case.report.cycles if (front := _front_of(cycle)) is not None}
    mixed = sum(_has_lost_bits(one.detail, used) for one in damaged)
    return mixed >= FEW and mixed >= MOSTLY * len(damaged)


def _has_lost_bits(front: ev.Front, used: set[ev.Front]) -> bool:
    """Tell whether this begins no packet of the master, and is one of its with bits cleared."""
    return front not in used and any(
        front.instruction & ~one.instruction == 0 and front.length & ~one.length == 0
        for one in used)


def _front_of(cycle: Cycle) -> ev.Front | None:
    """Return how the packets of an instruction begin after their ID, None where that varies."""
    code, many = cycle.instruction, len(cycle.ids)
    if code == Instruction.PING:
        return ev.Front(code, 3)
    if code == Instruction.READ:
        return ev.Front(code, 7)
    if code in _WRITES:
        return ev.Front(code, 5 + cycle.length)
    if code in GROUPS:
        return ev.Front(code, 7 + many)
    if code == Instruction.SYNC_WRITE:
        return ev.Front(code, 7 + many * (1 + cycle.length))
    return None


def ran_into_answers(case: Case) -> int:
    """Return how many questions ran into an answer, as far as the last noise shows it."""
    noise = case.report.noise
    found = 0
    for cycle in case.report.cycles if case.damage else ():
        packet = packet_of(cycle.instruction, cycle.ids, cycle.address, cycle.length)
        at = noise.find(packet[-TAIL:]) if packet else -1
        while at >= 0:
            begin = at + TAIL - len(packet)
            found += begin >= 0 and wrong_bits(noise[begin:at], packet[:-TAIL]) > FLIPPED
            at = noise.find(packet[-TAIL:], at + TAIL)
    return found


def laid_over_answers(case: Case) -> bool:
    """Tell whether questions were wholly inside something else, as far as the last noise."""
    return case.damage >= FEW and laid_over(case.report) >= FEW
