# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""
Who else is on a terminal: processes that have it open, and those that it controls.

Reads below /proc (`root` is an argument for tests). The descriptors of other users' processes are
for root alone; their controlling terminal and control group are for everybody.
"""
from __future__ import annotations

from collections.abc import Iterator
from contextlib import suppress
import os
from pathlib import Path
import stat
from typing import NamedTuple

ROOT = Path('/')
_LOGINS = ('getty', 'login')    # parts of the names of programs that offer one
PTYS = range(136, 144)          # major numbers
_READER = 'dxl_reader'          # reads for the program that started it
_PPID, _TTY_NR = 1, 4           # fields of /proc/PID/stat after the name, see proc_pid_stat(5)


class PortUser(NamedTuple):
    """A process that is on a terminal: 'name (pid N)', and what it does there."""

    name: str
    is_login: bool                 # it offers a login
    is_maker: bool                 # it made this pty: a simulated bus holds both ends of its own
    process: int


def holders(path: str, root: Path = ROOT) -> list[PortUser]:
    """Return who else is on the terminal `path`; what only a descriptor shows, for root only."""
    return sorted({*_holders(path, root)})


def _holders(path: str, root: Path) -> Iterator[PortUser]:
    status = None
    with suppress(OSError):
        status = os.stat(path)
    name = tty_of(path)
    for process in (root / 'proc').glob('[0-9]*'):
        user = process
        if _program(user) == _READER:   # its parent is the command that a person started
            user = root / 'proc' / str(_stat_field(process, _PPID))
        program = _program(user)
        if int(user.name) == os.getpid():
            continue
        is_login = any(part in program for part in _LOGINS)
        if (is_login and _serves(process, name)) or (status and (
                is_controlled_by(process, path, status) or _has_open(process, status))):
            yield PortUser(process_name(user), is_login,
                           status is not None and (_has_made(process, status.st_rdev)
                                                   or _has_made(user, status.st_rdev)),
                           int(user.name))


def process_name(process: Path) -> str:
    """Return 'name (pid N)' for a folder of /proc."""
    return f'{_program(process) or "a process"} (pid {process.name})'


def _program(process: Path) -> str:
    return file_text(process / 'comm').strip()


def _serves(process: Path, tty: str) -> bool:
    """Tell whether a getty was started for `tty`, by an argument or as a unit of systemd."""
    # systemd passes the terminal as standard input: `agetty ... -` does not name it.
    return bool({tty, f'/dev/{tty}'} & set(file_text(process / 'cmdline').split('\0'))) \
        or f'getty@{tty}.service' in file_text(process / 'cgroup')


def terminal_id(status: os.stat_result) -> tuple[int, ...]:
    """
    Return what two names of a terminal have in common, and no other terminal has.

    Of a device its number, in any /dev. Each /dev/pts (a container, a sandbox) begins to number
    its ptys at 0: there the file system and the file count too.
    """
    if os.major(status.st_rdev) in PTYS:
        return status.st_rdev, status.st_dev, status.st_ino
    return (status.st_rdev,)


def is_controlled_by(process: Path, path: str, status: os.stat_result) -> bool:
    """
    Tell whether the controlling terminal of a process is `path`, which has this status.

    The kernel says its number only. Of a pty it counts if the process finds the same one there;
    whether it does, root knows of all and others of their own processes.
    """
    number = _stat_field(process, _TTY_NR)
    # Minor numbers above 255 are in the upper 12 bits of the 32.
    if status.st_rdev != os.makedev(number >> 8 & 0xFFF, number & 0xFF | number >> 12 & 0xFFF00):
        return False
    if os.major(status.st_rdev) not in PTYS:
        return True
    found = {terminal_id(one) for one in _open_devices(process) if one.st_rdev == status.st_rdev}
    with suppress(OSError):
        found = found or {terminal_id(os.stat(f'{process}/root{os.path.realpath(path)}'))}
    return terminal_id(status) in found


def _stat_field(process: Path, index: int) -> int:
    """Return a number of /proc/PID/stat after the name, 0 where the process has ended."""
    fields = _stat_fields(process)
    return int(fields[index]) if len(fields) > index else 0


def is_started_by(process: int, ancestor: int) -> bool:
    """Tell whether a process is another one, or a child of it, or of a child."""
    while process not in (0, ancestor):
        process = _stat_field(ROOT / f'proc/{process}', _PPID)
    return process == ancestor


def tracer(process: int | str) -> int:
    """Return the process that traces this one, 0 for none."""
    text = file_text(ROOT / f'proc/{process}/status').partition('TracerPid:\t')[2]
    return int(text.partition('\n')[0] or 0)


def _stat_fields(process: Path) -> list[str]:
    return file_text(process / 'stat').rpartition(')')[2].split()


def is_running(process: int) -> bool:
    """Tell whether a process is there, and is no zombie."""
    return _stat_fields(ROOT / f'proc/{process}')[:1] not in ([], ['Z'], ['X'])


def _has_open(process: Path, status: os.stat_result) -> bool:
    """Tell whether a process has a descriptor of the terminal with this status."""
    return any(terminal_id(one) == terminal_id(status) for one in _open_devices(process))


def _open_devices(process: Path) -> Iterator[os.stat_result]:
    """Yield the status of each device that a process has open; it may end while we look."""
    with suppress(OSError):
        for entry in (process / 'fd').iterdir():
            with suppress(OSError):
                status = entry.stat()
                if stat.S_ISCHR(status.st_mode):
                    yield status


def _has_made(process: Path, device: int) -> bool:
    """Tell whether a process has the other end of a pty."""
    if os.major(device) not in PTYS:
        return False
    index = f'tty-index:\t{os.minor(device)}'
    return any(index in file_text(entry).splitlines() for entry in (process / 'fdinfo').glob('*'))


def tty_of(path: str | Path) -> str:
    """Return the name that the kernel has for a port, as ttyUSB0; links are followed."""
    return os.path.basename(os.path.realpath(path))


def is_terminal(path: str) -> bool:
    """Tell whether a path is a serial port or a pty."""
    name = tty_of(path)
    with suppress(OSError):
        return os.path.exists(f'/sys/class/tty/{name}') or os.major(os.stat(path).st_rdev) in PTYS
    return False


def file_text(path: Path) -> str:
    """Return what a file holds, '' when it cannot be read."""
    try:
        return path.read_text(errors='replace')
    except OSError:
        return ''
