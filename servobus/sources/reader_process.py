# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""
The node's side of the reader process: start it on an open port, take its records, end it.

The process shares the descriptor of the port, which is O_RDONLY. As long as it lives, nothing else
reads that, and the port must not be closed: end the process first.
"""

from __future__ import annotations

from collections.abc import Iterator
from collections.abc import Sequence
from contextlib import suppress
import fcntl
import os
import select
import subprocess
import sys
from typing import NamedTuple

from servobus.sources import reader

PIPE_SIZE = 1 << 20              # two seconds at 4.5 MBd; what root's limit allows everybody
READ_SIZE = 65_536
END_WAIT_S = 0.1                 # how long it may take to end by itself


class Record(NamedTuple):
    """What the process says; kinds are in reader.py, times are ns."""

    kind: bytes
    stamp: int
    largest_gap: int
    data: bytes


class ReaderProcess:
    """A running reader; OSError when it cannot be started. Leaving the context ends it."""

    def __init__(self, port: int, idle_s: float, gather_s: float, wake: int,
                 usb: Sequence[int] = (), *, byte_ns: float = 0.0) -> None:
        """
        Start; port and wake are descriptors, the latter interrupts `wait`.

        usb: where the port is /dev/usbmonN, what of it is read (reader.py). byte_ns: reader.Loop.
        """
        self.is_over = False             # it ended, by itself or by force; all it said was taken
        self._rest = b''
        self._process = subprocess.Popen(
            # -I -S: none of the environment's Python paths and hooks, no site-packages.
            [sys.executable, '-I', '-S', reader.__file__,
             *map(str, (port, idle_s, gather_s, byte_ns, *usb))],
            pass_fds=[port], stdin=subprocess.PIPE, stdout=subprocess.PIPE,
            stderr=subprocess.DEVNULL, bufsize=0, cwd='/', start_new_session=True)
        assert self._process.stdin is not None
        assert self._process.stdout is not None
        self._lifeline = self._process.stdin
        self._records = self._process.stdout
        self._pipe = self._records.fileno()
        with suppress(OSError):              # too many large pipes: then it has the usual 64 KiB
            fcntl.fcntl(self._pipe, fcntl.F_SETPIPE_SZ, PIPE_SIZE)
        self.pid = self._process.pid
        self._poll = select.poll()
        self._poll.register(self._pipe, select.POLLIN)
        self._poll.register(wake, select.POLLIN)

    def wait(self) -> bool:
        """Wait until there is something to take (True), or `wake` is readable."""
        return any(fd == self._pipe for fd, _ in self._poll.poll())

    def records(self) -> Iterator[Record]:
        """Take the whole records that are there; to be used up."""
        data = os.read(self._pipe, READ_SIZE)
        self.is_over = not data
        data = self._rest + data
        at = 0
        while len(data) - at >= reader.HEAD.size:
            kind, stamp, gap, size = reader.HEAD.unpack_from(data, at)
            begin = at + reader.HEAD.size
            if begin + size > len(data):
                break
            at = begin + size
            yield Record(kind, stamp, gap, data[begin:at])
        self._rest = data[at:]

    def __enter__(self) -> ReaderProcess:
        return self

    def __exit__(self, *_: object) -> None:
        self.end()

    def end(self) -> str:
        """End it, unless it has ended, and return how it did: 'signal 9', 'exit code 0'."""
        self._lifeline.close()
        self._records.close()
        try:
            code = self._process.wait(END_WAIT_S)
        except subprocess.TimeoutExpired:
            self._process.kill()
            code = self._process.wait()
        return f'signal {-code}' if code < 0 else f'exit code {code}'
