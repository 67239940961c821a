# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""A rover to judge: the bridge in the guest on one adapter, and the MCU on this machine."""
from __future__ import annotations

from contextlib import contextmanager
import time

from rigs.drivers.guest import INSIDE
from rigs.drivers.lead import Mcu


class Rover:
    """A bridge in the guest on one adapter, the MCU behind it, and commands all the time."""

    def __init__(self, guest, adapter, mcu):
        self.adapter = adapter
        self.mcu = mcu
        self.guest = guest
        self.bridge = self._start()

    def _start(self):
        return self.guest.start(
            'bridge', f'python {INSIDE}/rover.py {self.adapter.path}', 'robot')

    def drive(self):
        """Have it drive; start the bridge again where it has ended."""
        if not self.bridge.is_active():
            self.bridge = self._start()
        self.guest.until(lambda: self.mcu.drives, 120)

    def stopped(self, record):
        """Wait until the wheels stand; keep how long after the last frame with a velocity."""
        self.guest.until(lambda: not self.mcu.drives)
        moving = max(point.stamp for point in self.mcu.set_points if not point.is_stop)
        stop = min(point.stamp for point in self.mcu.set_points if point.stamp > moving)
        record('figure', f'stop {(stop - moving) / 1e9:.2f} s after the last frame')

    def stands(self, seconds):
        """Tell whether the wheels stand for so long."""
        deadline = time.monotonic() + seconds
        while time.monotonic() < deadline:
            if self.mcu.drives:
                return False
            time.sleep(0.01)
        return True


@contextmanager
def rover_on(kind, guest):
    mcu = Mcu()
    with mcu.running(), kind(guest, mcu.path, gather=True) as adapter:
        rover = Rover(guest, adapter, mcu)
        yield rover
        rover.bridge.stop()
