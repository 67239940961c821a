# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""The rules of the doctor, a file for each family of causes."""

from servobus.bus.report import Finding
from servobus.doctor.rule import Rule
from servobus.doctor.rules import devices
from servobus.doctor.rules import feetech
from servobus.doctor.rules import goals
from servobus.doctor.rules import missing
from servobus.doctor.rules import noise
from servobus.doctor.rules import program
from servobus.doctor.rules import setup
from servobus.doctor.rules import timing

# The sections of docs/doctor.md, in the order in which findings of one level are reported: the
# causes of others first.
FAMILIES: dict[str, tuple[Rule, ...]] = {
    'Servos that were never set up': setup.RULES,
    'Noise and unknown bytes': noise.RULES,
    'Devices are missing': missing.RULES,
    'Goals and joints': goals.RULES,
    'The devices themselves': devices.RULES,
    'What the program does': program.RULES,
    'Time': timing.RULES,
    'Feetech servos': feetech.RULES}
RULES = tuple([rule for rules in FAMILIES.values() for rule in rules])
BY_NAME = {rule.name: rule for rule in RULES}
RANKS = {name: rank for rank, name in enumerate(BY_NAME)}


def accounts_for(cause: Finding, effect: Finding) -> bool:
    """Tell whether a finding follows from another one: what was, accounts for nothing that is."""
    if cause is effect or (cause.read_at and not effect.read_at) \
            or not BY_NAME[effect.rule].symptoms <= BY_NAME[cause.rule].accounts_for:
        return False
    if cause.rule == effect.rule:           # the bus has it, so its devices do; not the reverse
        return cause.device is None
    return None in (cause.device, effect.device) or effect.device in (
        cause.device, *cause.covers)
