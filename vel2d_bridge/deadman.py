# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""
Deadman: the bridge's side of the process that stops the rover when the bridge dies or freezes.

Forked before rclpy.init, while there is one thread; deadman_server.py and deadman_process.py are
what it does. Both sides share a board in memory, a channel, which wakes it and ends with either
side, and a queue, in which the open port lies.
"""
from __future__ import annotations

from collections.abc import Callable
from contextlib import suppress
import os
import signal
import socket
import time

from vel2d_bridge.claim import identity
from vel2d_bridge.deadman_process import NUMBER
from vel2d_bridge.deadman_server import serve
from vel2d_bridge.lost_port import settings
from vel2d_bridge.process_attributes import PR_SET_CHILD_SUBREAPER
from vel2d_bridge.process_attributes import prctl
from vel2d_bridge.shared_memory import ACTED
from vel2d_bridge.shared_memory import ALIVE
from vel2d_bridge.shared_memory import AWAY
from vel2d_bridge.shared_memory import BEATEN
from vel2d_bridge.shared_memory import GOODBYE
from vel2d_bridge.shared_memory import HANDLED
from vel2d_bridge.shared_memory import HELD
from vel2d_bridge.shared_memory import OWED
from vel2d_bridge.shared_memory import PortRecord
from vel2d_bridge.shared_memory import SERVER
from vel2d_bridge.shared_memory import SharedBoard
from vel2d_bridge.shared_memory import WATCH

READY, STARTING, FROZEN, GONE = 'ready', 'starting', 'frozen', 'lost'
_ANSWER_S = 0.5                    # how long the bridge waits for it
_MUTE = 1_000_000_000              # ns after which it counts as frozen


class Deadman:
    """Forks the dead man, passes it the port, beats, says goodbye. For one thread at a time."""

    def __init__(self) -> None:
        """Fork, and return when the dead man is there; the process must have only one thread."""
        self._board = SharedBoard()
        self._words = self._board.words
        self._record = PortRecord()
        self._acted = 0
        self._words[ALIVE] = self._words[BEATEN] = time.monotonic_ns()
        self._channel, their_channel = socket.socketpair()
        self._fd_queue, their_fd_queue = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
        for one in (self._channel, self._fd_queue, their_fd_queue):
            one.setblocking(False)
        prctl(PR_SET_CHILD_SUBREAPER, 1)         # a dead man whose server was killed
        self._child = os.fork()
        if self._child == 0:
            serve(self._board, their_channel, their_fd_queue)
        their_channel.close()
        their_fd_queue.close()
        self._write(AWAY)
        self._wait(self._is_handled)

    @property
    def pids(self) -> list[int]:
        """The processes it consists of, as far as they are born: the dead man, then its server."""
        return [pid for pid in (self._words[WATCH], self._words[SERVER]) if pid]

    def hold(self, fd: int, stop_frame: bytes, baud: int, path: str = '', claim: str = '') -> None:
        """
        Hand over a newly opened port; from now on silence has consequences.

        `path`: where it is looked for when it was lost, '' for a URL. `claim`: of this bridge.
        """
        self.beat(time.monotonic_ns())
        number = (self._record.number + 1).to_bytes(NUMBER, 'little')
        with suppress(OSError):
            socket.send_fds(self._fd_queue, [number], [fd])
        self._write(HELD, stop=stop_frame, baud=baud, path=os.path.abspath(path) if path else '',
                    device=identity(os.fstat(fd).st_rdev),
                    settings=settings(fd), claim=claim)

    def release(self, owes_stop: bool = False) -> None:
        """
        Have the port closed: an adapter that is held open comes back under another name.

        `owes_stop`: the rover may be driving. Keep on beating then; without a beat for SILENCE
        the dead man looks for the port itself.
        """
        self.beat(time.monotonic_ns())
        self._write(OWED if owes_stop else AWAY)
        self._wait(self._is_handled)

    def beat(self, now: int) -> None:
        """Say that the bridge's port thread runs; at least every BEAT."""
        self._words[BEATEN] = now

    def acted(self) -> bool:
        """Return whether it wrote a stop since the last call: the bridge must begin again."""
        before, self._acted = self._acted, self._words[ACTED]
        return self._acted != before

    def is_alive(self, now: int) -> bool:
        """Whether it would stop the rover: it watches, with the port that is open."""
        return self.state(now) == READY

    def state(self, now: int) -> str:
        if self._is_gone():
            return GONE
        if now - self._words[ALIVE] >= _MUTE:
            return FROZEN
        return READY if self._is_handled() else STARTING

    def leave(self) -> None:
        """End it, without stops: the bridge has sent its own. Never raises."""
        self._write(GOODBYE)
        if not self._wait(self._is_gone):
            self._end_server()
            self._wait(self._is_gone)
        self._wait(self._is_reaped)
        self._channel.close()
        self._fd_queue.close()

    def _end_server(self) -> None:
        """End a server that does not respond; its dead man goes on then, and leaves."""
        server = self._words[SERVER] or self._child
        with suppress(ChildProcessError):
            if os.waitpid(server, os.WNOHANG)[0] == 0:
                os.kill(server, signal.SIGKILL)

    def _write(self, what: int, **changes: str | bytes | int) -> None:
        """Write what is to be done; one that is stuck or gone shows in `state`."""
        self._record = self._record._replace(
            number=self._record.number + 1, what=what, **changes)  # type: ignore[arg-type]
        self._board.write(self._record)
        with suppress(OSError):
            self._channel.send(b'!')

    def _is_handled(self) -> bool:
        return self._words[HANDLED] == self._record.number

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
