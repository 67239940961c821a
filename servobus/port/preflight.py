# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""
Why a serial port cannot be used, or soon will not work well, and what helps.

Looks at the file system only (`root` is an argument for tests) and may take a second when many
processes run: never call it from an executor's thread. Facts on the Raspberry Pi 5: serial0
points at the debug connector, the UART of GPIO 14/15 is ttyAMA0.
"""
from __future__ import annotations

from collections.abc import Callable
from collections.abc import Sequence
import errno
import os
from pathlib import Path
import re
import stat
from typing import Any

from serial.tools import list_ports

from servobus.port.port_error import Reason
from servobus.port.port_users import file_text
from servobus.port.port_users import holders
from servobus.port.port_users import PTYS
from servobus.port.port_users import ROOT
from servobus.port.port_users import tty_of

_FOREIGN = {stat.S_IFDIR: 'a directory', stat.S_IFREG: 'a file', stat.S_IFBLK: 'a disk',
            stat.S_IFIFO: 'a pipe', stat.S_IFSOCK: 'a socket'}
DEADMAN = 'deadman '                # what a bridge leaves where it was killed
_SCREENS = re.compile(r'tty\d*|console|ptmx')


def why_not(path: str, error: Exception, root: Path = ROOT) -> Reason:
    """Turn the error of opening `path` into words; looks at the system to be precise."""
    number = _errno(error)
    # That it is not a port comes first: rights to a file that is none would not help.
    if wrong := _wrong_kind(path, root):
        return wrong
    if number in (errno.ENOENT, errno.ENOTDIR):
        return _absent(path)
    if number in (errno.EACCES, errno.EPERM):
        return _permission(path, root)
    if number in (errno.EBUSY, errno.EAGAIN):
        return busy(path)
    if number in (errno.ENOTTY, errno.EINVAL):
        return _not_a_port('not a serial port')
    if '://' in path and number is not None:
        return _absent(path)
    if number in (errno.EMFILE, errno.ENFILE):
        return Reason('other', 'no file descriptor is left to open it',
                      'raise the limit (ulimit -n, LimitNOFILE=) or find the program that leaks '
                      'them')
    if number in (errno.ENODEV, errno.ENXIO, errno.EIO):
        return Reason('lost', 'its device was removed', 'check plug and power')
    return Reason('other', str(error), 'check the address and what answers there (a plain TCP '
                  'port is socket://)' if '://' in path else
                  'check the path, the cable and the adapter')


def warnings(path: str, root: Path = ROOT, ours: Sequence[str] = ()) -> list[Reason]:
    """
    Return what will disturb a port although it opens: a console, a login, a wrong header.

    `ours` are names of processes that share the port with us on purpose.
    """
    name = tty_of(path)
    found = []
    if name in _kernel_consoles(root):
        found.append(Reason(
            'console', 'the kernel writes its console here',
            f'remove console={name} or console=serial0 from the kernel command line and reboot'))
    others = holders(path, root)
    found.extend(_login(who.name, path) for who in others if who.is_login)
    # TIOCEXCL keeps out neither root nor a program that was there before.
    found.extend(Reason('busy', f'{who.name} has it open too', 'stop that program')
                 for who in others if not who.is_login and not who.is_maker
                 and not who.name.startswith(tuple(ours)))
    if name == 'ttyAMA10' and 'Raspberry Pi 5' in file_text(root / 'proc/device-tree/model'):
        found.append(Reason(
            'console', 'this is the 3-pin debug connector of the Pi 5, not GPIO 14/15',
            'add dtparam=uart0 to config.txt, reboot, and use /dev/ttyAMA0'))
    return found


def ports_here() -> str:
    """Name the serial ports that do exist, for a person who mistyped one."""
    try:
        found = list_ports.comports()
    except Exception:               # TypeError: one of them vanished while pyserial looked at it
        return 'ls /dev/serial/by-id names those that are plugged in'
    # ttyS* without hardware are listed on every PC: only real ones help.
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
        return Reason('absent', 'no answer from this address', 'check host, port and network')
    if os.path.islink(path):
        return Reason('absent', f'points to {os.readlink(path)}, which is not there',
                      f'plug the adapter in, or correct the link; {ports_here()}')
    whole = f'write /dev/{path}, or ' if path.startswith('tty') else ''
    return Reason('absent', 'is not there',
                  f'{whole}plug it in or set another port; {ports_here()}')


def _wrong_kind(path: str, root: Path) -> Reason | None:
    """Return why a path that is there cannot be a serial port, with any rights."""
    try:
        status = os.stat(path)
    except OSError:
        return None
    if not stat.S_ISCHR(status.st_mode):
        return _not_a_port(_FOREIGN[stat.S_IFMT(status.st_mode)])
    number = f'{os.major(status.st_rdev)}:{os.minor(status.st_rdev)}'
    known = root / 'sys/dev/char' / number          # but for ptys, which sysfs does not list
    if known.exists() and (known / 'subsystem').resolve().name != 'tty':
        return _not_a_port('a device, but not a serial port')
    name = tty_of(path)
    if _SCREENS.fullmatch(name):
        return _not_a_port('a text console, not a serial port')
    if file_text(root / 'sys/class/tty' / name / 'type').strip() == '0':     # PORT_UNKNOWN
        return Reason('absent', 'this name has no UART',
                      f'enable it in the firmware, or set another port; {ports_here()}')
    return None


def _not_a_port(what: str) -> Reason:
    return Reason('not_a_port', what, f'give the port itself; {ports_here()}')


def _permission(path: str, root: Path) -> Reason:
    import grp  # Windows has none, and no use for what follows
    import pwd

    user = _name(pwd.getpwuid, os.geteuid())
    try:
        status = os.stat(path)
        group, _, _, members = grp.getgrgid(status.st_gid)
    except (OSError, KeyError):
        return Reason('permission', f'user {user} may not open it', 'check its owner and mode')
    if os.major(status.st_rdev) in PTYS:
        owner = _name(pwd.getpwuid, status.st_uid)
        return Reason('permission', f'a pty of user {owner}, and you are {user}',
                      'run both ends as one user')
    if group == 'tty':              # no rule of udev gives a port to it, a getty does
        return _left_by_login(path, root)
    mine = sorted(_name(grp.getgrgid, number) for number in os.getgroups())
    reason = (f'user {user} (groups {", ".join(mine) or "none"}) may not open it: it belongs to '
              f'group {group}, mode {stat.filemode(status.st_mode)}')
    if user in members and group not in mine:
        return Reason('permission', reason, f'{user} joined {group} after this session began: '
                      'log in again')
    if group in mine or group == 'root':
        return Reason('permission', reason, f'sudo chmod g+rw {path}, or a udev rule that does it')
    return Reason('permission', reason,
                  f'sudo usermod -aG {group} {user}, then log in again (a service: Group={group})')


def _left_by_login(path: str, root: Path) -> Reason:
    """Return what helps where a getty has taken the port from its group, as agetty(8) does."""
    for who in holders(path, root):
        if who.is_login:
            return _login(who.name, path)
    return Reason('permission', 'a login on this port took it away from its group',
                  f'{_end_login(path)} gives it back')


def _login(who: str, path: str) -> Reason:
    return Reason('console', f'{who} offers a login here', _end_login(path))


def _end_login(path: str) -> str:
    device = os.path.realpath(path)
    return (f'sudo systemctl disable --now serial-getty@{os.path.basename(device)}; '
            f'sudo udevadm trigger --action=add {device}')


def busy(path: str) -> Reason:
    """Return who has a port that one cannot use, and what helps."""
    who = holders(path)
    if who:
        in_the_way = [one for one in who if not one.is_maker] or who
        programs = [one for one in in_the_way if not one.name.startswith(DEADMAN)]
        names = ', '.join(one.name for one in programs or in_the_way)
        return Reason('busy', f'in use by {names}', 'stop that program' if programs else
                      'it stops the rover of a bridge that ended or froze, and leaves by '
                      'itself')
    return Reason('busy', 'in use by another process',
                  f'stop that program; sudo fuser -v {path} names it')


def _name(find: Callable[[int], Sequence[Any]], number: int) -> str:
    """Return the name of a user or a group."""
    try:
        return str(find(number)[0])
    except KeyError:                # a container with a user of its own
        return str(number)


def _kernel_consoles(root: Path) -> set[str]:
    """Names of the ttys that the kernel writes to."""
    names = {line.split()[0] for line in file_text(root / 'proc/consoles').splitlines() if line}
    names |= set(re.findall(r'console=(\w+)', file_text(root / 'proc/cmdline')))
    if 'serial0' in names:
        names.add(tty_of(root / 'dev/serial0'))
    return names
