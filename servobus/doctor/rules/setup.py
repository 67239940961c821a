# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""Servos that were never set up for this robot: ID, supply, table of another series."""

from __future__ import annotations

from collections.abc import Iterator
from functools import lru_cache

from msg_defs.diagnostics import Level
from msg_defs.dxl_instruction import Instruction
from msg_defs.dxl_instruction import name_of
from servobus.bus import evidence as ev
from servobus.bus.report import DeviceReport
from servobus.doctor.case import Case
from servobus.doctor.facts import ALIVE_MIN_VOLTS
from servobus.doctor.facts import last_read
from servobus.doctor.facts import limit_of
from servobus.doctor.facts import SUPPLY
from servobus.doctor.rule import all_ids
from servobus.doctor.rule import Claim
from servobus.doctor.rule import Claims
from servobus.doctor.rule import Doubt
from servobus.doctor.rule import FAMILY_1
from servobus.doctor.rule import first_ids
from servobus.doctor.rule import Found
from servobus.doctor.rule import Rule
from servobus.doctor.rules.noise import first_words
from servobus.doctor.symptom import DAMAGE
from servobus.doctor.symptom import SILENCE
from servobus.doctor.thresholds import INCIDENTS_MIN
from servobus.doctor.thresholds import SUPPLY_MIN_DEVICES
from servobus.doctor.thresholds import WINDOW_NS
from servobus.model.control_table import Model

FACTORY_ID = 1
_PROTOCOL_2 = '2'                  # as model files call it
CLASH_MIN_SHARE = 0.5              # share of its answers: a bad cable spoils fewer
SUPPLY_MAX_FACTOR = 1.25           # times the limit: made for another supply, not just near it
SUPPLY_12_V_MIN = 12.0             # a limit from here on: the servo is made for 12 V
SUPPLY_LOW_V = 8.6                 # two cells; an empty battery of three has more
SUPPLY_ONSET_S = 3.0               # a supply that sags for a moment is none
TABLE_END = 256                    # no address above it exists there
ACCESS_MAX_BYTES = 4               # who reads more at once, looks at all there is
# The registers there in other series (e-Manual; Feetech, memory tables of STS and SCS).
_OTHER_SERIES = {30: 'Goal Position of AX and MX', 36: 'Present Position of AX and MX',
                 48: 'Lock of SCS', 55: 'Lock of STS', 64: 'Torque Enable of X',
                 116: 'Goal Position of X', 132: 'Present Position of X'}


@Rule(level=Level.ERROR,
      symptoms={'second answers', 'silent device'},
      accounts_for={*SILENCE, *DAMAGE, 'second answers', 'silent bus', 'damaged first bytes',
                    'unasked answers', 'wrong length', 'late answers', 'slow cycle',
                    'unread bytes'})
def factory_id(case: Case) -> Claims:
    """
    Several new servos have ID 1.

    Do: connect them one at a time, give each its own ID.
    """
    first = case.by_id.get(FACTORY_ID)
    absent = [device.id for device in case.devices if device is not first
              and device.last_heard_s is None
              and max(device.missed_in_a_row, device.acks_missing) >= INCIDENTS_MIN
              and 2 * device.window.garbled <= device.window.missed]
    if first is None or not absent or not _clashes(case, first) \
            or first_words(case.report.noise):             # a board that starts
        return
    yield Claim(f'several servos answer as 001, and {first_ids(absent, 3)} never did: '
                'new ones still have ID 1; connect one at a time and give each its own ID',
                {'never heard': all_ids(absent),
                 'spoilt': f'{first.window.spoilt} of {first.window.asked}'},
                covers=tuple(absent), device=FACTORY_ID)


def _clashes(case: Case, device: DeviceReport) -> bool:
    """Tell whether more than one device answers: twice, or over each other most of the time."""
    window = device.window
    return case.count(ev.SECOND_ANSWER, device) >= INCIDENTS_MIN or (
        window.spoilt >= INCIDENTS_MIN and window.spoilt >= CLASH_MIN_SHARE * window.asked)


@Rule(level=Level.ERROR, onset_s=SUPPLY_ONSET_S,
      accounts_for={'voltage limit', 'error bits', 'joint at rest'})
def wrong_supply(case: Case) -> Claims:
    """
    A 7.4 V servo on 12 V; WARN: a 12 V servo on 7.4 V (1.0 family).

    Do: compare its label with the supply.
    """
    high, low, unknown = [], [], []
    for device in case.devices:
        volts = last_read(case, device, SUPPLY[0])
        if device.model.protocol not in FAMILY_1 or volts is None or volts < ALIVE_MIN_VOLTS:
            continue
        limit, is_of_model = limit_of(case, device, 'Max Voltage Limit', 'high')
        if limit is None or (is_of_model and device.model.protocol != '1'):
            unknown += [device.id] * (device.model.number is not None)
        elif volts > SUPPLY_MAX_FACTOR * limit:
            high.append((device, volts, limit))
        # What was higher before, or is below the lowest, is a supply that sags.
        elif limit >= SUPPLY_12_V_MIN \
                and max(volts, case.highest.get(device.id, 0.0)) < SUPPLY_LOW_V \
                and volts >= (limit_of(case, device, 'Min Voltage Limit', 'low')[0] or 0.0):
            low.append((device, volts, limit))
    yield from _supply_claims(high, 'far above its limit of {limit:.1f} V: a servo for a lower '
                              'voltage{others}; switch off, and check which servos these are',
                              Level.ERROR)
    yield from _supply_claims(low, 'while its limit is {limit:.1f} V: a servo for 12 V on a lower '
                              'supply{others}, slow and weak; supply 12 V', Level.WARN)
    if unknown:
        yield Doubt(f'{first_ids(unknown, 3)}: Max Voltage Limit never read, so it is unknown '
                    'whether they fit the supply')


def _supply_claims(found: list[tuple[DeviceReport, float, float]], words: str,
                   level: Level) -> Iterator[Claim]:
    """Claim each, or the first for all where it is many: then it is the supply."""
    ids = tuple(device.id for device, _, _ in found)
    many = len(found) >= SUPPLY_MIN_DEVICES
    for device, volts, limit in found[:1] if many else found:
        others = f', {len(ids) - 1} others too' if many else ''
        yield Claim(f'at {volts:.0f} V, ' + words.format(limit=limit, others=others),
                    {'voltage (V)': f'{volts:.1f}',
                     'limit (V)': f'{limit:.1f}',
                     'devices': all_ids(ids)}, level, covers=ids, device=device.id,
                    rests_on=SUPPLY)


@Rule(protocols=(*FAMILY_1, _PROTOCOL_2), needs_model=True)
def layout(case: Case, device: DeviceReport) -> Found | None:
    """
    Reads or writes that cut a register; in 2.0, Sync Writes.

    Do: use the table of its model.
    """
    is_2 = device.model.protocol == _PROTOCOL_2
    if not is_2 and (otherwise := _order_otherwise(case, device)):
        return otherwise
    for cycle in case.cycles:
        if (is_2 and cycle.instruction != Instruction.SYNC_WRITE) or device.id not in cycle.ids \
                or cycle.address is None or cycle.asked < INCIDENTS_MIN \
                or cycle.stamps[-1] < case.now - WINDOW_NS:
            continue                           # what is not there, 2.0 refuses by an error
        first = device.model.by_address.get(cycle.address)
        is_low_byte = first is not None and first.at == cycle.address not in _OTHER_SERIES \
            and cycle.length == 1 and cycle.instruction == Instruction.WRITE
        unfit = _why_unfit(device.model, cycle.address, cycle.length)
        if unfit and not is_low_byte and not any(      # a low byte is enough for a small number
                one.detail.address == cycle.address for one in case.incidents(ev.REFUSED, device)):
            return Claim(f'{name_of(cycle.instruction)} of {cycle.length} at '
                         f'{cycle.address}, {unfit}: use the table of {device.model_name}',
                         {'address': cycle.address, 'times': cycle.asked})
    return None


def _order_otherwise(case: Case, device: DeviceReport) -> Claim | None:
    """Look for a servo that says by a register that its numbers have the other order of bytes."""
    order = case.values[device.id].get('Byte Order')
    place = device.model.by_name.get('Present Position')
    if order is None or place is None or (order.value.raw == 1) == (place.byte_order == 'big'):
        return None
    return Claim(f'reports that its numbers are {order.value.text}, but those of '
                 f'{device.model_name} are not: set its real model in {case.names.devices}')


@lru_cache(maxsize=1024)          # a program repeats what it asks
def _why_unfit(model: Model, begin: int, length: int) -> str:
    """Return why an access does not fit the registers of a model, '' where it does."""
    end = begin + length
    fields = [field for field in model.fields if field.at < TABLE_END]
    is_of_other = begin in _OTHER_SERIES and not any(field.at == begin for field in fields)
    elsewhere = f' ({_OTHER_SERIES[begin]})' if is_of_other else ''
    for field in fields:
        if any(field.at < edge < field.end for edge in (begin, end)):
            return f'which cuts {field.name} ({field.at}, {field.size} bytes){elsewhere}'
    if length <= ACCESS_MAX_BYTES and begin < TABLE_END \
            and not any(field.at < end and field.end > begin for field in fields):
        return f'where {model.name} has no register{elsewhere}'
    return ''


RULES = (factory_id, wrong_supply, layout)
