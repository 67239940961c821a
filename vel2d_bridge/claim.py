# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""
Claim: a bridge says which device it drives, for the dead men of bridges before it.

An abstract socket that no one talks to: /proc/net/unix lists its name for every user, and the
kernel removes it when its process ends. A container with a network of its own has its own list.
"""
from __future__ import annotations

from contextlib import suppress
import os
from pathlib import Path
import socket
import stat

_LIST = Path('/proc/net/unix')


class PortClaim:
    """Kept while the bridge lives, also when the port is lost; `token` is its own."""

    def __init__(self) -> None:
        self.token = os.urandom(8).hex()
        self._device = 0
        self._socket: socket.socket | None = None

    def take(self, fd: int) -> None:
        """Claim an open port, before the first byte. Never raises."""
        with suppress(OSError):
            status = os.fstat(fd)
            if not stat.S_ISCHR(status.st_mode) or status.st_rdev == self._device:
                return
            claim = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)
            claim.bind('\0' + _name(status.st_rdev) + self.token)
            self.drop()
            self._device, self._socket = status.st_rdev, claim

    def drop(self) -> None:
        if self._socket is not None:
            self._socket.close()
        self._device, self._socket = 0, None


def is_claimed(device: int, but: str) -> bool:
    """Tell whether a bridge has claimed this device, other than the one with the token `but`."""
    with suppress(OSError):
        return any('@' + _name(device) in line and not line.endswith(but)
                   for line in _LIST.read_text(errors='replace').splitlines())
    return False


def _name(device: int) -> str:
    return f'mecarover_serial/bridge/{os.major(device)}:{os.minor(device)}/'
