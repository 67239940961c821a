# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""
Deadman: a small child process that stops the rover when the bridge process dies or freezes.

Forked before rclpy.init, while there is one thread. It holds a copy of the open port, watches a
heartbeat in shared memory, and writes stops when that is silent or the bridge is gone. It
ignores signals, keeps none of the bridge's other descriptors, and leaves when the bridge does.
Imports only the standard library: what it needs of the frame is handed to it.
"""
from __future__ import annotations

import array
from collections.abc import Callable
from contextlib import suppress
import fcntl
import gc
import mmap
import os
from pathlib import Path
import select
import signal
import socket
import struct
import termios
import time

SILENCE = 200_000_000              # ns without a heartbeat: the bridge is frozen
BEAT = 50_000_000                  # ns between heartbeats
STOP_PERIOD_S = 0.05              # between zeros, and how many after a death: the gate's burst
STOP_FRAMES = 6
GAP_CHARACTERS = 30               # the bridge may just have written: its frame, and the gap
_FIFO_CHARACTERS = 130             # what the UART still sends after a flush, and the gap
_CHARACTER_BITS = 10
_TICK_S = 1.0                      # without a port
_STUCK_S = 0.05                    # a line that takes nothing for so long is flushed
_ANSWER_S = 0.5                    # how long the bridge waits for its child
_MUTE = 3_000_000_000              # ns after which the child counts as dead

_PORT, _RELEASE, _GOODBYE = b'p', b'r', b'g'
_HEAD = struct.Struct('<cI')       # and, for a port, the stop frame
_BEATEN, _ACTED, _HANDLED, _ALIVE = range(4)     # words of the board


def _board() -> memoryview:
    """Return 64-bit words that both processes see; each is written by one side only."""
    return memoryview(mmap.mmap(-1, mmap.PAGESIZE)).cast('Q')


class Deadman:
    """The bridge's side: forks the child, passes it the port, beats, says goodbye."""

    def __init__(self) -> None:
        """Fork; the process must have only one thread."""
        self._words = _board()
        self._acted = self._sent = 0
        self._words[_ALIVE] = self._words[_BEATEN] = time.monotonic_ns()
        self._channel, theirs = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
        bridge = os.getpid()
        self.pid = os.fork()
        if self.pid == 0:
            _live(self._words, theirs, bridge)
        theirs.close()
        self._channel.setblocking(False)

    def hold(self, fd: int, stop_frame: bytes, baud: int) -> None:
        """Hand over a newly opened port; from now on silence has consequences."""
        self.beat(time.monotonic_ns())
        self._send(_HEAD.pack(_PORT, baud) + stop_frame, [fd])

    def release(self) -> None:
        """Have the port closed: an adapter that is held open comes back under another name."""
        self._send(_HEAD.pack(_RELEASE, 0))
        self._wait(lambda: self._words[_HANDLED] >= self._sent)

    def beat(self, now: int) -> None:
        """Say that the bridge's port thread runs; at least every BEAT."""
        self._words[_BEATEN] = now

    def acted(self) -> bool:
        """Return whether it wrote a stop since the last call: the bridge must begin anew."""
        before, self._acted = self._acted, self._words[_ACTED]
        return self._acted != before

    def is_alive(self, now: int) -> bool:
        return now - self._words[_ALIVE] < _MUTE

    def leave(self) -> None:
        """End the child, without stops: the bridge has sent its own. Never raises."""
        self._send(_HEAD.pack(_GOODBYE, 0))
        if not self._wait(self._is_reaped):
            with suppress(ProcessLookupError):
                os.kill(self.pid, signal.SIGKILL)
            self._wait(self._is_reaped)
        self._channel.close()

    def _send(self, message: bytes, descriptors: list[int] | None = None) -> None:
        """Send; a child that is stuck or gone shows in `is_alive`."""
        with suppress(OSError):
            socket.send_fds(self._channel, [message], descriptors or [])
            self._sent += 1

    def _is_reaped(self) -> bool:
        try:
            return os.waitpid(self.pid, os.WNOHANG)[0] == self.pid
        except ChildProcessError:
            return True

    def _wait(self, condition: Callable[[], bool]) -> bool:
        deadline = time.monotonic() + _ANSWER_S
        while not (met := condition()) and time.monotonic() < deadline:
            time.sleep(0.001)
        return met


def _live(words: memoryview, channel: socket.socket, bridge: int) -> None:
    """Be the child: never returns."""
    try:
        _isolate(channel.fileno())
        _Watch(words, channel, bridge).run()
    finally:
        os._exit(0)


def _isolate(keep: int) -> None:
    """Own session, deaf to signals, none of the bridge's descriptors: its pipes must end."""
    gc.disable()
    os.setsid()
    signal.set_wakeup_fd(-1)
    for number in signal.valid_signals() - {
            signal.SIGKILL, signal.SIGSTOP, signal.SIGSEGV, signal.SIGBUS, signal.SIGILL,
            signal.SIGFPE, signal.SIGABRT}:
        with suppress(OSError, ValueError):
            signal.signal(number, signal.SIG_IGN)
    null = os.open(os.devnull, os.O_RDWR)
    for fd in range(3):
        os.dup2(null, fd)
    for name in os.listdir('/proc/self/fd'):
        if int(name) > 2 and int(name) != keep:
            with suppress(OSError):
                os.close(int(name))
    os.chdir('/')
    with suppress(OSError):
        Path('/proc/self/comm').write_text('vel2d_deadman')


class _Watch:
    """The child's side."""

    def __init__(self, words: memoryview, channel: socket.socket, bridge: int) -> None:
        self._words = words
        self._channel = channel
        self._bridge = bridge
        self._left = False         # the bridge said goodbye
        self._dead = False         # the bridge is gone without one
        self._fd = -1
        self._stop = b''
        self._character_s = 0.0
        self._acting = False

    def run(self) -> None:
        while not (self._left or self._dead):
            now = self._words[_ALIVE] = time.monotonic_ns()
            left_s = (self._words[_BEATEN] + SILENCE - now) / 1e9
            if self._fd >= 0 and left_s <= 0:
                self._act()
                self._listen(STOP_PERIOD_S)
            else:
                self._acting = False
                self._listen(_TICK_S if self._fd < 0 else left_s)
            self._dead = self._dead or os.getppid() != self._bridge
        if self._dead:
            for _ in range(STOP_FRAMES):
                self._act()
                time.sleep(STOP_PERIOD_S)
        self._release()

    def _listen(self, timeout_s: float) -> None:
        if not select.select([self._channel], [], [], timeout_s)[0]:
            return
        try:
            message, descriptors, _, _ = socket.recv_fds(self._channel, 256, 1)
        except ConnectionError:
            message, descriptors = b'', []
        if not message:
            self._dead = True
            return
        what, baud = _HEAD.unpack_from(message)
        self._release()
        if what == _PORT and descriptors:
            self._fd = descriptors[0]
            self._stop = message[_HEAD.size:]
            self._character_s = _CHARACTER_BITS / baud
        self._left = what == _GOODBYE
        self._words[_HANDLED] += 1

    def _act(self) -> None:
        """Write one zero, with a gap before it; say so first, the bridge might be waking up."""
        if self._fd < 0:
            return
        with suppress(OSError, termios.error):
            self._settle()
            if not self._acting:
                self._acting = True
                self._words[_ACTED] += 1
            os.write(self._fd, self._stop)

    def _settle(self) -> None:
        """Wait for an idle line; what does not leave is flushed, but for what a socket has."""
        deadline = time.monotonic() + max(_STUCK_S, 2 * GAP_CHARACTERS * self._character_s)
        while (pending := self._pending()) and time.monotonic() < deadline:
            time.sleep(0.001)
        if pending:
            with suppress(termios.error):      # a socket delivers it, in order
                termios.tcflush(self._fd, termios.TCOFLUSH)
            time.sleep(_FIFO_CHARACTERS * self._character_s)
        else:
            time.sleep(GAP_CHARACTERS * self._character_s)

    def _pending(self) -> int:
        count = array.array('i', [0])
        with suppress(OSError):    # a socket answers as well: what its peer has not confirmed
            fcntl.ioctl(self._fd, termios.TIOCOUTQ, count)
        return count[0]

    def _release(self) -> None:
        """Close the port, so that the next start finds it free."""
        if self._fd < 0:
            return
        if self._dead:
            with suppress(OSError, termios.error):
                self._settle()
                fcntl.ioctl(self._fd, termios.TIOCNXCL)
        with suppress(OSError):
            os.close(self._fd)
        self._fd = -1
