# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""
Messages from any thread until the server takes them in.

Bounded: what does not fit was overtaken anyway.
"""
from __future__ import annotations

from collections import deque
import threading

from mecarover_dashboard.cdr import Message
from mecarover_dashboard.state import MOST_OF_MESSAGE

MOST_MESSAGES = 400
MOST_BYTES = 64_000_000
_Arrived = tuple[str, Message, float]       # topic, message, monotonic s


class Inbox:
    """The newest messages, of the time since the last restart."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._empty(is_restarted=False)

    def _empty(self, is_restarted: bool) -> None:
        self._messages: deque[_Arrived] = deque()
        self._bytes = 0
        self._is_restarted = is_restarted

    def put(self, topic: str, message: Message, now_s: float) -> None:
        """Take a message; the oldest have to go where it has no room."""
        if len(message) > MOST_OF_MESSAGE:
            message = b''                       # counted as malformed, and takes no one's room
        with self._lock:
            self._messages.append((topic, message, now_s))
            self._bytes += len(message)
            while len(self._messages) > MOST_MESSAGES or self._bytes > MOST_BYTES:
                self._bytes -= len(self._messages.popleft()[1])

    def restart(self) -> None:
        """Forget what is here, and have all forgotten that was taken out."""
        with self._lock:
            self._empty(is_restarted=True)

    def take(self) -> tuple[bool, deque[_Arrived]]:
        """Return whether there was a restart, and what came since then."""
        with self._lock:
            found = self._is_restarted, self._messages
            self._empty(is_restarted=False)
        return found
