# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""
The traffic of a fake bus as /dev/usbmonN would give it, on a Unix socket: `usb:PATH` hears it.

Who connects learns first what is plugged in and at which rate. A reader that does not take what it
is given for too long is let go.
"""

from __future__ import annotations

from contextlib import suppress
import os
import socket
import time

from mecarover_fakes.new_socket import new_socket
from mecarover_fakes.usb_adapter import FakeAdapter

PENDING_LIMIT = 1 << 22            # bytes that wait for a reader


class VirtualUsb:
    """An adapter of this family at `baud`; path: of the socket."""

    def __init__(self, path: str, family: str, baud: int) -> None:
        self._path = path
        self._adapter = FakeAdapter(family)
        self._baud = baud
        self._readers: dict[socket.socket, bytearray] = {}
        self._listener = socket.socket(socket.AF_UNIX)
        with new_socket(path, '--usbmon'):
            self._listener.bind(path)
        self._listener.listen()
        self._listener.setblocking(False)

    def sent(self, data: bytes) -> None:
        """Tell of bytes that the master wrote."""
        self._send_events(self._adapter.sent(data, time.time_ns()))

    def received(self, data: bytes) -> None:
        """Tell of bytes that came from the bus."""
        self._send_events(self._adapter.received(data, time.time_ns()))

    def _send_events(self, events: bytes) -> None:
        self._accept()
        for reader, pending in list(self._readers.items()):
            pending += events
            try:
                while pending:
                    del pending[:reader.send(pending, socket.MSG_NOSIGNAL)]
            except BlockingIOError:
                if len(pending) > PENDING_LIMIT:
                    self._let_go(reader)
            except OSError:
                self._let_go(reader)

    def _accept(self) -> None:
        with suppress(BlockingIOError):
            while True:
                reader, _ = self._listener.accept()
                reader.setblocking(False)
                now = time.time_ns()
                self._readers[reader] = bytearray(
                    self._adapter.plug(now) + self._adapter.set_baud(self._baud, now))

    def _let_go(self, reader: socket.socket) -> None:
        del self._readers[reader]
        reader.close()

    def close(self) -> None:
        """Hang up."""
        for reader in list(self._readers):
            self._let_go(reader)
        self._listener.close()
        with suppress(FileNotFoundError):
            os.unlink(self._path)
