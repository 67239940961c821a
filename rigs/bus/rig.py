# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""Rig: one bus with its servos and one or two programs, as a scene describes it."""

from __future__ import annotations

from collections.abc import Callable
from random import Random
from typing import Any

from rigs.bus.ear import Ear
from rigs.bus.ear import Kind
from rigs.bus.master import Port
from rigs.bus.masters import Master
from rigs.bus.servo import Servo
from rigs.bus.servo1 import Servo1
from rigs.bus.wire import Clock
from rigs.bus.wire import S
from rigs.bus.wire import Wire


class Rig:
    """The parts; altered: when the first byte was different for the fault (ns; None: not yet)."""

    def __init__(self, baud: int, seed: int) -> None:
        self.clock = Clock()
        self.random = Random(seed)
        self.wire = Wire(self.clock, baud)
        self.servos: dict[int, Any] = {}       # Servo, or Servo1
        self.ports: list[Port] = []
        self.altered: int | None = None

    def add(self, servo: Servo | Servo1) -> None:
        servo.changed = self.alter
        self.servos[servo.number] = servo

    def port(self, **options: object) -> Port:
        """Return one more serial port on this wire; options as Port takes them."""
        port = Port(self.wire, self.random, name=f'master {len(self.ports)}', **options)  # type: ignore[arg-type]
        self.ports.append(port)
        return port

    def alter(self) -> None:
        """Note that from now on the bytes are not those of a healthy bus."""
        if self.altered is None:
            self.altered = self.clock.now

    def run_master(self, master: Master, ids: list[int], at: float = 0.0,
                   **options: object) -> Port:
        port = self.port(**options)
        port.run(master(port, ids), round(at * S))
        return port

    def listen(self, kind: Kind, hear: Callable[[bytes, int], object],
               idle: Callable[[int], object]) -> Ear:
        ear = Ear(self.clock, self.wire.baud, kind, self.random, hear, idle)
        self.wire.listeners.append(ear.take)
        return ear

    def at(self, seconds: float, do: Callable[[], object]) -> None:
        self.clock.at(round(seconds * S), do)

    def altering(self, seconds: float, do: Callable[[], object]) -> None:
        """Do something at a time that changes the bytes from then on."""
        self.at(seconds, do)
        self.at(seconds, self.alter)
