# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""Simulated devices on a bus for a client from outside, and a monitor that listens at its tap."""

import time

from harness import wait

from mecarover_fakes.bus_ptys import FakeBus
from mecarover_fakes.fake_bus import make_devices
from mecarover_fakes.fake_bus import make_line
from mecarover_fakes.master import Master
from mecarover_fakes.traffic import none
from servobus.model.models import Models
from servobus.monitor import Monitor
from servobus.sources.listener import Listener

BAUD = 1_000_000
MODELS = Models()
PATIENCE_MS = 1000                 # for a client on a machine that may be slow


class ListenedBus:
    """A bus without a master of its own: the test is that."""

    def __init__(self, entries, settings, dialect='2'):
        self.devices = make_devices(list(entries), MODELS, BAUD, moving=False, dialect=dialect)
        self.bus = FakeBus(Master(make_line(self.devices, BAUD, dialect), none), tap=True)
        self.monitor = Monitor('bus', MODELS, settings, idle_is_told=True)
        self.listener = Listener(self.bus.tap.path, BAUD, self.monitor.feed_chunks,
                                 self.monitor.flush_if_idle)
        self.listener.start()
        wait(lambda: self.listener.state.is_open)
        self.bus.start()

    def close(self):
        self.listener.stop()
        self.bus.stop()

    def report(self):
        return self.monitor.report(time.monotonic_ns())

    def device(self, number):
        return next((one for one in self.report().devices if one.id == number), None)
