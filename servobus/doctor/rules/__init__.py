# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""The rules of the doctor, a file for each family of causes."""

from servobus.doctor.rule import Rule
from servobus.doctor.rules import devices
from servobus.doctor.rules import feetech
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
    'The devices themselves': devices.RULES,
    'Time': timing.RULES,
    'What the program does': program.RULES,
    'Feetech servos': feetech.RULES}
RULES = tuple([rule for rules in FAMILIES.values() for rule in rules])
