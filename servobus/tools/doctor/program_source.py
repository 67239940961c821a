# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""
A program and what its serial ports say, as a source: run -- COMMAND.

It goes on as without us: its input and output are ours, signals are handed on. It runs where
there is no fcntl, termios or pty, too.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
import json
import ntpath
import os
from pathlib import Path
import secrets
import signal
import time
from typing import Any
from typing import NamedTuple

from msg_defs.diagnostics import Level
from msg_defs.event import Chunk
from msg_defs.event import CLOSED
from msg_defs.event import GAVE_UP
from msg_defs.event import IN
from servobus.bus.report import FAILED
from servobus.bus.report import OTHER_PART
from servobus.bus.report import RAISED
from servobus.bus.report import RATE_REFUSED
from servobus.bus.report import SERVO_LIBRARIES
from servobus.bus.report import STOLE_REPLIES
from servobus.port.port_users import holders
from servobus.port.port_users import is_running
from servobus.printable_text import printable
from servobus.sources.capture import Wire
from servobus.sources.source import Chunks
from servobus.sources.source import Source
from servobus.sources.tap_reader import TapReader
from servobus.sources.tap_reader import TapRecord
from servobus.sources.tap_sender import ENDED
from servobus.sources.tap_sender import HAS_DIED
from servobus.sources.tap_sender import OPENED
from servobus.sources.tap_sender import TWO_READERS
from servobus.tools.doctor import explain
from servobus.tools.doctor.verdict import Trouble
from servobus.tools.start_program import StartedProgram
from servobus.tools.start_program import STRACE

TICK_S = 0.1
LAST_RECORDS_WAIT_S = 1.0          # for what the program said last
CRASHES = {getattr(signal, f'SIG{name}', None) for name in (
    'ILL', 'TRAP', 'ABRT', 'BUS', 'FPE', 'SEGV', 'SYS')}
OVERLAPS_MIN = 3                   # two that read at once: at its end a program may do so once
TURNS_OF_TWO = 4                   # between two who ask: a parent that hands on has fewer
USERS_EVERY_S = 0.5                # at most, and more rarely in a long run: a look takes 0.03 s
USERS_EVERY_SHARE = 0.1            # share of the time since the start
LEFT_AFTER_S = 0.5                 # a process that still runs then has closed our connection
_LEFT = ('the program closed the connection of the tap after {:.1f} s; what it sent and received '
         f'since then was not heard: write --by {STRACE} in front of --')
_IN_BACKGROUND = ('the program goes on in the background and is no longer heard: let it run in '
                  f'the foreground, or write --by {STRACE} in front of --')
_BESIDES = f'if it writes to the descriptor itself, write --by {STRACE} in front of --'
_ROBBED = 'multiple access on port'        # as pyserial says


class Ending(NamedTuple):
    """
    How a program ended; error: the exception that nothing caught, '' if none is known.

    function: the one that raised it, packages: those that it came through.
    """

    code: int = 0
    error: str = ''
    function: str = ''
    packages: frozenset[str] = frozenset()
    python: str = ''               # that ran it
    was_stopped: bool = False      # by Ctrl-C or another signal, and the error came of that
    users: tuple[str, ...] = ()    # who else has one of its ports open
    unheard: str = ''              # why the tap heard nothing
    is_over: bool = True
    signal: int = 0                # that ended it, 0: none
    missed: tuple[str, ...] = ()   # why not all of it was heard
    is_of_thread: bool = False     # the error ended a thread, not all of it

    @property
    def failed(self) -> str:
        """Whether it ended by itself with an error that may be of the bus (bus/report.py)."""
        if not self.code or self.was_stopped:
            return ''
        return FAILED if self.is_of_thread else self._cause

    @property
    def failed_alone(self) -> str:
        """The same where no other program can have read what it missed, otherwise empty."""
        return '' if self.users else self.failed

    @property
    def _cause(self) -> str:
        means = self._means
        if any('rate_refused' in one.findings for one in means):
            return RATE_REFUSED
        is_of_library = any(not one.is_general for one in means) or (
            self.packages & SERVO_LIBRARIES and (means or not explain.find(self.error or '-')))
        return RAISED if is_of_library else FAILED

    @property
    def _means(self) -> list[explain.Explanation]:
        return explain.find(self.error or '-', self.function)

    @property
    def ended_by(self) -> str:
        """The signal that ended it, in words, '' for none."""
        return signal.strsignal(self.signal) or '' if self.signal else ''

    def trouble(self) -> Trouble | None:
        """Return what is wrong with a program that its servo library has ended, or a thread of."""
        if (not self.is_of_thread and not self.failed) or self._cause == FAILED:
            return None
        means = self._means
        who = 'a thread of it' if self.is_of_thread else 'it'
        return Trouble(Level.WARN, 'the program', '', f'{who} ended with {self.error}',
                       means[0].means if means else '')

    def unknowns(self) -> list[str]:
        """Return what is unknown of a program that ended with another error."""
        found = [*self.missed]
        if self.users:
            found.append(f'{", ".join(self.users)} uses its port too: what that asks is not heard '
                         'here')
        if self.signal not in (0, signal.SIGINT):
            found.append(f'the program was ended by a signal: {self.ended_by}')
        elif self.failed == FAILED:
            error = self.error or 'what it printed says why'
            found.append(f'the program ended with exit code {self.code}: {error}')
        return found


class Openings:
    """
    How often the ports of a program are open.

    is_robbed: another has read what came for it; found: by bus, that two ask in turns, or that
    one robs the other.
    """

    def __init__(self) -> None:
        self.is_robbed = False
        self.found: dict[str, str] = {}
        self._overlaps = Counter[str]()
        self._ports: dict[str, tuple[set[int], list[int]]] = {}        # who wrote, in turns

    def count_record(self, bus: str, record: TapRecord) -> None:
        opened, turns = self._ports.setdefault(bus, (set(), []))
        is_shared, is_other = len(opened) > 1, turns[-1:] != [record.opening]
        if record.kind == OPENED:
            opened.add(record.opening)
        elif record.kind == CLOSED:
            opened.discard(record.opening)
        elif record.kind == TWO_READERS:
            opened.add(0)                      # as if it were open twice
            self._overlaps[bus] += 1
            if record.value == HAS_DIED or self._overlaps[bus] >= OVERLAPS_MIN:
                self.found[bus] = STOLE_REPLIES if record.value > 1 \
                    else self.found.get(bus, OTHER_PART)
        elif record.side == IN:                # another has asked since it did
            self.is_robbed |= is_other and record.opening in turns
        elif record.side and is_other:
            turns[:] = [*turns, record.opening][-TURNS_OF_TWO:]
        if is_shared and self.is_robbed:
            self.found[bus] = STOLE_REPLIES
        elif is_shared and len(turns) == TURNS_OF_TWO > len({*turns}):
            self.found.setdefault(bus, OTHER_PART)


class Program(Source):
    """A running program; OSError when it cannot be started."""

    is_live = True

    def __init__(self, command: Sequence[str], by: str = '', output: int | None = None,
                 tool: str = 'dxl_doctor') -> None:
        super().__init__()
        name = f'doctor-{secrets.token_hex(4)}'
        self._ending = Ending()
        self.command = command
        self.ports: list[str] = []
        self._was_stopped = False
        self._unheard: str | None = None       # unknown as long as it runs
        self._others: dict[str, list[str]] = {}        # programs that have a port open, by its bus
        self._openings = Openings()
        self._missed: tuple[str, ...] = ()
        self._began_s = time.monotonic()
        self._reader = TapReader(name)
        try:
            self._started = StartedProgram(tool, name, command, by, output)
        except OSError:
            self._reader.close()
            raise
        self._child = self._started.child
        self._add_users([
            word for word in command if os.path.exists(word) and Path(word).is_char_device()])
        self._users_due_s = 0.0                # when to look again who has a port open
        signal.signal(signal.SIGINT, self._remember_stop)  # the terminal sends it to the child too

    def _remember_stop(self, *_: object) -> None:
        self._was_stopped = True

    def chunks(self) -> Chunks:
        """Yield what it reads and writes, until it ends; None when nothing came for a moment."""
        while self._child.poll() is None:
            yield from self._some(self._reader.wait(TICK_S))
            self._find_left()
        until_s = time.monotonic() + LAST_RECORDS_WAIT_S
        while (self._reader.programs or self._reader.left or not self._started.is_heard_out) \
                and time.monotonic() < until_s:
            yield from self._some(self._reader.wait(TICK_S))
            self._find_left()
        yield from self._some(self._reader.rest())
        if self._reader.programs and not self._started.is_traced:
            self._missed = (*self._missed, _IN_BACKGROUND)
        self._add_users(self.ports)             # while it ran it was one of them

    def _find_left(self) -> None:
        """Note a process that is no longer connected and runs, with a port open as we know."""
        due_s = time.monotonic() - LEFT_AFTER_S
        for process, at_s in list(self._reader.left.items()):
            is_left = is_running(process)
            if at_s < due_s or not is_left:
                del self._reader.left[process]
                if is_left:
                    self._missed = (*self._missed, _LEFT.format(at_s - self._began_s))

    def _add_users(self, ports: Sequence[str]) -> None:
        for port in ports:
            found = self._others.setdefault(ntpath.basename(port), [])
            found += [one.name for one in holders(port)
                      if not one.is_maker and one.name not in found
                      and not self._started.has_started(one.process)]
        now_s = time.monotonic()
        self._users_due_s = now_s + max(USERS_EVERY_S, USERS_EVERY_SHARE * (now_s - self._began_s))

    @property
    def users(self) -> dict[str, list[str]]:
        """Who else has a port open, by its bus: other programs, another part of this one."""
        own = self._openings.found
        return {bus: [*self._others.get(bus, ()), *filter(None, [own.get(bus)])]
                for bus in {*self._others, *own}}

    @property
    def ending(self) -> Ending:
        """How it ended, as far as it has."""
        code = self._child.returncode or 0
        return self._ending._replace(
            code=self._started.exit_code,
            was_stopped=self._ending.was_stopped if self._ending.error else
            self._was_stopped or (code < 0 and -code not in CRASHES),
            unheard=(self._started.why_unheard() if self._unheard is None else self._unheard)
            or ('' if self._started.is_traced else '; '.join(self._missed) or _BESIDES),
            missed=self._missed, is_over=self._child.returncode is not None, signal=max(0, -code),
            users=tuple(one for port in self.ports
                        for one in self._others.get(ntpath.basename(port), ())))

    def _some(self, records: list[TapRecord]) -> Chunks:
        yield from filter(None, map(self._chunk, records))
        if not records:
            yield None

    def _chunk(self, record: TapRecord) -> Chunk | None:
        if record.kind == ENDED:
            ended: dict[str, Any] = json.loads(record.data)
            self._ending = Ending(error=printable(' '.join(ended['error'].split())),
                                  function=ended['function'],
                                  packages=frozenset(ended['packages']),
                                  python=ended['python'], was_stopped=ended['stopped'],
                                  is_of_thread=ended['thread'])
            self._openings.is_robbed |= _ROBBED in self._ending.error
        if record.kind == OPENED and record.port not in self.ports:
            self.ports.append(record.port)
        if record.kind == GAVE_UP and time.monotonic() >= self._users_due_s:
            self._add_users([record.port])     # another may have read what it waited for
        bus = ntpath.basename(record.port)           # works for both kinds of path
        self._openings.count_record(bus, record)
        return record.chunk(bus) if record.side or (record.change and bus) else None

    def wire(self, bus: str) -> Wire:
        """Return what is known of a bus: its rate comes with its opening."""
        return Wire(bus, 0)

    def close(self) -> None:
        """Stop to listen, and wait for the program."""
        self._reader.close()
        if self._child.poll() is None:
            self._started.print_line('the program goes on and is no longer heard; Ctrl-C ends it')
        self._unheard = self._started.end()
