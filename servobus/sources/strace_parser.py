# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""
What strace prints of a program, as events of its serial ports: bytes in, events out.

strace is run with OPTIONS. Its lines have a wall clock, which anchors the first of them, and the
monotonic time since the line before, so a step of the wall clock changes nothing. strace holds a
call at its begin and at its end, and takes nearly all the time of a short one. So a short write
has the time of its end, a longer one that of its begin, a read that of its end; the end is noticed
late by half a short call.
"""

from __future__ import annotations

from collections.abc import Callable
from collections.abc import Iterator
from contextlib import suppress
from dataclasses import dataclass
from dataclasses import field
import errno
import re
import termios
from typing import NamedTuple

from msg_defs.event import ADDS_RETURNS
from msg_defs.event import AWAY
from msg_defs.event import BAUD
from msg_defs.event import CHANGES_BYTES
from msg_defs.event import CLOSED
from msg_defs.event import DTR
from msg_defs.event import GAVE_UP
from msg_defs.event import GONE
from msg_defs.event import HAS_ADDED_RETURN
from msg_defs.event import HOLDS_LINES
from msg_defs.event import IN
from msg_defs.event import LINE_MODE
from msg_defs.event import LOST
from msg_defs.event import OUT
from msg_defs.event import PURGED
from msg_defs.event import RTS
from msg_defs.event import TRACED
from servobus.sources.tap_sender import OPENED
from servobus.sources.tap_sender import PORT
from servobus.sources.tap_sender import TWO_READERS

AT_ONCE_NS = 200_000               # between two calls: strace, not the program
AWAY_NS = 500_000                  # who looks as often does not sleep
TRACED_MIN_NS = 500_000            # strace took so long: worth an event
WRITE_LATE_NS = 20_000_000         # a write that takes longer has the time before its end
PRINTED_MAX_BYTES = 65_536         # bytes that strace prints of a call
_WRITES = frozenset(('write', 'pwrite64', 'writev', 'pwritev', 'pwritev2'))
_READS = frozenset(('read', 'pread64', 'readv', 'preadv', 'preadv2'))
_POLLS = frozenset(('poll', 'ppoll'))
_WAITS = _POLLS | {'select', 'pselect6'}
_HUNG_UP = {one.encode(): getattr(errno, one) for one in ('EIO', 'ENXIO', 'ENODEV')}
_UNSEEN = frozenset(('splice', 'sendfile', 'copy_file_range'))      # strace prints no bytes
_OTHERS = ('open', 'openat', 'openat2', 'creat', 'close', 'dup', 'dup2', 'dup3', 'fcntl', 'ioctl',
           'epoll_ctl')
_DEADLY = 'SEGV,ABRT,BUS,ILL,FPE,SYS,TRAP,KILL,TERM,INT,HUP'        # else their end is not printed
# -DDD: the program stays the child of who starts it; strace is out of the terminal's reach.
# -I1: strace ends, and leaves the program alone, when its output has no reader.
OPTIONS = ('-DDD', '-f', '-I1', '-q', '-y', '-v', '-xx', '-X', 'raw', '-s', str(PRINTED_MAX_BYTES),
           '--absolute-timestamps=format:unix,precision:ns', '--relative-timestamps=ns',
           '--syscall-times=ns', '-e', 'signal=' + _DEADLY, '-e', 'trace=' + ','.join(
               f'?{name}' for name in (*sorted(_WRITES | _READS | _WAITS | _UNSEEN), *_OTHERS)))

_LINE = re.compile(rb' *(\d+) +(\d+)\.(\d{9}) \(\+ +(\d+)\.(\d{9})\) (.*)')
_CALL = re.compile(rb'(\w+)\((.*)\)\s+= (-?\d+)(?:<([^>]*)>(?:\(deleted\))?)?(?: (E\w+)?[^<].*?)?'
                   rb'(?: <(\d+)\.(\d{9})>)?')
_FD = re.compile(rb'(\d+)<((?:\\x[0-9a-f]{2})+)>')
_POLLED_FD = re.compile(rb'fd=\d+<((?:\\x[0-9a-f]{2})+)>, '
                        rb'events=0x[0-9a-f]*[13579bdf]\b')       # with POLLIN
_STRING = re.compile(rb'"((?:\\x[0-9a-f]{2})*)"')
_UNFINISHED = b' <unfinished ...>'
_CFLAG = re.compile(rb'c_cflags?=(0x[0-9a-f]+)')        # the rate, or all flags
_LFLAG = re.compile(rb'c_lflags?=(0x[0-9a-f]+|0)?')     # strace prints nothing for 0
_IFLAG = re.compile(rb'c_iflags?=(0x[0-9a-f]+|0)?')
_OFLAG = re.compile(rb'c_oflags?=([0-9a-fx|]*)')        # as 0|0|0x5
_ADDING = termios.OPOST | termios.ONLCR
_NEW_LINE = b'\\x0a'               # as strace prints it
_CHANGING = termios.ICRNL | termios.INLCR | termios.IGNCR | termios.ISTRIP | termios.IXON
_OSPEED = re.compile(rb'c_ospeed=(\d+)')
_RATES = {getattr(termios, name): int(name[1:]) for name in dir(termios)
          if re.fullmatch(r'B[1-9]\d*', name)}
_CBAUD, _BOTHER = 0o10017, 0o10000
# Requests of ioctl, as on x86, ARM and RISC-V.
_TCFLSH, _TIOCSSERIAL, _FIONREAD = 0x540B, 0x541F, 0x541B
_ASKED = frozenset((0x5401, 0x802C542A))               # TCGETS, TCGETS2
_SETTINGS = _ASKED | {0x5402, 0x5403, 0x5404, 0x402C542B, 0x402C542C, 0x402C542D}
_SET_AND_FLUSH = frozenset((0x5404, 0x402C542D))
_MODEM = {0x5416: (1, None), 0x5417: (0, None), 0x5418: (1, 0)}     # listed lines, the others
_LINES = {2: DTR, 4: RTS}


class PortEvent(NamedTuple):
    """What a program did with a port; what: a side, a name of msg_defs.event, or OPENED."""

    stamp: int                             # ns, monotonic
    port: str
    what: str
    data: bytes = b''
    process: int = 0                       # for IN, OUT and OPENED
    value: int = 0


PortEvents = Iterator[PortEvent]


@dataclass
class _TracedPort:
    """What is known of a port."""

    name: str
    holders: set[tuple[int, int]] = field(default_factory=set)     # process, descriptor
    rate: int = 0                          # not said yet; 0: nothing new
    has_odd_rate: bool = False             # 38400 may mean any rate
    line_mode: int = 0
    is_lost: bool = False                  # its driver has hung up
    looked: tuple[int, int] | None = None  # for bytes: when, and what it returned
    away_ns: int = 0                       # until bytes were found
    is_awaited: bool = False               # by epoll
    traced_ns: int = 0                     # since its last write


@dataclass
class _TracedThread:
    """What is known of a thread."""

    process: int
    unfinished: bytes = b''                # begin of a call
    ended: int = 0                         # when its last call did, 0: none did yet
    held_ns: float = 0.0                   # since it waited


class StraceParser:
    """Takes the output of one strace; `process_of` returns the process of a thread."""

    def __init__(self, process_of: Callable[[int], int]) -> None:
        self._process_of = process_of
        self._ports: dict[str, _TracedPort] = {}
        self._threads: dict[int, _TracedThread] = {}
        self._resume_ns = 0.0              # from a call to the next one
        self._short_ns = 0.0               # a call takes that does not wait
        self._rest = b''
        self._now = 0

    def feed(self, data: bytes, ahead: int) -> PortEvents:
        """Take output; ahead: the monotonic clock less the wall clock (ns), used at first."""
        *lines, self._rest = (self._rest + data).split(b'\n')
        for line in lines:
            found = _LINE.fullmatch(line)
            if found is None:
                continue
            thread_id, second, part, seconds, nanoseconds = map(int, found.groups()[:5])
            self._now = self._now + seconds * 10**9 + nanoseconds if self._now \
                else max(1, second * 10**9 + part + ahead)
            yield from self._parse_text(thread_id, found[6])

    def _parse_text(self, thread_id: int, text: bytes) -> PortEvents:
        if text.startswith(b'+++'):
            yield from self._end(thread_id)
            return
        if thread_id not in self._threads:
            self._threads[thread_id] = _TracedThread(self._process_of(thread_id))
        thread = self._threads[thread_id]
        is_resumed = text.startswith(b'<... ')
        if is_resumed:
            text = thread.unfinished + text.partition(b' resumed>')[2]
            thread.unfinished = b''
        else:
            yield from self._two_readers(thread, text)
        if text.endswith(_UNFINISHED):
            thread.unfinished = text[:-len(_UNFINISHED)]
            return
        found = _CALL.fullmatch(text)
        if found is None:
            return
        took = int(found[6]) * 10**9 + int(found[7]) if found[6] else 0
        end = self._now + (0 if is_resumed else took)
        yield from self._parse_call(found, thread, end - took, end)

    def _parse_call(self, found: re.Match[bytes], thread: _TracedThread, begin: int,
                    end: int) -> PortEvents:
        name, arguments, result = found[1].decode(), found[2], int(found[3])
        away_ns = self._account_time(thread, name, begin, end)
        self._remember_wait(name, arguments, result, end, away_ns)
        opened = self._port(found[4] or b'')
        if opened is not None:
            opened.is_lost = False
            yield from _hold(opened, thread, result, end)
        first = _FD.match(arguments)
        port = first and self._port(first[2])
        if first is None or port is None:
            return
        descriptor = int(first[1])
        if name == 'close':
            yield from _release(port, {(thread.process, descriptor)}, begin)
            return
        yield from _hold(port, thread, descriptor, begin)
        if found[5] in _HUNG_UP and not port.is_lost:
            port.is_lost = True
            yield PortEvent(end, port.name, GONE, value=_HUNG_UP[found[5]])
        if name == 'ioctl' and result >= 0:
            with suppress(ValueError):         # numbers that are none
                yield from _ioctl(port, arguments, end)
        elif name in _UNSEEN and result > 0:
            yield PortEvent(end, port.name, LOST, value=1)
        elif name in _WRITES and result >= 0:
            stamp = max(begin, end - WRITE_LATE_NS)
            if end - begin < AT_ONCE_NS:
                stamp, self._short_ns = end, _median(self._short_ns, end - begin)
            yield from _rate(port, stamp)
            yield from _before_write(port, stamp, thread)
            yield from _transfer(port, OUT, arguments, result, stamp, thread)
            if port.line_mode & ADDS_RETURNS and _NEW_LINE in arguments:
                yield PortEvent(stamp, port.name, LINE_MODE,
                                value=port.line_mode | HAS_ADDED_RETURN)
        elif name in _READS and result > 0:
            yield from _rate(port, end)
            arrived = self._arrived(port, begin, end)
            yield from _was_away(port, arrived, away_ns)
            yield from _transfer(port, IN, arguments, result, arrived, thread)
        elif name in _READS:                   # also -1: EAGAIN
            port.looked = end, 0

    def _port(self, escaped: bytes) -> _TracedPort | None:
        """Return the port of a path as strace prints it, None where it is none."""
        name = _text(escaped)
        port = self._ports.get(name)
        if port is None and PORT.fullmatch(name):
            port = self._ports[name] = _TracedPort(name)
        return port

    def _account_time(self, thread: _TracedThread, name: str, begin: int, end: int) -> int:
        """Count what strace held the thread; return for how long (ns) that slept, 0: it waited."""
        gap, took = begin - thread.ended, end - begin
        away_ns = gap if gap >= AWAY_NS and took < AT_ONCE_NS and thread.ended else 0
        thread.ended = end
        if gap < AT_ONCE_NS:
            self._resume_ns = _median(self._resume_ns, gap)
        if took > (AT_ONCE_NS if name in _WRITES else 2 * self._short_ns):
            thread.held_ns = self._short_ns / 2        # it waited, and strace with it
        else:
            thread.held_ns += took + (gap if gap < 2 * self._resume_ns else self._resume_ns)
        return away_ns

    def _remember_wait(self, name: str, arguments: bytes, result: int, end: int,
                       away_ns: int) -> None:
        """Remember what a program waits for; away_ns: as in _was_away(), 0: it waited."""
        is_wait = name in _WAITS and result >= 0
        if not is_wait and name != 'epoll_ctl':
            return
        for path in _awaited_files(name, arguments):
            port = self._port(path)
            if port is None:
                continue
            if is_wait:
                port.looked, port.away_ns = (end, result), away_ns
            else:
                port.is_awaited = True

    def _two_readers(self, thread: _TracedThread, text: bytes) -> PortEvents:
        """Say that others wait for bytes of a port where one begins to read it."""
        port = self._read_port(text)
        if port is None or not port.holders:
            return
        for other in self._threads.values():
            if other is not thread and self._read_port(other.unfinished, _READS | _WAITS) is port:
                yield PortEvent(self._now, port.name, TWO_READERS,
                                value=1 + (other.process != thread.process))

    def _read_port(self, text: bytes, names: frozenset[str] = _READS) -> _TracedPort | None:
        """Return the first port of a call that reads."""
        name, _, arguments = text.partition(b'(')
        found = _FD.search(arguments) if name.decode('latin-1') in names else None
        return self._port(found[2]) if found else None

    def _arrived(self, port: _TracedPort, begin: int, end: int) -> int:
        """Return when the bytes of a read were there: after a wait for them at its end."""
        ready, result = port.looked or (0, 0)
        port.looked = None
        arrived = ready if result and begin - ready <= AT_ONCE_NS else end
        return arrived - int(self._short_ns / 2)

    def _end(self, thread_id: int) -> PortEvents:
        """Forget a thread that ended; with the first of a process its ports are closed."""
        thread = self._threads.pop(thread_id, None)
        if thread is None or thread.process == thread_id:
            for port in self._ports.values():
                yield from _release(port, {one for one in port.holders if one[0] == thread_id},
                                    self._now)


def _awaited_files(name: str, arguments: bytes) -> list[bytes]:
    """Return the files that a call waits to read from: who waits to write, looks for nothing."""
    if name in _POLLS:
        return _POLLED_FD.findall(arguments)
    if name in _WAITS:
        read_set = arguments.partition(b', ')[2]
        arguments = read_set.partition(b']')[0] if read_set.startswith(b'[') else b''
    return [path for _, path in _FD.findall(arguments)]


def _before_write(port: _TracedPort, stamp: int, thread: _TracedThread) -> PortEvents:
    """Say what the program did before a write: looked for bytes in vain, waited for strace."""
    yield from _vain(port, stamp)
    port.looked, port.away_ns = None, 0
    port.traced_ns += int(thread.held_ns)
    thread.held_ns = 0.0
    if port.traced_ns >= TRACED_MIN_NS:
        yield PortEvent(stamp, port.name, TRACED, value=port.traced_ns // 1000)
        port.traced_ns = 0


def _was_away(port: _TracedPort, stamp: int, away_ns: int) -> PortEvents:
    """Say for how long a program had not looked for what was there when it did."""
    away_ns, port.away_ns = port.away_ns or away_ns, 0
    if away_ns and not port.is_awaited:
        yield PortEvent(stamp, port.name, AWAY, value=away_ns // 1000)


def _vain(port: _TracedPort, stamp: int) -> PortEvents:
    if port.looked is not None and not port.looked[1]:
        yield PortEvent(stamp, port.name, GAVE_UP, value=max(0, stamp - port.looked[0]) // 1000)


def _transfer(port: _TracedPort, side: str, arguments: bytes, size: int, stamp: int,
              thread: _TracedThread) -> PortEvents:
    data = b''.join(map(_bytes, _STRING.findall(arguments)))[:size]
    if data:
        yield PortEvent(stamp, port.name, side, data, thread.process)
    if len(data) < size:
        yield PortEvent(stamp, port.name, LOST, value=size - len(data))


def _ioctl(port: _TracedPort, arguments: bytes, stamp: int) -> PortEvents:
    _, text, argument = arguments.split(b', ', 2)
    request = int(text, 0)
    if request in _SETTINGS:
        rate = _rate_in(argument)
        if rate and not (rate == 38_400 and port.has_odd_rate):
            port.rate = rate
        if request not in _ASKED:          # else the program may be about to change it
            yield from _rate(port, stamp)
        yield from _find_line_mode(port, argument, stamp)
    if request in _SET_AND_FLUSH:
        yield PortEvent(stamp, port.name, PURGED, value=1)
    elif request == _TCFLSH:
        yield from _vain(port, stamp)
        yield PortEvent(stamp, port.name, PURGED, value=int(argument, 0) + 1)
    elif request == _FIONREAD and argument == b'[0]':
        port.looked = stamp, 0
    elif request == _TIOCSSERIAL:
        port.has_odd_rate = True
    elif request in _MODEM:
        listed = _flags(argument.strip(b'[]'))
        for bit, what in _LINES.items():
            value = _MODEM[request][0 if listed & bit else 1]
            if value is not None:
                yield PortEvent(stamp, port.name, what, value=value)


def _find_line_mode(port: _TracedPort, settings: bytes, stamp: int) -> PortEvents:
    if not (local := _LFLAG.search(settings)):
        return
    on_input, on_output, local_flags = (
        _flags(found[1] or b'') if found else 0 for found in (
            _IFLAG.search(settings), _OFLAG.search(settings), local))
    mode = HOLDS_LINES if local_flags & termios.ICANON else \
        CHANGES_BYTES if on_input & _CHANGING else 0
    if on_output & _ADDING == _ADDING:
        mode += ADDS_RETURNS
    if mode != port.line_mode:
        port.line_mode = mode
        yield PortEvent(stamp, port.name, LINE_MODE, value=mode)


def _rate(port: _TracedPort, stamp: int) -> PortEvents:
    """Say the rate that a port has by now."""
    if port.rate:
        yield PortEvent(stamp, port.name, BAUD, value=port.rate)
        port.rate = 0


def _hold(port: _TracedPort, thread: _TracedThread, descriptor: int, stamp: int) -> PortEvents:
    """Remember that a process has a port open."""
    if not port.holders:
        yield PortEvent(stamp, port.name, OPENED, process=thread.process)
    port.holders.add((thread.process, descriptor))


def _release(port: _TracedPort, gone: set[tuple[int, int]], stamp: int) -> PortEvents:
    if port.holders and not port.holders - gone:
        yield from _vain(port, stamp)
        yield PortEvent(stamp, port.name, CLOSED)
    port.holders -= gone


def _median(so_far: float, ns: int) -> float:
    """Return a median that follows one more value."""
    return so_far * (15 / 16 if ns < so_far else 17 / 16) or ns


def _bytes(text: bytes) -> bytes:
    return bytes.fromhex(text.replace(b'\\x', b'').decode())


def _text(escaped: bytes) -> str:
    """Return a path as strace -xx prints it."""
    with suppress(ValueError):
        return _bytes(escaped).decode(errors='replace')
    return ''


def _flags(text: bytes) -> int:
    value = 0
    for part in text.split(b'|'):
        value |= int(part or b'0', 0)
    return value


def _rate_in(settings: bytes) -> int:
    """Return the rate in a struct termios or termios2, 0 where it is unknown."""
    flags = _CFLAG.search(settings)
    speed = int(flags[1], 16) & _CBAUD if flags else 0
    free = _OSPEED.search(settings)
    if speed == _BOTHER:
        return int(free[1]) if free else 0
    return _RATES.get(speed, 0)
