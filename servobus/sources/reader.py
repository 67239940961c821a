# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""
How a line is read: wait, let bytes gather, read all that is there, stamp it, hand it on.

`Loop` does that, in any process. Run as a script this file is a small process that does it
for a node with threads that wait: it reads a descriptor opened by the node and pipes
records to it. It ends with its standard input. Imports little, so that it starts in 20 ms.
"""

from __future__ import annotations

from collections.abc import Callable
from contextlib import suppress
import errno
from math import ceil
import os
import select
import signal
import struct
import sys
import time
from typing import Any

# Many tiny reads cost more than all parsing. On a busy line (the last read was less than BUSY ago)
# bytes are therefore let gather before they are read. After a pause they are read at once, so that
# an instruction and the answer to it come in two chunks and the time between them is known.
GATHER_S = 0.001
# A line without pauses hides how far apart its packets are. So there bytes gather for longer,
# twice as long after each full chunk. They are read without a wait for the first of them: it would
# take more CPU than the read. At most 3/8 of the 4096 bytes that a driver has room for; what is
# left is for a process that comes 5.7 ms late at 4.5 MBd.
GATHER_LONGEST_S = 0.004
GATHER_BYTES = 1536
FULL_SHARE = 0.75                # at least this share of the time there were bytes on the line
BUSY_NS = 3_000_000
AT_ONCE_NS = 50_000              # waiting was so short that bytes were there already
SILENT_WAIT_S = 0.25             # how long to wait once the line was reported idle
READ_SIZE = 65_536
PROCESS_NAME = 'dxl_reader'      # what the process is called

# A record: its kind, a stamp, the largest gap so far (both ns), the size of the bytes after it.
HEAD = struct.Struct('<cqqI')
READY, CHUNK, IDLE, LOST = b'r', b'c', b'i', b'l'       # LOST: the bytes are the error number
DROPPED = b'd'                   # the bytes are how many events the kernel had no room for
_CONTROL = 0                     # standard input: it ends when the node wants that, or dies
_RECORDS = 1                     # standard output; writing there may block
_IGNORED = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP, signal.SIGQUIT, signal.SIGTSTP)


class Loop:
    """
    Reading, in any process.

    wait(seconds) returns whether there is something to read, read() all of it (perhaps nothing).
    on_idle(stamp): nothing came until then; again and again as long as nothing comes.
    largest_gap (ns): the longest time between two reads in which bytes were waiting. byte_ns: what
    a byte takes on the line, 0 where that is not known or what is read are not its bytes.
    """

    def __init__(self, wait: Callable[[float], bool], read: Callable[[], bytes],
                 on_chunk: Callable[[bytes, int], object], on_idle: Callable[[int], object], *,
                 idle_s: float, gather_s: float = GATHER_S, byte_ns: float = 0.0) -> None:
        self.largest_gap = 0
        self._wait = wait
        self._read = read
        self._on_chunk = on_chunk
        self._on_idle = on_idle
        self._idle_s = idle_s
        self._gather_s = self._shortest_s = gather_s
        self._longest_s = max(gather_s, min(GATHER_LONGEST_S, GATHER_BYTES * byte_ns / 1e9))
        self._byte_ns = byte_ns
        self._last_read = 0
        self._is_full = False          # the last chunk was: there will be bytes, without a wait

    def run(self, is_over: Callable[[], bool] = lambda: False) -> None:
        """Read until it is over, or until wait() or read() raise."""
        clock = time.monotonic_ns
        self._last_read = reported = clock()
        is_idle = True
        while not is_over():
            if self._is_full and self._read_chunk(True):
                reported = clock()
                continue
            begin = clock()
            patience_s = SILENT_WAIT_S if is_idle else self._idle_s
            if self._wait(patience_s):
                if self._read_chunk(clock() - begin < AT_ONCE_NS):
                    is_idle = False
                    reported = clock()
                else:                  # there was something, and nothing for us
                    time.sleep(self._gather_s)
                    if clock() - reported > patience_s * 1e9:
                        is_idle = True
                        reported = clock()
                        self._on_idle(reported)
            elif not is_over():
                is_idle = True
                # Up to the end of the wait: we may have been stopped since, with bytes coming in.
                self._on_idle(min(clock(), begin + int(patience_s * 1e9)))

    def _read_chunk(self, was_waiting: bool) -> bool:
        """Read and hand on what is there; `was_waiting`: it was there before we came back."""
        if time.monotonic_ns() - self._last_read < BUSY_NS:
            time.sleep(self._gather_s)
        chunk = self._read()
        stamp = time.monotonic_ns()
        if not chunk:
            self._is_full, self._gather_s = False, self._shortest_s
            return False
        since = stamp - self._last_read
        if was_waiting:
            self.largest_gap = max(self.largest_gap, since)
        self._is_full = len(chunk) * self._byte_ns > FULL_SHARE * since
        self._gather_s = (min(2 * self._gather_s, self._longest_s) if self._is_full
                          else self._shortest_s)
        self._last_read = stamp
        self._on_chunk(chunk, stamp)
        return True


class _Process:
    """Reads `port` and writes records to standard output."""

    def __init__(self, port: int, idle_s: float, gather_s: float, byte_ns: float) -> None:
        self._port = port
        self._poll = select.poll()
        self._poll.register(port, select.POLLIN)
        self._poll.register(_CONTROL, select.POLLIN)
        self._loop = Loop(self._wait, self._read,
                          lambda chunk, stamp: self._write(CHUNK, stamp, chunk),
                          lambda stamp: self._write(IDLE, stamp),
                          idle_s=idle_s, gather_s=gather_s, byte_ns=byte_ns)
        self._ring: Any = None

    def run(self, usb: list[str]) -> None:
        """Read until the port is lost; usb: device, bytes of an idle transfer, endpoints."""
        try:
            self._write(READY, time.monotonic_ns())
            if usb:
                device, idle, *endpoints = map(int, usb)
                sys.path.append(os.path.join(os.path.dirname(__file__), '../..'))
                from servobus.sources.usb_ring import Ring  # python -I does not find it
                self._ring = Ring(self._port, device, frozenset(endpoints), idle)
            self._loop.run()
        except BrokenPipeError:         # the node has gone
            return
        except OSError as error:
            with suppress(BrokenPipeError):
                self._write(LOST, time.monotonic_ns(), str(error.errno).encode())

    def _wait(self, seconds: float) -> bool:
        ready = self._poll.poll(ceil(seconds * 1000))
        if any(fd == _CONTROL for fd, _ in ready):
            raise BrokenPipeError
        return bool(ready)

    def _read(self) -> bytes:
        if self._ring is not None:
            return self._read_ring()
        try:
            chunk = os.read(self._port, READ_SIZE)
        except BlockingIOError:
            return b''
        if not chunk:
            raise OSError(errno.ENODEV, 'end of file')
        return chunk

    def _read_ring(self) -> bytes:
        events: bytes = self._ring.read()
        if self._ring.dropped:
            self._write(DROPPED, time.monotonic_ns(), str(self._ring.dropped).encode())
            self._ring.dropped = 0
        return events

    def _write(self, kind: bytes, stamp: int, data: bytes = b'') -> None:
        record = HEAD.pack(kind, stamp, self._loop.largest_gap, len(data)) + data
        while record:
            record = record[os.write(_RECORDS, record):]


def main(arguments: list[str]) -> None:
    """Be the process; arguments: port (a descriptor), idle_s, gather_s, byte_ns, [usb]."""
    for number in _IGNORED:             # they are for the node; when it goes, this goes
        signal.signal(number, signal.SIG_IGN)
    with suppress(OSError), open('/proc/self/comm', 'w') as name:
        name.write(PROCESS_NAME)
    port, idle_s, gather_s, byte_ns, *usb = arguments
    _Process(int(port), float(idle_s), float(gather_s), float(byte_ns)).run(usb)


if __name__ == '__main__':
    main(sys.argv[1:])
