# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""
Who else opens and closes a device node, as inotify(7) of Linux sees it: at once, and for nothing.

It says that somebody does, not who. It sees no process that has the device open through another
node, nor what happened before `begin`.
"""
from __future__ import annotations

from contextlib import suppress
import ctypes
import os
import struct

_OPEN, _CLOSE = 0x20, 0x08 | 0x10               # IN_OPEN; IN_CLOSE_WRITE, IN_CLOSE_NOWRITE
_EVENT = struct.Struct('iIII')                  # struct inotify_event; nothing follows for a file
_READ_SIZE = 65536


class PortWatch:
    """
    A watch on one device node; without inotify it never sees anybody.

    is_open: who opened it last has not closed it. has_changed, was_opened: since `clear`, somebody
    opened or closed it, somebody opened it.
    """

    def __init__(self) -> None:
        self._fd = -1
        self.is_open = False
        self.clear()

    def clear(self) -> None:
        self.has_changed = self.was_opened = False

    def begin(self, path: str) -> None:
        """Watch the node that is at `path` now: call it after each opening of our own."""
        if self._fd >= 0:
            os.close(self._fd)
        self._fd = -1
        self.is_open = False
        self.clear()
        with suppress(OSError, AttributeError, TypeError):      # another system has no inotify
            libc = ctypes.CDLL(None)
            self._fd = libc.inotify_init1(os.O_NONBLOCK | os.O_CLOEXEC)
            libc.inotify_add_watch(self._fd, os.fsencode(path), _OPEN | _CLOSE)

    def read(self) -> None:
        """Note what happened since the last call; never waits."""
        with suppress(OSError):
            while self._fd >= 0 and (events := os.read(self._fd, _READ_SIZE)):
                for _, mask, _, _ in _EVENT.iter_unpack(events):
                    if mask & (_OPEN | _CLOSE):
                        self.has_changed, self.is_open = True, bool(mask & _OPEN)
                        self.was_opened |= self.is_open
