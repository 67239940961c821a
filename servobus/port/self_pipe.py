# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""SelfPipe: a pipe that ends another thread's sleep on descriptors."""
from __future__ import annotations

from contextlib import suppress
import os

from servobus.port.readable import readable


class SelfPipe:
    """`rouse` from any thread, sleep on `fd` in one."""

    def __init__(self) -> None:
        self.fd, self._write_fd = os.pipe()        # macOS has no pipe2
        os.set_blocking(self.fd, False)
        os.set_blocking(self._write_fd, False)

    def rouse(self) -> None:
        with suppress(OSError):    # a full pipe wakes as well
            os.write(self._write_fd, b'.')

    def sleep(self, seconds: float) -> None:
        """Sleep so long, or until roused."""
        readable([self.fd], seconds)
        self.drain()

    def drain(self) -> None:
        """Forget the calls up to now."""
        with suppress(BlockingIOError):
            os.read(self.fd, 4096)

    def close(self) -> None:
        os.close(self.fd)
        os.close(self._write_fd)
