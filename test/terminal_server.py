# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""A terminal server of one port (RFC 2217), by pyserial's own PortManager."""
from contextlib import suppress
import os
import select
import socket
import threading

import serial
from serial.rfc2217 import PortManager


class _Tty(serial.Serial):
    """A pty has no modem lines; the manager would end at the first question for one."""

    cts = dsr = ri = cd = False

    def _update_dtr_state(self):
        pass

    def _update_rts_state(self):
        pass


class TerminalServer:
    """
    Serves one client at a time; `tty` is the port, and shows what the client has set.

    carried  what each connection has brought for the port
    """

    def __init__(self, path):
        self.tty = _Tty(path, 9600)
        self.carried: list[bytearray] = []
        self._door = socket.create_server(('127.0.0.1', 0))
        self.url = f'rfc2217://127.0.0.1:{self._door.getsockname()[1]}'
        self._client = None
        self._thread = threading.Thread(target=self._run)

    def hang_up(self):
        """Drop the client, as a server does that is switched off."""
        with suppress(OSError):
            self._client.shutdown(socket.SHUT_RDWR)

    def write(self, data):
        """Send to the client, as the manager does by itself too."""
        self._client.sendall(data)

    def _run(self):
        with suppress(OSError):         # the door is closed
            while True:
                self._client, _ = self._door.accept()
                with self._client, suppress(ConnectionError):
                    self._serve()

    def _serve(self):
        manager = PortManager(self.tty, self)
        self.carried.append(bytearray())
        while True:
            ready, _, _ = select.select([self._client, self.tty.fd], [], [])
            if self.tty.fd in ready:
                self.write(b''.join(manager.escape(os.read(self.tty.fd, 4096))))
            if self._client in ready:
                if not (chunk := self._client.recv(4096)):
                    return
                data = b''.join(manager.filter(chunk))
                os.write(self.tty.fd, data)
                self.carried[-1] += data

    def __enter__(self):
        self._thread.start()
        return self

    def __exit__(self, *_):
        self._door.shutdown(socket.SHUT_RDWR)
        if self._client is not None:
            self.hang_up()
        self._thread.join()
        self._door.close()
        self.tty.close()
