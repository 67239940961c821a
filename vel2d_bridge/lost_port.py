# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""
Lost port: find it again for a dead man, and only it.

Another device at the same path gets nothing, not even its lines raised. The order is that of the
bridge: lock, then settings, then bytes.
"""
from __future__ import annotations

from contextlib import suppress
import fcntl
import os
import struct
import termios

from servobus.port.port_users import terminal_id
from vel2d_bridge.claim import identity
from vel2d_bridge.claim import is_claimed

_TCGETS2, _TCSETS2 = 0x802C542A, 0x402C542B
_TERMIOS2 = 44                     # bytes


class TakenOver(Exception):
    """Another bridge has the port: it begins with stops."""


def settings(fd: int) -> bytes:
    """Return the settings of a port, its rate among them; b'' for a socket."""
    found = bytearray(_TERMIOS2)
    try:
        fcntl.ioctl(fd, _TCGETS2, found)
    except OSError:
        return b''
    return bytes(found)


def find(path: str, known_as: str, settings: bytes, claim: str) -> int:
    """
    Open the port `path` if it is there, the same device, and free; -1 if not now.

    TakenOver: a bridge has it, or had it and lives, that is not the one with this `claim`.
    """
    fd, is_ours = -1, False
    try:
        status = os.stat(path)
        if not status.st_rdev or identity(status.st_rdev) != known_as:
            return -1
        with suppress(OSError):            # somebody has it: who?
            fd = os.open(path, os.O_RDWR | os.O_NOCTTY | os.O_NONBLOCK)
            fcntl.flock(fd, fcntl.LOCK_EX | fcntl.LOCK_NB)
            is_ours = terminal_id(os.fstat(fd)) == terminal_id(status)
        if is_claimed(status, path, claim):
            raise TakenOver
        if is_ours:
            _prepare(fd, settings)
            found, fd = fd, -1
            return found
    except OSError:
        pass
    finally:
        if fd >= 0:
            os.close(fd)
    return -1


def _prepare(fd: int, settings: bytes) -> None:
    fcntl.ioctl(fd, termios.TIOCEXCL)
    if settings:
        fcntl.ioctl(fd, _TCSETS2, settings)
    with suppress(OSError):        # a pty has no such lines; on a board they may mean reset
        fcntl.ioctl(fd, termios.TIOCMBIC,
                    struct.pack('I', termios.TIOCM_DTR | termios.TIOCM_RTS))
