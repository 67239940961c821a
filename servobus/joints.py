# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""
What a bus says about joints: position, velocity and effort, as the devices reported them.

Pure, and cheap enough for 200 Hz. Only what was read since the last time is reported: a lost reply
leaves its joint out, so that no old value is ever shown under a new stamp. Effort is current times
torque constant, where the model has both.
"""
from __future__ import annotations

from typing import NamedTuple

from msg_defs.diagnostics import Joint
from servobus.bus.device import Device
from servobus.bus.table import Observed

POSITION, VELOCITY, CURRENT = 'Present Position', 'Present Velocity', 'Present Current'
UNITS = {POSITION: 'rad', VELOCITY: 'rad/s', CURRENT: 'A'}


class JointReadings(NamedTuple):
    """Joints in order of ID, and the stamp of the newest bytes they come from (0 = none)."""

    joints: tuple[Joint, ...]
    stamp: int


def name_of(device: Device) -> str:
    """Return the name of a joint: as in `devices`, else its ID in three digits."""
    return device.joint or f'{device.number:03}'


def fresh(device: Device, since: int) -> tuple[Joint, int] | None:
    """Return what was read of a joint after the stamp `since`, and the stamp of that."""
    model = device.model
    if device.heard <= since or POSITION not in model.by_name:
        return None
    seen = zip(UNITS, device.table.observed_of(model, UNITS, since), strict=True)
    found = {name: one for name, one in seen if one is not None and _is_new(one, UNITS[name])}
    if model.torque_constant is None:
        found.pop(CURRENT, None)
    if not found:
        return None
    position, velocity, current = (
        found[name].value.number if name in found else None for name in UNITS)
    effort = None if current is None else current * (model.torque_constant or 0.0)
    newest = min(one.age_s for one in found.values())
    return Joint(name_of(device), position, velocity, effort), since - round(newest * 1e9)


def _is_new(seen: Observed, unit: str) -> bool:
    # Seen with `since` as now: an age below zero is how much newer the bytes are.
    return seen.age_s < 0 and seen.source == 'r' and seen.field.unit == unit
