# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""Devices are missing: gone, cut off, started again, or heard to Pings only."""

from __future__ import annotations

from collections.abc import Sequence
from collections.abc import Set
from dataclasses import replace
from itertools import groupby
from itertools import takewhile
from operator import attrgetter
from statistics import median

from msg_defs.diagnostics import Level
from msg_defs.dxl_instruction import Instruction
from msg_defs.dxl_packet import BROADCAST
from msg_defs.nanoseconds import NS_PER_MS
from msg_defs.nanoseconds import NS_PER_S
from servobus.bus import evidence as ev
from servobus.bus import report as words
from servobus.bus.report import DeviceReport
from servobus.bus.report import Incident
from servobus.bus.table import IDENTITY_REGISTERS
from servobus.bus.unread import HUNG_WAIT_NS
from servobus.doctor.case import Case
from servobus.doctor.case import is_waiting
from servobus.doctor.case import Sample
from servobus.doctor.facts import absences
from servobus.doctor.facts import does_not_follow
from servobus.doctor.facts import fatal_late_answer
from servobus.doctor.facts import fatal_wait
from servobus.doctor.facts import first_of_groups
from servobus.doctor.facts import highest_goal
from servobus.doctor.facts import is_of_one_turn
from servobus.doctor.facts import is_off
from servobus.doctor.facts import is_rate_search
from servobus.doctor.facts import is_scs
from servobus.doctor.facts import span
from servobus.doctor.rhythm import WRITES
from servobus.doctor.rule import about
from servobus.doctor.rule import all_ids
from servobus.doctor.rule import Claim
from servobus.doctor.rule import Claims
from servobus.doctor.rule import Doubt
from servobus.doctor.rule import first_ids
from servobus.doctor.rule import Found
from servobus.doctor.rule import longer_than
from servobus.doctor.rule import Rule
from servobus.doctor.rule import share
from servobus.doctor.symptom import SILENCE
from servobus.doctor.thresholds import ADAPTER_HOLD_US
from servobus.doctor.thresholds import DIP_MAX_SHARE
from servobus.doctor.thresholds import GOAL_MOVES_STEPS
from servobus.doctor.thresholds import GONE_S
from servobus.doctor.thresholds import INCIDENTS_MIN
from servobus.doctor.thresholds import LONG_WAIT_MS

TOGETHER_S = 0.5                   # fell silent, or came back, within it: by one cause
RETURN_SETTLED_S = 2.0             # by then a restart has shown
TICK_TURN_S, TICK_SLACK_S = 32.768, 0.5        # Realtime Tick begins at 0 again (e-Manual)
TOGETHER_MIN = 4                   # times that answers are missing: fewer coincide by chance
TOGETHER_MIN_SHARE = 0.8           # share of these times, in one cycle
TOGETHER_KEPT = 16                 # the last of these times
MISSED_MIN_SHARE = 0.01            # share of its answers; fewer are lost on a healthy bus too
LATE_MIN_SHARE = 0.1               # share of its answers; fewer are late by chance
ACKS_MISSED_LIMIT = 4              # as `missed_limit`


# --- nothing answers -----------------------------------------------------------------------------

@Rule(subject='bus', level=Level.ERROR,
      symptoms={'absence of several'},
      accounts_for={'restart', 'absence', 'missed answers', 'voltage limit', 'uneven rhythm',
                    'joint at rest'})
def brown_out(case: Case) -> Claims:
    """
    Several devices restarted at once; WARN: all were silent together, and are back.

    Do: check battery, cable gauge, peak load.
    """
    found = absences(case)
    if not found:
        return
    last = max(found, key=lambda one: one.stamp)
    begin = last.stamp - last.detail.ms * NS_PER_MS
    together = [one for one in found if one.stamp > begin]
    if len({one.device for one in together}) == 1:     # others waited for it, unasked
        together += [other for number, device in case.by_id.items()
                     if number != last.device and device.window.not_served and not device.alert
                     and _supply_proof(case, other := replace(last, device=number))]
    ids = sorted({one.device for one in together})
    restarts = [proof for one in together if (proof := _restart_proof(case, one))]
    proofs = restarts or [proof for one in together if (proof := _supply_dip(case, one.device))]
    if len(ids) > 1 and proofs:
        what = f'restarted together ({proofs[0]}): the supply failed' if restarts else \
            f'were silent together, and their supply fell ({proofs[0]})'
        yield Claim(f'{first_ids(ids, 2, len(case.by_id))} {what}; check battery and '
                    'cables, set up again',
                    {'devices': all_ids(ids), 'seen by': proofs[0]}, covers=tuple(ids))
    elif _was_with_all(case, last, ids):
        yield Claim(f'{first_ids(ids, 2, len(case.by_id))} were silent together for '
                    f'{last.detail.ms} ms: the supply or the first cable failed for a moment; '
                    'check both, and whether torque and settings are as before',
                    {'devices': all_ids(ids)}, Level.WARN, covers=tuple(ids))


def _was_with_all(case: Case, back: Incident[ev.SilentFor], ids: list[int]) -> bool:
    """Tell whether nothing at all answered while a device was away, and several were asked."""
    begin = back.stamp - back.detail.ms * NS_PER_MS
    waits = [one for one in case.report.waits if begin < one.stamp <= back.stamp]
    asked = {cycle.ids[0] for cycle in case.cycles for stamp in cycle.stamps
             if cycle.ids != (BROADCAST,) and (begin < stamp < back.stamp or (
                 begin < cycle.stamps[0] and len(cycle.stamps) < cycle.asked))}     # or unknown
    return len(waits) >= INCIDENTS_MIN and not _hurries(case) and {*ids} >= asked \
        and not any(one.is_spoilt for one in waits) and len({one.device for one in waits}) > 1


def _supply_proof(case: Case, back: Incident[ev.SilentFor]) -> str:
    """Return what says that a device restarted or had too little voltage, '' if nothing does."""
    return _restart_proof(case, back) or _supply_dip(case, back.device)


def _supply_dip(case: Case, number: int) -> str:
    """Return what says that a device had too little voltage, '' if nothing does."""
    voltages = [one.voltage for one in case.samples.get(number, ()) if one.voltage]
    return f'{number:03} measured {min(voltages):.1f} V before, {voltages[-1]:.1f} V now' \
        if voltages and min(voltages) < DIP_MAX_SHARE * voltages[-1] else ''


@Rule(subject='bus', level=Level.ERROR, holds=False,
      symptoms={'silent bus'},
      accounts_for={'silent device', 'device not served', 'answers to Pings only',
                    'uneven rhythm', 'slow cycle'})
def all_silent(case: Case) -> Claims:
    """
    Several devices asked, no answer for 1.5 s, or not one byte came back.

    Do: switch their power on, check the first cable; if the robot moves, connect the monitor
    to the data line.
    """
    asked, heard = case.increase_of('instructions', GONE_S), case.increase_of('answers', GONE_S)
    missing = [device.id for device in case.devices
               if device.missed_in_a_row or is_waiting(device)]
    figures = {'instructions': asked or case.report.counters['Instructions']}     # or too short
    is_new = all(device.last_heard_s is None for device in case.devices)
    if _waits_for_one(case, missing) or _hurries(case, 1) or (missing and all(
            _is_ping_only(case, case.by_id[number]) for number in missing)):
        return
    if len(missing) > 1 and ((case.failed and is_new)
                             or (asked >= 5 and heard <= 0 and case.gone)):
        first = case.gone[0] if len(case.gone) == 1 else None
        alone = '' if first is None else f'; or {first:03} is dead and the others wait for it'
        hint = '' if case.has_sides else '; or only the master is heard'
        yield Claim(f'none of {len(missing)} devices answers the master: check power and '
                    f'first cable{_of_the_program(case) if is_new else alone}{hint}', figures)
    elif not case.report.is_answered and _asks_in_vain(case):
        yield Claim('not one byte comes back to the program: check power and first cable'
                    f'{_of_the_program(case)}', figures)


def _of_the_program(case: Case) -> str:
    """Return what a program may have set wrongly, with what it uses."""
    used = ', '.join(filter(None, (f'{case.report.baud} Bd', case.report.protocol)))
    return f", and that the program uses the servos' baud rate, protocol and ID ({used})"


def _asks_in_vain(case: Case) -> bool:
    """Tell whether a program that never got a byte waits long and often enough for one."""
    report = case.report
    if case.count(ev.LATE) or (is_rate_search(report) and not report.is_over):
        return False
    pings = sum(cycle.asked for cycle in report.cycles if cycle.instruction == Instruction.PING)
    if not report.is_over:
        return bool(report.failed) or pings >= INCIDENTS_MIN
    return bool(report.failed or pings) or len(report.waits) >= INCIDENTS_MIN


def _waits_for_one(case: Case, missing: list[int]) -> bool:
    """Tell whether all others were heard and wait for one that never was."""
    return len(case.gone) == 1 and all(
        device.last_heard_s is None if device.id in case.gone
        else device.last_heard_s is not None and device.waiting_behind == case.gone[0]
        for device in map(case.by_id.__getitem__, missing))


def _hurries(case: Case, least: int = INCIDENTS_MIN) -> bool:
    """Tell whether the master waits too short a time for most adapters, and answers come late."""
    return len(first_of_groups(case.incidents(ev.LATE))) >= least and min(
        (one.us for one in case.report.waits), default=ADAPTER_HOLD_US) < ADAPTER_HOLD_US


@Rule(level=Level.ERROR, holds=False,
      symptoms={'silent device', 'device not served'},
      accounts_for=SILENCE)
def broken_cable(case: Case) -> Claims:
    """
    The last two or more of `devices`, listed in cable order, are gone.

    Do: check the cable between the two named.
    """
    chain = [number for number in case.report.chain if number in case.by_id]
    tail = 0
    while tail < len(chain) and _cut_off(case, chain[-1 - tail]):
        tail += 1
    lost = chain[len(chain) - tail:]
    if 0 < tail < len(chain) and sum(number in case.gone for number in lost) > 1:
        yield Claim('it and everything downstream are silent: the cable between '
                    f'{chain[-1 - tail]:03} and {lost[0]:03} is broken or unplugged',
                    {'silent': all_ids(lost)}, covers=tuple(lost), device=lost[0])


def _cut_off(case: Case, number: int) -> bool:
    return number in case.gone or is_waiting(case.by_id[number])


@Rule(level=Level.ERROR, holds=False,
      symptoms={'device not served'},
      accounts_for={'silent device', 'missed answers', 'uneven rhythm'})
def sync_read_stops(case: Case) -> Claims:
    """
    No answer, and devices after it in a Sync Read or Bulk Read are never read.

    Do: repair this one first, or take it out of the list.
    """
    for number in () if _hurries(case) else case.gone:
        after = _devices_after(case, number)
        if after:
            yield Claim(f'silent, and the Sync Read ends there: {first_ids(after, 2)} after it '
                        'are never read; check its power and cable, or leave it out',
                        {'not served': all_ids(after), **_wait_figures(case, number)},
                        device=number)


@Rule(level=Level.ERROR, holds=False,
      symptoms={'silent device'},
      accounts_for={'missed answers', 'uneven rhythm'})
def no_answer(case: Case) -> Claims:
    """
    More answers missed in a row than `missed_limit`.

    WARN where it was only written to, and others acknowledge writes.

    Do: check power, plug, ID, baud rate.
    """
    hurries = _hurries(case)
    for number in case.gone:
        if hurries:
            yield Doubt('no answer in time, and others are late: raise the time-out, or check '
                        'power and ID', number, f'let the program wait {LONG_WAIT_MS} ms for '
                        f'{number:03}: if it answers then, its time-out was too short')
        elif not _devices_after(case, number):
            yield _no_answer_claim(case, number)
    yield from _claim_fatal_question(case)
    for device in case.devices:
        if device.state == words.EXPECTED and device.last_heard_s is None \
                and not (device.window.asked or device.window.not_served):
            yield Doubt(f'in {case.names.devices}, but the master never asks it', device.id)


def _devices_after(case: Case, number: int) -> list[int]:
    """Return the devices that get no turn in a group read, as this one says nothing."""
    return [device.id for device in case.devices
            if device.waiting_behind == number and is_waiting(device)]


def _no_answer_claim(case: Case, number: int) -> Claim:
    device = case.by_id[number]
    since = 'never heard' if device.last_heard_s is None \
        else f'silent for {longer_than(device.last_heard_s)}' if number in case.gone \
        else f'though it gave {device.totals.answers} before, and the program ended there'
    others = ', others answer' if any(
        case.recent_counts(other, GONE_S).answers for other in case.devices) else ''
    figures = {'requests without an answer': device.missed_in_a_row, **_wait_figures(case, number)}
    together = _lost_together(case, device) if others else []
    if together:
        return Claim(f'{first_ids(together, 3)} fell silent together, others answer: check '
                     f'{_before(case, together)}, and their supply', figures, device=number)
    what = 'cable and ID' if device.last_heard_s is not None else 'cable, ID and baud rate' if any(
        other.totals.answers for other in case.devices) else f'cable and ID{_of_the_program(case)}'
    return Claim(f'no answer, {since}{others}: check its power, {what}', figures, device=number)


def _lost_together(case: Case, device: DeviceReport) -> list[int]:
    """Return the devices, next to each other by ID, that fell silent when this one did, if any."""
    since = device.last_heard_s
    if since is None or device.id not in case.gone:
        return []
    return _adjacent(case, device.id, {
        one.id for one in case.devices if one.missed_in_a_row and one.last_heard_s is not None
        and abs(one.last_heard_s - since) <= TOGETHER_S})


def _adjacent(case: Case, number: int, ids: Set[int]) -> list[int]:
    """Return those of some devices that are next to one by ID, with it; nothing if it is alone."""
    groups = groupby(sorted(case.by_id), key=ids.__contains__)
    found = next((group for is_in, some in groups if is_in and number in (group := [*some])), [])
    return found if len(found) > 1 else []


def _before(case: Case, ids: Sequence[int]) -> str:
    """Return the part of the cable that devices share, in words."""
    before = max((one for one in case.by_id if one < ids[0]), default=None)
    wired = '' if before is None else f' ({before:03} to {ids[0]:03}, if they are in this order)'
    return f'the plug or cable before the first of them{wired}'


def _wait_figures(case: Case, number: int) -> dict[str, str]:
    """Return what each request without an answer costs the master."""
    waits = [one.us for one in case.report.waits if one.device == number]
    return {'wait per request (ms)': f'{median(waits) / 1000:.1f}'} if waits else {}


def _claim_fatal_question(case: Case) -> Claims:
    """Look at the question on which a program ended by itself, with an error."""
    yield from _claim_unacknowledged(case)
    if fatal_late_answer(case):
        return
    yield from _claim_left_open(case)
    last, fatal = case.last_wait, fatal_wait(case)
    if case.failed and fatal is None and last is not None and not last.is_spoilt:
        yield Doubt('the last question got no answer; whether the program ended for '
                    'that is unknown: it went on after earlier ones, or only searched',
                    last.device, f'ping {last.device:03} alone: if it does not answer, check its '
                    'power, plug and ID; if it does, the program ended for another reason')
    lost = [] if fatal is None else [fatal.device]
    absent = [device.id for device in case.devices
              if device.last_heard_s is None and device.missed_in_a_row
              and not device.window.spoilt and not _was_searched_for(case, device) and (
                  fatal is None or fatal.instruction == Instruction.PING or _is_used(device))]
    if case.failed == words.RAISED or {*lost} & {*absent}:
        lost += absent                 # it asked all, then complained of those
    yield from (_no_answer_claim(case, number) for number in dict.fromkeys(lost)
                if number in case.by_id and number not in case.gone
                and not _is_late(case, case.by_id[number]))


def _is_late(case: Case, device: DeviceReport) -> bool:
    """Tell whether a device answers too late so often that the last question is one more."""
    least = max(INCIDENTS_MIN, LATE_MIN_SHARE * device.window.asked)
    return case.count(ev.LATE, device) >= least or (
        device.last_heard_s is not None and not device.totals.answers)


def _claim_left_open(case: Case) -> Claims:
    """Look at what a program waited for when it was heard last."""
    hung = [(one.device, one.detail.us / 1e6) for one in case.incidents(ev.HUNG)]
    last = case.last_wait
    if last is not None and not last.is_spoilt and last.instruction != Instruction.PING \
            and case.report.is_over and case.now - last.stamp > HUNG_WAIT_NS:
        hung.append((last.device, (case.now - last.stamp) / NS_PER_S))
    for number, seconds in hung:
        yield Claim('did not answer the last question, and the program waits for that without '
                    f'end ({seconds:.0f} s): let it read with a time-out; if it gets no answer '
                    'then, check power and cable', device=number)
    for one in case.incidents(ev.LEFT_OPEN):
        yield Doubt(f'the program ended {one.detail.us / 1000:.0f} ms after it asked: '
                    'whether this answers is unknown', device=one.device)


def _is_used(device: DeviceReport) -> bool:
    """Tell whether a program asked a device for more than Pings."""
    totals = device.totals
    return bool(totals.reads or totals.writes or totals.data_missed or device.acks_missing)


def _was_searched_for(case: Case, device: DeviceReport) -> bool:
    """Tell whether a program only pinged a device, and went on for long without it."""
    pinged = max((stamp for cycle in case.cycles for stamp in cycle.stamps
                  if cycle.instruction == Instruction.PING and cycle.ids == (device.id,)),
                 default=0)
    return not _is_used(device) and any(
        sum(stamp > pinged for stamp in cycle.stamps) >= INCIDENTS_MIN
        for cycle in case.cycles if cycle.instruction != Instruction.PING)


def _claim_unacknowledged(case: Case) -> Claims:
    """Look for devices that were only written to, and never heard."""
    failed, is_over = case.failed, case.report.is_over
    if is_over and not failed and not case.report.is_answered \
            and any(one.acks_missing for one in case.devices) \
            and len(case.report.waits) < INCIDENTS_MIN:
        yield Doubt('writes are sent, and not one byte comes back: no power, another baud '
                    'rate, or Status Return Level below 2', step='let your program read one '
                    'register: if that is answered, all is well; else measure the supply, then '
                    'ping at other rates')
    for device in case.devices if any(one.acks for one in case.devices) else ():
        if device.last_heard_s is None and device.acks_missing \
                and not (device.id in case.gone and device.totals.data_missed) \
                and not device.window.spoilt and not device.moved_to:
            says = (f'never heard, and did not acknowledge {device.acks_missing} writes, as '
                    'others do: check its power, cable, ID and baud rate, or its Status Return '
                    'Level if it answers a Ping')
            yield Claim(says, level=None if failed else Level.WARN, device=device.id) \
                if failed or (is_over and device.acks_missing > ACKS_MISSED_LIMIT) \
                else Doubt(says, device.id, f'ping {device.id:03} alone: if it answers, set its '
                           'Status Return Level to 2; else check its plug and ID'
                           if device.acks_missing >= INCIDENTS_MIN else '')


# --- away and back -------------------------------------------------------------------------------

@Rule(level=Level.ERROR, needs_incident=(ev.RETURNED,),
      symptoms={'restart'},
      accounts_for={'absence', 'missed answers', 'uneven rhythm', 'joint at rest'})
def rebooted(case: Case, device: DeviceReport) -> Found | None:
    """
    Away, back, and restarted: torque off, Realtime Tick back, or it ignores its goal.

    Do: check supply and plug; set it up again.
    """
    if device.window.spoilt * 2 > device.window.missed:
        return None
    for one in absences(case, device):
        proof = _restart_proof(case, one)
        if proof and _talks_since(case, one):
            return Claim(f'restarted by itself, no answers for {one.detail.ms} ms '
                         f'({proof}): check its supply and plug, then set it up again, torque too',
                         {'away (ms)': one.detail.ms, 'seen by': proof})
    return None


@Rule(needs_incident=(ev.RETURNED,),
      symptoms={'absence'},
      accounts_for={'missed answers', 'uneven rhythm', 'joint at rest'})
def dropout(case: Case, device: DeviceReport) -> Found | None:
    """
    Silent for three questions or more, 0.1 s at least, and back; restart not proven.

    Do: check its plugs.
    """
    totals = device.totals
    if device.window.spoilt * 2 > device.window.missed \
            or (totals.data_missed and totals.answers == totals.pongs):
        return None                    # or it answers Pings only
    gaps = [one for one in absences(case, device)
            if one.detail.missed >= INCIDENTS_MIN and _talks_since(case, one)
            and (case.now - one.stamp > RETURN_SETTLED_S * NS_PER_S or case.report.is_over)]
    if not gaps or sum(one.detail.missed for one in gaps) * 2 < device.window.missed:
        return None                    # else answers are lost by chance
    away = max(one.detail.ms for one in gaps)
    others = [other for other in case.devices if other.id != device.id]
    supply = ', or the supply of all: nothing else was heard either' \
        if others and all(other.window.not_served for other in others) else ''
    alike = [other for other in absences(case) for one in gaps
             if abs(other.stamp - one.stamp) <= TOGETHER_S * NS_PER_S
             and abs(other.detail.ms - one.detail.ms) <= TOGETHER_S * 1000]
    together = _adjacent(case, device.id, {one.device for one in alike})
    if together and len(together) < len(case.devices):
        return Claim(f'{first_ids(together, 3)} were silent together for '
                     f'{max(one.detail.ms for one in alike)} ms, others were not: check '
                     f'{_before(case, together)}, and their supply; read Torque Enable to see '
                     'whether they restarted',
                     {'absences': len(gaps), 'longest (ms)': away}, covers=tuple(together))
    after, before = _neighbours(case, device)
    where = '' if before is None else f' between {before:03} and {device.id:03}'
    unserved = f', and {first_ids(after, 2)} after it not served' if after else ''
    return Claim(f'no answers for {away} ms{unserved}: a loose plug{where} or a restart{supply}; '
                 'read Torque Enable or Realtime Tick to find out',
                 {'absences': len(gaps), 'longest (ms)': away})


def _neighbours(case: Case, device: DeviceReport) -> tuple[list[int], int | None]:
    """Return who got no turn after a device in a group read, and who answered before it."""
    for cycle in case.cycles:
        if device.id in cycle.ids[:-1] and cycle.instruction not in WRITES:
            at = cycle.ids.index(device.id)
            after = [one for one in cycle.ids[at + 1:]      # an ID that none can have, too
                     if one in case.by_id and case.by_id[one].window.not_served]
            if after:
                return after, cycle.ids[at - 1] if at else None
    return [], None


def _talks_since(case: Case, back: Incident[ev.SilentFor]) -> bool:
    """Tell whether data came from it since; one that never gave any shall not be held up."""
    ages = _data_ages(case.by_id[back.device]) if back.device in case.by_id else []
    return not ages or min(ages) * NS_PER_S < case.now - back.stamp


def _data_ages(device: DeviceReport) -> list[float]:
    return [one.age_s for one in device.observed
            if one.source == 'r' and one.field.name not in IDENTITY_REGISTERS]


def _restart_proof(case: Case, back: Incident[ev.SilentFor]) -> str:
    """Return what says that a device started again while it was away, '' if nothing does."""
    torque = case.values[back.device].get('Torque Enable') if back.device in case.values else None
    if torque is not None and is_off(torque) and case.now - torque.age_s * NS_PER_S >= back.stamp \
            and back.detail.torque > 0:
        return 'Torque Enable fell to 0'
    samples = case.samples.get(back.device, ())
    before = [one for one in samples if one.stamp < back.stamp - back.detail.ms * NS_PER_MS]
    after = [one for one in samples if one.stamp > back.stamp]
    if before and after and _tick_jumped(before[-1], after[0]):
        return 'Realtime Tick jumped back'
    heat = case.values[back.device].get('Present Temperature') if after else None
    if heat is not None and not heat.value.raw and any(one.position for one in before) \
            and not any(one.position for one in after):
        return 'position and temperature read 0: its indirect addresses are lost'
    device = case.by_id.get(back.device)
    if device is not None and not device.alert \
            and 2 * back.detail.missed >= device.window.missed \
            and does_not_follow(after) and not does_not_follow(before) \
            and span([one.position for one in before]) >= GOAL_MOVES_STEPS \
            and not _goes_beyond(case, device, after):
        return 'no longer follows its goal'        # one of many short absences is a plug
    return ''


def _goes_beyond(case: Case, device: DeviceReport, samples: list[Sample]) -> bool:
    """Tell whether goals are beyond a turn, or the travel of an SCS, where it never was."""
    goal = case.values[device.id].get('Goal Position')
    if goal is None or not (is_of_one_turn(goal.field) or is_scs(goal.field)):
        return False
    top = highest_goal(goal.field)
    return any((one.goal or 0) > top for one in samples) \
        and all((one.position or 0) <= top for one in samples)


def _tick_jumped(before: Sample, after: Sample) -> bool:
    if before.tick is None or after.tick is None:
        return False
    expected = (before.tick + (after.stamp - before.stamp) / NS_PER_S) % TICK_TURN_S
    off = abs(expected - after.tick)
    return TICK_SLACK_S < off < TICK_TURN_S - TICK_SLACK_S and after.tick < expected



# --- partly there --------------------------------------------------------------------------------

@Rule(symptoms={'answers to Pings only'},
      accounts_for={*SILENCE, 'absence', 'restart', 'no acknowledgements'})
def ping_only(case: Case, device: DeviceReport) -> Found | None:
    """
    Answers Pings only, or the program ended on its first write or read.

    Do: write 2 to Status Return Level, 1 for reads alone.
    """
    if not _is_ping_only(case, device):
        return None
    return Claim('answers Pings only: set its Status Return Level to 2, or 1 for '
                 'reads; if it no longer answers a Ping, check its power and cable',
                 {'missed': f'{device.window.missed} of {device.window.asked}'})


def _is_ping_only(case: Case, device: DeviceReport) -> bool:
    """Tell whether it answers Pings, and nothing but Pings, while data are asked for."""
    last, totals = fatal_wait(case), device.totals
    if last is not None and last.device == device.id and last.instruction != Instruction.PING \
            and totals.answers == totals.pongs > 0:
        return True
    is_since = device.id in case.gone and totals.data_missed == totals.missed   # no Ping was
    asked, least = (totals, 1) if is_since else (case.recent_counts(device, GONE_S), 2)
    return asked.answers == asked.pongs >= least and not asked.spoilt \
        and asked.data_missed >= INCIDENTS_MIN


@Rule(symptoms={'missed answers'})
def missed_answers(case: Case, device: DeviceReport) -> Found | None:
    """
    More than 1 % of its answers missing.

    Do: check its plugs.
    """
    window = device.window
    lost = window.missed - window.spoilt - sum(     # what came in the next one's time is there
        case.count(kind, device) for kind in (ev.LATE, ev.SECOND_ANSWER))
    if lost < INCIDENTS_MIN or lost <= MISSED_MIN_SHARE * window.asked:
        return None
    is_gone = device.id in case.gone or device.missed_in_a_row > INCIDENTS_MIN
    if is_gone or is_rate_search(case.report) or case.count(ev.REBOOTED, device) \
            or case.count(ev.MISSED, device) < INCIDENTS_MIN:
        return None
    figures = {'loss': share(lost, window.asked), 'missed': f'{lost} of {window.asked}'}
    if together := _missing_together(case, device):
        return Claim(f'answers of {first_ids(together, 3)} are missing in the same moments, '
                     f'others are not: check {_before(case, together)}', figures)
    return Claim(f'{about(lost, window.asked)} of its answers missing, with no bytes '
                 'in their place: check its plugs; a device that did not get the instruction '
                 'looks the same', figures)


def _missing_together(case: Case, device: DeviceReport) -> list[int]:
    """Return devices, adjacent by ID, that miss answers in the same cycles; [] if it is alone."""
    cycle = max((one for one in case.cycles if device.id in one.ids and len(one.stamps) > 1),
                key=attrgetter('asked'), default=None)
    mine = [one.stamp for one in case.incidents(ev.MISSED, device)][-TOGETHER_KEPT:]
    if cycle is None or len(mine) < TOGETHER_MIN:
        return []
    period = (cycle.stamps[-1] - cycle.stamps[0]) / (len(cycle.stamps) - 1)

    def is_alike(number: int) -> bool:
        stamps = [one.stamp for one in case.incidents(ev.MISSED, case.by_id[number])
                  if one.stamp > mine[0] - period]
        return sum(any(abs(one - stamp) < period for stamp in stamps) for one in mine) \
            >= TOGETHER_MIN_SHARE * max(len(mine), len(stamps))

    ids = sorted(case.by_id)
    at = ids.index(device.id)
    before, after = takewhile(is_alike, reversed(ids[:at])), takewhile(is_alike, ids[at + 1:])
    found = sorted([*before, device.id, *after])
    return found if 1 < len(found) < len(ids) else []


RULES = (brown_out, all_silent, broken_cable, sync_read_stops, no_answer, rebooted,
    ping_only, dropout, missed_answers)
