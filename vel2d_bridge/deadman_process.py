# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""
Watch: the dead man, which stops the rover when the bridge dies or freezes.

It has a copy of the open port, watches a heartbeat in shared memory, and writes stops when that
is silent or the bridge is gone. A port that was lost while the rover drove it opens again itself,
if the bridge does not. All it knows is on the board and in the queue, for the next dead man.
Imports no ROS and nothing that is large: what it needs of the frame is handed to it.

States: idle, no port and none to look for; guarding, the bridge has it open and beats; waiting,
the bridge looks for a lost port; stopping and searching, a zero or a search for the port each
STOP_PERIOD_S; last stops and last search, the same after the bridge has died; over.

| state | event | next state | it does |
|---|---|---|---|
| idle | the bridge opens the port | guarding | |
| idle | the bridge dies | over | |
| idle | the bridge leaves | over | |
| guarding | the bridge closes the port | idle | closes the port |
| guarding | the bridge loses the port while it drives | waiting | closes the port |
| guarding | no beat for SILENCE | stopping | writes a zero |
| guarding | the bridge dies | last stops | writes a zero |
| guarding | the bridge leaves | over | closes the port |
| waiting | the bridge opens the port | guarding | |
| waiting | the bridge gives up the port | idle | |
| waiting | no beat for SILENCE | searching | |
| waiting | the bridge dies | last search | |
| waiting | the bridge leaves | over | |
| stopping | a beat | guarding | |
| stopping | the port fails | searching | closes the port |
| stopping | the bridge dies | last stops | writes a zero |
| searching | the port is there | stopping | writes a zero |
| searching | another bridge has the port | idle | |
| searching | a beat | waiting | |
| searching | the bridge dies | last search | |
| last stops | STOP_FRAMES zeros | over | closes the port |
| last stops | the port fails | last search | closes the port |
| last search | the port is there | last stops | writes a zero |
| last search | another bridge has the port | over | |
| last search | SEARCH_S | over | |

A port that it found itself is closed at the next beat: stopping, then waiting.
"""
from __future__ import annotations

import array
from collections.abc import Callable
from contextlib import suppress
import errno
import fcntl
import os
import signal
import socket
import struct
import termios
import time

from servobus.port.readable import readable
from vel2d_bridge import lost_port
from vel2d_bridge.shared_memory import ACTED
from vel2d_bridge.shared_memory import ALIVE
from vel2d_bridge.shared_memory import AWAY
from vel2d_bridge.shared_memory import BEATEN
from vel2d_bridge.shared_memory import GOODBYE
from vel2d_bridge.shared_memory import HANDLED
from vel2d_bridge.shared_memory import HELD
from vel2d_bridge.shared_memory import OWED
from vel2d_bridge.shared_memory import PortRecord
from vel2d_bridge.shared_memory import SharedBoard

SILENCE = 200_000_000              # ns without a heartbeat: the bridge is frozen
BEAT = 50_000_000                  # ns between heartbeats
STOP_PERIOD_S = 0.05               # between zeros, and how many after a death: the gate's burst
STOP_FRAMES = 6
GAP_CHARACTERS = 30                # the bridge may just have written: its frame, and the gap
SEARCH_S = 60.0                    # for a port that was lost, when the bridge is dead
IGNORE_SIGTERM_S = 2.0             # after the bridge; a service manager ends all at once
NUMBER = 8                         # bytes: the number of a record, with its port in the queue
_DESCRIPTOR = struct.Struct('i')
_FIFO_CHARACTERS = 130             # what the UART still sends after a flush, and the gap
_CHARACTER_BITS = 10
_TURN_S = 0.2                      # at most between two signs of life
_STUCK_S = 0.05                    # a line that takes nothing for so long is flushed
_NOT_NOW = (errno.EAGAIN, errno.EINTR)


class Watch:
    """
    What the dead man knows and does.

    `fd_queue`: a queue with the open port, from the bridge. Only looked at, so that the port is
    there for the next dead man too; the process that holds it is not among those that
    `fuser -k` finds and kills.
    """

    def __init__(self, board: SharedBoard, channel: socket.socket,
                 fd_queue: socket.socket) -> None:
        self.board = board
        self.channel = channel         # ends with the bridge, wakes us when the board is new
        self._fd_queue = fd_queue
        self._record = PortRecord()
        self._fd = -1
        self._beaten = 0
        self._has_begun_stop = False
        self._has_found_port = False   # we opened the port, the bridge did not hand it over
        self._is_dead = False          # the bridge is

    def run(self, replace_server: Callable[[], None]) -> None:
        """Return when the bridge has left, or is dead and the rover has stopped."""
        wait_s = 0.0
        while self._is_bridge_there(wait_s):
            self._read_record()
            now = time.monotonic_ns()
            left_s = (self._last_beat(now) + SILENCE - now) / 1e9
            if self._record.what == GOODBYE:
                return
            if self._is_on_duty and left_s <= 0:
                self._write_stop()
                self._report_alive()
                wait_s = STOP_PERIOD_S
                continue
            self._has_begun_stop = False
            if self._has_found_port:   # the bridge lives and looks for the port
                self._close()
            if self._fd >= 0 or self._record.what != HELD:
                self._report_alive()
            wait_s = min(left_s, _TURN_S) if self._is_on_duty else _TURN_S
            replace_server()
        self._is_dead = True
        self._read_record()
        if self._record.what != GOODBYE:
            self._stop_for_good()
        self.release_port()

    @property
    def _is_on_duty(self) -> bool:
        return self._fd >= 0 or (self._record.path != '' and self._record.what in (HELD, OWED))

    def _report_alive(self) -> None:
        """Report that this record is watched over; the server ends who does not."""
        self.board.words[HANDLED] = self._record.number
        self.board.words[ALIVE] = time.monotonic_ns()

    def _last_beat(self, now: int) -> int:
        """Return when the bridge beat last; on a 32-bit machine half of the word may be old."""
        beaten = self.board.words[BEATEN]
        if self._beaten < beaten <= now:
            self._beaten = beaten
        return self._beaten

    def _is_bridge_there(self, timeout_s: float) -> bool:
        """Wait for news on the board; tell whether the bridge has the other end still."""
        if not readable([self.channel.fileno()], timeout_s):
            return True
        try:
            return bool(self.channel.recv(4096))
        except ConnectionError:
            return False

    def _read_record(self) -> None:
        """Follow a new record: have its port, or none."""
        if not self.board.is_new(self._record):
            return
        self._close()
        self._record = self.board.read()
        self._fd = self._copy_fd_of(self._record.number)

    def _copy_fd_of(self, wanted: int) -> int:
        """Return a copy of the port of a record, -1 if there is none; throw away older ones."""
        while found := self._peek_fd():
            number, fd = found
            if number == wanted:
                return fd
            if fd >= 0:
                os.close(fd)
            if number > wanted:        # its record is just being written
                break
            with suppress(OSError):
                self._fd_queue.recv(NUMBER)    # the kernel closes what comes with it
        return -1

    def _peek_fd(self) -> tuple[int, int] | None:
        """Return the oldest number and port in the queue, where they stay."""
        try:                           # socket.recv_fds forgets its flags
            number, copies, _, _ = self._fd_queue.recvmsg(
                NUMBER, socket.CMSG_LEN(_DESCRIPTOR.size), socket.MSG_PEEK)
        except OSError:
            return None
        if not number:
            return None
        fd = _DESCRIPTOR.unpack(copies[0][2])[0] if copies else -1
        return int.from_bytes(number, 'little'), fd

    def _write_stop(self) -> bool:
        """Write one zero, with a gap before it; say so first, the bridge might be waking up."""
        if self._fd < 0:
            self._find_port()
        if self._fd < 0:
            return False
        try:
            self._await_idle_line()
            if not self._has_begun_stop:
                self._has_begun_stop = True
                self.board.words[ACTED] += 1
            os.write(self._fd, self._record.stop)
        except (OSError, termios.error) as error:
            if error.args[0] not in _NOT_NOW:
                self._close_all_copies()
        return self._fd >= 0

    def _close_all_copies(self) -> None:
        """Close every copy: an adapter that is held open comes back with another name."""
        self._close()
        self._fd = self._copy_fd_of(self._record.number + 1)
        self._close()

    def _find_port(self) -> None:
        record = self._record
        try:
            self._fd = lost_port.find(record.path, record.device, record.settings, record.claim)
            self._has_found_port = self._fd >= 0
        except lost_port.TakenOver:
            self._record = record._replace(what=AWAY)

    def _stop_for_good(self) -> None:
        """Send the last burst; a port that is away is looked for, for a while."""
        written, begin = 0, time.monotonic()
        while self._is_on_duty and written < STOP_FRAMES and (
                waited_s := time.monotonic() - begin) < SEARCH_S:
            if waited_s > IGNORE_SIGTERM_S:
                signal.signal(signal.SIGTERM, signal.SIG_DFL)
            written = written + 1 if self._write_stop() else 0
            self._report_alive()
            time.sleep(STOP_PERIOD_S)

    def _await_idle_line(self) -> None:
        """Wait for an idle line; what does not leave is flushed, but for what a socket has."""
        character_s = _CHARACTER_BITS / self._record.baud
        deadline = time.monotonic() + max(_STUCK_S, 2 * GAP_CHARACTERS * character_s)
        while (pending := self._pending()) and time.monotonic() < deadline:
            time.sleep(0.001)
        if pending:
            with suppress(termios.error):      # a socket delivers it, in order
                termios.tcflush(self._fd, termios.TCOFLUSH)
            time.sleep(_FIFO_CHARACTERS * character_s)
        else:
            time.sleep(GAP_CHARACTERS * character_s)

    def _pending(self) -> int:
        count = array.array('i', [0])
        with suppress(OSError):    # a socket answers as well: what its peer has not confirmed
            fcntl.ioctl(self._fd, termios.TIOCOUTQ, count)
        return count[0]

    def release_port(self) -> None:
        """Close the port, and know nothing: the next one begins with the board."""
        if self._fd >= 0 and self._is_dead:
            with suppress(OSError, termios.error):
                self._await_idle_line()
            self._close_all_copies()           # in the queue too: the port is free now
        self._close()
        self._record = PortRecord()

    def _close(self) -> None:
        if self._fd >= 0:
            with suppress(OSError):
                if self._is_dead or self._has_found_port:      # the next start finds it free
                    fcntl.ioctl(self._fd, termios.TIOCNXCL)
            with suppress(OSError):
                os.close(self._fd)
        self._fd = -1
        self._has_found_port = False
