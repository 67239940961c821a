# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""Rig: one bus with its servos and one or two programs, as a scene describes it."""

from random import Random

from rigs.bus.adapter import Adapter
from rigs.bus.master import Port
from rigs.bus.wire import Clock
from rigs.bus.wire import S
from rigs.bus.wire import Wire


class Rig:
    """The parts; altered: when the first byte was different for the fault (ns; None: not yet)."""

    def __init__(self, baud, seed):
        self.clock = Clock()
        self.random = Random(seed)
        self.wire = Wire(self.clock, baud)
        self.servos = {}       # Servo, or Servo1
        self.ports = []
        self.altered = None

    def add(self, servo):
        servo.changed = self.alter
        self.servos[servo.number] = servo

    def port(self, **options):
        """Return one more serial port on this wire; options as Port takes them."""
        port = Port(self.wire, self.random, name=f'master {len(self.ports)}', **options)
        self.ports.append(port)
        return port

    def alter(self):
        """Note that from now on the bytes are not those of a healthy bus."""
        if self.altered is None:
            self.altered = self.clock.now

    def run_master(self, master, ids, at=0.0, **options):
        port = self.port(**options)
        port.run(master(port, ids), round(at * S))
        return port

    def listen(self, kind, hear, idle):
        adapter = Adapter(self.clock, self.wire.baud, kind, self.random, hear, idle)
        self.wire.listeners.append(adapter.receive_bytes)
        return adapter

    def at(self, seconds, do):
        self.clock.at(round(seconds * S), do)

    def altering(self, seconds, do):
        """Do something at a time that changes the bytes from then on."""
        self.at(seconds, do)
        self.at(seconds, self.alter)
