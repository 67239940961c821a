# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""
The bus doctor: reports in, named causes out. docs/doctor.md has every one of them.

Rules are data and pure functions (rules/, a file for each family of causes); the engine joins
them. Time comes with the report; no IO, no clock. Other packages use what is named here.
"""

from servobus.doctor.case import OPTIONS
from servobus.doctor.engine import Doctor
from servobus.doctor.finding_log import BusSummary
from servobus.doctor.finding_log import FindingLog
from servobus.doctor.rule import first_ids
from servobus.doctor.rules import RULES

__all__ = ['OPTIONS', 'RULES', 'BusSummary', 'Doctor', 'FindingLog', 'first_ids']
