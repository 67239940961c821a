# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""
The listening end of a tap: what the programs of one name read and write.

Any number of readers and of programs, started in any order. What processes say is put in the
order of its stamps, so it comes HOLD_S late. tap_sender.py says what is sent.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import suppress
import errno
import heapq
import json
import os
import secrets
import socket
import time
from typing import NamedTuple

from msg_defs.event import Change
from msg_defs.event import CHANGES
from msg_defs.event import Chunk
from msg_defs.event import CLOSED
from msg_defs.event import IN
from msg_defs.event import OUT
from servobus.port.readable import readable
from servobus.printable_text import printable
from servobus.sources import tap_sender as sent

HOLD_S = 0.06                              # three times what a sender lets gather
RECORD_MAX_BYTES = 1 << 24                 # bytes of a record: more is none of ours
CONNECTIONS_MAX = 64
PORTS_MAX = 256                            # that a program has open at once
PORT_NAME_MAX_LENGTH = 1000                # characters
_NAME_CHARACTERS = frozenset('abcdefghijklmnopqrstuvwxyzABCDEFGHIJKLMNOPQRSTUVWXYZ0123456789_-')
_NAME_LIMIT = 40                           # the path of a Unix socket has 107 characters
_READ_SIZE = 1 << 16
_NEW = '.new'                              # as long as SUFFIX
PATH_TOO_LONG = ('the path of the socket is too long; set XDG_RUNTIME_DIR to a shorter folder, '
                 'for the program too')


class TapRecord(NamedTuple):
    """One record; port: as the program opened it, '' for what is about no port."""

    stamp: int                             # ns, monotonic: of the call in the program
    port: str
    kind: str                              # a kind of tap_sender
    data: bytes                            # for OUT, IN and ENDED
    value: int                             # for the other kinds
    opening: int = 0                       # who has the port open

    @property
    def side(self) -> str:
        """Who put the bytes on the wire, '' where there are none."""
        return self.kind if self.kind in (OUT, IN) else ''

    @property
    def change(self) -> Change | None:
        """What happened to the line, None where there are bytes."""
        if self.kind not in CHANGES:
            return None
        return Change(self.kind, self.value or int(self.kind == CLOSED))

    def chunk(self, bus: str) -> Chunk:
        """Return the bytes or the change as a chunk of a bus."""
        return Chunk(self.stamp, bus, self.data if self.side else b'', self.side, self.change)


def why_no_name(name: str) -> str:
    """Return what is wrong with the name of a tap, '' for nothing."""
    if name and set(name) <= _NAME_CHARACTERS and len(name) <= _NAME_LIMIT:
        return ''
    return (f'{name!r} cannot be the name of a tap; use 1 to {_NAME_LIMIT} letters, digits, _ or '
            '-')


class _Connection:
    """A connection to a tapped process."""

    def __init__(self, connection: socket.socket, secret: str) -> None:
        self.socket = connection
        self.ports: dict[int, str] = {}
        self.process = 0
        self._secret = secret
        self._is_trusted = not secret
        self._rest = b''

    def records(self, data: bytes) -> Iterator[TapRecord]:
        """Yield what these bytes complete; ValueError for what is none of ours."""
        data = self._rest + data
        at = 0
        while len(data) - at >= sent.HEAD.size:
            kind, number, stamp, size = sent.HEAD.unpack_from(data, at)
            if kind >= len(sent.KINDS) or size > RECORD_MAX_BYTES or stamp < 0:
                raise ValueError(kind)
            begin = at + sent.HEAD.size
            if begin + size > len(data):
                break
            at = begin + size
            one = self._one(sent.KINDS[kind], number, stamp, data[begin:at])
            if one is not None:
                yield one
        self._rest = data[at:]

    def _one(self, kind: str, number: int, stamp: int, data: bytes) -> TapRecord | None:
        if kind == 'hello':
            hello = json.loads(data)
            self.process = int(hello['pid'])
            self._is_trusted |= secrets.compare_digest(
                str(hello.get('secret', '')).encode(), self._secret.encode())
            return None
        if not self._is_trusted:
            raise ValueError('no secret')
        if kind == sent.OPENED:
            self.ports[number] = printable(
                data.decode(errors='replace'), PORT_NAME_MAX_LENGTH)
            if len(self.ports) > PORTS_MAX:
                raise ValueError('too many ports')
        port = self.ports.pop(number, '') if kind == CLOSED else self.ports.get(number, '')
        if kind in (OUT, IN, sent.ENDED):
            return TapRecord(stamp, port, kind, data, 0, number)
        value = sent.NUMBER.unpack(data)[0] if len(data) == sent.NUMBER.size else 0
        return TapRecord(stamp, port, kind, b'', value, number)


class TapReader:
    """
    Listens for programs tapped as `name`; OSError where that cannot be.

    programs: those that are connected. left: the processes that were, while they had a port open,
    and when that was over (monotonic s). wake: a descriptor that ends a wait.
    """

    def __init__(self, name: str, wake: int | None = None) -> None:
        self._secret = ''
        self.programs: dict[int, _Connection] = {}
        self.left: dict[int, float] = {}
        self._held: list[tuple[int, int, TapRecord]] = []
        self._count = 0
        self._wake = wake
        place = sent.folder()
        os.makedirs(place, 0o700, exist_ok=True)
        if not sent.is_private(place):
            raise PermissionError(1, 'other users may write to it; remove it, or chmod 700', place)
        self._remove_dead(place, name)
        self._path = os.path.join(place, f'{name}.{secrets.token_hex(4)}{sent.SUFFIX}')
        self._listener = self._listen(self._path.removesuffix(sent.SUFFIX) + _NEW)
        self._listener.setblocking(False)

    def _listen(self, new: str) -> socket.socket:
        """Listen, then show the path: other readers remove one without a listener."""
        if hasattr(socket, 'AF_UNIX'):
            listener = socket.socket(socket.AF_UNIX)
            try:
                listener.bind(new)
            except OSError as error:
                listener.close()
                if error.errno is not None:
                    raise
                raise OSError(errno.ENAMETOOLONG, PATH_TOO_LONG, self._path) from error
        else:
            listener = socket.socket(socket.AF_INET)
            listener.bind(('127.0.0.1', 0))
            self._secret = secrets.token_hex(32)
            file = os.open(new, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o600)
            os.write(file, f'{listener.getsockname()[1]} {self._secret}'.encode())
            os.close(file)
        listener.listen()
        os.rename(new, self._path)
        return listener

    @staticmethod
    def _remove_dead(place: str, name: str) -> None:
        """Remove what readers left that were killed."""
        for file in os.listdir(place):
            path = os.path.join(place, file)
            if not (file.startswith(f'{name}.') and file.endswith(sent.SUFFIX)
                    and hasattr(socket, 'AF_UNIX')):
                continue
            with suppress(OSError), socket.socket(socket.AF_UNIX) as probe:
                try:
                    probe.connect(path)
                except ConnectionRefusedError:
                    os.unlink(path)

    def wait(self, seconds: float) -> list[TapRecord]:
        """Return the records until HOLD_S ago, in order; wait for more no longer than this."""
        if self._held:
            due_s = (self._held[0][0] - time.monotonic_ns()) / 1e9 + HOLD_S
            seconds = min(seconds, max(0.0, due_s))
        listener = self._listener.fileno()
        watched = [listener, *self.programs, *(() if self._wake is None else (self._wake,))]
        for fd in readable(watched, seconds):
            if fd == listener:
                self._accept()
            elif fd in self.programs:
                self._read(fd)
        return self._due(time.monotonic_ns() - int(HOLD_S * 1e9))

    def rest(self) -> list[TapRecord]:
        """Return the records that are still held back."""
        return self._due(1 << 63)

    def _due(self, until: int) -> list[TapRecord]:
        found = []
        while self._held and self._held[0][0] <= until:
            found.append(heapq.heappop(self._held)[2])
        return found

    def _accept(self) -> None:
        with suppress(OSError):
            connection, _ = self._listener.accept()
            if len(self.programs) >= CONNECTIONS_MAX:
                connection.close()
                return
            connection.setblocking(False)
            self.programs[connection.fileno()] = _Connection(connection, self._secret)

    def _read(self, number: int) -> None:
        program = self.programs[number]
        try:
            data = program.socket.recv(_READ_SIZE)
            for record in program.records(data):
                self._hold(record, number)
            self.left.pop(program.process, None)
        except BlockingIOError:
            return
        except (OSError, ValueError, LookupError, TypeError, AttributeError):
            data = b''
        if not data:
            now = time.monotonic_ns()
            for at, port in program.ports.items():     # it ended without closing them
                self._hold(TapRecord(now, port, CLOSED, b'', 0, at), number)
            if program.ports and program.process:
                self.left[program.process] = now / 1e9
            program.socket.close()
            del self.programs[number]

    def _hold(self, record: TapRecord, program: int) -> None:
        """Keep a record until its turn; one from the future would be kept for as long."""
        self._count += 1
        stamp = min(record.stamp, time.monotonic_ns())
        heapq.heappush(self._held, (stamp, self._count, record._replace(
            stamp=stamp, opening=program << 16 | record.opening)))

    def close(self) -> None:
        """Stop to listen; the programs go on."""
        for program in self.programs.values():
            program.socket.close()
        self._listener.close()
        with suppress(OSError):
            os.unlink(self._path)

    def __enter__(self) -> TapReader:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()
