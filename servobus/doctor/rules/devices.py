# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""The devices themselves: their own state, as control table and alert bit tell it."""

from __future__ import annotations

from math import inf
from operator import ne
from operator import sub

from msg_defs.diagnostics import Level
from msg_defs.nanoseconds import NS_PER_S
from servobus.bus import evidence as ev
from servobus.bus import report as words
from servobus.bus.report import DeviceReport
from servobus.bus.table import Observed
from servobus.doctor.case import Case
from servobus.doctor.case import Sample
from servobus.doctor.case import SIGN_BIT
from servobus.doctor.facts import ALIVE_MIN_VOLTS
from servobus.doctor.facts import is_of_one_turn
from servobus.doctor.facts import is_off
from servobus.doctor.facts import is_watched
from servobus.doctor.facts import last_read
from servobus.doctor.facts import limit_of
from servobus.doctor.facts import RANGE_ERROR
from servobus.doctor.facts import raw_value
from servobus.doctor.facts import span
from servobus.doctor.facts import SUPPLY
from servobus.doctor.rule import all_ids
from servobus.doctor.rule import ANSWER
from servobus.doctor.rule import Claim
from servobus.doctor.rule import Claims
from servobus.doctor.rule import Doubt
from servobus.doctor.rule import first_ids
from servobus.doctor.rule import Found
from servobus.doctor.rule import Rule
from servobus.doctor.thresholds import DIP_MAX_SHARE
from servobus.doctor.thresholds import GOAL_FAR_STEPS
from servobus.doctor.thresholds import INCIDENTS_MIN
from servobus.doctor.thresholds import STILL_MAX_STEPS
from servobus.doctor.thresholds import STILL_MIN_REPORTS
from servobus.doctor.thresholds import SUPPLY_MIN_DEVICES
from servobus.doctor.thresholds import TURN_STEPS
from servobus.doctor.thresholds import WINDOW_S

NEAR_DEGREES = 5.0                 # to its limit: a load that goes on brings it there
NEAR_VOLTS = 0.3                   # to a limit: a motion takes it there
WATCHDOG_TRIPPED = (0xFF, -1)
WATCHDOG_UNIT_S = 0.02             # what Bus Watchdog counts in (e-Manual)
EDGE_STEPS = 1024                  # so near the ends of a turn it may jump across
GOAL_BYTES = 2                     # with four a position does not end at a turn
VALUE_FRESH_S = 3.0                # loops send and read several times a second: it is of now
WRAPS_MIN = 2                      # across the end of the turn and back
ERROR_BYTE_BY_CHANCE = 8           # damaged answers to one error byte: their sum has one byte
_FREE_IT = ('free the joint or reduce its load; then switch its torque off and on, or its power '
            'if that does not help')
# What to do about an error bit of the 1.0 family, by a part of its name; the first that fits.
_REMEDIES = {
    'voltage': 'measure the voltage at the plug of the servo; compare it with its label',
    'overheating': 'let it cool and reduce its load',
    'angle limit': 'keep its goals within its limits; if the error stays after power off and '
                   'on, its sensor is broken',
    'overload': _FREE_IT,
    'current': _FREE_IT}
_OF_SUPPLY = 'voltage'     # ends the name of the first bit of the 1.0 family where it is alone
AT_ZERO_MAX = 1                    # as another register reads, or a dead sensor
ZERO_MIN_REPORTS = 8               # 4 s: a joint goes there, and does not stay through far goals
_PLACE = 'Present Position'
_HEAT = 'Present Temperature', 'Temperature Limit'
_ERRORS = ('Hardware Error Status', 'Error Code')


@Rule(level=Level.ERROR, holds=False,
      symptoms={'error bits'})
def hardware_error(case: Case, device: DeviceReport) -> Found | None:
    """
    The alert bit; WARN until Hardware Error Status is read.

    In the 1.0 family it is the state of now.

    Do: remove the cause, then Reboot (Dynamixel 2.0).
    """
    if not device.alert or device.last_error.endswith(_OF_SUPPLY):
        return None
    return latched_error(device, _likely_error(case.highest.get(device.id, 0.0),
                                               [*case.samples.get(device.id, ())]))


def _likely_error(highest: float, samples: list[Sample]) -> str:
    """Return what the error of a device with an alert is by its registers, '' if unknown."""
    volts = [one.voltage for one in samples if one.voltage]
    if volts and min(volts) < DIP_MAX_SHARE * highest:
        return ', likely Input Voltage: its supply falls when joints move; use a stronger one'
    recent = samples[-STILL_MIN_REPORTS:]
    ways = [one.goal - one.position for one in recent
            if one.goal is not None and one.position is not None]
    if len(ways) < STILL_MIN_REPORTS or span([one.position for one in recent]) > STILL_MAX_STEPS \
            or not min(ways) < -GOAL_FAR_STEPS < GOAL_FAR_STEPS < max(ways):
        return ''
    return (', likely Overload: its torque is off, as it ignores goals on both sides; free the '
            'joint or limit its current')


def latched_error(device: DeviceReport, likely: str = '') -> Claim | None:
    """Return the hardware error of a device, by its alert bit; likely: what it is if not read."""
    is_2 = device.protocol == words.PROTOCOL_2
    if not device.alert or not device.window.alerts \
            or (not is_2 and ERROR_BYTE_BY_CHANCE * device.window.alerts <= device.window.spoilt):
        return None
    values = {one.field.name: one for one in device.observed}
    torque = ', torque is off' if is_off(values.get('Torque Enable')) else ''
    figures = {'answers with alert': device.window.alerts}
    if not is_2:                               # bits that say what is, with nothing to read
        remedy = next((remedy for bit, remedy in _REMEDIES.items() if bit in device.last_error),
                      'switch it off and on')
        return Claim(f'{device.last_error} error in its answers{torque}: {remedy}',
                     figures, device=device.id, rests_on=(ANSWER,))
    seen = next((values[name] for name in _ERRORS
                 if name in values and values[name].value.raw), None)
    if seen is None:
        return Claim(f'alert in its answers{torque}: an error is latched{likely}; read '
                     'Hardware Error Status, then reboot it', figures, Level.WARN,
                     device=device.id, rests_on=(ANSWER,))
    return Claim(f'{seen.value.text} error latched{torque}: remove the cause, then '
                 'send Reboot; until then it does not move', figures, device=device.id,
                 rests_on=(ANSWER,))


@Rule(level=Level.ERROR, needs_registers={'Bus Watchdog'},
      accounts_for={'refused address', 'refused access', 'joint at rest'})
def watchdog(case: Case, device: DeviceReport) -> Found | None:
    """
    Bus Watchdog has stopped it.

    Do: write 0 to it; write goals more often.
    """
    seen = case.values[device.id]['Bus Watchdog']
    refused = sum(one.detail.error == RANGE_ERROR and _is_goal(device, one.detail.address)
                  for one in case.incidents(ev.REFUSED, device))
    tripped = seen.source == 'r' and seen.value.raw in WATCHDOG_TRIPPED
    if not tripped and not (refused >= INCIDENTS_MIN and seen.value.raw):
        return _watchdog_outlasted(case, seen)
    return Claim(f'Bus Watchdog tripped, {refused} goals refused: the master was '
                 'silent too long; write 0 to Bus Watchdog, then send goals without such gaps',
                 {'goals refused': refused, 'read': 'yes' if tripped else 'no'},
                 rests_on=('Bus Watchdog',) if tripped else ())


def _watchdog_outlasted(case: Case, seen: Observed) -> Claim | None:
    """Look for a pause that was longer than the Bus Watchdog, which nothing has cleared since."""
    limit_s, since = WATCHDOG_UNIT_S * seen.value.raw, case.stamp_ago(seen.age_s)
    pauses = [(stamp - period, stamp) for stamp, period in case.loop
              if period > limit_s * NS_PER_S > 0 and stamp - period > since]
    stamps = [stamp for cycle in case.cycles for stamp in cycle.stamps] if pauses else []
    for begin, end in pauses:
        known = [begin, *sorted(stamp for stamp in stamps if begin < stamp < end), end]
        pause_s = max(map(sub, known[1:], known)) / NS_PER_S
        if pause_s > limit_s:
            return Claim(f'its Bus Watchdog of {1000 * limit_s:.0f} ms is shorter than a pause of '
                         f'the master of {pause_s:.1f} s: it stopped then, and takes no goals '
                         'until Bus Watchdog is set to 0; send goals without such gaps',
                         {'pause (s)': f'{pause_s:.2f}'})
    return None


def _is_goal(device: DeviceReport, address: int) -> bool:
    field = device.model.by_address.get(address)
    return field is not None and field.name.startswith('Goal')


@Rule(level=Level.ERROR)
def too_hot(case: Case) -> Claims:
    """
    At its Temperature Limit; WARN from 5 degrees below.

    Do: less load, more air.
    """
    unknown = []
    for device in case.devices:
        temperature = last_read(case, device, _HEAT[0])
        if temperature is None:
            continue
        limit, source = limit_of(case, device, _HEAT[1], 'degrees')
        if limit is None and device.model.number is not None:
            unknown.append(device.id)
        elif limit is not None and temperature >= limit - NEAR_DEGREES:
            is_above = temperature >= limit
            yield Claim(f'{"above" if is_above else "near"} its shutdown limit of '
                        f'{limit:.0f} °C{source}: reduce load or holding torque, let it cool',
                        {'temperature (°C)': f'{temperature:.0f}', 'limit (°C)': f'{limit:.0f}'},
                        _level(is_above), device=device.id, rests_on=_HEAT)
    if unknown:
        yield Doubt(f'{first_ids(unknown, 3)}: Temperature Limit never read')


def _level(is_beyond: bool) -> Level:
    return Level.ERROR if is_beyond else Level.WARN


@Rule(subject='device or bus', level=Level.ERROR,
      symptoms={'voltage limit'},
      accounts_for={'voltage limit'})
def voltage(case: Case) -> Claims:
    """
    Outside its limits, or its error byte says so (1.0 family); WARN within 0.3 V of them.

    Do: charge the battery, use thicker cables.
    """
    unknown, pinged = [], []
    found, sides = [], {}
    for device in case.devices:
        error = latched_error(device) if device.last_error.endswith(_OF_SUPPLY) else None
        # An error bit of now says more than a value of then.
        volts = last_read(case, device, SUPPLY[0], WINDOW_S if error else inf)
        if error and device.totals.answers == device.totals.pongs:
            pinged.append(device.id)
        elif error and (volts is None or volts < ALIVE_MIN_VOLTS):
            found.append(error)
        if volts is None or volts < ALIVE_MIN_VOLTS:
            continue
        low, source = limit_of(case, device, 'Min Voltage Limit', 'low')
        high, _ = limit_of(case, device, 'Max Voltage Limit', 'high')
        if low is None and high is None and not error and device.model.number is not None:
            unknown.append(device.id)
        if low is not None and volts < low + NEAR_VOLTS:
            side = f'below its limit of {low:.1f} V'
            found.append(_supply_claim(
                device, volts, volts < low, f'{side}{source}: charge the '
                'battery, check cable gauge and the load on the chain'))
            sides[side] = device.id
        elif high is not None and volts > high - NEAR_VOLTS:
            side = f'above its limit of {high:.1f} V'
            found.append(_supply_claim(
                device, volts, volts > high, f'{side}{source}: lower the '
                'supply voltage, or use a supply that takes the braking current'))
            sides[side] = device.id
        elif error:
            found.append(error._replace(figures={'voltage (V)': f'{volts:.1f}'}))
    yield from found
    ids = tuple([one.device for one in found if one.device is not None])
    if len(found) >= SUPPLY_MIN_DEVICES:
        where = f', as {first_ids(sides.values())} {next(iter(sides))}' if len(sides) == 1 else ''
        yield Claim(f'{len(found)} devices near or beyond a voltage limit{where}: the supply is '
                    'the cause; measure it, and compare it with their labels',
                    {'devices': all_ids(ids)},
                    _level(any(one.level is not Level.WARN for one in found)),
                    covers=ids, rests_on=SUPPLY)
    if unknown:
        yield Doubt(f'{first_ids(unknown, 3)}: voltage limits never read')
    if pinged:
        yield Doubt(f'{first_ids(pinged, 3)}: what answers the Pings is the same as the Pings: '
                    'an echo of the adapter, or a voltage error', step='let the program read a '
                    'register: an echo is the same as that instruction, an answer is not')


def _supply_claim(device: DeviceReport, volts: float, is_beyond: bool, where: str) -> Claim:
    return Claim(f'its supply is near or {where}', {'voltage (V)': f'{volts:.1f}'},
                 _level(is_beyond), device=device.id, rests_on=SUPPLY)


@Rule(needs_registers={'Goal Position', _PLACE})
def range_wraps(case: Case, device: DeviceReport) -> Found | None:
    """
    Positions jump between 4095 and 0 while goals are sent (1.0 family).

    Do: calibrate with the joint in the middle of its range.
    """
    values = case.values[device.id]
    goal, place = values['Goal Position'], values[_PLACE]
    if goal.source != 'w' or goal.age_s > VALUE_FRESH_S or goal.field.size != GOAL_BYTES \
            or not is_watched(case, device, place):
        return None
    places = [one.position for one in case.samples.get(device.id, ()) if one.position is not None]
    beyond = [place < EDGE_STEPS for place in places
              if place < EDGE_STEPS or TURN_STEPS - EDGE_STEPS <= place < TURN_STEPS]
    if len(beyond) < len(places) or sum(map(ne, beyond, beyond[1:])) < WRAPS_MIN:
        return None                            # it goes the long way, as it can
    return Claim(f'its joint moves across the end of the turn, from {TURN_STEPS - 1} to 0, '
                 'where goals make it turn the long way round: calibrate it again, with the joint '
                 'in the middle of its range', rests_on=(_PLACE,))


@Rule(needs_registers={_PLACE})
def impossible_position(case: Case, device: DeviceReport) -> Found | None:
    """
    A position beyond a turn in spite of its limits (Feetech).

    Do: switch its power off and on, calibrate it once.
    """
    place = case.values[device.id][_PLACE]
    raw = place.value.raw
    if place.source != 'r' or place.age_s > VALUE_FRESH_S:
        return None
    if 0 <= raw <= AT_ZERO_MAX:
        return _doubt_zero(case, device)
    if device.model.protocol != 'feetech' or raw < TURN_STEPS or not is_of_one_turn(place.field):
        return None
    low, high, mode = (raw_value(case, device, name) for name in (
        'Min Position Limit', 'Max Position Limit', 'Operating Mode'))
    if low is None or high is None or high <= low or mode:
        return None
    steps = raw if raw < SIGN_BIT else SIGN_BIT - raw
    return Claim(f'its position is {steps:.0f}, and within its limits only 0 to '
                 f'{TURN_STEPS - 1} can be: calibrated twice; switch its power off and on, '
                 'then write 0 to Homing Offset and calibrate it once',
                 {'position': f'{steps:.0f}'}, rests_on=(_PLACE,))


def _doubt_zero(case: Case, device: DeviceReport) -> Doubt | None:
    samples = [one for one in case.samples.get(device.id, ()) if one.goal is not None]
    if len(samples) < ZERO_MIN_REPORTS or span([one.goal for one in samples]) < GOAL_FAR_STEPS \
            or any(not 0 <= (one.position or 0) <= AT_ZERO_MAX for one in samples):
        return None
    return Doubt('its position reads 0 or 1 for all its goals: check address and size of that '
                 'read, and its torque; else its sensor is broken')


RULES = (hardware_error, watchdog, too_hot, voltage, range_wraps, impossible_position)
