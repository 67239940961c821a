# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""
Standing claims, and how old the values are that they rest on.

A register that is not read any more says neither that a claim is still true nor that it is over:
the claim stands, and its message says of when the value is.
"""

from __future__ import annotations

from typing import NamedTuple

from msg_defs.nanoseconds import NS_PER_S
from servobus.bus import evidence as ev
from servobus.doctor.case import Case
from servobus.doctor.rule import ANSWER
from servobus.doctor.rule import Claim
from servobus.doctor.rule import Rule
from servobus.doctor.thresholds import WINDOW_S

AGE_ROUNDING_NS = 1000                 # an age is a float
TIME_OF_DAY_MAX_S = 43_200                   # a time of day is clear for so long
_VERBS = {'r': 'read', 'w': 'written'}
_UNITS = (('days', 86_400), ('h', 3600), ('min', 60), ('s', 1))


class Reading(NamedTuple):
    """A value that a claim rests on; others: raw values that decide what it means."""

    stamp: int                     # when it was seen last
    verb: str                      # 'read', 'written', 'heard'
    text: str                      # '82 °C'; '' of several devices
    others: tuple[float | None, ...]


class StandingClaim(NamedTuple):
    """A claim that stands. stamp: when it was claimed last; reading: None if it is of no value."""

    rule: Rule
    claim: Claim
    stamp: int
    reading: Reading | None
    has_restarted: bool = False    # since that reading
    is_old: bool = False           # so is the reading


def standing_claim(case: Case, rule: Rule, claim: Claim,
                   before: StandingClaim | None) -> StandingClaim:
    """Return what is claimed now; before: the same as it stood until now."""
    reading = _read_last(case, claim) if claim.rests_on else None
    was_restarted = reading is not None and before is not None and before.has_restarted \
        and before.reading is not None and _is_same(reading, before.reading)
    return StandingClaim(rule, claim, case.now, reading,
                    was_restarted or _has_restarted(case, claim, reading))


def kept_claim(case: Case, one: StandingClaim) -> StandingClaim | None:
    """Return a claim that is not made any more, if what it rests on was not seen since."""
    if one.reading is None or not any(number in case.by_id for number in _devices(one.claim)):
        return None
    now = _read_last(case, one.claim)
    if now is not None and not _is_same(now, one.reading):
        return None
    return one._replace(has_restarted=one.has_restarted or now is None
                        or _has_restarted(case, one.claim, now))


def dated_claim(case: Case, one: StandingClaim) -> StandingClaim:
    """Return a standing claim whose message says of when its value is, if that is not now."""
    reading = one.reading
    if reading is None:
        return one
    stamp = min(reading.stamp, case.now)  # a broken source may stamp its bytes with any future
    age_s = (case.now - stamp) / NS_PER_S
    if age_s <= WINDOW_S and not one.has_restarted:
        return one
    spell = case.names.time_of_day
    when = f'at {spell(stamp)}' if spell is not None and age_s < TIME_OF_DAY_MAX_S \
        else f'{_ago(age_s)} ago'
    message = (f'{reading.text}{", " if reading.text else ""}last {reading.verb} {when}'
               f'{", restarted since" if one.has_restarted else ""}; {one.claim.message}')
    return one._replace(claim=one.claim._replace(message=message), is_old=True)


def _read_last(case: Case, claim: Claim) -> Reading | None:
    """Return the newest value that a claim rests on; None where none is known (any more)."""
    name, *others = claim.rests_on
    numbers = _devices(claim)
    if name == ANSWER:
        [ago_s] = (case.by_id[number].last_heard_s for number in numbers)
        return None if ago_s is None else Reading(case.stamp_ago(ago_s), 'heard', '', ())
    tables = [case.values[number] for number in numbers
              if number in case.values and name in case.values[number]]
    if not tables:
        return None
    seen = tables[0][name]
    for table in tables:
        if table[name].age_s < seen.age_s:
            seen = table[name]
    text = ''
    if len(numbers) == 1:
        unit, text = seen.field.unit, seen.value.text       # a unit, unless the value is a word
        text = f'{text} {unit}' if unit and text[-1:].isdigit() else f'{seen.field.name} {text}'
    return Reading(case.stamp_ago(seen.age_s), _VERBS[seen.source], text,
                   tuple([table[other].value.raw if other in table else None
                          for table in tables for other in others]))


def _is_same(one: Reading, other: Reading) -> bool:
    """Tell whether nothing was seen since one of them."""
    return abs(one.stamp - other.stamp) < AGE_ROUNDING_NS and one.others == other.others


def _has_restarted(case: Case, claim: Claim, reading: Reading | None) -> bool:
    """Tell whether a device was told to restart after a reading."""
    return reading is not None and any(
        one.stamp > reading.stamp and one.device in _devices(claim)
        for one in case.incidents_by_kind.get(ev.REBOOTED, ()))


def _devices(claim: Claim) -> tuple[int, ...]:
    return claim.covers if claim.device is None else (claim.device,)


def _ago(seconds: float) -> str:
    unit, size = next((one for one in _UNITS if seconds >= 2 * one[1]), _UNITS[-1])
    return f'{seconds / size:.0f} {unit}'
