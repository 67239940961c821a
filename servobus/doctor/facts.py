# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""
Facts of a case that rules of several families use.

What the registers of a device say; the question on which a program ended; and what shows that two
talked at the same time, which no cable and no ground can mend.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable
from collections.abc import Iterable
from functools import lru_cache
from itertools import pairwise
from math import inf
from math import isclose
from math import tau
from operator import itemgetter
from operator import sub
from statistics import median
from typing import NamedTuple

from msg_defs.dxl_instruction import Instruction
from msg_defs.nanoseconds import NS_PER_MS
from msg_defs.nanoseconds import NS_PER_S
from servobus.bus import evidence as ev
from servobus.bus import report as words
from servobus.bus.report import BusReport
from servobus.bus.report import Cycle
from servobus.bus.report import D
from servobus.bus.report import DeviceReport
from servobus.bus.report import Incident
from servobus.bus.report import PROTOCOL_2
from servobus.bus.report import Wait
from servobus.bus.table import Observed
from servobus.doctor.bit_errors import count_overlaid
from servobus.doctor.bit_errors import NOISE_MAX_BITS
from servobus.doctor.bit_errors import packet_of
from servobus.doctor.bit_errors import SYNC_READS
from servobus.doctor.bit_errors import TWO_SENDERS
from servobus.doctor.bit_errors import wrong_bits
from servobus.doctor.case import Case
from servobus.doctor.case import Sample
from servobus.doctor.rhythm import WRITES
from servobus.doctor.thresholds import GOAL_MOVES_STEPS
from servobus.doctor.thresholds import INCIDENTS_MIN
from servobus.doctor.thresholds import STILL_MAX_STEPS
from servobus.doctor.thresholds import TURN_STEPS
from servobus.model.control_table import Field

LOST_BITS_MIN_SHARE = 0.3          # share of damaged instructions; bits turned over by chance: 0.1
TAIL_BYTES = 6                     # the CRC is among them, so they are not there by chance
SAME_DELAY_NS = 3 * NS_PER_MS       # late answers closer than this were delayed by one cause
ALIVE_MIN_VOLTS = 1.0              # a device with less does not answer: the register is not it
WATCHED_EVERY_NS = NS_PER_S // 2   # rarer reads are of a program that waits for a motion's end
PROGRAM_RATES_MAX = 3              # a program sets two and that of the port; more are a search
WAITS_WINDOW_S = 3.0               # a master that waits in vain now
HASTY_MIN_WAITS = 10               # fewer are those of damage
HASTY_MIN_SHARE = 0.7              # share of the vain waits
FACTORY_DELAY_US = 500             # Return Delay Time as from the factory (e-Manual)
AWAY_MIN_MS = 100                  # shorter than any start; longer than an answer or two lost
STOPPED_MIN_S = 1.0                # two reports at the usual 2 Hz: one may be before it starts
FOLLOW_WINDOW_S = 4.0              # samples of so long show whether it follows
SCS_STEPS = 1024                   # over the travel of an SCS
SUPPLY = 'Present Input Voltage', 'Min Voltage Limit', 'Max Voltage Limit'
SINGLE_WRITES = (Instruction.WRITE, Instruction.REG_WRITE)
# Error numbers of a status (e-Manual, Protocol 2.0).
INSTRUCTION_ERROR, CRC_ERROR = 2, 3
RANGE_ERROR, LENGTH_ERROR, LIMIT_ERROR, ACCESS_ERROR = 4, 5, 6, 7


# --- registers -----------------------------------------------------------------------------------

class Limits(NamedTuple):
    """
    The limits that a servo has from the factory, for where the master never read its own.

    Initial values of Temperature Limit, Min and Max Voltage Limit in the control tables
    (e-Manual). degrees: °C; low and high: V.
    """

    degrees: float
    low: float
    high: float


# By model number. A model that is not here is not judged before its own limits are seen.
FACTORY = {number: limits for limits, numbers in (
    (Limits(70.0, 6.0, 14.0), (12, 18, 300)),              # AX-12A, AX-18A, AX-12W
    (Limits(80.0, 6.0, 16.0), (29, 310, 320, 360)),        # MX-28, MX-64, MX-106, MX-12W (1.0)
    # MX-28, MX-64, MX-106 (2.0), XM430-W350, XM430-W210
    (Limits(80.0, 9.5, 16.0), (30, 311, 321, 1020, 1030)),
    (Limits(72.0, 6.0, 14.0), (1060,)),                    # XL430-W250
    (Limits(80.0, 10.0, 16.0), (1120, 1130)),              # XM540-W270, XM540-W150
    (Limits(70.0, 3.5, 7.0), (1190, 1200)),                # XL330-M077, XL330-M288
) for number in numbers}


def is_rate_search(report: BusReport) -> bool:
    """Tell whether a program tries one baud rate after the other, so that most answers fail."""
    return len(report.tried) > PROGRAM_RATES_MAX


def last_read(case: Case, device: DeviceReport, name: str, within_s: float = inf) -> float | None:
    """Return the value of a register, as it was read last."""
    seen = case.values[device.id].get(name)
    return None if seen is None or seen.age_s > within_s or seen.source != 'r' \
        else seen.value.number


def limit_of(case: Case, device: DeviceReport, name: str,
             factory: str) -> tuple[float | None, str]:
    """Return a limit and where it is from: the device, or its model's factory values."""
    seen = case.values[device.id].get(name)
    if seen is not None and seen.value.number is not None:
        return seen.value.number, ''
    values = FACTORY.get(device.model_number or -1)
    if factory == 'degrees' and device.model.number is None and device.model.protocol != 'feetech':
        return max(one.degrees for one in FACTORY.values()), ' or less'
    return (None, '') if values is None else (getattr(values, factory), ' from the factory')


def is_watched(case: Case, device: DeviceReport, place: Observed) -> bool:
    """Tell whether a register is read all the time, now too, rather than where a motion ends."""
    return place.age_s * NS_PER_S <= WATCHED_EVERY_NS and any(
        device.id in one.ids and one.address is not None and len(one.stamps) > INCIDENTS_MIN
        and one.address <= place.field.at < one.address + one.length
        and max(map(sub, one.stamps[1:], one.stamps)) < WATCHED_EVERY_NS
        for one in case.cycles)


def raw_value(case: Case, device: DeviceReport, name: str) -> float | None:
    """Return the raw value of a register as it was read or written last."""
    seen = case.values[device.id].get(name)
    return None if seen is None else seen.value.raw


def is_of_one_turn(field: Field) -> bool:
    """Tell whether a position is in steps of which a turn has 4096."""
    return isclose(TURN_STEPS * (field.scale or 0.0), tau, abs_tol=0.005)


def is_scs(field: Field) -> bool:
    """Tell whether a position is that of an SCS servo: high byte first, and no turns."""
    return field.byte_order == 'big'


def highest_goal(field: Field) -> int:
    """Return the highest position of one turn, or of the travel of an SCS."""
    return (SCS_STEPS if is_scs(field) else TURN_STEPS) - 1


def span(places: Iterable[float | None]) -> float:
    """Return how far apart places are; -1 where none is known."""
    known = [place for place in places if place is not None]
    return max(known) - min(known) if known else -1.0


def is_off(torque: Observed | None) -> bool:
    """Tell whether Torque Enable was read and is 0."""
    return torque is not None and torque.source == 'r' and not torque.value.raw


# --- the question on which a program ended -------------------------------------------------------

def fatal_wait(case: Case) -> Wait | None:
    """Return the vain wait on which a program ended with an error, None if that is unknown."""
    last = case.last_wait
    if not case.failed or last is None or last.is_spoilt or fatal_late_answer(case):
        return None
    if case.failed == words.RAISED:
        return last
    answered = min((one.last_heard_s for one in case.devices
                    if one.last_heard_s is not None), default=0.0)
    is_ping = last.instruction == Instruction.PING
    silent = sum(one.last_heard_s is None for one in case.devices)
    if is_ping and silent > 1:
        return None                    # a search
    alike = [one.stamp for one in case.report.waits
             if (one.instruction == Instruction.PING) == is_ping]
    return None if len(alike) > 1 and alike[0] < case.now - answered * NS_PER_S else last


def fatal_late_answer(case: Case) -> Incident[ev.Lateness] | None:
    """Return the late answer that a program got for its last question, on which it ended."""
    last = case.last_wait
    asked = [one.stamp - 1000 * one.detail.us for one in case.incidents(ev.LEFT_OPEN)] \
        if last is None else [last.stamp - 1000 * last.us]
    return next((one for one in case.incidents(ev.LATE) if case.failed
                 and asked and one.stamp > asked[-1]), None)


def count_early_ends(case: Case) -> int:
    """Return how many of the last waits ended before any answer could come, 0 if not most."""
    waits = case.waits(WAITS_WINDOW_S)
    hasty = [one.us for one in waits if not one.is_spoilt and one.instruction not in WRITES]
    if len(hasty) < HASTY_MIN_WAITS or (
            case.has_sides and len(hasty) < HASTY_MIN_SHARE * len(waits)):
        return 0
    return len(hasty) if median(hasty) < FACTORY_DELAY_US else 0


def count_early_reads(case: Case) -> int:
    """Return how often a program read before any answer could come, 0 if it mostly waits."""
    waits = [one.us for one in case.waits(WAITS_WINDOW_S) if one.us
             and one.instruction not in WRITES] if case.has_sides else []
    return len(waits) if len(waits) >= HASTY_MIN_WAITS and median(waits) < FACTORY_DELAY_US else 0


def first_of_groups(incidents: list[Incident[D]]) -> list[Incident[D]]:
    """Return the first of each group of incidents that are close: one delay has many answers."""
    return incidents[:1] + [one for before, one in pairwise(incidents)
                            if one.stamp - before.stamp > SAME_DELAY_NS]


# --- joints and goals ---------------------------------------------------------------------------

def does_not_follow(samples: list[Sample]) -> bool:
    """Tell whether the goal moves and the position does not."""
    samples = samples[1:]
    if len(samples) < 2 or samples[-1].stamp - samples[0].stamp < STOPPED_MIN_S * NS_PER_S:
        return False
    return span([one.goal for one in samples]) >= GOAL_MOVES_STEPS \
        and 0 <= span([one.position for one in samples]) <= STILL_MAX_STEPS


def recent_samples(case: Case, number: int) -> list[Sample]:
    since = case.now - FOLLOW_WINDOW_S * NS_PER_S
    return [one for one in case.samples.get(number, ()) if one.stamp > since]


def since_it_moved(samples: list[Sample]) -> list[Sample]:
    """Return the samples since a joint moved last, with that one."""
    last = samples[-1].position if samples else None
    moved = [at for at, one in enumerate(samples) if one.position is not None
             and last is not None and abs(one.position - last) > STILL_MAX_STEPS]
    return samples[moved[-1] if moved else 0:]


def absences(case: Case, device: DeviceReport | None = None) -> list[Incident[ev.SilentFor]]:
    """Return the returns after an absence that no Reboot or Factory Reset accounts for."""
    if not case.count(ev.RETURNED):
        return []
    ordered = {one.device for one in case.incidents(ev.REBOOTED)}
    return [one for one in case.incidents(ev.RETURNED, device)
            if one.detail.ms >= AWAY_MIN_MS and one.device not in ordered]


def most_refused(case: Case, device: DeviceReport,
                  is_meant: Callable[[ev.Refusal], bool]) -> tuple[int, int, int]:
    """Return the address that it refused most, with which error, and how often."""
    found = Counter(one.detail[1:] for one in case.incidents(ev.REFUSED, device)
                    if is_meant(one.detail))
    return max(((*what, count) for what, count in found.items()), key=itemgetter(2),
               default=(-1, 0, 0))


def least_refusals(case: Case, device: DeviceReport, few: int) -> int:
    """Return how many refusals say something: one on which a program ended does."""
    found = case.incidents(ev.REFUSED, device)
    return 1 if case.failed and found and found[-1].stamp >= case.report.asked else few


# --- two senders at once -------------------------------------------------------------------------

# A line that two drive is low where either pulls it low: of what both send, bits get lost and none
# is added. And what began later goes on alone when the other is over, so that the end of a
# question is in the noise after the answer that it ran into, without the header that it had.

def may_overlap(case: Case) -> bool:
    """Tell whether damage in answers may be packets that overlap, so that it is no cable's."""
    if is_collision(case) or case.has_overlaps:
        return True
    # Where the sides are known, it would have been seen that somebody did not wait.
    return not case.has_sides \
        and case.damage_picture().get('looks like', '').startswith(TWO_SENDERS)


@lru_cache(maxsize=1)              # several rules ask it of one case
def is_collision(case: Case) -> bool:
    """
    Tell whether damage is what two talkers at once make.

    Two loops repeat one instruction, and a question was laid over something; or questions are in
    the noise with bits lost and none added; or damaged instructions of Protocol 2.0 are.
    """
    if is_overlaid(case) or (
            case.clocks and case.damage >= INCIDENTS_MIN and ran_into_answers(case)):
        return True
    if case.report.protocol != PROTOCOL_2:
        return False
    damaged = case.incidents(ev.DAMAGED_INSTRUCTION)
    if len(damaged) < INCIDENTS_MIN:
        return False
    used = {front for cycle in case.cycles if (front := _front_of(cycle)) is not None}
    mixed = sum(_has_lost_bits(one.detail, used) for one in damaged)
    return mixed >= INCIDENTS_MIN and mixed >= LOST_BITS_MIN_SHARE * len(damaged)


def _has_lost_bits(front: ev.PacketHeader, used: set[ev.PacketHeader]) -> bool:
    """Tell whether this begins no packet of the master, and is one of its with bits cleared."""
    return front not in used and any(
        front.instruction & ~one.instruction == 0 and front.length & ~one.length == 0
        for one in used)


def _front_of(cycle: Cycle) -> ev.PacketHeader | None:
    """Return how the packets of an instruction begin after their ID, None where that varies."""
    code, many = cycle.instruction, len(cycle.ids)
    if code == Instruction.PING:
        return ev.PacketHeader(code, 3)
    if code == Instruction.READ:
        return ev.PacketHeader(code, 7)
    if code in SINGLE_WRITES:
        return ev.PacketHeader(code, 5 + cycle.length)
    if code in SYNC_READS:
        return ev.PacketHeader(code, 7 + many)
    if code == Instruction.SYNC_WRITE:
        return ev.PacketHeader(code, 7 + many * (1 + cycle.length))
    return None


def ran_into_answers(case: Case) -> int:
    """Return how many questions ran into an answer, as far as the last noise shows it."""
    noise = case.report.noise
    found = 0
    for cycle in case.cycles if case.damage else ():
        packet = packet_of(cycle.instruction, cycle.ids, cycle.address, cycle.length)
        at = noise.find(packet[-TAIL_BYTES:]) if packet else -1
        while at >= 0:
            begin = at + TAIL_BYTES - len(packet)
            found += begin >= 0 \
                and wrong_bits(noise[begin:at], packet[:-TAIL_BYTES]) > NOISE_MAX_BITS
            at = noise.find(packet[-TAIL_BYTES:], at + TAIL_BYTES)
    return found


def is_overlaid(case: Case) -> bool:
    """Tell whether questions were wholly inside something else, as far as the last noise."""
    return case.damage >= INCIDENTS_MIN and count_overlaid(case.report) >= INCIDENTS_MIN
