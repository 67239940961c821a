# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""
Claim: a bridge says which device it drives, for the dead men of bridges before it.

An abstract socket that no one talks to: /proc/net/unix lists its name for every user, and the
kernel removes it when its process ends. A container with a network of its own has its own list.
The name says the number of the device, and what the device is: another one gets the number of
one that was unplugged.
"""
from __future__ import annotations

from contextlib import suppress
import os
from pathlib import Path
import socket
import stat
from zlib import crc32

from servobus.port.port_users import file_text
from servobus.port.port_users import terminal_id

_LIST = Path('/proc/net/unix')
_SYSFS = Path('/sys/dev/char')


class PortClaim:
    """Kept while the bridge lives, also when the port is lost; `token` is its own."""

    def __init__(self) -> None:
        self.token = os.urandom(8).hex()
        self._name = ''
        self._socket: socket.socket | None = None

    def claim_port(self, fd: int, path: str) -> None:
        """Claim an open port, found at `path`, before the first byte. Never raises."""
        with suppress(OSError):
            status = os.fstat(fd)
            if not stat.S_ISCHR(status.st_mode):
                return
            name = _name(status, path)
            if name == self._name:
                return
            claim = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)
            claim.bind('\0' + name + self.token)
            self.drop()
            self._name, self._socket = name, claim

    def drop(self) -> None:
        if self._socket is not None:
            self._socket.close()
        self._name, self._socket = '', None


def is_claimed(status: os.stat_result, path: str, but: str) -> bool:
    """Tell whether a bridge has claimed this device, other than the one with the token `but`."""
    with suppress(OSError):
        return any('@' + _name(status, path) in line and not line.endswith(but)
                   for line in _LIST.read_text(errors='replace').splitlines())
    return False


def identity(device: int, sysfs: Path = _SYSFS) -> str:
    """
    Return what a character device has in common before and after it was unplugged.

    USB: maker, product, serial number and interface; without a serial number, the socket that it
    is in. Else its place on the board. '' where nothing is known: a pty.
    """
    place = sysfs / f'{os.major(device)}:{os.minor(device)}' / 'device'
    if not place.exists():
        return ''
    place = place.resolve()
    for folder in (place, *place.parents):
        if (folder / 'idVendor').exists():
            maker, product, serial = (file_text(folder / name).strip()
                                      for name in ('idVendor', 'idProduct', 'serial'))
            interface = ''.join(place.relative_to(folder).parts[:1])     # 1-1.2:1.0
            where = interface.partition(':')[2] if serial else interface
            number = file_text(place / 'port_number').strip()    # one of several on a chip
            return f'{maker}:{product} {serial} {where} {number}'
    return str(place)


def _name(status: os.stat_result, path: str) -> str:
    device = status.st_rdev
    known_as = identity(device) or f'{os.path.abspath(path)} {terminal_id(status)}'
    return (f'mecarover_serial/bridge/{os.major(device)}:{os.minor(device)}/'
            f'{crc32(known_as.encode()):08x}/')
