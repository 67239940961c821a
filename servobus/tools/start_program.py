# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""
Starts a program so that listeners of tap:NAME hear it: dxl_tap and dxl_doctor run.

A program in Python is heard inside, through pyserial; that costs least and works on every system.
Any other is heard through strace (Linux). The program is our child and goes on without us. It is
found as outside of the environment that holds this tool alone.
"""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import suppress
import errno
from importlib import metadata
import os
from pathlib import Path
import re
import shlex
import shutil
import signal
import subprocess
import sys
import tempfile
import threading
import time
from types import FrameType
from types import ModuleType

from servobus.port.port_users import is_running
from servobus.port.port_users import is_started_by
from servobus.port.port_users import tracer
from servobus.sources.site import __file__ as SITE
from servobus.sources.tap_sender import TAP_MARK
from servobus.sources.tap_sender import TAP_NAME
from servobus.sources.tap_sender import TRACE
from servobus.sources.tap_sender import USED

TAP, STRACE = 'tap', 'strace'
WAYS = (TAP, STRACE)
BY = ('how to hear it: tap, inside a Python program that uses pyserial, or strace, any program on '
      'Linux (default: what fits)')
TRACED = ('heard through strace: an exchange with a servo takes 0.2 ms longer, each other system '
          'call 0.03 ms')
STOPPED = 'strace was ended; the program goes on and is no longer heard'
HANDED_ON = ('SIGTERM', 'SIGHUP', 'SIGQUIT', 'SIGUSR1', 'SIGUSR2')
WATCH_EVERY_S = 0.5                # between two looks at what the program does
JOIN_CHECKS = 20                   # for what it asks for, in that time: it waits
RELAY_WAIT_S = 1.0                 # for what the relay heard last
_PYTHON = re.compile(r'(python|pypy)[\d.]*w?(\.exe)?')
_SCRIPT = re.compile(rb"#!.*(python|pypy)|#!/bin/sh\n'''exec'")
_DEVELOPER = re.compile(r'extra == .(test|docs|fuzz|mutation|release)\b')
_OUR_OWN = ('mecarover_serial', 'dxl_doctor')


class StartedProgram:
    """A program that was started and is heard; OSError where that cannot be."""

    def __init__(self, tool: str, name: str, command: Sequence[str], by: str = '',
                 stdout: int | None = None) -> None:
        """Start it; tool: who speaks on stderr; by: one of WAYS, '' for the one that fits."""
        self._tool = tool
        self._command = command[0]
        self._relay: subprocess.Popen[bytes] | None = None
        self._has_joined = False               # strace, or it could not
        self._name = name
        self._env = outside = own_environment()
        program = _find(command, outside)
        self.way = by or (TAP if sys.platform != 'linux' or is_python(program) else STRACE)
        self._folder = tempfile.TemporaryDirectory(prefix=f'{tool}_')
        self._mark = Path(self._folder.name) / 'mark'
        outside[TAP_MARK] = str(self._mark)
        try:
            if self.way == STRACE:
                self._start_traced(program, command, stdout)
            else:
                self.print_line(f'{program} is heard through pyserial')
                self.child = subprocess.Popen([program, *command[1:]], stdout=stdout,
                                              env=environment(name, outside))
        except OSError:
            self._folder.cleanup()
            raise
        hand_signals_on(self.child)
        with suppress(ImportError):            # Windows: nothing to see
            from servobus.sources import strace

            threading.Thread(target=self._watch, args=(strace,), daemon=True).start()

    def _start_traced(self, program: str, command: Sequence[str], stdout: int | None) -> None:
        if sys.platform != 'linux':
            raise OSError(0, 'strace is for Linux; leave out --by', self._command)
        from servobus.sources import strace  # needs fcntl and termios

        problem = strace.why_not()
        if problem:
            raise OSError(0, f'{problem}; or write --by {TAP}, if the command starts Python',
                          self._command)
        if strace.loses_rights(program):
            self.print_line(f'{program} runs without the rights that its file gives it: strace '
                            f'takes them away; write sudo {self._tool} ...')
        self.print_line(f'{program} is {TRACED}')
        self.child, self._relay = strace.start(
            self._env, self._name, self._folder.name, [program, *command[1:]], stdout)

    @property
    def exit_code(self) -> int:
        """How it ended, as a shell counts; 0 while it runs."""
        code = self.child.returncode or 0
        return 128 - code if code < 0 else code

    def has_started(self, process: int) -> bool:
        """Tell whether a process is of the program, or has ended by now: a child of a shell."""
        ours = tracer(self.child.pid)
        return is_started_by(process, self.child.pid) \
            or 0 < ours == tracer(process) or not is_running(process)

    @property
    def is_heard_out(self) -> bool:
        """Whether nothing more comes from strace."""
        return self._relay is None or self._relay.poll() is not None

    def print_line(self, text: str) -> None:
        """Print a line about the program."""
        print(f'{self._tool}: {text}', file=sys.stderr, flush=True)

    def _watch(self, strace: ModuleType) -> None:
        """Say once what is not heard."""
        before, printed = set[str](), set[str]()
        while not printed & {STOPPED}:
            for _ in range(JOIN_CHECKS):
                time.sleep(WATCH_EVERY_S / JOIN_CHECKS)
                self._join(strace)
            if self.way == TAP:
                used = set(map(os.path.realpath, self._marked(USED)))
                found = strace.unheard(self.child.pid, used)
            else:
                found = strace.unheard(self.child.pid) if tracer(self.child.pid) \
                    else {STOPPED}
            if self.child.returncode is not None:
                return
            for text in sorted(found & before - printed):
                self.print_line(text)
            printed |= found & before
            before = found

    def _join(self, strace: ModuleType) -> None:
        """Let strace hear a program in Python that asks for it, once."""
        asked = self._marked(TRACE)
        if not asked or self._has_joined:
            return
        self._has_joined = True
        problem = strace.why_not()
        if problem:
            self.print_line(f'{self._command} opens ports without pyserial, and is not heard: '
                            f'{problem}')
            return
        self.print_line(f'{self._command} opens ports without pyserial and is {TRACED}')
        with suppress(OSError):                # the program has ended
            self._strace, self._relay = strace.start(
                self._env, self._name, self._folder.name, process=int(asked[0]))

    def _marked(self, begin: bytes) -> list[str]:
        """Return what the tap has said in lines that begin so."""
        with suppress(OSError):
            return [line.removeprefix(begin).decode() for line in
                    self._mark.read_bytes().splitlines() if line.startswith(begin)]
        return []

    def end(self) -> str:
        """Wait for the program; return why nothing was heard, '' where a port was opened."""
        self.child.wait()
        if self._relay is not None and not self._marked(USED):
            with suppress(subprocess.TimeoutExpired):
                self._relay.wait(RELAY_WAIT_S)
        why = self.why_unheard()
        self._folder.cleanup()
        return why

    @property
    def is_traced(self) -> bool:
        """Whether strace hears the program."""
        return self._relay is not None

    def why_unheard(self) -> str:
        """Return why nothing has been heard up to now, '' where a port was opened."""
        if self._marked(USED):
            return ''
        if self.is_traced:                     # from the start or since an import
            return f'{self._command} opened no serial port'
        reason = 'opened no port through pyserial' if self._mark.exists() else \
            'did not load the tap: it is not Python, or PYTHONPATH did not reach it (python -E ' \
            'or -I, sudo, an emptied environment)'
        return f'{self._command} {reason}; to hear any program, write --by {STRACE} in front of --'


def environment(name: str, env: dict[str, str] | None = None) -> dict[str, str]:
    """Return the environment in which a Python program is tapped."""
    env = {**os.environ} if env is None else env
    paths = [str(Path(SITE).parent), *filter(None, [env.get('PYTHONPATH')])]
    return {**env, TAP_NAME: name, 'PYTHONPATH': os.pathsep.join(paths)}


def own_environment() -> dict[str, str]:
    """Return the environment variables, without the venv that holds this tool and nothing else."""
    env = {**os.environ}
    own = os.path.realpath(sys.prefix)
    folders = [folder for folder in os.get_exec_path()
               if os.path.dirname(os.path.realpath(folder)) != own]
    if sys.prefix == sys.base_prefix or folders == os.get_exec_path() or not _is_tools_own():
        return env
    env['PATH'] = os.pathsep.join(folders)
    if os.path.realpath(env.get('VIRTUAL_ENV', '')) == own:
        del env['VIRTUAL_ENV']
    return env


def _is_tools_own() -> bool:
    """Tell whether all packages of this venv are here because of ours."""
    here = {_plain(one.metadata['Name'] or ''): one for one in metadata.distributions(
        path=[path for path in sys.path if path.startswith(sys.prefix)])}
    needed, left = {*_OUR_OWN, 'pip', 'setuptools', 'wheel'}, [*_OUR_OWN]
    while left:
        one = here.get(left.pop())
        for text in (one.requires or ()) if one else ():
            name = _plain(re.split(r'[^\w.-]', text, maxsplit=1)[0])
            if name not in needed and not _DEVELOPER.search(text):
                needed.add(name)
                left.append(name)
    return here.keys() <= needed


def _plain(name: str) -> str:
    return re.sub(r'[-_.]+', '_', name).lower()


def _find(command: Sequence[str], env: dict[str, str]) -> str:
    """Return the path of a program, as a shell finds it."""
    found = shutil.which(command[0], path=env.get('PATH')) or shutil.which(command[0])
    if found is not None:
        return found
    meant = with_python(command)[:2]
    todo = f'write {shlex.join(meant)}' if meant[0] != command[0] \
        else 'check the name of the program'
    number = errno.EACCES if os.path.isfile(command[0]) else errno.ENOENT
    raise OSError(number, f'{os.strerror(number)}; {todo}', command[0])


def is_python(program: str) -> bool:
    """Tell whether a file is an interpreter of Python, or a script for one."""
    if _PYTHON.fullmatch(os.path.basename(program)):
        return True
    try:
        with open(program, 'rb') as file:
            return _SCRIPT.match(file.read(200)) is not None
    except OSError:
        return False


def with_python(command: Sequence[str]) -> list[str]:
    """Return a command as it was meant: a script of Python needs it in front."""
    return ['python', *command] if command[0].endswith('.py') else list(command)


def hand_signals_on(child: subprocess.Popen[bytes]) -> None:
    """Let the child have the signals that this process gets."""
    def hand_on(number: int, frame: FrameType | None) -> None:
        with suppress(OSError):
            child.send_signal(number)

    signal.signal(signal.SIGINT, signal.SIG_IGN)       # the terminal sends it to both
    for name in HANDED_ON:
        if hasattr(signal, name):
            signal.signal(getattr(signal, name), hand_on)
