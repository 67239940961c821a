# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""
The names of live sources, one grammar for every tool and for the node's `ports`.

/dev/ttyUSB0 and pyserial URLs: an adapter of its own. usb:NAME: the adapter of another program.
tap:NAME, tap:NAME/PORT: a Python program started with dxl_tap.
"""

from __future__ import annotations

import os

from servobus.port.port_users import tty_of

TAP, USB = 'tap:', 'usb:'
PREFIXES = (TAP, USB)              # live sources; listeners.py has their listeners
_USB_TTYS = ('ttyUSB', 'ttyACM')
DEFAULT_BAUD = 2_000_000


def has_sides(name: str) -> bool:
    """Tell whether a source is the port of the master itself: it knows sides and the rate."""
    return name.startswith((TAP, USB))


def is_live(name: str) -> bool:
    """Tell whether a name can only be one of a live source."""
    return name.startswith(PREFIXES) or '://' in name


def bus_name(name: str) -> str:
    """Return what a bus is called that is heard there: the base name of its port."""
    prefix = next(filter(name.startswith, PREFIXES), '')
    return os.path.basename(name.removeprefix(prefix).rstrip('/')) or name


def ways_to_hear(port: str) -> str:
    """Return which sources hear a program that has this port open."""
    return (f'{USB}{port} or ' if tty_of(port).startswith(_USB_TTYS) else '') \
        + f'{TAP}NAME (dxl_tap NAME -- COMMAND starts it)'


def rate_of(name: str, baud: int | None) -> int:
    """Return the rate to begin with, where none or 0 is given: 0 where it is learned."""
    return baud or (0 if has_sides(name) else DEFAULT_BAUD)
