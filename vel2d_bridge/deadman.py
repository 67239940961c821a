# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""
Deadman: the bridge's side of the process that stops the rover when the bridge dies or freezes.

Forked before rclpy.init, while there is one thread; watch.py is what it does. The two share a
board of words in memory and a socket, which also tells either side that the other one is gone.
"""
from __future__ import annotations

from collections.abc import Callable
from contextlib import suppress
import mmap
import os
import signal
import socket
import time

from vel2d_bridge.watch import ACTED
from vel2d_bridge.watch import ALIVE
from vel2d_bridge.watch import BEATEN
from vel2d_bridge.watch import BORN
from vel2d_bridge.watch import GOODBYE
from vel2d_bridge.watch import HANDLED
from vel2d_bridge.watch import HEAD
from vel2d_bridge.watch import PORT
from vel2d_bridge.watch import RELEASE
from vel2d_bridge.watch import serve
from vel2d_bridge.watch import SERVER
from vel2d_bridge.watch import WATCH

_ANSWER_S = 0.5                    # how long the bridge waits for it
_MUTE = 3_000_000_000              # ns after which it counts as dead


def board() -> memoryview:
    """Return 64-bit words that both processes see; each is written by one side only."""
    return memoryview(mmap.mmap(-1, mmap.PAGESIZE)).cast('Q')


class Deadman:
    """Forks the dead man, passes it the port, beats, says goodbye. For one thread at a time."""

    def __init__(self) -> None:
        """Fork, and return when the dead man is there; the process must have only one thread."""
        self._words = board()
        self._acted = self._sent = 0
        self._born = 1
        self._held: tuple[bytes, int] | None = None
        self._words[ALIVE] = self._words[BEATEN] = time.monotonic_ns()
        self._channel, theirs = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
        self._child = os.fork()
        if self._child == 0:
            serve(self._words, theirs)
        theirs.close()
        self._channel.setblocking(False)
        self._wait(lambda: self._words[WATCH] != 0)

    @property
    def pids(self) -> list[int]:
        """The processes it consists of, as far as they are born: the dead man, then its server."""
        # 0 to os.kill is each process of our group: that would end who launched us, too.
        return [pid for pid in (self._words[WATCH], self._words[SERVER]) if pid]

    def hold(self, fd: int, stop_frame: bytes, baud: int, path: str = '') -> None:
        """
        Hand over a newly opened port; from now on silence has consequences.

        `path`: where it is looked for when it was lost, '' for a URL.
        """
        self.beat(time.monotonic_ns())
        where = os.fsencode(os.path.abspath(path)) if path else b''
        self._held = HEAD.pack(PORT, baud, len(stop_frame)) + stop_frame + where, fd
        self._hand_over()

    def _hand_over(self) -> None:
        if self._held is not None:
            message, fd = self._held
            self._send(message, [fd])

    def release(self, owes_stop: bool = False) -> None:
        """
        Have the port closed: an adapter that is held open comes back under another name.

        `owes_stop`: the rover may be driving. Keep on beating then; without a beat for SILENCE
        the dead man looks for the port itself.
        """
        self.beat(time.monotonic_ns())
        self._held = None
        self._send(HEAD.pack(RELEASE, owes_stop, 0))
        self._wait(lambda: self._words[HANDLED] >= self._sent)

    def beat(self, now: int) -> None:
        """Say that the bridge's port thread runs; at least every BEAT."""
        self._words[BEATEN] = now
        if self._words[BORN] != self._born:      # a new one in the place of one that died
            self._born = self._words[BORN]
            self._sent = self._words[HANDLED]
            self._hand_over()

    def acted(self) -> bool:
        """Return whether it wrote a stop since the last call: the bridge must begin again."""
        before, self._acted = self._acted, self._words[ACTED]
        return self._acted != before

    def is_alive(self, now: int) -> bool:
        return now - self._words[ALIVE] < _MUTE and not self._is_gone()

    def leave(self) -> None:
        """End it, without stops: the bridge has sent its own. Never raises."""
        self._send(HEAD.pack(GOODBYE, 0, 0))
        if not self._wait(self._is_gone):
            for pid in reversed(self.pids):
                with suppress(ProcessLookupError):
                    os.kill(pid, signal.SIGKILL)
            self._wait(self._is_gone)
        self._wait(self._is_reaped)
        self._channel.close()

    def _send(self, message: bytes, descriptors: list[int] | None = None) -> None:
        """Send; one that is stuck or gone shows in `is_alive`."""
        with suppress(OSError):
            socket.send_fds(self._channel, [message], descriptors or [])
            self._sent += 1

    def _is_gone(self) -> bool:
        """Tell whether neither of its processes has the other end of the socket any more."""
        try:
            return not self._channel.recv(1)     # it never sends
        except BlockingIOError:
            return False
        except OSError:
            return True

    def _is_reaped(self) -> bool:
        try:
            return os.waitpid(self._child, os.WNOHANG)[0] == self._child
        except ChildProcessError:
            return True

    def _wait(self, condition: Callable[[], bool]) -> bool:
        deadline = time.monotonic() + _ANSWER_S
        while not (met := condition()) and time.monotonic() < deadline:
            time.sleep(0.001)
        return met
