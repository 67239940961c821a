# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""Why a port cannot be used, in one line."""
from __future__ import annotations

from typing import NamedTuple

from servobus.errors import ServobusError
from servobus.printable_text import printable


class Reason(NamedTuple):
    """Why a port cannot be used: `kind` for programs, `reason` and `remedy` for people."""

    kind: str       # absent, permission, busy, not_a_port, baud, url, lost, console, other
    reason: str
    remedy: str


class PortError(ServobusError):
    """A port that cannot be used: `str()` is one line, 'thing: reason; remedy'."""

    def __init__(self, thing: str, reason: Reason) -> None:
        self.kind, self.reason, self.remedy = map(printable, reason)    # with names of processes
        super().__init__(f'{printable(thing)}: {self.reason}; {self.remedy}')
