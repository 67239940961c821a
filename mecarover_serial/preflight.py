# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""
Why a serial port cannot be used, or soon will not work well, and what helps.

Looks at the file system only (`root` is an argument for tests) and may take a second when many
processes run: never call it from an executor's thread. Facts on the Raspberry Pi 5: serial0
points at the debug connector, the UART of GPIO 14/15 is ttyAMA0.
"""
from __future__ import annotations

from collections.abc import Sequence
from contextlib import suppress
import errno
import grp
import os
from pathlib import Path
import pwd
import re
import stat
from typing import NamedTuple

from serial.tools import list_ports

ROOT = Path('/')


class Reason(NamedTuple):
    """Why a port cannot be used: `kind` for programs, `reason` and `remedy` for people."""

    kind: str       # absent, permission, busy, not_a_port, baud, url, lost, console, other
    reason: str
    remedy: str


def why_not(path: str, error: Exception) -> Reason:
    """Turn the error of opening `path` into words; looks at the system to be precise."""
    number = _errno(error)
    if number in (errno.ENOENT, errno.ENOTDIR):
        return _absent(path)
    if number in (errno.EACCES, errno.EPERM):
        return _permission(path)
    if number in (errno.EBUSY, errno.EAGAIN):
        return _busy(path)
    if os.path.isdir(path) or number in (errno.ENOTTY, errno.EISDIR, errno.EINVAL):
        what = 'a directory' if os.path.isdir(path) else 'not a serial port'
        return Reason('not_a_port', what, f'give the port itself; {ports_here()}')
    if '://' in path and number is not None:
        return _absent(path)
    if number in (errno.EMFILE, errno.ENFILE):
        return Reason('other', 'no file descriptor is left to open it',
                      'raise the limit (ulimit -n, LimitNOFILE=) or look for who leaks them')
    if number in (errno.ENODEV, errno.ENXIO, errno.EIO):
        return Reason('lost', 'the device behind it has gone', 'check plug and power')
    return Reason('other', str(error), 'check the path, the cable and the adapter')


def warnings(path: str, root: Path = ROOT, ours: Sequence[str] = ()) -> list[Reason]:
    """
    Return what will disturb a port although it opens: a console, a login, a wrong header.

    `ours` are names of processes that share the port with us on purpose.
    """
    name = os.path.basename(os.path.realpath(path))
    found = []
    if name in _consoles(root):
        found.append(Reason(
            'console', 'the kernel writes its console here',
            f'remove console={name} or console=serial0 from the kernel command line and reboot'))
    others = holders(path, root)
    logins = {who for who in others if 'getty' in who or 'login' in who} | _gettys(name, root)
    found.extend(Reason('console', f'{who} offers a login here',
                        f'sudo systemctl disable --now serial-getty@{name}')
                 for who in sorted(logins))
    # TIOCEXCL does not keep root out, nor who was there before. (A pty, whose name is a number,
    # is held by its other end too.)
    found.extend(Reason('busy', f'{who} has it open too', 'stop that program') for who in others
                 if who not in logins and not who.startswith(tuple(ours)) and not name.isdigit())
    if name == 'ttyAMA10' and 'Raspberry Pi 5' in _text(root / 'proc/device-tree/model'):
        found.append(Reason(
            'console', 'this is the 3-pin debug connector of the Pi 5, not GPIO 14/15',
            'add dtparam=uart0 to config.txt, reboot, and use /dev/ttyAMA0'))
    return found


def holders(path: str, root: Path = ROOT) -> list[str]:
    """Name who else has the port open, 'name (pid N)'; other users' processes only for root."""
    try:
        device = os.stat(path).st_rdev
    except OSError:
        return []
    return [_process_name(process) for process in (root / 'proc').glob('[0-9]*')
            if int(process.name) != os.getpid() and _has_open(process, device)]


def ports_here() -> str:
    """Name the serial ports that do exist, for a person who mistyped one."""
    try:
        found = list_ports.comports()
    except Exception:               # TypeError: one of them vanished while pyserial looked at it
        return 'ls /dev/serial/by-id names those that are plugged in'
    # ttyS* without hardware behind them are listed on every PC: only real ones help.
    ports = [port for port in found if not port.device.startswith('/dev/ttyS')
             or port.hwid != 'n/a']
    if not ports:
        return 'no serial port is plugged in'
    return 'ports here: ' + ', '.join(
        port.device + (f' ({port.description})' if port.description != 'n/a' else '')
        for port in sorted(ports))


def _errno(error: Exception) -> int | None:
    """Find the number in what pyserial made of an OSError: it may only stand in the text."""
    number = getattr(error, 'errno', None)
    if number is None:
        match = re.search(r'\[Errno (\d+)\]|\((\d+), ', str(error))
        number = int(match[1] or match[2]) if match else None
    return number


def _absent(path: str) -> Reason:
    if '://' in path:
        return Reason('absent', 'nobody answers at this address', 'check host, port and network')
    if os.path.islink(path):
        return Reason('absent', f'points at {os.readlink(path)}, which is not there',
                      f'plug the adapter in, or mend the link; {ports_here()}')
    return Reason('absent', 'is not there', f'plug it in or set another port; {ports_here()}')


def _permission(path: str) -> Reason:
    user = _user_name()
    try:
        status = os.stat(path)
        group, _, _, members = grp.getgrgid(status.st_gid)
    except (OSError, KeyError):
        return Reason('permission', f'user {user} may not open it', 'check its owner and mode')
    mine = sorted(_group_name(number) for number in os.getgroups())
    reason = (f'user {user} (groups {", ".join(mine) or "none"}) may not open it: it belongs to '
              f'group {group}, mode {stat.filemode(status.st_mode)}')
    if user in members and group not in mine:
        return Reason('permission', reason, f'{user} joined {group} after this session began: '
                      'log in again')
    if group in mine or group == 'root':
        return Reason('permission', reason, f'sudo chmod g+rw {path}, or a udev rule that does it')
    return Reason('permission', reason,
                  f'sudo usermod -aG {group} {user}, then log in again (a service: Group={group})')


def _busy(path: str) -> Reason:
    who = holders(path)
    if who:
        return Reason('busy', f'in use by {", ".join(who)}', 'stop that program')
    return Reason('busy', 'in use by another process',
                  f'stop that program; sudo fuser -v {path} names it')


def _user_name() -> str:
    try:
        return pwd.getpwuid(os.geteuid()).pw_name
    except KeyError:                # a container with a user of its own
        return str(os.geteuid())


def _group_name(number: int) -> str:
    try:
        return grp.getgrgid(number).gr_name
    except KeyError:
        return str(number)


def _consoles(root: Path) -> set[str]:
    """Names of the ttys that the kernel writes to."""
    names = {line.split()[0] for line in _text(root / 'proc/consoles').splitlines() if line}
    names |= set(re.findall(r'console=(\w+)', _text(root / 'proc/cmdline')))
    if 'serial0' in names:
        names.add(os.path.basename(os.path.realpath(root / 'dev/serial0')))
    return names


def _gettys(tty: str, root: Path) -> set[str]:
    """Name the gettys of a tty by their command lines, which every user may read."""
    return {_process_name(process) for process in (root / 'proc').glob('[0-9]*')
            if 'getty' in _text(process / 'comm')
            and {tty, f'/dev/{tty}'} & set(_text(process / 'cmdline').split('\0'))}


def _process_name(process: Path) -> str:
    return f'{_text(process / "comm").strip() or "a process"} (pid {process.name})'


def _has_open(process: Path, device: int) -> bool:
    """Tell whether a process has a descriptor of `device`; it may end while we look."""
    with suppress(OSError):
        for entry in (process / 'fd').iterdir():
            with suppress(OSError):
                status = entry.stat()
                if stat.S_ISCHR(status.st_mode) and status.st_rdev == device:
                    return True
    return False


def _text(path: Path) -> str:
    try:
        return path.read_text(errors='replace')
    except OSError:
        return ''
