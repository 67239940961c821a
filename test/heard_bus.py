# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""A monitor in simulated time, and the usual packets of Protocol 2.0 with device 1, an MX-64."""
import struct

from msg_defs.dxl_instruction import Instruction as I
from msg_defs.dxl_packet import encode
from msg_defs.dxl_packet import STATUS
from servobus.bus.decoder import Settings
from servobus.model.models import Models
from servobus.monitor import Monitor

MODELS = Models()
MS = 1_000_000
SECOND = 1_000_000_000
PING = encode(1, I.PING)
PONG = encode(1, STATUS, b'\x37\x01\x29', error=0)
READ = encode(1, I.READ, struct.pack('<HH', 132, 4))
REPLY = encode(1, STATUS, bytes(4), error=0)


class Bus:
    """A monitor and its time; what is said goes by in chunks of their own."""

    every_ms = 1.0

    def __init__(self, *expected, **settings):
        self.monitor = Monitor('arm', MODELS, Settings(devices=expected, **settings))
        self.now = 100 * SECOND

    def hear(self, *chunks, every_ms=None):
        """Return when the last of them came."""
        for chunk in chunks:
            self.now += int((every_ms or self.every_ms) * MS)
            self.monitor.feed(chunk, self.now)
        return self.now

    def wait(self, seconds):
        self.now += int(seconds * SECOND)

    def report(self, errors=None):
        return self.monitor.report(self.now, errors)

    def device(self, number=1):
        return {device.id: device for device in self.report().devices}[number]
