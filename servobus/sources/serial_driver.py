# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""
What a serial driver can do for a listener beyond reading: hand bytes over soon, count errors.

Every function copes with a driver that cannot (pty, socket, most others): None or False. None of
them sends anything to the bus.
"""

from __future__ import annotations

import array
from contextlib import suppress
import os
from pathlib import Path

from msg_defs.diagnostics import Pairs
from servobus.bus.report import LineErrors
from servobus.port.port_users import file_text
from servobus.port.port_users import tty_of

TIOCGSERIAL = 0x541E
TIOCSSERIAL = 0x541F
TIOCGICOUNT = 0x545D
ASYNC_LOW_LATENCY = 0x2000
_FLAGS = 4                       # struct serial_struct, in ints
_SERIAL_STRUCT_INTS = 32
_ICOUNT_INTS = 20                # cts dsr rng dcd rx tx frame overrun parity brk buf_overrun ...
SYS = Path('/sys')


def line_errors(fd: int) -> LineErrors | None:
    """Return the driver's counters (TIOCGICOUNT), None where it keeps none."""
    import fcntl  # not at the top: files are read where there is none, too

    counts = array.array('i', [0] * _ICOUNT_INTS)
    try:
        fcntl.ioctl(fd, TIOCGICOUNT, counts)
    except OSError:
        return None
    frame, overrun, parity, breaks, buf_overrun = counts[6:11]
    return LineErrors(overrun, buf_overrun, frame, parity, breaks)


def set_low_latency(fd: int) -> bool:
    """Ask the driver to hand over each byte at once; tell whether it will."""
    import fcntl

    settings = array.array('i', [0] * _SERIAL_STRUCT_INTS)
    with suppress(OSError):
        fcntl.ioctl(fd, TIOCGSERIAL, settings)
        if not settings[_FLAGS] & ASYNC_LOW_LATENCY:
            settings[_FLAGS] |= ASYNC_LOW_LATENCY
            fcntl.ioctl(fd, TIOCSSERIAL, settings)
        return True
    return False


def adapter(path: str, root: Path = SYS) -> Pairs:
    """Return what a USB adapter says of itself, 'Adapter' and 'Adapter Serial Number'."""
    tty = tty_of(path)
    device = Path(os.path.realpath(root / 'class/tty' / tty / 'device'))
    usb = next((one for one in (device, *device.parents) if (one / 'idVendor').exists()), None)
    if usb is None:
        return []
    files = (('Adapter', 'product'), ('Adapter Serial Number', 'serial'))
    return [(key, text) for key, name in files if (text := file_text(usb / name).strip())]


def shorten_latency_timer(path: str, root: Path = SYS) -> None:
    """
    Set the latency timer of an FTDI adapter to 1 ms, where there is one and we may.

    At 16 ms, the driver's default, an adapter hides every delay on the bus below that.
    """
    with suppress(OSError):
        _latency_timer(path, root).write_text('1')


def latency_timer_ms(path: str, root: Path = SYS) -> int | None:
    """Return the latency timer of an FTDI adapter (ms), None without one."""
    try:
        return int(_latency_timer(path, root).read_text())
    except (OSError, ValueError):
        return None


def _latency_timer(path: str, root: Path) -> Path:
    return root / 'class/tty' / tty_of(path) / 'device/latency_timer'
