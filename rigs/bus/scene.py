# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""What a scene is: a bus, a program, perhaps a fault, an ear, and what must be said of it."""

from __future__ import annotations

from typing import NamedTuple

from rigs.bus import ear
from rigs.bus import frames
from rigs.bus import frames1
from rigs.bus.faults import Fault
from rigs.bus.masters import Master
from rigs.bus.rig import Rig
from rigs.bus.servo import Servo
from rigs.bus.servo1 import Kind
from rigs.bus.servo1 import Servo1

SECONDS = 20.0
Key = tuple[str, int | None]       # rule, device (None: the bus)


class Scene(NamedTuple):
    """
    One run of 20 s.

    expected: what is really wrong; more than one where each says it. also: what else is true of
    this bus and may be said at WARN or ERROR. Nothing expected: a healthy bus.
    """

    name: str
    master: Master
    expected: tuple[Key, ...] = ()
    faults: tuple[Fault, ...] = ()
    also: tuple[Key, ...] = ()
    ids: tuple[int, ...] = (1, 2, 3, 4, 5, 6)
    model: str = 'XL430-W250'
    family: Kind | None = None     # in place of the model, for the 1.0 family
    firmware: int = 46
    delay: int = 0                 # Return Delay Time, 2 us units
    in_line: bool = True           # in a Sync Read they wait for the one before
    spares: tuple[int, ...] = ()   # servos that are there and are not in `ids`
    absent: tuple[int, ...] = ()   # IDs in `ids` without a servo
    baud: int = 1_000_000
    ear: ear.Kind = ear.FULL_SPEED
    devices: tuple[str, ...] = ()  # the monitor's parameter
    latency_ms: float = 0.2        # the master's adapter
    wait_ms: float = 34.0
    why: str = ''                  # where the expectation needs a word

    def rig(self, seed: int) -> Rig:
        """Return the bus with its program, ready to run."""
        rig = Rig(self.baud, seed)
        for number in {*self.ids, *self.spares} - {*self.absent}:
            rig.add(self._servo(rig, number))
        rig.run_master(self.master, list(self.ids), 0.1, latency_ms=self.latency_ms,
                       wait_ms=self.wait_ms,
                       form=(frames1 if self.family else frames).FORM)
        for fault in self.faults:
            fault(rig)
        return rig

    def _servo(self, rig: Rig, number: int) -> Servo | Servo1:
        if self.family is not None:
            return Servo1(rig.wire, number, self.family, delay=self.delay)
        return Servo(rig.wire, number, self.model, firmware=self.firmware, delay=self.delay,
                     in_line=self.in_line)
