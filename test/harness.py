# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""Real processes for tests: start one, read what it says, end it."""
from contextlib import contextmanager
from contextlib import suppress
import importlib.util
import os
from pathlib import Path
import resource
import signal
import subprocess
import sys
import threading
import time

import pytest

from rigs.harness import children
from rigs.harness import state

ROOT = Path(__file__).parents[1]
DEADLINE_S = 60.0               # for what takes a moment: generous, the machine may be busy
# What a shared machine may add to a bound in s. The figures of docs/reliability.md are from quiet
# runs with 0.25.
LATE_S = float(os.environ.get('LATE_S', '1.0'))
POLL_S = 0.005


def installed_share(*needed):
    """Return the share folder of the package as installed, and why a test of it has to skip."""
    missing = [name for name in needed if importlib.util.find_spec(name) is None]
    if missing:
        return '', ('skipped: needs ROS 2 with its launch tools, not importable: '
                    + ', '.join(missing))
    from ament_index_python.packages import get_package_share_directory
    try:
        return get_package_share_directory('mecarover_serial'), ''
    except LookupError as error:
        return '', ('skipped: mecarover_serial is not in the ament index; build and source it '
                    f'({error})')


def later(parameters, first):
    """Leave all but the first parameters of a test, or all but these, to scripts/test --all."""
    parameters = list(parameters)
    chosen = parameters[:first] if isinstance(first, int) else first
    return [one if one in chosen else pytest.param(
        *(one if type(one) is tuple else (one,)), marks=pytest.mark.more) for one in parameters]


def wait(condition, deadline_s=DEADLINE_S):
    """Wait until `condition()` is true and return what it returned; fail after the deadline."""
    deadline = time.monotonic() + deadline_s
    while not (met := condition()):
        assert time.monotonic() < deadline, f'not within {deadline_s} s'
        time.sleep(POLL_S)
    return met


def shown_on(terminal):
    """Return all that came to a terminal, from its master, until its other end is closed."""
    shown = b''
    with suppress(OSError), open(terminal, 'rb', buffering=0) as screen:
        while piece := screen.read(4096):
            shown += piece
    return shown.decode().replace('\r\n', '\n')


def output_of(module, *arguments):
    """Run a module of ours to its end, which has to be a good one; return what it prints."""
    done = subprocess.run([sys.executable, '-m', module, *arguments], capture_output=True,
                          text=True, cwd=ROOT)
    assert done.returncode == 0, done.stdout + done.stderr
    return done.stdout


class Background:
    """Does what `_run` does, in a thread, as long as it is entered; then `_done` is set."""

    def __init__(self):
        self._done = threading.Event()
        self._thread = threading.Thread(target=self._run, name=type(self).__name__)

    def stop(self):
        self._done.set()
        self._thread.join()

    def __enter__(self):
        self._thread.start()
        return self

    def __exit__(self, *_):
        self.stop()


class Program:
    """
    A Python program in a process of its own; its output is kept in `lines`.

    `script` is code to run instead of a module: to patch something before it starts. `prefix`
    is a command that starts it.
    """

    def __init__(self, module, *arguments, script=None, prefix=()):
        start = ['-m', module] if script is None else ['-c', script]
        self._process = subprocess.Popen(
            [*prefix, sys.executable, *start, *arguments], stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True, errors='replace',
            cwd=ROOT, env={**os.environ, 'PYTHONUNBUFFERED': '1', 'PYTHONFAULTHANDLER': '1'})
        self.pid = self._process.pid
        self.lines = []
        self._reader = threading.Thread(target=self._read, daemon=True)
        self._reader.start()

    def _read(self):
        for line in self._process.stdout:
            self.lines.append(line.rstrip('\n'))

    @property
    def text(self):
        return '\n'.join(self.lines)

    def said(self, *parts):
        """Return the lines that hold all of `parts`."""
        return [line for line in self.lines if all(part in line for part in parts)]

    def wait_for(self, *parts):
        """Wait for a line that holds all of `parts`, and return it."""
        deadline = time.monotonic() + DEADLINE_S
        while not (found := self.said(*parts)):
            assert time.monotonic() < deadline, f'nothing said of {parts}:\n{self.text}'
            time.sleep(POLL_S)
        return found[0]

    def signal(self, number):
        self._process.send_signal(number)

    @property
    def has_ended(self):
        return self._process.poll() is not None

    def state(self):
        """Return the state of the process as ps shows it: R, S, T (stopped) ..."""
        return state(self.pid)

    def children(self):
        return children(self.pid)

    def exit_code(self, deadline_s=DEADLINE_S):
        """Wait for its end and return its exit code."""
        code = self._process.wait(deadline_s)
        self._reader.join(DEADLINE_S)
        return code

    def __enter__(self):
        return self

    def __exit__(self, *_):
        """End it: politely, then not."""
        for number in (signal.SIGCONT, signal.SIGTERM, signal.SIGKILL):
            self._process.send_signal(number)
            with suppress(subprocess.TimeoutExpired):
                self._process.wait(5.0 if number is signal.SIGTERM else 0.0)
        self._process.wait()
        self._reader.join(DEADLINE_S)
        self._process.stdout.close()
        crashed = self._process.returncode in (-signal.SIGSEGV, -signal.SIGABRT, -signal.SIGBUS)
        assert not crashed, f'crashed with signal {-self._process.returncode}:\n{self.text}'


def loose_contact(cable):
    """Cut a cable six times in a second; return when it was last mended (monotonic ns)."""
    for pause_s in (0.0, 0.01, 0.05, 0.1, 0.2, 0.3):
        cable.cut()
        time.sleep(pause_s)
        begin = time.monotonic_ns()
        cable.reopen()
        time.sleep(pause_s)
    return begin


SPIN = """
import os, sys
print(flush=True)
while os.getppid() == int(sys.argv[1]):
    sum(range(100_000))
"""


@contextmanager
def starving():
    """Keep the machine busy, two spinning processes per core, from the first line to the last."""
    busy = [subprocess.Popen([sys.executable, '-c', SPIN, str(os.getpid())],
                             stdout=subprocess.PIPE)
            for _ in range(2 * len(os.sched_getaffinity(0)))]
    try:
        for one in busy:
            one.stdout.readline()
        yield
        assert all(one.poll() is None for one in busy)
    finally:
        for one in busy:
            one.kill()
            one.wait()
            one.stdout.close()


@contextmanager
def no_descriptors(pid):
    """Let a process open no further file: half of what it has open is all it may have."""
    before = resource.prlimit(pid, resource.RLIMIT_NOFILE)
    used = len(os.listdir(f'/proc/{pid}/fd'))
    resource.prlimit(pid, resource.RLIMIT_NOFILE, (used // 2, before[1]))
    try:
        yield
    finally:
        resource.prlimit(pid, resource.RLIMIT_NOFILE, before)
