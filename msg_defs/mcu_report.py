# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""The line of text that an MCU with the receiver of firmware/ sends to the host."""
from __future__ import annotations

import re
from typing import NamedTuple

VERSION = 1                     # VEL2D_VERSION of firmware/vel2d_receiver.h
WAITING, RUNNING, STOPPED = 'waiting', 'running', 'stopped'
_LINE = re.compile(
    rf'vel2d receiver {VERSION}: (waiting|running|stopped), ([0-9]{{1,10}}) good, '
    r'([0-9]{1,10}) bad, ([0-9]{1,10}) refused, ([0-9]{1,10}) stops')
_OTHER = re.compile(r'vel2d receiver ([0-9]{1,9}): ')


class McuReport(NamedTuple):
    """What it says: all that is left of another version is its number."""

    version: int = VERSION
    state: str = WAITING        # STOPPED by its watchdog
    good: int = 0               # frames that it followed
    bad: int = 0                # damaged
    refused: int = 0            # not finite, or more than its limits
    stops: int = 0              # by its watchdog

    def line(self) -> str:
        return 'vel2d receiver {}: {}, {} good, {} bad, {} refused, {} stops'.format(*self)


def parse_report(line: str) -> McuReport | None:
    """Return what a line of the MCU reports, None for any other line."""
    if found := _LINE.fullmatch(line):
        state, *counts = found.groups()
        return McuReport(VERSION, state, *map(int, counts))
    other = _OTHER.match(line)
    return McuReport(int(other[1])) if other and int(other[1]) != VERSION else None
