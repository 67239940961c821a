# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""Runs a program under strace, on Linux: which ports it hears, what forbids it, the processes."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import suppress
import fcntl
import os
from pathlib import Path
import shutil
import stat
import subprocess
import sys
import time

from servobus.port.port_users import is_controlled_by
from servobus.port.port_users import PTYS
from servobus.port.port_users import terminal_id
from servobus.port.port_users import tracer
from servobus.sources.reader_process import PIPE_SIZE
from servobus.sources.strace_parser import OPTIONS
from servobus.sources.tap_sender import PORT

START_S = 5.0                      # within which strace opens the pipe
_ABSENT = [f'/dev/tty{kind}{number}' for kind in ('USB', 'ACM') for number in range(16)]
_IO_URING, _USBFS = 'anon_inode:[io_uring]', '/dev/bus/usb/'
_NOT_HEARD = {
    _IO_URING: 'the program uses io_uring: what it reads and writes that way is not heard; if '
               'that is the bus, listen to usb:/dev/ttyUSB0',
    _USBFS: 'the program drives a USB device itself (libusb), which is not heard; if that is the '
            'adapter, listen to usb:1.5 (bus 1, device 5: lsusb shows the numbers)',
}
_PRIORITY = ('the program has threads with real-time priority: while it uses {} they wait for '
             'strace, which has none; do not rely on its timing')
_MISSED = ('{} is open, but not through pyserial, and is not heard; write --by strace in front of '
           '--')
_Pair = tuple[subprocess.Popen[bytes], subprocess.Popen[bytes]]
_ROOT = Path(__file__).parents[2]
_RELAY = ('import sys; sys.path.insert(0, {!r}); '
          'from servobus.sources.strace_relay import main; main()')


def ports() -> set[str]:
    """Return the serial ports, also some that may be plugged in; not the terminal in use."""
    own = set()
    for standard in range(3):
        with suppress(OSError):
            status = os.fstat(standard)
            own |= {terminal_id(status)} if os.major(status.st_rdev) in PTYS else set()
    found = {*_ABSENT}
    for path in (*Path('/dev').glob('*'), *Path('/dev/pts').glob('*')):
        with suppress(OSError):
            status = path.lstat()
            if PORT.fullmatch(str(path)) and terminal_id(status) not in own \
                    and not is_controlled_by(Path('/proc/self'), str(path), status):
                found.add(str(path))
    return found


def why_not() -> str:
    """Return why strace cannot hear a program here, with the remedy, '' where it can."""
    if shutil.which('strace') is None:
        return 'strace is not installed; sudo apt install strace'
    tried = subprocess.run(['strace', *OPTIONS[1:], '-o', os.devnull, 'true'], text=True,
                           stdin=subprocess.DEVNULL, capture_output=True)
    if not tried.returncode:
        return ''
    other = tracer('self')
    if other:
        return f'process {other} traces this one already; start it without that'
    reason = (tried.stderr.strip() or 'strace fails').splitlines()[-1]
    return (f'{reason}; a container needs --cap-add SYS_PTRACE, and kernel.yama.ptrace_scope must '
            'be below 2; or listen to usb:/dev/ttyUSB0')


def loses_rights(program: str) -> bool:
    """Tell whether a program has rights of its own, which it does not get under strace."""
    if os.geteuid() == 0:
        return False
    with suppress(OSError):
        if os.stat(program).st_mode & (stat.S_ISUID | stat.S_ISGID):
            return True
        return 'security.capability' in os.listxattr(program)
    return False


def start(env: dict[str, str], name: str, folder: str, command: Sequence[str] = (),
          stdout: int | None = None, process: int = 0) -> _Pair:
    """
    Let strace hear a command, which becomes our child, or a process that runs.

    Return the child (strace, for a process that runs) and the relay, which sends to listeners of
    the tap `name`. folder: an empty one, for this alone. The relay ends with the last process of
    the program, or with strace; strace ends with the relay, and leaves the program alone.
    """
    fifo = os.path.join(folder, 'strace')      # it opens that: not for the program
    os.mkfifo(fifo, 0o600)
    theirs = os.open(fifo, os.O_RDONLY | os.O_NONBLOCK)
    ours = os.open(fifo, os.O_WRONLY)          # without it the relay would be at the end at once
    try:
        os.set_blocking(theirs, True)
        with suppress(OSError):                # as reader_process.py
            fcntl.fcntl(ours, fcntl.F_SETPIPE_SZ, PIPE_SIZE)
        relay = subprocess.Popen(
            [sys.executable, '-I', '-S', '-c', _RELAY.format(str(_ROOT)), name], env=env,
            stdin=theirs, stdout=subprocess.DEVNULL, start_new_session=True)
        paths = [part for path in sorted(ports()) for part in ('-P', path)]
        options = ['strace', *OPTIONS, *paths, '-o', fifo]
        if process:
            options.remove(OPTIONS[0])         # the program is no child of ours
            child = subprocess.Popen([*options, '-p', str(process)], start_new_session=True)
        else:
            child = subprocess.Popen([*options, '--', *command], env=env, stdout=stdout)
        until_s = time.monotonic() + START_S
        while not tracer(process or child.pid) and child.poll() is None \
                and time.monotonic() < until_s:
            time.sleep(0.002)
    finally:
        os.close(theirs)
        os.close(ours)
        os.unlink(fifo)
    return child, relay


def unheard(process: int, used: set[str] | None = None) -> set[str]:
    """
    Return what of a program and its children is not heard, or not as it should be.

    used: the ports that are heard inside of it; None where strace hears it.
    """
    left, found = [process], set()
    while left:
        folder = Path(f'/proc/{left.pop()}')
        with suppress(OSError):                # it may end meanwhile
            for children in folder.glob('task/*/children'):
                left += map(int, children.read_text().split())
            for file in (folder / 'fd').iterdir():
                path = os.readlink(file)
                if PORT.fullmatch(path):
                    found |= _unheard_on_port(folder, int(file.name), path, used)
                elif used is None:
                    found |= {text for begin, text in _NOT_HEARD.items() if path.startswith(begin)}
    return found


def _unheard_on_port(folder: Path, number: int, path: str, used: set[str] | None) -> set[str]:
    if number < 3 or path not in ports():      # a terminal
        return set()
    if used is not None:
        return set() if path in used else {_MISSED.format(path)}
    return {_PRIORITY.format(path) for thread in (folder / 'task').iterdir()
            if os.sched_getscheduler(int(thread.name)) in (os.SCHED_FIFO, os.SCHED_RR)}
