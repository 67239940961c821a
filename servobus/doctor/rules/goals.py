# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""Goals, and joints that do not go there: limits, bytes and signs, torque, mode."""

from __future__ import annotations

from collections.abc import Iterable
from itertools import groupby
from itertools import pairwise
from math import isclose
from math import tau
from operator import itemgetter
from operator import ne

from msg_defs.diagnostics import Level
from msg_defs.dxl1_instruction import FEETECH
from msg_defs.nanoseconds import NS_PER_S
from servobus.bus import evidence as ev
from servobus.bus.report import DeviceReport
from servobus.bus.table import Observed
from servobus.doctor.case import Case
from servobus.doctor.case import Sample
from servobus.doctor.case import SIGN_BIT
from servobus.doctor.case import SPEED_AT_REST
from servobus.doctor.case import speed_of
from servobus.doctor.facts import absences
from servobus.doctor.facts import ACCESS_ERROR
from servobus.doctor.facts import does_not_follow
from servobus.doctor.facts import FOLLOW_WINDOW_S
from servobus.doctor.facts import highest_goal
from servobus.doctor.facts import is_of_one_turn
from servobus.doctor.facts import is_off
from servobus.doctor.facts import is_scs
from servobus.doctor.facts import is_watched
from servobus.doctor.facts import least_refusals
from servobus.doctor.facts import LIMIT_ERROR
from servobus.doctor.facts import most_refused
from servobus.doctor.facts import raw_value
from servobus.doctor.facts import recent_samples
from servobus.doctor.facts import since_it_moved
from servobus.doctor.facts import SINGLE_WRITES
from servobus.doctor.facts import span
from servobus.doctor.facts import STOPPED_MIN_S
from servobus.doctor.rule import Claim
from servobus.doctor.rule import Doubt
from servobus.doctor.rule import Found
from servobus.doctor.rule import Rule
from servobus.doctor.thresholds import GOAL_FAR_STEPS
from servobus.doctor.thresholds import GOAL_MOVES_STEPS
from servobus.doctor.thresholds import INCIDENTS_MIN
from servobus.doctor.thresholds import SPEED_MIN
from servobus.doctor.thresholds import STILL_MAX_STEPS
from servobus.doctor.thresholds import STILL_MIN_REPORTS
from servobus.doctor.thresholds import TURN_STEPS
from servobus.doctor.thresholds import WINDOW_S
from servobus.model.control_table import Field

SIGN_AT = 15                       # the bit of a velocity of Feetech that is its sign
NEGATIVE_MAX = 8192                # as two's complement; without it 24576: no servo is so fast
ROUND_SPEED = 100
BYTE = 256
AX_STEPS = 1024                    # the positions of AX and RX (e-Manual)
FAR_OF_AX_STEPS = 50               # as GOAL_FAR_STEPS, of an AX
AX_RANGE = 300 * tau / 360         # rad that these steps are of
GOAL_CHANGES_MIN = 3               # after so many a joint that rests at its stop has moved
POSITION_CONTROL = 3               # a value of Operating Mode (e-Manual)
GOALS_BEYOND_MIN = 2               # one may be a slip of a person
WORD = 65_536
LOAD_SIGN = 1024                   # the bit of a load of Feetech that is its sign; in 0.1 %
LOAD_AT_REST = 100                 # who is held back by something pushes with more
SHORT_MIN_REPORTS = 3              # at rest in so many: it is not on its way
SHORT_MIN_STOPS = 2                # that it reached another goal between shows that it can move
_RATES = 'Velocity', 'Current', 'PWM'
_POSITION_LIMITS = 'Min Position Limit', 'Max Position Limit'
_ANGLE_LIMITS = 'CW Angle Limit', 'CCW Angle Limit'    # with Protocol 1.0
JUMP_NS = NS_PER_S                 # a slower one is a motion with a set speed
STILL_MIN_S = 2.5                  # the same where its torque was not read
STEPS_MIN_GOALS = 2                # one may be chance
VELOCITY_CONTROL = 1               # a value of Operating Mode (e-Manual; Feetech, STS table)
TURN_ONSET_S = 1.5                 # by then it turns, however it accelerates
_DECIDES_TURNING = {'Velocity Limit': 'Velocity Limit (a goal beyond it is refused)',
                    'Torque Enable': 'Torque Enable', 'Operating Mode': 'Operating Mode'}
_PLACE = 'Present Position'
_MOTION = _PLACE, 'Torque Enable'
_PLACE_AND_MODE = _PLACE, 'Operating Mode'
# Values of Operating Mode in which goals are positions (e-Manual), and those of Feetech.
_POSITION_MODES = (3, 4, 5), (0, 3)
_TORQUE_OF_HLS = 'Goal Time or Goal Torque'    # what series is not known (model/model_guesses.py)
_FORCES = 'Torque Limit', 'Goal Torque', 'Goal PWM', 'PWM Limit'      # 0 in one: it has none


# --- goals that a servo does not take ------------------------------------------------------------

@Rule(symptoms={'refused value'},
      accounts_for={'refused access', 'joint at rest'})
def goal_limits(case: Case, device: DeviceReport) -> Found | None:
    """
    Values beyond its limits, refused or not; swapped bytes, a wrong sign.

    Do: limit the goals, or set wider limits.
    """
    if ev.REFUSED in case.incidents_by_kind and (refusal := _value_refused(case, device)):
        return refusal
    values = case.values[device.id]
    is_feetech = device.model.protocol == FEETECH.protocol
    if is_feetech and (found := _goals_swapped(case, device) or _stops_short(case, device)):
        return found
    for name in _RATES:
        if f'Goal {name}' in values and f'{name} Limit' in values \
                and (beyond := _rate_beyond(name, values)):
            return beyond
    if is_feetech and 'Goal Velocity' in values \
            and (otherwise := _sign_otherwise(values['Goal Velocity'])):
        return otherwise
    return _position_beyond(case, device) if 'Goal Position' in values else None


def _value_refused(case: Case, device: DeviceReport) -> Found | None:
    address, _, count = most_refused(case, device, lambda one: (
        one.error == LIMIT_ERROR and one.instruction in SINGLE_WRITES))
    if count < least_refusals(case, device, GOALS_BEYOND_MIN):
        return None
    field = device.model.by_address.get(address)
    remedy = 'they may be those of another Operating Mode, of which the write was refused' \
        if _is_mode_refused(case, device) else \
        'keep goals within these, or set wider ones (as Max Position Limit)'
    return Claim(f'value for {field.name if field else f"address {address}"} refused, beyond its '
                 f'limits: {remedy}', {'refused': count})


def _is_mode_refused(case: Case, device: DeviceReport) -> bool:
    """Tell whether a write of Operating Mode was refused, as the torque was on."""
    mode = device.model.by_name.get('Operating Mode')
    return mode is not None and 'Operating Mode' not in case.values[device.id] and any(
        at == mode.at and error == ACCESS_ERROR for _, at, error in device.errors)


def _rate_beyond(name: str, values: dict[str, Observed]) -> Found | None:
    """Look for a velocity, current or PWM beyond its limit; nothing answers a Sync Write."""
    goal, limit = values[f'Goal {name}'], values[f'{name} Limit']
    if goal.source != 'w' or not limit.value.raw \
            or abs(goal.value.raw) <= limit.value.raw \
            or (limit.source == 'w' and limit.age_s < goal.age_s):     # it was wider then
        return None
    most = limit.value.raw
    return Claim(f'Goal {name} {goal.value.raw} is beyond its {name} Limit of {most}, so it '
                 f'is refused{_meant(goal.field, goal.value.raw, -most, most)}: send less, '
                 'or set a wider limit',
                 rests_on=(f'Goal {name}', f'{name} Limit'))


def _sign_otherwise(goal: Observed) -> Found | None:
    """Look for a negative velocity that a servo of Feetech reads as one faster than any."""
    code = int(goal.value.raw)
    # Who means as fast as it can, sends the greatest number or a round one.
    if goal.source != 'w' or goal.field.sign_bit != SIGN_AT \
            or not SPEED_MIN <= WORD - code <= NEGATIVE_MAX or not code % SIGN_BIT % ROUND_SPEED \
            or not _swapped(goal.field, code) % ROUND_SPEED:
        return None
    return Claim(f'Goal Velocity 0x{code:X} is {SIGN_BIT - code}, faster than any servo: bit '
                 f'{SIGN_AT} is its sign, the others are its speed; {code - WORD} is '
                 f'0x{SIGN_BIT | (WORD - code):X}', rests_on=('Goal Velocity',))


def _meant(field: Field, raw: float, low: float, high: float) -> str:
    """Return what a value that cannot be may have been meant as, as words in brackets."""
    swapped = _swapped(field, raw)
    if low <= swapped <= high and abs(raw) > 2 * high:             # not just beyond
        return f' (in the other order of bytes it is {swapped})'
    is_negative = WORD // 2 <= raw < WORD and WORD - raw < raw % SIGN_BIT
    return f' (as two bytes with sign it is {raw - WORD:.0f})' if is_negative else ''


def _swapped(field: Field, raw: float) -> float:
    """Return a raw value with its bytes in the other order."""
    code = int(raw) % (1 << 8 * field.size)            # its bytes without a sign
    return field.decode(field.bytes_of(code)[::-1]).raw


def _position_beyond(case: Case, device: DeviceReport) -> Found | None:
    """Look for goals beyond the limits, or beyond a turn."""
    values = case.values[device.id]
    goal, is_feetech = values['Goal Position'], device.model.protocol == FEETECH.protocol
    has_mode = 'Operating Mode' in values
    if goal.source != 'w' or (has_mode and values['Operating Mode'].value.raw != (
            0 if is_feetech else POSITION_CONTROL)):
        return None
    names = _ANGLE_LIMITS if device.model.protocol == '1' else _POSITION_LIMITS
    if names[1] in values:
        low, high = (raw_value(case, device, name) or 0 for name in names)
        if low < high and _are_limits(device, values, names[0], high - low):
            return _goals_held_back(case, device, names, low, high)
    if device.model.protocol == '1' or (is_feetech and not values.keys().isdisjoint(names)) \
            or not (is_of_one_turn(goal.field) or is_scs(goal.field)):
        return None                            # Feetech: both are 0 where it has none
    return _goals_beyond_a_turn(case, device, goal.field, has_mode)


def _are_limits(device: DeviceReport, values: dict[str, Observed], lower: str,
                width: float) -> bool:
    """Tell whether position limits so far apart are in force; the upper one is known."""
    within_turn = width < TURN_STEPS - 1       # with both at the end of a turn, an MX counts turns
    if device.model.protocol == '2':
        return lower in values and within_turn and 'Operating Mode' in values
    return device.model.protocol == FEETECH.protocol or lower in values or within_turn


def _goals_swapped(case: Case, device: DeviceReport) -> Found | None:
    """Look for goals of which some cannot be, and with their bytes swapped all can, of late."""
    clear = _clearly_swapped_goals(case, device)
    if not clear or len({goal for other in case.devices
                         for goal in _clearly_swapped_goals(case, other)}) < GOALS_BEYOND_MIN:
        return None
    goal, meant = max(clear.items())
    field = device.model.by_name['Goal Position']
    mine, other_one = ('high', 'low') if is_scs(field) else ('low', 'high')
    return Claim(f'goals as {goal} are sent, beyond 0 to {highest_goal(field)}; with their two '
                 f'bytes swapped all are within ({meant}): it takes the {mine} byte first, the '
                 f'program sends the {other_one} one first, as to another series: swap them, also '
                 'in what it reads', {'as sent': goal, 'swapped': meant},
                 rests_on=('Goal Position',))


def _clearly_swapped_goals(case: Case, device: DeviceReport) -> dict[float, float]:
    """Return goals that cannot be, and what they are with their bytes swapped, as all can be."""
    goal = case.values[device.id].get('Goal Position')
    if goal is None or goal.source != 'w' or raw_value(case, device, 'Operating Mode'):
        return {}
    top, clear = highest_goal(goal.field), {}
    for one in reversed(case.samples.get(device.id, ())):
        if one.goal is None:
            continue                           # between two reports
        swapped = _swapped(goal.field, one.goal)
        if not (0 <= swapped <= top and 0 <= (one.position or 0) <= top):
            break
        if one.goal > top and swapped >= BYTE:         # whole turns, swapped, are small numbers
            clear[one.goal] = swapped
    return clear


def _stops_short(case: Case, device: DeviceReport) -> Found | None:
    """Look for a joint that stops before its goals again and again, and does not push there."""
    load = case.values[device.id].get('Present Load')
    if load is None or load.source != 'r' or load.age_s > STOPPED_MIN_S \
            or load.value.raw % LOAD_SIGN > LOAD_AT_REST or device.window.alerts \
            or raw_value(case, device, 'Torque Enable') == 0:
        return None
    stops: list[tuple[float, float]] = []
    reached = False
    since = case.stamp_ago(load.age_s)
    known = [(one.goal, one.position) for one in case.samples.get(device.id, ())
             if one.goal is not None and one.position is not None and one.stamp < since]
    for goal, many in groupby(known, key=itemgetter(0)):
        places = [place for _, place in many]
        reached |= any(_is_at(goal, place) for place in places)
        rest = places[-SHORT_MIN_REPORTS:]
        if len(rest) == SHORT_MIN_REPORTS and span(rest) <= STILL_MAX_STEPS \
                and abs(goal - rest[-1]) > GOAL_FAR_STEPS:
            stops.append((goal, rest[-1]))
    if len(stops) < SHORT_MIN_STOPS or not reached or known[-1][0] != stops[-1][0]:
        return None
    goal, place = stops[-1]
    return Claim(f'stops at {place:.0f} on its way to {goal:.0f}, as before, and does not push '
                 f'there (load {load.value.raw % LOAD_SIGN / 10:.0f} %): it has a limit there; '
                 'read Min and Max Position Limit, set wider ones or keep goals within them',
                 {'stops': len(stops)})


def _goals_held_back(case: Case, device: DeviceReport, names: tuple[str, str], low: float,
                     high: float) -> Found | None:
    """Look for goals beyond limits that were read."""
    beyond = {one.goal for one in case.samples.get(device.id, ())
              if one.goal is not None and not low <= one.goal <= high}
    if not beyond or (len(beyond) < GOALS_BEYOND_MIN and device.window.writes < INCIDENTS_MIN):
        return None                            # it was sent once
    farthest = max(beyond, key=lambda goal: abs(2 * goal - low - high))
    field = device.model.by_name['Goal Position']
    effect = 'it stops there' if device.model.protocol == FEETECH.protocol else 'it refuses them'
    return Claim(f'goals beyond its limits of {low} to {high} are sent'
                 f'{_meant(field, farthest, low, high)}: {effect}; keep goals within them, or '
                 f'set wider ones ({names[0].partition(" ")[0]} and {names[1]})',
                 {'the farthest': farthest}, rests_on=('Goal Position', *names))


def _goals_beyond_a_turn(case: Case, device: DeviceReport, field: Field,
                         is_certain: bool) -> Found | None:
    """Look for goals beyond a turn, where no limits are known and it does not go there."""
    samples, top = case.samples.get(device.id, ()), highest_goal(field)
    beyond = [one for one in samples if one.goal is not None and not 0 <= one.goal <= top]
    if len(beyond) < GOALS_BEYOND_MIN:
        return None
    places = [one.position for one in beyond if one.position is not None]
    still = sum(0 <= two <= top and abs(one - two) <= STILL_MAX_STEPS
                for one, two in pairwise(places))
    is_feetech = device.model.protocol == FEETECH.protocol
    torque = case.values[device.id].get('Torque Enable')
    is_at_rest = still >= STILL_MIN_REPORTS and (
        torque.value.raw == 1 if torque is not None else device.window.writes >= INCIDENTS_MIN)
    moved_before = still >= GOALS_BEYOND_MIN \
        and not {*places}.issuperset(one.position for one in samples)
    # In another mode, or without limits, it would go there; an SCS never.
    has_no_turns = is_scs(field) and all(0 <= place <= top for place in places)
    if not (is_at_rest or moved_before or has_no_turns or (is_certain and not is_feetech)):
        return None
    remedy = 'keep them within, and read Min and Max Position Limit' if is_feetech else \
        'keep them within, or set Extended Position Control Mode' if is_certain or moved_before \
        else 'keep them within, and read Operating Mode and Torque Enable'
    who = 'it does not go to' if is_feetech else 'Position Control Mode refuses'
    last = beyond[-1].goal or 0.0
    return Claim(f'goals beyond 0 to {top} are sent'
                 f'{_meant(field, last, 0, top)}, which {who}: {remedy}',
                 {'the last': last}, rests_on=('Goal Position', 'Operating Mode'))


# --- joints that do not follow -------------------------------------------------------------------

@Rule(needs_registers={'Present Position'},
      symptoms={'joint at rest'})
def torque_off(case: Case, device: DeviceReport) -> Found | None:
    """
    Goals change, and the joint does not move.

    On both sides, or twice, or nothing set the torque, or its limit is 0.

    Do: switch the torque on, or free the joint.
    """
    samples = since_it_moved(recent_samples(case, device.id))
    place = case.values[device.id]['Present Position']
    if place.source != 'r' or place.age_s > STOPPED_MIN_S or device.alert \
            or not does_not_follow(samples):
        return None                    # or its error says why
    torque, goal = map(case.values[device.id].get, ('Torque Enable', 'Goal Position'))
    if torque is not None and not torque.value.raw and (
            torque.age_s < FOLLOW_WINDOW_S if torque.source == 'r'
            else goal is not None and goal.age_s < torque.age_s):
        return Claim('goals are sent to it, but its torque is off: switch it on '
                     '(Torque Enable 1); after a restart, write all its settings again',
                     rests_on=_MOTION)
    force = _force_at_zero(case, device)
    if force:
        return Claim(f'goals are sent to it, but its {force} is 0, so it has no force: write '
                     'more to that', rests_on=(_PLACE, force))
    if device.model.protocol == '1' and device.window.alerts:
        return Claim('goals change, and it has not moved since the error in its answers: after an '
                     'overload its Torque Limit is 0; free the joint, then write Max Torque to '
                     'Torque Limit (34), or switch its power off and on', rests_on=_MOTION)
    may_hold = device.id in case.turned and not absences(case, device)
    if (torque is None or torque.source == 'w') \
            and is_watched(case, device, place) and _is_ignored(
                [*case.samples[device.id]], 0.1 / (place.field.scale or 0.001), may_hold):
        first = 'read Torque Enable and Operating Mode' \
            if torque is not None and 'Operating Mode' in device.model.by_name \
            else 'write 1 to Torque Enable'
        if raw_value(case, device, _TORQUE_OF_HLS) == 0 and device.id not in case.turned:
            first = 'an HLS servo has no force with the Goal Torque 0 that is sent to it; else ' \
                f'{first}'
        return Claim('goals leave its position on both sides or repeatedly, and it '
                     f'does not move: {first}, or check its motor and what '
                     'blocks it', rests_on=_MOTION)
    if device.model.protocol == '1' and (why := _why_no_ax(case, place.value.raw)):
        return Claim(f'goals change, and no joint moves; {why}: a Feetech servo has its goal at '
                     '42 and its position at 56; if it is an AX or MX, write 1 to Torque Enable',
                     rests_on=_MOTION)
    if may_hold or (
            torque is not None and torque.value.raw and not absences(case, device)):
        return None                    # it is on, so something holds it, or it is where it can be
    who = ', others do' if _others_move(case, device, samples) else ''
    if not who and torque is None and case.has_sides and device.model.protocol == '2' \
            and span([one.goal for one in samples[1:]]) >= GOAL_FAR_STEPS:
        who = ', nothing set its torque'
    if samples[-1].stamp - samples[0].stamp < STILL_MIN_S * NS_PER_S or not who:
        return None
    return Claim(f'its goal changes but the joint does not move{who}: its '
                 'torque is off or it is blocked; read Torque Enable, switch it on',
                 rests_on=_MOTION)


@Rule(needs_registers={'Goal Position', _PLACE},
      symptoms={'joint at rest'},
      accounts_for={'joint at rest'})
def operating_mode(case: Case, device: DeviceReport) -> Found | None:
    """
    It turns past its goals, moves by them, or its mode has no goal positions.

    Do: write its Operating Mode.
    """
    values = case.values[device.id]
    goal, place = values['Goal Position'], values[_PLACE]
    if goal.source != 'w' or place.source != 'r' or place.age_s > STOPPED_MIN_S or device.alert:
        return None
    torque, mode = values.get('Torque Enable'), values.get('Operating Mode')
    if is_off(torque):
        return None
    is_feetech = device.model.protocol == 'feetech'
    if mode is not None and (mode.value.raw in _POSITION_MODES[is_feetech] or (
            mode.source == 'w' and mode.age_s < goal.age_s)):
        return None
    remedy = 'write its angle limits: with 0 in both it is a wheel' \
        if device.model.protocol == '1' else 'write 0 (position) to Operating Mode, with Lock 0' \
        if is_feetech else 'switch its torque off, write 3 (position) to Operating Mode'
    if device.id in case.turned and _turns_past_goals(case, device, goal.field):
        return Claim('its goals are within one turn, and it turns on and on past them, as in '
                     f'velocity or PWM mode: {remedy}', rests_on=_PLACE_AND_MODE)
    if is_feetech and device.id in case.turned and _moves_by_its_goals(case.samples[device.id]):
        return Claim('it moves by its goals, not to them, as in step mode: '
                     f'{remedy}', rests_on=_PLACE_AND_MODE)
    if mode is None or not does_not_follow(since_it_moved(recent_samples(case, device.id))):
        return None
    return Claim(f'its Operating Mode is {mode.value.text}, in which goal positions do '
                 f'nothing: {remedy}', rests_on=_PLACE_AND_MODE)


def _moves_by_its_goals(samples: Iterable[Sample]) -> bool:
    """Tell whether each new goal moves a joint by so many steps, and not to that place."""
    known = [(one.goal, one.position) for one in samples
             if one.goal is not None and one.position is not None]
    ends = [before for before, after in pairwise(known) if before[0] != after[0]]
    if len(known) > 1 and known[-2] == known[-1]:
        ends.append(known[-1])                 # it is at rest
    way = 0.0
    for (_, start), (goal, end) in pairwise(ends):
        if not _is_at((start + goal) % TURN_STEPS, end) or _is_at(goal, end):
            return False
        way = max(way, abs(end - start))
    return len(ends) > STEPS_MIN_GOALS and way > GOAL_FAR_STEPS


def _is_at(place: float, position: float) -> bool:
    return abs(place - position) <= GOAL_MOVES_STEPS


def _force_at_zero(case: Case, device: DeviceReport) -> str:
    """Return the register which leaves a servo without force, '' if there is none."""
    return next((name for name in _FORCES if raw_value(case, device, name) == 0), '')


def _turn_of(field: Field) -> int:
    """Return after how many steps a position begins at 0 again, 0 where that is unknown."""
    is_of_ax = isclose(AX_STEPS * (field.scale or 0.0), AX_RANGE, abs_tol=0.01)
    return TURN_STEPS if is_of_one_turn(field) else AX_STEPS if is_of_ax else 0


def _turns_past_goals(case: Case, device: DeviceReport, field: Field) -> bool:
    """Tell whether a joint goes half a turn and more in one way, away from goals in one turn."""
    samples = case.samples[device.id]
    moved = abs((samples[-1].position or 0) - (samples[-2].position or 0)) \
        if len(samples) > INCIDENTS_MIN else 0
    if moved <= FAR_OF_AX_STEPS:
        return False                           # it does not turn now
    turn = _turn_of(field)
    far = GOAL_FAR_STEPS if turn == TURN_STEPS else FAR_OF_AX_STEPS
    if moved <= far:
        return False
    known = [(one.goal, one.position) for one in samples
             if one.goal is not None and one.position is not None]
    if not all(0 <= goal < turn and 0 <= place < turn for goal, place in known):
        return False
    half = turn // 2
    steps = [(two - one + half) % turn - half for (_, one), (_, two) in pairwise(known)]
    way = 1 if sum(steps) > 0 else -1
    beyond = [way * (place - goal) > far for goal, place in known]
    away = sum(before and after and way * step > far
               for (before, after), step in zip(pairwise(beyond), steps, strict=True))
    return way * sum(steps) >= half and min(way * step for step in steps) >= -STILL_MAX_STEPS \
        and away >= INCIDENTS_MIN


@Rule(level=Level.OK, needs_registers={'Goal Position', _PLACE, 'Torque Enable'})
def torque_jump(case: Case, device: DeviceReport) -> Found | None:
    """
    Torque was switched on far from its goal: it jumped there.

    Do: write its position as goal first.
    """
    values = case.values[device.id]
    torque, goal = values['Torque Enable'], values['Goal Position']
    if torque.source != 'w' or torque.value.raw != 1 or goal.source != 'w' \
            or not torque.age_s < min(goal.age_s, WINDOW_S):
        return None
    since = case.stamp_ago(torque.age_s)
    known = [one for one in case.samples[device.id]
             if one.torque is not None and one.position is not None]
    before = [one for one in known if one.stamp < since]
    after = [one for one in known if since < one.stamp < since + JUMP_NS]
    if not before or not after or before[-1].torque != 0:
        return None
    way, left = (abs(goal.value.raw - (one[-1].position or 0)) for one in (before, after))
    if way <= GOAL_FAR_STEPS or left > GOAL_MOVES_STEPS:
        return None
    return Claim(f'its torque was switched on {way:.0f} steps from its old goal, and it went '
                 'there at once: write its position to Goal Position before')


@Rule(onset_s=TURN_ONSET_S, needs_registers={'Goal Velocity', 'Present Velocity'},
      symptoms={'joint at rest'})
def wheel_stopped(case: Case, device: DeviceReport) -> Found | None:
    """
    A velocity is asked for, and it never turns.

    Do: read Velocity Limit, Torque Enable and Operating Mode.
    """
    values = case.values[device.id]
    goal, now = values['Goal Velocity'], values['Present Velocity']
    if device.alert or goal.source != 'w' or now.source != 'r' or now.age_s > STOPPED_MIN_S \
            or speed_of(goal) < SPEED_MIN or speed_of(now) > SPEED_AT_REST \
            or not _is_in_velocity_control(device, values) or _is_mode_refused(case, device):
        return None                            # its mode is another one: eeprom_locked
    if device.id in case.turned:
        return Doubt(f'velocity {goal.value.raw} is asked for, and it does not turn any more: '
                     'blocked, or it holds something')
    unread = [words for name, words in _DECIDES_TURNING.items() if name not in values]
    remedy = 'its torque is off: write 1 to Torque Enable' \
        if is_off(values.get('Torque Enable')) else \
        f'read {", ".join(unread)}' if unread else 'check what blocks it, and its supply'
    return Claim(f'velocity {goal.value.raw} is asked for, and it does not turn: {remedy}',
                 rests_on=('Present Velocity', 'Goal Velocity'))


def _is_in_velocity_control(device: DeviceReport, values: dict[str, Observed]) -> bool:
    """Tell whether Goal Velocity makes it turn; with Profile Velocity it is that of a motion."""
    mode, place = map(values.get, ('Operating Mode', 'Goal Position'))
    if mode is not None:
        return mode.value.raw == VELOCITY_CONTROL
    return 'Profile Velocity' in device.model.by_name and (place is None or place.source != 'w')


def _others_move(case: Case, device: DeviceReport, samples: list[Sample]) -> bool:
    """Tell whether another joint moves while this one does not."""
    since = samples[1].stamp
    return any(span([one.position for one in recent_samples(case, other) if one.stamp >= since])
               >= GOAL_MOVES_STEPS for other in case.samples if other != device.id)


def _why_no_ax(case: Case, place: float) -> str:
    """Return what shows, where no joint moves by changing goals, that there is no AX; or ''."""
    driven = [samples for samples in case.samples.values() if len(samples) > STILL_MIN_REPORTS
              and span([one.goal for one in samples]) >= GOAL_MOVES_STEPS]
    if len(driven) < 2 or not all(
            0 <= span([one.position for one in samples]) <= STILL_MAX_STEPS
            and sum(one.goal != two.goal for one, two in pairwise(samples)) >= GOAL_CHANGES_MIN
            for samples in driven):
        return ''
    if len({samples[-1].position for samples in driven}) == 1:
        return f'each has the position {place}, as another register reads'
    highest = max(one.goal or 0 for samples in driven for one in samples)
    return f'its position {place} is beyond the {AX_STEPS - 1} of an AX' \
        if place >= AX_STEPS > highest else ''


def _is_ignored(samples: list[Sample], least: float, may_hold: bool) -> bool:
    """
    Tell whether no goal moves a joint, on both sides of it, or away from it and back again.

    One that is blocked ignores one side, as a gripper does that has closed and holds something.
    """
    ways = [one.goal - one.position for one in samples[1:]
            if one.goal is not None and one.position is not None]
    ends = [abs(one) > least for one in ways if not least / 3 < abs(one) < 3 * least]
    is_repeated = not may_hold and sum(map(ne, ends, ends[1:])) > 2
    return does_not_follow(samples) and (is_repeated or min(
        sum(one > least for one in ways), sum(one < -least for one in ways)) > 1)


RULES = (goal_limits, torque_off, operating_mode, torque_jump, wheel_stopped)
