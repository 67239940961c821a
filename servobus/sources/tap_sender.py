# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""
The tap inside of a Python master: what passes through pyserial is forwarded to listeners.

Loaded by file, by site/sitecustomize.py, into a program that knows nothing of this package.
So it takes only what the standard library has on every system. It never blocks the program: calls
put a record into a queue, a thread sends. What a slow reader does not take is counted and left
out. tap_pyserial.py calls this, tap_reader.py is the other end.

The program may close our descriptor and get its number for a file of its own: before each use of
the number the kernel is asked whether it is still our socket. Another thread may come in between:
so the number is a high one, and send() is refused by all but sockets.
"""

from __future__ import annotations

from collections import deque
from contextlib import suppress
import json
import os
import re
import socket
import stat
import struct
import sys
import tempfile
import threading
import time
from typing import Any
from weakref import WeakSet

TAP_NAME = 'MECAROVER_TAP'                 # environment: the name that the user gave
TAP_MARK = 'MECAROVER_TAP_MARK'            # and a file that says how far it got:
LOADED, USED = b'tap\n', b'port '          # a tap was loaded; the port that was opened, a line
TRACE = b'trace '                          # the process that strace shall hear from now on, a line
SUFFIX = '.tap'                            # ends the name of a listener's socket

# A record: its kind as a place in KINDS, the number of the port, a stamp (ns, monotonic), the size
# of what follows. Kinds but OPENED, ENDED, TWO_READERS and hello are names of msg_defs/event.py.
HEAD = struct.Struct('<BHqI')
OPENED, ENDED = 'opened', 'ended'
TWO_READERS = 'two_readers'                # wait for bytes at once; 1: threads, 2: processes
HAS_DIED = 3                               # its value where one of these threads did
KINDS = ('hello', OPENED, 'closed', 'out', 'in', 'baud', 'purged', 'not_sent', 'lost', 'unread',
         ENDED, 'dtr', 'rts', 'gave_up_us', 'traced_us', 'away_us', 'busy_us',
         'line_mode', TWO_READERS, 'unplugged')
NUMBER = struct.Struct('<q')               # what follows the others

PORT = re.compile(r'/dev/(?:(?!ttyprintk)tty[A-Za-z]\w*|rfcomm\d+|pts/\d+)')
QUEUED_RECORDS_MAX = 20_000                # records that wait for the thread
PENDING_MAX_BYTES = 4_000_000              # bytes that wait for a reader
POLL_S = 0.02
FIND_READERS_EVERY_S = 0.2                 # between two looks for new readers
END_WAIT_S = 0.3                           # how long the end of the program waits for a reader
READERS_MAX = 8
STRACE_WAIT_S = 2.0                        # how long a program waits for strace, once
HIGH_NUMBERS = (900, 200, 50)              # at least: programs seldom have as many open
_SET_PTRACER = 0x59616D61                  # prctl: who may trace (kernel, Yama)
_NO_SIGNAL = getattr(socket, 'MSG_NOSIGNAL', 0)


def folder() -> str:
    """Return where readers and masters of one user meet."""
    runtime = os.environ.get('XDG_RUNTIME_DIR')
    if runtime:
        return os.path.join(runtime, 'mecarover_serial')
    user = os.getuid() if hasattr(os, 'getuid') else 'user'
    return os.path.join(tempfile.gettempdir(), f'mecarover_serial-{user}')


def is_private(path: str) -> bool:
    """Tell whether a folder belongs to this user alone, where a system knows such a thing."""
    status = os.lstat(path)
    return stat.S_ISDIR(status.st_mode) and (
        not hasattr(os, 'getuid')
        or (status.st_uid == os.geteuid() and not status.st_mode & 0o077))


def record(kind: str, port: int, stamp: int, data: bytes) -> bytes:
    return HEAD.pack(KINDS.index(kind), port, stamp, len(data)) + data


def lost_record(count: int) -> bytes:
    """Return the record of how many records were left out."""
    return record('lost', 0, time.monotonic_ns(), NUMBER.pack(count))


class _OwnSocket(socket.socket):
    """A socket that is closed on purpose only: its number may be the program's by then."""

    def __del__(self) -> None:
        self.detach()


def _unix_socket() -> socket.socket:
    """Return a socket, if possible under a number that the program will not get."""
    low = _OwnSocket(socket.AF_UNIX)
    for least in HIGH_NUMBERS:
        with suppress(ImportError, OSError):   # the limit of open files is lower
            import fcntl

            high = fcntl.fcntl(low.fileno(), fcntl.F_DUPFD_CLOEXEC, least)
            if os.path.sameopenfile(high, low.fileno()):       # else the program was faster
                low.close()
            return _OwnSocket(socket.AF_UNIX, socket.SOCK_STREAM, 0, high)
    return low


class _TapPeer:
    """One who listens; `lost`: records that it did not get and does not know of."""

    def __init__(self, path: str, lost: int = 0) -> None:
        secret = ''
        self.lost = lost
        if hasattr(socket, 'AF_UNIX'):
            self._socket = _unix_socket()
            address: object = path
        else:
            with open(path) as file:
                port, secret = file.read().split()
            self._socket = socket.socket(socket.AF_INET)
            address = ('127.0.0.1', int(port))
        self._file = self._file_of_number()
        self._socket.settimeout(0.1)
        try:
            self._socket.connect(address)      # type: ignore[arg-type]
        except OSError:
            self.close()
            raise
        self._socket.setblocking(False)
        hello = json.dumps({'pid': os.getpid(), 'program': sys.argv[0] if sys.argv else '',
                            'secret': secret}).encode()
        self.pending = bytearray(record('hello', 0, time.monotonic_ns(), hello))

    def _file_of_number(self) -> tuple[int, int] | None:
        """Return which file our number is of, as the kernel has it now; None: no file."""
        try:
            status = os.fstat(self._socket.fileno())
        except OSError:                        # on Windows a socket is no file
            return None
        return status.st_dev, status.st_ino

    def is_ours(self) -> bool:
        """Tell whether the number is still that of our socket."""
        return self._file_of_number() == self._file

    def close(self) -> None:
        """Close our socket, nothing else."""
        if self.is_ours():
            self._socket.close()
        else:
            self._socket.detach()

    def send(self, records: list[bytes]) -> bool:
        """Send what it takes without waiting; return whether it is still there."""
        if len(self.pending) > PENDING_MAX_BYTES:
            self.lost += len(records)
        else:
            if self.lost:
                self.pending += lost_record(self.lost)
                self.lost = 0
            self.pending += b''.join(records)
        try:
            while self.pending:
                if not self.is_ours():
                    return False
                sent = self._socket.send(self.pending[:65_536], _NO_SIGNAL)
                del self.pending[:sent]
        except (BlockingIOError, InterruptedError):
            pass
        except OSError:
            return False
        return True


class Sender:
    """The records of this process, and the thread that sends them."""

    def __init__(self, name: str) -> None:
        self.name = name
        self.queue: deque[tuple[str, int, int, bytes]] = deque()
        self.lost = 0                          # records that found the queue full
        self._ports: dict[int, tuple[bytes, int]] = {}     # number: name, rate
        self._announced: set[int] = set()      # ports that listeners know as open
        self.serials: WeakSet[Any] = WeakSet() # the ports of pyserial that were opened
        self.rivals: dict[int, int] = {}       # threads that read a port at once: its number
        self._numbers = 0
        self._is_traced = False                # strace hears the ports of this process
        self._has_asked = False                # for strace
        self._readers: dict[str, _TapPeer] = {}
        # tempfile locks the first time: in a thread, a child that is forked then waits for ever.
        with suppress(OSError):
            folder()
        self._forget()
        self._mark(LOADED)

    def _forget(self) -> None:
        """Begin as after a fork: the thread and the connections are the parent's."""
        self.queue.clear()
        for reader in self._readers.values():
            reader.close()
        self._readers.clear()
        self._missed: dict[str, int] = {}      # records, by reader with a closed connection
        self._looked = float('-inf')
        self._is_ending = False
        self._thread: threading.Thread | None = None
        self._lock = threading.Lock()

    def after_fork(self) -> None:
        """Go on in a child; it has one thread, so nothing comes in between in making a socket."""
        self._forget()
        self._announced.update(self._ports)
        if self._ports:
            with suppress(Exception):
                self._find_readers()
            self._begin()

    def put(self, kind: str, port: int, data: bytes, stamp: int = 0) -> None:
        """Take a record, at once, of now or `stamp`; called in the program's reads and writes."""
        if port and self._is_traced:
            return
        if len(self.queue) < QUEUED_RECORDS_MAX:
            self.queue.append((kind, port, stamp or time.monotonic_ns(), data))
        else:
            self.lost += 1

    def number(self, kind: str, port: int, value: int, stamp: int = 0) -> None:
        self.put(kind, port, NUMBER.pack(value), stamp)

    def opened(self, name: str, baud: int, stamp: int = 0) -> int:
        """Take note of an open port; return its number. baud: 0 where it is unknown."""
        encoded = name.encode('utf-8', 'replace')
        with self._lock:
            self._numbers = number = self._numbers % 0xFFFF + 1
            self._ports[number] = (encoded, baud)
            self._begin()
        self.put(OPENED, number, encoded, stamp)
        if baud:
            self.number('baud', number, baud, stamp)
        self._mark(USED + os.path.realpath(name).encode('utf-8', 'replace') + b'\n')
        return number

    def rate(self, port: int, baud: int, stamp: int = 0) -> None:
        name, before = self._ports.get(port, (b'', 0))
        if baud != before:
            self._ports[port] = (name, baud)
            self.number('baud', port, baud, stamp)

    def closed(self, port: int, stamp: int = 0) -> None:
        self._ports.pop(port, None)
        self.put('closed', port, b'', stamp)

    def give_way(self) -> None:
        """Ask for strace, where a library opens ports by itself; wait until it is there."""
        if sys.platform != 'linux' or self._has_asked or TAP_MARK not in os.environ:
            return
        self._has_asked = True
        import ctypes

        ctypes.CDLL(None).prctl(_SET_PTRACER, ctypes.c_ulong(-1), 0, 0, 0)     # else ancestors
        self._mark(TRACE + b'%d\n' % os.getpid())
        until = time.monotonic() + STRACE_WAIT_S
        while not self._is_traced and time.monotonic() < until:
            time.sleep(POLL_S / 10)
            with open('/proc/self/status') as file:
                self._is_traced = '\nTracerPid:\t0\n' not in file.read()

    def note_open(self, path: Any, flags: int) -> None:
        """Ask for strace before the program opens a serial port for writing by itself."""
        if not flags & os.O_ACCMODE or self._has_asked:
            return
        status = os.stat(path)
        if stat.S_ISCHR(status.st_mode) and PORT.fullmatch(os.path.realpath(os.fsdecode(path))) \
                and status.st_rdev not in [os.fstat(number).st_rdev for number in range(3)]:
            self.give_way()

    def end(self) -> None:
        """Let readers have what they did not get yet, but not for long."""
        thread = self._thread
        self._is_ending = True
        if thread is not None:
            thread.join(END_WAIT_S)
        elif self.queue:                       # Python starts no thread at its end
            self._run()

    def _mark(self, line: bytes) -> None:
        """Say to who started this program that the tap works."""
        path = os.environ.get(TAP_MARK)
        if path:
            with suppress(OSError), open(path, 'ab') as file:
                file.write(line)

    def _begin(self) -> None:
        if self._thread is None:
            self._thread = threading.Thread(target=self._run, name='mecarover_tap', daemon=True)
            self._thread.start()

    def _run(self) -> None:
        until = float('inf')
        while True:
            with suppress(Exception):          # any error: the program must not see it
                self._find_readers()
                self._send()
            if self._is_ending:
                until = min(until, time.monotonic() + END_WAIT_S)
                if time.monotonic() >= until or not (
                        self.queue or any(one.pending for one in self._readers.values())):
                    return
            time.sleep(POLL_S if not self._is_ending else POLL_S / 10)

    def _find_readers(self) -> None:
        """Connect to those who began to listen; each first learns what is open."""
        now = time.monotonic()
        for path, reader in list(self._readers.items()):
            if not reader.is_ours():
                self._drop(path, len(reader.pending) > 0)
        if now - self._looked < FIND_READERS_EVERY_S and not (self._is_ending and self._missed):
            return
        self._looked = now
        place = folder()
        if not os.path.isdir(place) or not is_private(place):
            return
        for file in os.listdir(place):
            path = os.path.join(place, file)
            name = file.rpartition('.')[0].rpartition('.')[0]
            if (name == self.name and file.endswith(SUFFIX) and path not in self._readers
                    and len(self._readers) < READERS_MAX):
                try:
                    reader = _TapPeer(path, self._missed.get(path, 0))
                except (OSError, ValueError):
                    continue
                self._readers[path] = reader
                reader.send(self._state())
        self._missed.clear()

    def _state(self) -> list[bytes]:
        """Return what a new reader missed: the ports that were opened before."""
        now = self.queue[0][2] if self.queue else time.monotonic_ns()
        records = []
        for number, (name, baud) in list(self._ports.items()):
            if number in self._announced:
                records.append(record(OPENED, number, now, name))
                if baud:
                    records.append(record('baud', number, now, NUMBER.pack(baud)))
        return records

    def _send(self) -> None:
        if self._missed:                       # a reader is looked for again
            return
        taken = [self.queue.popleft() for _ in range(min(len(self.queue), QUEUED_RECORDS_MAX))]
        opened = {number for kind, number, _, _ in taken if kind == OPENED}
        self._announced |= opened
        records = [record(*one) for one in taken]
        lost, self.lost = self.lost, 0
        if lost:
            records.append(lost_record(lost))
        for path, reader in list(self._readers.items()):
            if reader.send(records):
                continue
            before = len(reader.pending) - sum(map(len, records))
            if reader.is_ours() or len(self._readers) > 1 or not 0 <= before < PENDING_MAX_BYTES:
                self._drop(path, len(taken))
            else:                              # it got none of these: the next connection does
                self._drop(path, before > 0)
                self.queue.extendleft(reversed(taken))
                self._announced -= opened
                self.lost += lost

    def _drop(self, path: str, missed: int) -> None:
        """
        Leave a reader; where the program closed the connection it is looked for again.

        Not at once: the program may just be opening files of its own.
        """
        reader = self._readers.pop(path)
        if not reader.is_ours():
            self._missed[path] = reader.lost + missed
            self._looked = time.monotonic()
        reader.close()
