# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""
Watch: the dead man's process, which stops the rover when the bridge dies or freezes.

It holds a copy of the open port, watches a heartbeat in shared memory, and writes stops when that
is silent or the bridge is gone. A port that was lost while the rover drove it opens again itself,
if the bridge does not. Two processes: the dead man, and its parent, the server, that starts it
again when it dies; when the server dies, the dead man takes over that part. Both ignore signals,
keep none of the bridge's other descriptors, and their command lines say `deadman`.
Imports no ROS and nothing that is large: what it needs of the frame is handed to it.
"""
from __future__ import annotations

import array
from contextlib import suppress
import errno
import fcntl
import gc
import os
import select
import signal
import socket
import struct
import termios
import time

from mecarover_serial.process import rename_process

NAME = 'deadman'                   # `pkill -f vel2d_bridge` must not find it
SILENCE = 200_000_000              # ns without a heartbeat: the bridge is frozen
BEAT = 50_000_000                  # ns between heartbeats
STOP_PERIOD_S = 0.05               # between zeros, and how many after a death: the gate's burst
STOP_FRAMES = 6
GAP_CHARACTERS = 30                # the bridge may just have written: its frame, and the gap
SEARCH_S = 60.0                    # for a port that was lost, when the bridge is dead
_FIFO_CHARACTERS = 130             # what the UART still sends after a flush, and the gap
_CHARACTER_BITS = 10
_TICK_S = 1.0                      # without a port
_STUCK_S = 0.05                    # a line that takes nothing for so long is flushed
_REBIRTH_S = 0.02                  # before the next dead man: one that fails must not spin

PORT, RELEASE, GOODBYE = b'p', b'r', b'g'
HEAD = struct.Struct('<cII')       # what; baud, or for RELEASE 1 = a stop is owed; its size
BEATEN, ACTED, HANDLED, ALIVE, BORN, SERVER, WATCH = range(7)     # words of the board
_LONGEST_MESSAGE = 8192            # a path has 4096 bytes at most
_NOT_NOW = (errno.EAGAIN, errno.EINTR)
_TCGETS2, _TCSETS2 = 0x802C542A, 0x402C542B
_TERMIOS2 = 44                     # bytes


def serve(words: memoryview, channel: socket.socket) -> None:
    """Be the server, and have a dead man for as long as the bridge wants one. Never returns."""
    try:
        isolate({channel.fileno()})
        _keep_one(Watch(words, channel))
    finally:
        os._exit(1)


def _keep_one(watch: Watch) -> None:
    """Return never: the child is the dead man, this process waits for its end."""
    watch.words[SERVER] = os.getpid()
    while os.fork():
        watch.let_go()                 # two that hold a port would be one too many
        _, status = os.wait()
        if status == 0:                # it left because the bridge did
            os._exit(0)
        time.sleep(_REBIRTH_S)
        watch.begin()
    watch.words[WATCH] = os.getpid()
    watch.server = watch.words[SERVER]
    watch.run()
    os._exit(0)


def isolate(keep: set[int]) -> None:
    """Own session, deaf to signals, none of the bridge's descriptors: its pipes must end."""
    gc.disable()
    os.setsid()
    signal.set_wakeup_fd(-1)
    for number in signal.valid_signals() - {
            signal.SIGKILL, signal.SIGSTOP, signal.SIGSEGV, signal.SIGBUS, signal.SIGILL,
            signal.SIGFPE, signal.SIGABRT, signal.SIGCHLD}:
        with suppress(OSError, ValueError):
            signal.signal(number, signal.SIG_IGN)
    null = os.open(os.devnull, os.O_RDWR)
    for fd in range(3):
        os.dup2(null, fd)
    for name in os.listdir('/proc/self/fd'):
        if int(name) > 2 and int(name) not in keep:
            with suppress(OSError):
                os.close(int(name))
    os.chdir('/')
    rename_process(NAME)


class Watch:
    """What the dead man knows and does."""

    def __init__(self, words: memoryview, channel: socket.socket) -> None:
        self.words = words
        self.server = 0            # the pid of its parent
        self._channel = channel
        self._fd = -1
        self.begin()

    def begin(self) -> None:
        """Know nothing yet: the bridge sees a new number, and hands over the port again."""
        self._left = False         # the bridge said goodbye
        self._dead = False         # the bridge is gone without one
        self._is_owed = False      # the port was lost while the rover may have driven
        self._is_ours = False      # the bridge did not hand it over, we opened it
        self._beaten = 0
        self._stop = b''
        self._path = ''
        self._settings = bytearray()
        self._character_s = 0.0
        self._acting = False
        self.words[BORN] += 1

    def run(self) -> None:
        while not (self._left or self._dead):
            now = self.words[ALIVE] = time.monotonic_ns()
            left_s = (self._last_beat(now) + SILENCE - now) / 1e9
            if self._is_on_duty and left_s <= 0:
                self._act()
                self._listen(STOP_PERIOD_S)
                continue
            self._acting = False
            if self._is_ours:      # the bridge lives and looks for the port: its turn
                self._close()
            self._listen(left_s if self._is_on_duty else _TICK_S)
            self._replace_server()
        if self._dead:
            self._stop_for_good()
        self.let_go()

    @property
    def _is_on_duty(self) -> bool:
        return self._fd >= 0 or self._is_owed

    def _last_beat(self, now: int) -> int:
        """Return when the bridge beat last; on a 32-bit machine half of the word may be old."""
        beaten = self.words[BEATEN]
        if self._beaten < beaten <= now:
            self._beaten = beaten
        return self._beaten

    def _replace_server(self) -> None:
        """Take the place of a server that was killed: from now on the dead man is a child."""
        if os.getppid() != self.server:
            _keep_one(self)

    def _listen(self, timeout_s: float) -> None:
        if not select.select([self._channel], [], [], timeout_s)[0]:
            return
        try:
            message, descriptors, _, _ = socket.recv_fds(self._channel, _LONGEST_MESSAGE, 1)
        except ConnectionError:
            message, descriptors = b'', []
        if not message:
            self._dead = True
            return
        what, number, size = HEAD.unpack_from(message)
        self.let_go()
        self._is_owed = what == RELEASE and number == 1 and bool(self._path)
        if what == PORT and descriptors:
            self._fd = descriptors[0]
            stop_and_path = message[HEAD.size:]
            self._stop, self._path = stop_and_path[:size], os.fsdecode(stop_and_path[size:])
            self._character_s = _CHARACTER_BITS / number
            self._settings = self._read_settings()
        self._left = what == GOODBYE
        self.words[HANDLED] += 1

    def _read_settings(self) -> bytearray:
        """Return the settings of the port, its rate among them, for the port when it is back."""
        settings = bytearray(_TERMIOS2)
        with suppress(OSError):        # a socket has none
            fcntl.ioctl(self._fd, _TCGETS2, settings)
        return settings

    def _act(self) -> None:
        """Write one zero, with a gap before it; say so first, the bridge might be waking up."""
        if self._fd < 0:
            self._find()
        if self._fd < 0:
            return
        try:
            self._settle()
            if not self._acting:
                self._acting = True
                self.words[ACTED] += 1
            os.write(self._fd, self._stop)
        except (OSError, termios.error) as error:
            if error.args[0] not in _NOT_NOW:
                self._close()          # an adapter that is held open comes back with another name
                self._is_owed = bool(self._path)

    def _find(self) -> None:
        """Open the port as it was, if it is back."""
        try:
            fd = os.open(self._path, os.O_RDWR | os.O_NOCTTY | os.O_NONBLOCK)
        except OSError as error:
            self._leave_to_others(error)
            return
        try:
            fcntl.flock(fd, fcntl.LOCK_EX | fcntl.LOCK_NB)
            fcntl.ioctl(fd, _TCSETS2, self._settings)
        except OSError as error:
            os.close(fd)
            self._leave_to_others(error)
            return
        with suppress(OSError):        # a pty has no such lines; on a board they may mean reset
            fcntl.ioctl(fd, termios.TIOCMBIC,
                        struct.pack('I', termios.TIOCM_DTR | termios.TIOCM_RTS))
        self._fd = fd
        self._is_ours = True

    def _leave_to_others(self, error: OSError) -> None:
        """Look no more when the next bridge has the port: it begins with stops."""
        if self._dead and error.errno in (errno.EBUSY, errno.EAGAIN):
            self._is_owed = False

    def _stop_for_good(self) -> None:
        """Send the last burst; a port that is away is looked for, for a while."""
        written, deadline = 0, time.monotonic() + SEARCH_S
        while written < STOP_FRAMES and self._is_on_duty and time.monotonic() < deadline:
            self._act()
            written += self._fd >= 0
            time.sleep(STOP_PERIOD_S)

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

    def let_go(self) -> None:
        """Close the port, so that the next start finds it free."""
        if self._fd >= 0 and self._dead:
            with suppress(OSError, termios.error):
                self._settle()
                fcntl.ioctl(self._fd, termios.TIOCNXCL)
        self._close()

    def _close(self) -> None:
        if self._fd >= 0:
            with suppress(OSError):
                os.close(self._fd)
        self._fd = -1
        self._is_ours = False
