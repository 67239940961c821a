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
import re
import termios
from typing import NamedTuple

from msg_defs.event import AWAY
from msg_defs.event import BAUD
from msg_defs.event import CLOSED
from msg_defs.event import DTR
from msg_defs.event import GAVE_UP
from msg_defs.event import IN
from msg_defs.event import LINE_MODE
from msg_defs.event import LOST
from msg_defs.event import OUT
from msg_defs.event import PURGED
from msg_defs.event import RTS
from msg_defs.event import TRACED
from servobus.sources.tap_sender import OPENED

PORT = re.compile(r'/dev/(?:(?!ttyprintk)tty[A-Za-z]\w*|rfcomm\d+|pts/\d+)')
AT_ONCE_NS = 200_000               # between two calls: strace, not the program
AWAY_NS = 500_000                  # who looks as often does not sleep
TRACED_MIN_NS = 500_000            # strace took so long: worth an event
WRITE_LATE_NS = 20_000_000         # a write that takes longer has the time before its end
PRINTED_MAX_BYTES = 65_536         # bytes that strace prints of a call
_WRITES = frozenset(('write', 'pwrite64', 'writev', 'pwritev', 'pwritev2'))
_READS = frozenset(('read', 'pread64', 'readv', 'preadv', 'preadv2'))
_WAITS = frozenset(('poll', 'ppoll', 'select', 'pselect6'))
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
_CALL = re.compile(rb'(\w+)\((.*)\)\s+= (-?\d+)(?:<([^>]*)>(?:\(deleted\))?)?(?: [^<].*?)?'
                   rb'(?: <(\d+)\.(\d{9})>)?')
_FD = re.compile(rb'(\d+)<((?:\\x[0-9a-f]{2})+)>')
_STRING = re.compile(rb'"((?:\\x[0-9a-f]{2})*)"')
_UNFINISHED = b' <unfinished ...>'
_CFLAG = re.compile(rb'c_cflags?=(0x[0-9a-f]+)')        # the rate, or all flags
_LFLAG = re.compile(rb'c_lflags?=(0x[0-9a-f]+)')
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


class StraceParser:
    """Takes the output of one strace; `process_of` returns the process of a thread."""

    def __init__(self, process_of: Callable[[int], int]) -> None:
        self._process_of = process_of
        self._processes: dict[int, int] = {}                   # by thread
        self._holders: dict[str, set[tuple[int, int]]] = {}    # by port: process, descriptor
        self._rates: dict[str, int] = {}                       # by port, not said yet
        self._line_mode: set[str] = set()                      # ports
        self._odd_rates: set[str] = set()                      # ports with a divisor of their own
        self._unfinished: dict[int, bytes] = {}                # a call by thread
        self._looked: dict[str, tuple[int, int]] = {}          # by port: for bytes, when, result
        self._away: dict[str, int] = {}                        # ns by port, until bytes were found
        self._awaited: set[str] = set()                        # ports that epoll waits for
        self._ended: dict[int, int] = {}                       # the last call, by thread
        self._resume = 0.0                                     # ns from a call to the next one
        self._short = 0.0                                      # ns of a call without a wait
        self._held: dict[int, float] = {}                      # ns by thread, since it waited
        self._traced: dict[str, int] = {}                      # ns by port, since its last write
        self._rest = b''
        self._now = 0

    def feed(self, data: bytes, ahead: int) -> PortEvents:
        """Take output; ahead: the monotonic clock less the wall clock (ns), used at first."""
        *lines, self._rest = (self._rest + data).split(b'\n')
        for line in lines:
            found = _LINE.fullmatch(line)
            if found is None:
                continue
            thread, second, part, seconds, nanoseconds = map(int, found.groups()[:5])
            self._now = self._now + seconds * 10**9 + nanoseconds if self._now \
                else max(1, second * 10**9 + part + ahead)
            yield from self._parse_text(thread, found[6])

    def _parse_text(self, thread: int, text: bytes) -> PortEvents:
        is_resumed = text.startswith(b'<... ')
        if is_resumed:
            begin = self._unfinished.pop(thread, b'')
            text = begin + text.partition(b' resumed>')[2]
        elif text.endswith(_UNFINISHED):
            self._unfinished[thread] = text[:-len(_UNFINISHED)]
            return
        elif text.startswith(b'+++'):
            yield from self._end(thread)
            return
        found = _CALL.fullmatch(text)
        if found is None:
            return
        took = int(found[5]) * 10**9 + int(found[6]) if found[5] else 0
        end = self._now + (0 if is_resumed else took)
        yield from self._parse_call(found, thread, end - took, end)

    def _parse_call(self, found: re.Match[bytes], thread: int, begin: int,
                    end: int) -> PortEvents:
        name, arguments, result = found[1].decode(), found[2], int(found[3])
        away = self._account_time(thread, name, begin, end)
        self._remember_wait(name, arguments, result, end, away)
        yield from self._hold(_text(found[4] or b''), thread, result, end)
        first = _FD.match(arguments)
        port = '' if first is None else _text(first[2])
        if first is None or not PORT.fullmatch(port):
            return
        if name == 'close':
            yield from self._release(port, {(self._process(thread), int(first[1]))}, begin)
            return
        yield from self._hold(port, thread, int(first[1]), begin)
        if name == 'ioctl' and result >= 0:
            with suppress(ValueError):         # numbers that are none
                yield from self._ioctl(port, arguments, end)
        elif name in _UNSEEN and result > 0:
            yield PortEvent(end, port, LOST, value=1)
        elif name in _WRITES and result >= 0:
            stamp = max(begin, end - WRITE_LATE_NS)
            if end - begin < AT_ONCE_NS:
                stamp, self._short = end, _median(self._short, end - begin)
            yield from self._rate(port, stamp)
            yield from self._before_write(port, stamp, self._held.pop(thread))
            yield from self._transfer(port, OUT, arguments, result, stamp, thread)
        elif name in _READS and result > 0:
            yield from self._rate(port, end)
            arrived = self._arrived(port, begin, end)
            yield from self._was_away(port, arrived, away)
            yield from self._transfer(port, IN, arguments, result, arrived, thread)
        elif name in _READS:                   # also -1: EAGAIN
            self._looked[port] = end, 0

    def _account_time(self, thread: int, name: str, begin: int, end: int) -> int:
        """Count what strace held the thread; return for how long (ns) that slept, 0: it waited."""
        gap, took = begin - self._ended.get(thread, 0), end - begin
        away = gap if gap >= AWAY_NS and took < AT_ONCE_NS and thread in self._ended else 0
        self._ended[thread] = end
        if gap < AT_ONCE_NS:
            self._resume = _median(self._resume, gap)
        if took > (AT_ONCE_NS if name in _WRITES else 2 * self._short):
            self._held[thread] = self._short / 2       # it waited, and strace with it
        else:
            self._held[thread] = self._held.get(thread, 0.0) + took + (
                gap if gap < 2 * self._resume else self._resume)
        return away

    def _remember_wait(self, name: str, arguments: bytes, result: int, end: int,
                       away: int) -> None:
        """Remember what a program waits for; away: as in _was_away(), 0: it waited."""
        if name in _WAITS and result >= 0:
            ports = [_text(path) for _, path in _FD.findall(arguments)]
            self._looked |= dict.fromkeys(ports, (end, result))
            self._away |= dict.fromkeys(ports, away)
        elif name == 'epoll_ctl':
            self._awaited.update(_text(path) for _, path in _FD.findall(arguments))

    def _arrived(self, port: str, begin: int, end: int) -> int:
        """Return when the bytes of a read were there: after a wait for them at its end."""
        ready, result = self._looked.pop(port, (0, 0))
        arrived = ready if result and begin - ready <= AT_ONCE_NS else end
        return arrived - int(self._short / 2)

    def _before_write(self, port: str, stamp: int, held: float) -> PortEvents:
        """Say what the program did before a write: looked for bytes in vain, waited for strace."""
        yield from self._vain(port, stamp)
        self._looked.pop(port, None)
        self._away.pop(port, None)
        self._traced[port] = self._traced.get(port, 0) + int(held)
        if self._traced[port] >= TRACED_MIN_NS:
            yield PortEvent(stamp, port, TRACED, value=self._traced.pop(port) // 1000)

    def _was_away(self, port: str, stamp: int, away: int) -> PortEvents:
        """Say for how long (ns) a program had not looked for what was there when it did."""
        away = self._away.pop(port, 0) or away
        if away and port not in self._awaited:
            yield PortEvent(stamp, port, AWAY, value=away // 1000)

    def _vain(self, port: str, stamp: int) -> PortEvents:
        looked, result = self._looked.get(port, (0, 1))
        if not result:
            yield PortEvent(stamp, port, GAVE_UP, value=max(0, stamp - looked) // 1000)

    def _transfer(self, port: str, side: str, arguments: bytes, size: int,
                  stamp: int, thread: int) -> PortEvents:
        data = b''.join(map(_bytes, _STRING.findall(arguments)))[:size]
        if data:
            yield PortEvent(stamp, port, side, data, self._process(thread))
        if len(data) < size:
            yield PortEvent(stamp, port, LOST, value=size - len(data))

    def _ioctl(self, port: str, arguments: bytes, stamp: int) -> PortEvents:
        _, text, argument = arguments.split(b', ', 2)
        request = int(text, 0)
        if request in _SETTINGS:
            rate = _rate(argument)
            if rate and not (rate == 38_400 and port in self._odd_rates):
                self._rates[port] = rate
            if request not in _ASKED:          # else the program may be about to change it
                yield from self._rate(port, stamp)
            yield from self._find_line_mode(port, argument, stamp)
        if request in _SET_AND_FLUSH:
            yield PortEvent(stamp, port, PURGED, value=1)
        elif request == _TCFLSH:
            yield from self._vain(port, stamp)
            yield PortEvent(stamp, port, PURGED, value=int(argument, 0) + 1)
        elif request == _FIONREAD and argument == b'[0]':
            self._looked[port] = stamp, 0
        elif request == _TIOCSSERIAL:          # 38400 may mean any rate from now on
            self._odd_rates.add(port)
        elif request in _MODEM:
            listed = _flags(argument.strip(b'[]'))
            for bit, what in _LINES.items():
                value = _MODEM[request][0 if listed & bit else 1]
                if value is not None:
                    yield PortEvent(stamp, port, what, value=value)

    def _find_line_mode(self, port: str, settings: bytes, stamp: int) -> PortEvents:
        flags = _LFLAG.search(settings)
        if flags and (is_on := bool(int(flags[1], 16) & termios.ICANON)) != (
                port in self._line_mode):
            self._line_mode ^= {port}
            yield PortEvent(stamp, port, LINE_MODE, value=int(is_on))

    def _rate(self, port: str, stamp: int) -> PortEvents:
        """Say the rate that a port has by now."""
        if port in self._rates:
            yield PortEvent(stamp, port, BAUD, value=self._rates.pop(port))

    def _hold(self, port: str, thread: int, descriptor: int, stamp: int) -> PortEvents:
        """Remember that a thread's process has a port open."""
        if not PORT.fullmatch(port):
            return
        holders = self._holders.setdefault(port, set())
        if not holders:
            yield PortEvent(stamp, port, OPENED, process=self._process(thread))
        holders.add((self._process(thread), descriptor))

    def _release(self, port: str, gone: set[tuple[int, int]], stamp: int) -> PortEvents:
        holders = self._holders.get(port, set())
        if holders and not holders - gone:
            yield from self._vain(port, stamp)
            yield PortEvent(stamp, port, CLOSED)
        holders -= gone

    def _end(self, thread: int) -> PortEvents:
        """Forget a thread that ended; with the first of a process its ports are closed."""
        self._unfinished.pop(thread, None)
        self._ended.pop(thread, None)
        self._held.pop(thread, None)
        if self._processes.pop(thread, thread) == thread:
            for port, holders in self._holders.items():
                yield from self._release(
                    port, {one for one in holders if one[0] == thread}, self._now)

    def _process(self, thread: int) -> int:
        if thread not in self._processes:
            self._processes[thread] = self._process_of(thread)
        return self._processes[thread]


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


def _rate(settings: bytes) -> int:
    """Return the rate in a struct termios or termios2, 0 where it is unknown."""
    flags = _CFLAG.search(settings)
    speed = int(flags[1], 16) & _CBAUD if flags else 0
    free = _OSPEED.search(settings)
    if speed == _BOTHER:
        return int(free[1]) if free else 0
    return _RATES.get(speed, 0)
