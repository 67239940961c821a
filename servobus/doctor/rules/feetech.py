# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""Feetech servos: what is peculiar to EEPROM, baud codes and calibration there."""

from __future__ import annotations

from collections import Counter
from collections import defaultdict

from servobus.bus import evidence as ev
from servobus.bus.report import DeviceReport
from servobus.doctor.case import Case
from servobus.doctor.rule import Claim
from servobus.doctor.rule import Claims
from servobus.doctor.rule import Doubt
from servobus.doctor.rule import FAMILY_1
from servobus.doctor.rule import first_ids
from servobus.doctor.rule import Found
from servobus.doctor.rule import Rule
from servobus.doctor.symptom import SILENCE
from servobus.doctor.thresholds import WINDOW_S

FEETECH = 'feetech'
# What LeRobot takes these codes for (its tables of Feetech motors, commit 7427f31).
LEROBOT_BAUDS = {5: 57_600, 6: 38_400, 7: 19_200}
CALIBRATIONS_MIN = 2
MIDDLE_STEPS = 2047                # where LeRobot puts the middle
OFFSET_TOLERANCE_STEPS = 1         # as near as a goal is met
OFFSET_SIGN = 0x800                # in Homing Offset (Feetech, STS memory table)
# What Lock does to a write of EEPROM (e-Manual, Protocol 1.0; Feetech, STS memory table).
_OF_LOCK = {'1': ('ignores it', 'switch its power off and on to unlock it'),
            FEETECH: ('forgets it at power-off', 'write 0 to Lock before it, and 1 after it')}


@Rule(needs_incident=(ev.BAUD_WRITTEN,), protocols=(FEETECH,),
      accounts_for={*SILENCE, 'changed rate'})
def baud_code(case: Case, device: DeviceReport) -> Found | None:
    """
    Baud Rate code 5 to 7, which Feetech and LeRobot read differently.

    Do: look for the servo at Feetech's rate.
    """
    code = case.incidents(ev.BAUD_WRITTEN, device)[-1].detail.value
    taken_for = LEROBOT_BAUDS.get(code)
    field = device.model.by_name.get('Baud Rate')      # the servo may prove to be another one
    if taken_for is None or field is None:
        return None
    meant = field.decode(field.bytes_of(code)).text
    return Claim(f'Baud Rate {code} was written: that is {meant} for Feetech and '
                 f'{taken_for} in LeRobot; look for the servo at {meant} Bd',
                 {'code': code})


@Rule(protocols=FAMILY_1)
def lock(case: Case, device: DeviceReport) -> Found | None:
    """
    EEPROM written while Lock is 1.

    Do: write 0 to Lock before it, and 1 after it.
    """
    values = case.values[device.id]
    lock = values.get('Lock')
    written = [device.model.by_address[one.detail.value].name for one in
               case.incidents(ev.LOCKED, device) if one.detail.value in device.model.by_address]
    if lock is None or lock.value.raw == 1:
        written += [one.field.name for one in device.observed if one.source == 'w'
                    and one.field.memory == 'eeprom' and (
                        lock is None or one.age_s < min(lock.age_s, WINDOW_S))]
    if not written:
        return None
    if lock is None:
        return Doubt(f'{written[0]} written, and Lock never read: while Lock is 1 the '
                     'servo ignores that, or forgets it at power-off')
    effect, remedy = _OF_LOCK[device.model.protocol]
    return Claim(f'{written[0]} written while Lock is 1: the servo {effect}; {remedy}',
                 {'written': ', '.join(dict.fromkeys(written))})


@Rule(needs_incident=(ev.CALIBRATED, ev.OFFSET_WRITTEN))
def calibrated_twice(case: Case, device: DeviceReport) -> Found | None:
    """
    The new offset includes the old one, or was measured with it.

    Do: write 0 to Homing Offset, calibrate once.
    """
    times = case.count(ev.CALIBRATED, device)
    if times >= CALIBRATIONS_MIN:
        return Claim(f'calibrated {times} times within 10 s: each time its present '
                     'position becomes the middle; do it once, with the joint in the middle',
                     {'times': times})
    offsets = case.incidents(ev.OFFSET_WRITTEN, device)
    for now, before, place in (one.detail for one in offsets):
        if now and before and abs(_signed(now) - (place - MIDDLE_STEPS)) <= OFFSET_TOLERANCE_STEPS:
            return Claim(f'Homing Offset {_signed(now)} written: its position less '
                         f'{MIDDLE_STEPS}, as it was with the offset {_signed(before)}, so the '
                         'new one is wrong by that; write 0, measure again')
    last = offsets[-1] if len(offsets) >= CALIBRATIONS_MIN else None
    if last is None or not (last.detail.now and last.detail.before):
        return None
    return Claim(f'Homing Offset written {len(offsets)} times within 10 s, {CALIBRATIONS_MIN} '
                 'without 0 between: the new offset includes the old one; write 0, measure '
                 'again', {'now, before': f'{last.detail.now}, {last.detail.before}'})


def _signed(offset: int) -> int:
    return offset if offset < OFFSET_SIGN else OFFSET_SIGN - offset


@Rule(subject='bus')
def mixed_firmware(case: Case) -> Claims:
    """
    One model with different firmware.

    Do: update them.
    """
    by_model: defaultdict[str, dict[int, str]] = defaultdict(dict)
    for device in case.devices:
        if device.model.protocol == FEETECH:
            seen = case.values[device.id]
            parts = [seen[name].value.text for name in (
                'Firmware Version', 'Firmware Version Minor') if name in seen]
            if len(parts) == 2:
                by_model[device.model_name][device.id] = '.'.join(parts)
    for name, versions in by_model.items():
        count = Counter(versions.values())
        if len(count) > 1:
            least = ', '.join(
                f'{version} in {first_ids([one for one in versions if versions[one] == version])}'
                for version in sorted(count) if count[version] == min(count.values()))
            yield Claim(f'{name} with different firmware, {least}: LeRobot refuses that; '
                        "update them to one version with Feetech's debugger",
                        {'versions': ', '.join(sorted(count))})


RULES = (baud_code, lock, calibrated_twice, mixed_firmware)
