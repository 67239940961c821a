# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""
StandardStreams: what is written to stdout and stderr never blocks, also where it is not read.

rclpy logs while it holds the interpreter's lock. A pipe that is full, or a terminal after Ctrl-S,
would then stop every thread, those that stop a rover too. So descriptors 1 and 2 become pipes that
refuse what they have no room for, and a thread passes on what comes through them. Lines that find
no room are lost, counted, and reported when there is room again.
"""
from __future__ import annotations

from contextlib import suppress
import faulthandler
import fcntl
import os
import select
import stat
import sys
import threading
import time

from servobus.port.readable import readable

_WAITING_MAX_BYTES = 256 * 1024  # for their reader
_PIPE_BYTES = 1024 * 1024       # and those on their way here
_WRITE_MAX_BYTES = 1024         # a terminal or pipe that is writable has room for so much
_FLUSH_MAX_S = 0.3              # at the end, for what waits
_FLUSH_POLL_MS = 20
_COLOUR = 'RCUTILS_COLORIZED_OUTPUT'


class StandardStreams:
    """To be entered before ROS starts; leaving passes on what waits and takes 0.3 s at most."""

    def __init__(self, name: str) -> None:
        self._relays: list[_StreamRelay] = []
        self._name = name
        self._ending: float | None = None
        self._wake = os.eventfd(0)
        self._thread = threading.Thread(target=self._run, name='relay', daemon=True)

    def __enter__(self) -> StandardStreams:
        known: dict[tuple[int, int], _StreamRelay] = {}
        for fd in (1, 2):
            with suppress(OSError):             # a descriptor that is closed
                status = os.fstat(fd)
                if not _may_block(status.st_mode):
                    continue
                if fd == 2 and os.isatty(fd):
                    os.environ.setdefault(_COLOUR, '1')     # rcutils sees a pipe from now on
                file = status.st_dev, status.st_ino
                if file not in known:           # one pipe where both are one: the order stays
                    known[file] = _StreamRelay(fd, self._name)
                known[file].redirect(fd)
        self._relays = list(known.values())
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        for stream in (sys.stdout, sys.stderr):
            with suppress(OSError, ValueError):
                stream.flush()
        self._ending = time.monotonic() + _FLUSH_MAX_S
        os.eventfd_write(self._wake, 1)
        self._thread.join(2 * _FLUSH_MAX_S)
        for relay in self._relays:
            relay.give_back()

    def _run(self) -> None:
        while self._ending is None or (
                time.monotonic() < self._ending
                and any(relay.has_waiting() for relay in self._relays)):
            poll = select.poll()
            if self._ending is None:
                poll.register(self._wake, select.POLLIN)
            for relay in self._relays:
                relay.register(poll)
            for fd, _ in poll.poll(None if self._ending is None else _FLUSH_POLL_MS):
                for relay in self._relays:
                    relay.handle_ready(fd)


def _may_block(mode: int) -> bool:
    """Tell whether a write to such a file may wait for a reader; what a disk takes, it takes."""
    return stat.S_ISFIFO(mode) or stat.S_ISSOCK(mode) or stat.S_ISCHR(mode)


class _StreamRelay:
    """From a pipe to where stdout or stderr, or both, went."""

    def __init__(self, fd: int, name: str) -> None:
        self._name = name
        self._taken: list[int] = []
        self._target = fcntl.fcntl(fd, fcntl.F_DUPFD_CLOEXEC, 3)
        self._source, self._pipe = os.pipe2(os.O_NONBLOCK | os.O_CLOEXEC)
        with suppress(OSError):                 # more than a user may have
            fcntl.fcntl(self._pipe, fcntl.F_SETPIPE_SZ, _PIPE_BYTES)
        self._waiting = bytearray()
        self._lost = 0

    def redirect(self, fd: int) -> None:
        os.dup2(self._pipe, fd)
        self._taken.append(fd)
        if fd == 2 and faulthandler.is_enabled():
            faulthandler.enable(self._target)   # after a crash no thread passes it on

    def has_waiting(self) -> bool:
        """Whether something is not passed on yet."""
        return bool(self._waiting or self._lost or readable([self._source], 0))

    def register(self, poll: select.poll) -> None:
        poll.register(self._source, select.POLLIN)
        if self._waiting or self._lost:
            poll.register(self._target, select.POLLOUT)

    def handle_ready(self, fd: int) -> None:
        if fd == self._source:
            self._receive()
        elif fd == self._target:
            self._pass_on()

    def _receive(self) -> None:
        with suppress(BlockingIOError):
            chunk = os.read(self._source, _WAITING_MAX_BYTES)
            if len(self._waiting) + len(chunk) > _WAITING_MAX_BYTES:
                self._lost += chunk.count(b'\n')
            else:
                self._waiting += chunk

    def _pass_on(self) -> None:
        if not self._waiting:
            self._waiting += (f'{self._name}: {self._lost} lines of this log are lost, as nothing '
                              'read it\n').encode()
            self._lost = 0
        try:
            written = os.write(self._target, self._waiting[:_WRITE_MAX_BYTES])
        except BlockingIOError:
            written = 0
        except OSError:                         # its reader has gone
            written = len(self._waiting)
        del self._waiting[:written]

    def give_back(self) -> None:
        """Have the descriptors be what they were; if that still takes nothing, it gets nothing."""
        target = os.open(os.devnull, os.O_WRONLY) if self.has_waiting() else self._target
        for fd in self._taken:
            os.dup2(target, fd)
        if 2 in self._taken and faulthandler.is_enabled():
            faulthandler.enable(sys.__stderr__ or 2)
        os.close(self._pipe)
