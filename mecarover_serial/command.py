# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""The commands of the whole package: nodes, page, fakes, and the tools of the library."""
from __future__ import annotations

from servobus.tools.command import begin
from servobus.tools.command import COMMANDS as TOOLS

COMMANDS = {
    'vel2d_bridge': 'vel2d_bridge.main',
    'dxl_monitor': 'dxl_monitor.start',
    'fake_mcu': 'mecarover_fakes.fake_mcu',
    'fake_bus': 'mecarover_fakes.fake_bus',
    'dxl_dashboard': 'mecarover_dashboard.dxl_dashboard',
    'mecarover_status': 'mecarover_dashboard.mecarover_status',
    **TOOLS,
}


def __getattr__(name: str) -> object:
    return begin(COMMANDS, name)
