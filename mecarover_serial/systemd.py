# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""
Tell systemd how a service is: ready, alive, stopping (sd_notify(3), ten lines of it).

Does nothing where systemd did not start the process. Never raises and never blocks.
"""
from __future__ import annotations

from collections.abc import Mapping
from contextlib import suppress
import os
import socket


class Systemd:
    """The way to the service manager named in `environment`."""

    def __init__(self, environment: Mapping[str, str] = os.environ) -> None:
        self._address = environment.get('NOTIFY_SOCKET', '')
        if self._address.startswith('@'):           # an abstract socket
            self._address = '\0' + self._address[1:]
        self._socket = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)
        self._socket.setblocking(False)
        self.watchdog_s = self._watchdog_s(environment)

    def notify(self, state: str) -> None:
        """Say READY=1, STOPPING=1, or WATCHDOG=1: that at least twice per `watchdog_s`."""
        if self._address:
            with suppress(OSError):
                self._socket.sendto(state.encode(), self._address)

    @staticmethod
    def _watchdog_s(environment: Mapping[str, str]) -> float | None:
        """Return the time without a sign of life that systemd tolerates; None = for ever."""
        if environment.get('WATCHDOG_PID', str(os.getpid())) != str(os.getpid()):
            return None
        text = environment.get('WATCHDOG_USEC', '')
        return int(text) / 1e6 if text.isdecimal() and int(text) else None
