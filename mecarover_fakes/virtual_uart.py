# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""
A pty that behaves like the receive side of a UART: it never waits for its reader.

What does not fit while CAPACITY bytes are outstanding is lost and counted, as an overrun; before
anybody has read at all, as unheard. A pty by itself would take 17 KiB and then block.
"""

from __future__ import annotations

import array
import fcntl
import os
import termios

from servobus.port.pty import Pty
from servobus.port.readable import readable

CAPACITY = 4096
COUNTERS = 'sent', 'taken', 'overrun', 'unheard', 'received'
_READ_SIZE = 4096


class VirtualUart:
    """One end of the simulated line, for one reader; `sent` = `taken` + `overrun` + `unheard`."""

    def __init__(self, link: str | None = None) -> None:
        self._link = link
        self.is_plugged_in = False
        self.plug(plugged_in=True)
        self.sent = self.taken = self.overrun = self.unheard = 0
        self.received = 0            # from the other end

    def plug(self, *, plugged_in: bool) -> None:
        """Be plugged in, under the same link each time, or unplugged: a reader gets an error."""
        if plugged_in and not self.is_plugged_in:
            self._pty = Pty(self._link)
            self.path = self._pty.path
            self.fd = self._pty.master
            self._other_end = os.open(self.path, os.O_RDONLY | os.O_NOCTTY | os.O_NONBLOCK)
            self._outstanding = 0        # when last looked at
            self._passed_on = 0          # to this pty
            self._is_heard = False
        elif self.is_plugged_in and not plugged_in:
            os.close(self._other_end)
            self._pty.close()
        self.is_plugged_in = plugged_in

    def outstanding(self) -> int:
        """Return how many bytes the reader has not taken yet; the pty counts to 4095."""
        count = array.array('i', [0])
        if not self.is_plugged_in:
            return 0
        fcntl.ioctl(self._other_end, termios.FIONREAD, count)
        return count[0]

    def write(self, data: bytes) -> None:
        """Pass bytes on as far as there is room; the rest is lost."""
        outstanding = self.outstanding()
        # As long as this only grows, nothing reads, and no more than fits was ever accepted.
        self._is_heard |= outstanding < self._outstanding \
            or self._passed_on - outstanding > CAPACITY
        self._outstanding = outstanding
        taken = self._pass_on(data[:max(0, CAPACITY - 1 - outstanding)])
        self._passed_on += taken
        self.sent += len(data)
        self.taken += taken
        if self._is_heard:
            self.overrun += len(data) - taken
        else:
            self.unheard += len(data) - taken

    def _pass_on(self, data: bytes) -> int:
        if not self.is_plugged_in:
            return 0
        try:
            return os.write(self.fd, data)
        except BlockingIOError:
            return 0

    def wait(self, timeout_s: float) -> bool:
        """Wait until the other end writes, at most so long; return whether it has."""
        return bool(readable([self.fd] * self.is_plugged_in, timeout_s))

    def read(self, most: int = _READ_SIZE) -> bytes:
        """Return what the other end wrote, at most so many bytes; b'' when nothing."""
        if not self.is_plugged_in:
            return b''
        try:
            data = os.read(self.fd, most)
        except OSError:              # nothing there, or the reader has just closed
            return b''
        self.received += len(data)
        return data

    def totals(self) -> dict[str, int]:
        """Return the counters by name."""
        return {name: getattr(self, name) for name in COUNTERS}

    def close(self) -> None:
        """Hang up: the reader gets an error, the link goes."""
        self.plug(plugged_in=False)
