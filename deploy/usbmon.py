# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""
The right to read usbmon, for the service dxl_monitor alone.

A group without members owns /dev/usbmonN, and the unit alone has it: no program of a login user
gets to what usbmon shows, keyboards above all.
"""
from __future__ import annotations

from pathlib import Path

DROP_IN = Path('/etc/systemd/system/dxl_monitor.service.d/usbmon.conf')
GROUP = 'mecarover_usbmon'
FILES = {
    Path('/etc/udev/rules.d/71-mecarover_usbmon.rules'): (
        f'let the group {GROUP} read usbmon',
        f'SUBSYSTEM=="usbmon", KERNEL=="usbmon[0-9]*", GROUP="{GROUP}", MODE="0640"\n'),
    Path('/etc/modules-load.d/mecarover_usbmon.conf'): (
        'load usbmon at every boot', 'usbmon\n'),
    DROP_IN: (
        'give the group to this service only',
        f'[Service]\nSupplementaryGroups={GROUP}\n'),
}
NOTE = ('note: --usbmon lets the service dxl_monitor read all traffic of all USB buses, keyboards '
        f'and disks too; no user is made a member of group {GROUP} (docs/security.md)')
