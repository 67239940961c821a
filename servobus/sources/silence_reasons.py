# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""Why a source gave no byte: the usual reasons, the likeliest first, as far as is known."""

from __future__ import annotations

import os

from servobus.port.preflight import ports_here
from servobus.port.preflight import warnings

_OURS = ('dxl_doctor', 'dxl_dump')
_NOT_BAUD = 'The baud rate is not the cause: a wrong one gives bytes that make no sense.'
_NO_MASTER = 'No program sends to the servos now: start yours, and listen while it runs.'
_WIRE = ('The adapter is not connected to the data line: connect D+, D- and ground (TTL: data and '
         'ground) to the bus of the master. A bus without supply is silent too.')


def reasons(name: str, is_live: bool) -> list[str]:
    """Return why a source of this name gave no byte."""
    if not is_live:
        return of_file(name)
    kind, _, port = name.partition(':')
    if kind == 'usb':
        return [f'No program uses {port} now: start yours, and listen while it runs.',
                'The program uses another adapter: check which port it opens.', _NOT_BAUD]
    if kind == 'tap':
        program = port.partition('/')[0]
        return [f'No program sent anything: start it with dxl_tap {program} -- COMMAND, and '
                'listen while it runs.']
    found = []
    for reason in warnings(name, ours=_OURS) if os.path.exists(name) else ():
        remedy = f'then this is its own port; listen with usb:{name}' if reason.kind == 'busy' \
            else reason.remedy
        found.append(f'{name}: {reason.reason}; {remedy}.')
    return [*found, _NO_MASTER, _WIRE, f'It is another port: {ports_here()}.', _NOT_BAUD]


def of_file(name: str) -> list[str]:
    return [f'{name} holds no byte of a bus: record again while a program uses the bus.']
