# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""
The names of live sources, one grammar for every tool and for the node's `ports`.

/dev/ttyUSB0 and pyserial URLs: an adapter of its own. usb:NAME: the adapter of another program.
tap:NAME, tap:NAME/PORT: a Python program started with dxl_tap.
"""

from __future__ import annotations

import os
from typing import Any
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from dxl_monitor.port.listener import Listener

TAP, USB = 'tap:', 'usb:'
DEFAULT_BAUD = 2_000_000


def has_sides(name: str) -> bool:
    """Tell whether a source is the port of the master itself: it knows sides and the rate."""
    return name.startswith((TAP, USB))


def is_live(name: str) -> bool:
    """Tell whether a name can only be one of a live source."""
    return has_sides(name) or '://' in name


def bus_name(name: str) -> str:
    """Return what a bus is called that is heard there: the base name of its port."""
    place = name.removeprefix(USB).removeprefix(TAP).rstrip('/')
    return os.path.basename(place) or name


def rate_of(name: str, baud: int | None) -> int:
    """Return the rate to begin with, where none or 0 is given: 0 where it is learned."""
    return baud or (0 if has_sides(name) else DEFAULT_BAUD)


def listener_on(name: str, baud: int, *handlers: Any, **options: Any) -> Listener:
    """Return a listener on a live source; arguments as of Listener."""
    # Not at the top: files are read where there is no fcntl, too.
    from dxl_monitor.port.listener import Listener
    from dxl_monitor.port.tap_listener import TapListener
    from dxl_monitor.port.usb_listener import UsbListener

    kinds = {TAP: TapListener, USB: UsbListener}
    kind = next((kind for prefix, kind in kinds.items() if name.startswith(prefix)), Listener)
    return kind(name, baud, *handlers, **options)
