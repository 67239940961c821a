# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""
Server: the dead man's parent, which starts another one when it dies or does not respond.

When the server dies, the dead man becomes the server of the next one. Both ignore signals while
there is a bridge, keep none of its descriptors, and their command lines say `deadman`. A stopped
one goes on when its parent dies. No process is signalled that is not a child.
"""
from __future__ import annotations

from contextlib import suppress
import fcntl
import gc
import os
import select
import signal
import socket
import time

from vel2d_bridge.deadman_process import IGNORE_SIGTERM_S
from vel2d_bridge.deadman_process import SEARCH_S
from vel2d_bridge.deadman_process import Watch
from vel2d_bridge.process_attributes import PR_SET_PDEATHSIG
from vel2d_bridge.process_attributes import prctl
from vel2d_bridge.process_attributes import rename_process
from vel2d_bridge.shared_memory import ALIVE
from vel2d_bridge.shared_memory import HANDLED
from vel2d_bridge.shared_memory import SERVER
from vel2d_bridge.shared_memory import SharedBoard
from vel2d_bridge.shared_memory import WATCH

NAME = 'deadman'                   # `pkill -f vel2d_bridge` must not find it
_REBIRTH_S = 0.02                  # before the next dead man: one that fails must not spin
_CHECK_MS = 250
_SILENT_CHECKS = 4                 # without a sign of life. Not a time: we may have slept too
_OUTLIVE_S = SEARCH_S + 5.0        # the bridge
_LEFT = (0, signal.SIGTERM)        # status of a dead man that needs no other


def serve(board: SharedBoard, *sockets: socket.socket) -> None:
    """Be the server, and have a dead man for as long as the bridge wants one. Never returns."""
    try:
        _DeadmanServer(Watch(board, *isolate(*sockets))).run()
    finally:
        os._exit(1)


def isolate(*sockets: socket.socket) -> list[socket.socket]:
    """Own session, deaf to signals, of the bridge's descriptors only these: its pipes must end."""
    gc.disable()
    os.setsid()
    signal.set_wakeup_fd(-1)
    for number in signal.valid_signals() - {
            signal.SIGKILL, signal.SIGSTOP, signal.SIGSEGV, signal.SIGBUS, signal.SIGILL,
            signal.SIGFPE, signal.SIGABRT, signal.SIGCHLD}:
        with suppress(OSError, ValueError):
            signal.signal(number, signal.SIG_IGN)
    signal.pthread_sigmask(signal.SIG_SETMASK, [])     # the bridge starts with some held back
    # Where a standard stream was closed, a socket may have its number.
    kept = [socket.socket(fileno=fcntl.fcntl(one.detach(), fcntl.F_DUPFD_CLOEXEC, 3))
            for one in sockets]
    null = os.open(os.devnull, os.O_RDWR)
    for fd in range(3):
        os.dup2(null, fd)
    for name in os.listdir('/proc/self/fd'):
        if int(name) > 2 and int(name) not in [one.fileno() for one in kept]:
            with suppress(OSError):
                os.close(int(name))
    os.chdir('/')
    rename_process(NAME)
    return kept


class _DeadmanServer:
    """A server; in its child the dead man, which may become a server too."""

    def __init__(self, watch: Watch) -> None:
        self._watch = watch
        self._words = watch.board.words
        self._bridge_ended_s: float | None = None
        prctl(PR_SET_PDEATHSIG, signal.SIGCONT)

    def run(self) -> None:
        """Return never."""
        while not self._has_outlived_bridge(_OUTLIVE_S):
            with suppress(OSError):              # no process or descriptor is to be had just now
                self._keep_watcher()
            time.sleep(_REBIRTH_S)
        os._exit(0)

    def _has_outlived_bridge(self, seconds: float) -> bool:
        """Tell whether the bridge has been dead for so long."""
        ended_s = self._bridge_ended_s
        return ended_s is not None and time.monotonic() - ended_s > seconds

    def _keep_watcher(self) -> None:
        """Start a dead man; return when another one is needed."""
        server = self._words[SERVER] = os.getpid()
        ours, theirs = socket.socketpair()       # closed at its end
        with ours:
            with theirs:
                child = os.fork()
                if child == 0:
                    ours.close()
                    self._run_watcher(server)
            self._watch.release_port()           # two that hold a port would be one too many
            status = self._await_watcher_end(child, ours)
        if status in _LEFT:
            os._exit(0)
        self._words[HANDLED] = 0

    def _run_watcher(self, server: int) -> None:
        """Be the dead man. Never returns."""
        prctl(PR_SET_PDEATHSIG, signal.SIGCONT)
        self._words[WATCH] = os.getpid()
        self._watch.run(lambda: self._replace_server(server))
        os._exit(0)

    def _replace_server(self, server: int) -> None:
        """Take the place of a server that was killed, as soon as there is a process to be had."""
        if os.getppid() != server:
            with suppress(OSError):
                self._keep_watcher()
                self.run()

    def _await_watcher_end(self, child: int, end: socket.socket) -> int:
        """Return the wait status of a dead man; end one that shows no sign of life."""
        poll = select.poll()
        poll.register(end, 0)
        if self._bridge_ended_s is None:
            poll.register(self._watch.channel, 0)
        last, silent_checks = 0, 0
        while end.fileno() not in (events := dict(poll.poll(_CHECK_MS))):
            before, last = last, self._words[ALIVE]
            if events:
                poll.unregister(self._watch.channel)
                self._bridge_ended_s = time.monotonic()
                os.kill(child, signal.SIGCONT)
            else:
                silent_checks = silent_checks + 1 if last == before else 0
            if silent_checks >= _SILENT_CHECKS or self._has_outlived_bridge(_OUTLIVE_S):
                os.kill(child, signal.SIGKILL)
            if self._has_outlived_bridge(IGNORE_SIGTERM_S):
                signal.signal(signal.SIGTERM, signal.SIG_DFL)
        return os.waitpid(child, 0)[1]
