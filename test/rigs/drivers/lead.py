# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""The lead between an adapter in the guest and a fake on this machine, and the fakes for it."""
from __future__ import annotations

from contextlib import contextmanager
from contextlib import suppress
import os
import select
import socket
import threading
import time
import tty

from mecarover_fakes.bus_ptys import FakeBus
from mecarover_fakes.fake_bus import make_devices
from mecarover_fakes.line import Line
from mecarover_fakes.master import Master
from mecarover_fakes.traffic import none
from mecarover_fakes.traffic import PATTERNS
from msg_defs.vel2d import FRAME_SIZE
from rigs.running_mcu import RunningMcu
from servobus.model.models import Models

READ_SIZE = 65_536
IDLE_S = 0.004          # a UART is silent for so long behind a frame only
TURN_S = 0.001


class Lead:
    """
    Carries bytes between the socket of an adapter and the pty of a fake, in a thread.

    `gather`: hand what the guest sends on as the MCU's "receive to idle" sees it: a driver passes
    a frame on in portions.
    """

    def __init__(self, adapter, fake, *, gather=False):
        self._gather = gather
        self._adapter = socket.socket(socket.AF_UNIX)
        self._adapter.connect(str(adapter))
        self._adapter.setblocking(False)
        self._fake = os.open(fake, os.O_RDWR | os.O_NOCTTY | os.O_NONBLOCK)
        tty.setraw(self._fake)
        self.handed = 0             # bytes that came to the fake
        self._held = b''
        self._held_at = 0.0
        self._done = threading.Event()
        self._thread = threading.Thread(target=self._run, name='lead')
        self._thread.start()

    def __enter__(self):
        return self

    def __exit__(self, *_):
        self._done.set()
        self._thread.join()
        self._adapter.close()
        os.close(self._fake)

    def _run(self):
        while not self._done.is_set():
            wait_s = TURN_S if self._held else 0.05
            adapter = self._adapter.fileno()
            ready, _, _ = select.select([adapter, self._fake], [], [], wait_s)
            if adapter in ready and not self._from_guest():
                return
            if self._fake in ready:
                self._to_guest()
            if self._held and time.monotonic() - self._held_at > IDLE_S:
                self._hand_on()

    def _from_guest(self):
        """Take what the guest sent; False: the adapter was pulled out."""
        try:
            chunk = self._adapter.recv(READ_SIZE)
        except OSError:
            return False
        if not chunk:
            return False
        self._held += chunk
        self._held_at = time.monotonic()
        if not self._gather or len(self._held) >= FRAME_SIZE:
            self._hand_on()
        return True

    def _hand_on(self):
        with suppress(OSError):
            self.handed += os.write(self._fake, self._held)
        self._held = b''

    def _to_guest(self):
        with suppress(OSError):
            chunk = os.read(self._fake, READ_SIZE)
            self._adapter.setblocking(True)
            self._adapter.sendall(chunk)
            self._adapter.setblocking(False)


@contextmanager
def bus_of(devices, baud=2_000_000, rate=0.0):
    """Return a bus to be started; rate: cycles a second of its own master, 0: it has none."""
    line = Line(make_devices([devices], Models(), baud, moving=bool(rate)), baud)
    bus = FakeBus(Master(line, PATTERNS['moving'], rate=rate) if rate else Master(line, none))
    try:
        yield bus
    finally:
        bus.stop()


class Mcu(RunningMcu):
    """A fake MCU at the end of a cable."""

    def has_taken(self, handed):
        """Tell whether all of the bytes that were handed on are taken, its queue empty."""
        totals = self.receiver.totals
        return (totals.received >= handed
                and len(self.set_points) >= totals.frames - totals.queue_full)

    @property
    def drives(self):
        """Whether the wheels turn now."""
        return bool(self.set_points) and not self.set_points[-1].is_stop
