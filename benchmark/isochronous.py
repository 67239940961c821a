# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""
A camera of 24 MB/s on the same USB bus: what the reader of the ring of usbmon makes of it.

The kernel is simulated: a ring of 1200 KiB that fills by the clock, with a transfer of a camera in
each millisecond between the events of the adapter, and that drops what has no room. The reader is
the real one (dxl_monitor/port/usb_ring.py), worked as its process works it.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Iterator
import ctypes
from itertools import count
import struct
import time
from typing import Any
from typing import NamedTuple
from unittest.mock import patch

from dxl_monitor.port import usb_ring
from dxl_monitor.port.reader import GATHER_S
from mecarover_fakes.usb_adapter import BUS
from mecarover_fakes.usb_adapter import DEVICE
from mecarover_fakes.usb_adapter import FakeAdapter
from mecarover_fakes.usb_adapter import FAMILIES

_HEAD = struct.Struct('<QBBBBHBBqiiII8siiII')
_SUBMIT, _DONE = b'SC'
CAMERA, CAMERA_BYTES, PACKETS = 9, 24_000, 8        # device; of each ms
OURS = 450                                          # bytes of the line in each ms: 4.5 MBd
MS = 1_000_000


class Run(NamedTuple):
    """cpu: of the reader, share of a core; bytes of the adapter; events that found no room."""

    cpu: float
    heard: int
    dropped: int
    events: int


class Kernel:
    """What ioctl() on /dev/usbmonN does, and the memory behind mmap()."""

    def __init__(self) -> None:
        self.memory = bytearray(usb_ring.RING_SIZE)
        self.spent_ns = 0              # in here: it is not the work of the reader
        self.events = 0
        self._dropped = 0
        self._begin = time.monotonic_ns()
        self._due = _events()
        self._next = next(self._due)
        self._held: deque[tuple[int, int]] = deque()        # offset, size with what it padded
        self._used = self._head = 0

    def ioctl(self, fd: int, request: int, argument: Any = 0) -> int:
        begin = time.thread_time_ns()
        try:
            return self._ioctl(request, argument)
        finally:
            self.spent_ns += time.thread_time_ns() - begin

    def _ioctl(self, request: int, argument: Any) -> int:
        if request == usb_ring._RING_SIZE_GET:
            return len(self.memory)
        if request == usb_ring._FLUSH:
            self._release(argument)
        elif request == usb_ring._STATISTICS:
            argument[4:] = self._dropped.to_bytes(4, 'little')
            self._dropped = 0
        elif request == usb_ring._FETCH:
            self._release(argument.flush)
            self._fill()
            argument.count = number = min(argument.count, len(self._held))
            if not number:
                raise BlockingIOError
            offsets = (ctypes.c_uint32 * number).from_address(argument.offsets)
            offsets[:] = [self._held[at][0] for at in range(number)]
        return 0

    def _release(self, number: int) -> None:
        for _ in range(number):
            self._used -= self._held.popleft()[1]

    def _fill(self) -> None:
        """Put in what came since the last time."""
        now = time.monotonic_ns() - self._begin
        while self._next[0] <= now:
            _, event, size = self._next
            self._put(event, size)
            self._next = next(self._due)

    def _put(self, event: bytes, size: int) -> None:
        self.events += 1
        rest = len(self.memory) - self._head
        padding = rest if size > rest else 0           # an event lies in one piece
        if self._used + padding + size > len(self.memory):
            self._dropped += 1
            return
        self._head = 0 if padding else self._head
        self.memory[self._head:self._head + len(event)] = event
        self._held.append((self._head, padding + size))
        self._used += padding + size
        self._head += size


def _events() -> Iterator[tuple[int, bytes, int]]:
    """Yield (when in ns, bytes that matter, size in the ring) of both devices, without an end."""
    adapter = FakeAdapter('ftdi')
    transfer = adapter.received(bytes(OURS), 0)
    head = [_HEAD.pack(1, kind, 0, 0x81, CAMERA, BUS, ord('-'), 0, 0, 0, 0, CAMERA_BYTES, size,
                       b'', 0, 0, 0, PACKETS)
            for kind, size in ((_DONE, CAMERA_BYTES), (_SUBMIT, 16 * PACKETS))]
    for turn in count():
        yield turn * MS, head[0], len(head[0]) + CAMERA_BYTES + 16 * PACKETS
        yield turn * MS, head[1], len(head[1]) + 16 * PACKETS
        yield turn * MS + MS // 2, transfer, len(transfer)


def beside_a_camera(seconds: float) -> Run:
    """Read the ring for so long, as the reader process does."""
    kernel = Kernel()
    with patch.object(usb_ring.fcntl, 'ioctl', kernel.ioctl), \
            patch.object(usb_ring.mmap, 'mmap', lambda *_: kernel.memory):
        ring = usb_ring.Ring(-1, DEVICE, frozenset(FAMILIES['ftdi'].endpoints), 2)
        heard = 0
        begin, cpu = time.monotonic(), time.thread_time_ns()
        while time.monotonic() - begin < seconds:
            heard += len(ring.read())
            time.sleep(GATHER_S)
        lasted = time.monotonic() - begin
        spent = time.thread_time_ns() - cpu - kernel.spent_ns
    return Run(spent / 1e9 / lasted, heard, ring.dropped, kernel.events)
