# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""
The ring of /dev/usbmonN, read in place: only what concerns one adapter is copied.

Run by the reader process, which has nothing but the standard library and what usbmon.py needs.
Source: kernel Documentation/usb/usbmon.rst, binary interface.
"""

from __future__ import annotations

import ctypes
import fcntl
import mmap
import struct

from servobus.sources.usbmon import BULK
from servobus.sources.usbmon import CONTROL
from servobus.sources.usbmon import HEADER_SIZE
from servobus.sources.usbmon import INPUT
from servobus.sources.usbmon import INTERRUPT
from servobus.sources.usbmon import KINDS
from servobus.sources.usbmon import SUBMITTED

RING_SIZE = 1200 * 1024            # the most that the kernel gives
FETCH_MAX_EVENTS = 4096            # events that are looked at in one go
_RING_SIZE_SET, _RING_SIZE_GET = 0x9204, 0x9205
_STATISTICS = 0x80089203
_LOOK = struct.Struct('=8xBBBB16xi4xI')        # kind, transfer, endpoint, device, status, kept


class _Fetch(ctypes.Structure):
    _fields_ = [('offsets', ctypes.c_void_p), ('count', ctypes.c_uint32),
                ('flush', ctypes.c_uint32)]


_FETCH = 3 << 30 | ctypes.sizeof(_Fetch) << 16 | 0x92 << 8 | 7


def wanted_size(events: bytes | mmap.mmap, at: int, device: int, endpoints: frozenset[int],
                idle: int) -> int:
    """
    Return how many bytes after the header at this place are wanted, -1 where it says nothing.

    endpoints: with the bit of the direction. idle: bytes of a transfer without any of the line.
    """
    kind, transfer, endpoint, its_device, status, kept = _LOOK.unpack_from(events, at)
    wanted = False
    if its_device != device or kind not in KINDS:
        return -1
    if transfer == CONTROL:
        wanted = True
    elif transfer == INTERRUPT:
        wanted = kind != SUBMITTED and bool(kept or status)
    elif transfer == BULK and endpoint in endpoints:
        if kind == SUBMITTED:
            wanted = endpoint < INPUT
        else:
            wanted = bool(status) or (endpoint >= INPUT and kept > idle)
    return kept if wanted else -1


class Ring:
    """
    The ring of an open descriptor; device, endpoints and idle as for wanted_size().

    dropped: events that the kernel had no room for, since the last time they were taken.
    """

    def __init__(self, fd: int, device: int, endpoints: frozenset[int], idle: int) -> None:
        self.dropped = 0
        self._idle = idle
        self._fd = fd
        self._device = device
        self._endpoints = endpoints
        fcntl.ioctl(fd, _RING_SIZE_SET, RING_SIZE)
        size = fcntl.ioctl(fd, _RING_SIZE_GET)
        self._map = mmap.mmap(fd, size, mmap.MAP_SHARED, mmap.PROT_READ)
        self._offsets = (ctypes.c_uint32 * FETCH_MAX_EVENTS)()
        self._seen = 0             # events that were looked at and are to be let go

    def read(self) -> bytes:
        """Return the events that concern the adapter, one after the other; do not wait."""
        found = []
        while count := self._fetch():
            for offset in self._offsets[:count]:
                kept = wanted_size(self._map, offset, self._device, self._endpoints, self._idle)
                if kept >= 0:
                    found.append(self._map[offset:offset + HEADER_SIZE + kept])
            self._seen = count
        counts = bytearray(8)
        fcntl.ioctl(self._fd, _STATISTICS, counts)
        self.dropped += int.from_bytes(counts[4:], 'little')
        return b''.join(found)

    def _fetch(self) -> int:
        """Let go what was seen; return how many more events there are, without waiting."""
        ask = _Fetch(ctypes.addressof(self._offsets), FETCH_MAX_EVENTS, self._seen)
        self._seen = 0
        try:
            fcntl.ioctl(self._fd, _FETCH, ask)
        except BlockingIOError:
            return 0
        return int(ask.count)
