# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""What the link tells of itself: a snapshot for diagnostics."""
from __future__ import annotations

from typing import NamedTuple

from mecarover_serial.port import Port
from mecarover_serial.preflight import PortError
from mecarover_serial.preflight import Reason
from vel2d_bridge.deadman import Deadman
from vel2d_bridge.pacer import Sent

NO_STOP = 'no stop could be sent, the rover may be driving'
OFF, READY, LOST, NO_USE = 'off', 'ready', 'lost', 'no use'    # how the deadman stands


class LinkState(NamedTuple):
    """A snapshot for diagnostics; stamps are monotonic ns, `problem` is why it is not open."""

    is_open: bool
    since: int                     # time of the last change of is_open
    problem: PortError | None
    last_error: str                # stays after recovery
    openings: int
    losses: int
    frames: int
    time_outs: int                 # writes that took too long
    partial_writes: int
    freezes: int                   # the bridge was frozen, or the deadman acted
    bytes_received: int
    last: Sent | None
    driving: bool
    enabled: bool
    deadman: str                   # OFF, READY, LOST or NO_USE
    owes_stop: bool                # none has left since it drove: it may do so still


def deadman_state(deadman: Deadman | None, port: Port | None, now: int) -> str:
    """Tell whether it would stop the rover: it needs a descriptor, rfc2217:// has none."""
    if deadman is None:
        return OFF
    if port is not None and port.fd is None:
        return NO_USE
    return READY if deadman.is_alive(now) else LOST


def stuck(name: str, time_outs: int, many: int) -> PortError | None:
    """Return what is wrong with a line that let out no frame so many times in a row, if it is."""
    if time_outs < many:
        return None
    return PortError(name, Reason(
        'lost', 'takes no data', 'check flow control, cable and adapter'))
