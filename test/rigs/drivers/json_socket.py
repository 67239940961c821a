# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""Questions and answers as JSON lines on a Unix socket: QEMU's own (QMP) and the guest's agent."""
from __future__ import annotations

import json
import random
import socket

_READ_SIZE = 65_536
_SYNC_S = 2.0
ANSWER_S = 300.0                # an emulated processor that has much to do answers late


class Refused(Exception):
    """QEMU or the agent answered with an error."""


class JsonSocket:
    """One socket; `ask` waits for the answer. QEMU's events are kept in `events`."""

    def __init__(self, path):
        self.events = []
        self._socket = socket.socket(socket.AF_UNIX)
        self._socket.connect(str(path))
        self._buffer = b''

    def ask(self, command, arguments=None, timeout_s=ANSWER_S):
        """Return what is answered; raise Refused, or TimeoutError."""
        self._send(command, arguments or {})
        while True:
            answer = self._next(timeout_s)
            if 'error' in answer:
                raise Refused(f'{command}: {answer["error"]["desc"]}')
            if 'return' in answer:
                return answer['return']
            self._keep(answer)

    def wait_event(self, name, device=None, timeout_s=ANSWER_S):
        """Wait for an event of QEMU (of a device), one that came before included; forget it."""
        while True:
            for event in self.events:
                if event['event'] == name and device in (None, event['data'].get('device')):
                    self.events.remove(event)
                    return
            self._keep(self._next(timeout_s))

    def synchronise(self):
        """Tell whether the agent answers now; what it answered to older questions is dropped."""
        number = random.getrandbits(31)
        try:
            self._send('guest-sync', {'id': number})
            while self._next(_SYNC_S).get('return') != number:
                pass
        except TimeoutError:
            return False
        return True

    def close(self):
        self._socket.close()

    def _keep(self, answer):
        if 'event' in answer:
            self.events.append(answer)

    def _send(self, command, arguments):
        self._socket.sendall(json.dumps({'execute': command, 'arguments': arguments}).encode()
                             + b'\n')

    def _next(self, timeout_s):
        self._socket.settimeout(timeout_s)
        while b'\n' not in self._buffer:
            chunk = self._socket.recv(_READ_SIZE)
            if not chunk:
                raise Refused('the machine has ended')
            self._buffer += chunk
        line, self._buffer = self._buffer.split(b'\n', 1)
        return json.loads(line.lstrip(b'\xff'))
