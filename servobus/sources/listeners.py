# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""The listener for each kind of live source."""

from __future__ import annotations

from typing import Any

from servobus.sources.listener import Listener
from servobus.sources.source_name import TAP
from servobus.sources.source_name import USB
from servobus.sources.tap_listener import TapListener
from servobus.sources.usb_listener import UsbListener

_LISTENERS = {TAP: TapListener, USB: UsbListener}


def listener_on(name: str, baud: int, *handlers: Any, **options: Any) -> Listener:
    """Return a listener on a live source; arguments as of Listener."""
    kind = next((kind for prefix, kind in _LISTENERS.items() if name.startswith(prefix)), Listener)
    return kind(name, baud, *handlers, **options)
