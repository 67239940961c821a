#!/usr/bin/env python3
# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""
Install udev rules, settings and services of mecarover_serial on a robot; undo with --uninstall.

Run it as the user who shall run the nodes, with ROS 2 and the workspace sourced (or the venv
active): that is how it finds them. It prints every command, asks, then runs them with sudo.
What is already as it should be is left alone, so are settings that somebody edited.
Standard library only.
"""
from __future__ import annotations

import argparse
from collections.abc import Iterator
from collections.abc import Sequence
import getpass
import grp
import os
from pathlib import Path
import re
import shlex
import shutil
import subprocess
import sys
import tempfile
from typing import NamedTuple

from device_names import BUS_LINK
from device_names import check_device
from device_names import device_unit
from device_names import InstallError
from device_names import MCU_LINK
from device_names import name_rules
from device_names import parse_bus
from installed import command
import usbmon

HERE = Path(__file__).resolve().parent
NAME = 'mecarover_serial'
RULES = Path('/etc/udev/rules.d/70-mecarover_serial.rules')
SETTINGS = Path('/etc') / NAME
LOGS = Path('/var/log') / NAME          # systemd makes it, LogsDirectory=
UNITS = Path('/etc/systemd/system')
GROUP = 'dialout'
STATE = Path('/var/lib') / NAME         # the same, StateDirectory=
LINKS_LIMIT = 40                        # on the way to a file, as in the kernel
HISTORY = Path('/var/lib/mecarover_dashboard')          # systemd makes it, StateDirectory=
SERVICES = {'vel2d_bridge': 'bridge', 'dxl_monitor': 'monitor', 'dxl_dashboard': ''}
# ... the unit and its settings file, '' where there is none


class Step(NamedTuple):
    """One command and why it is needed; `content` is shown by --dry-run."""

    why: str
    command: tuple[str, ...]
    content: str = ''


def main(arguments: Sequence[str] | None = None) -> int:
    options = _parser().parse_args(arguments)
    try:
        with tempfile.TemporaryDirectory() as staging:
            site = Site(options, Path(staging))
            steps = list(site.remove() if options.uninstall else site.install())
            return _carry_out(steps, options)
    except InstallError as error:
        print(f'install: {error}', file=sys.stderr)
        return 1
    except KeyboardInterrupt:
        print('\ninstall: ended before all was done; run it again')
        return 1
    except BrokenPipeError:                # who reads it has enough, as head
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return 1


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog='install.py', description=(__doc__ or '').split('\n\n')[0],
        epilog='example: deploy/install.py --mcu /dev/ttyAMA0 --bus /dev/ttyUSB0')
    add = parser.add_argument
    add('--mcu', metavar='DEVICE', help=f'the UART to the MCU; becomes {MCU_LINK}')
    add('--bus', metavar='[NAME=]DEVICE', action='append', default=[],
        help=f'an adapter that listens to a Dynamixel bus; becomes {BUS_LINK}[_NAME]. '
             'Repeat it for more buses')
    add('--dashboard', action='store_true',
        help='the web page at every boot, for this machine; DXL_DASHBOARD_OPTIONS in '
             f'{SETTINGS}/environment opens it to the network')
    add('--usbmon', action='store_true', help='listen through usbmon to what other programs '
        'exchange with the adapters of --bus, instead of opening them; only the service may read '
        'usbmon')
    add('--user', default=os.environ.get('SUDO_USER') or getpass.getuser(),
        help='user that runs the nodes (default %(default)s)')
    add('--prefix', type=Path, help='where the package is installed (default: found)')
    add('--setup', type=Path, help='the setup.bash to source first (default: found)')
    add('--yes', action='store_true', help='run the commands without asking')
    add('--dry-run', action='store_true', help='show commands and files, change nothing')
    add('--uninstall', action='store_true', help='undo')
    add('--root', type=Path, default=Path('/'),
        help='install below this folder and touch nothing else (for images and tests)')
    return parser


def _carry_out(steps: Sequence[Step], options: argparse.Namespace) -> int:
    if not steps:
        print('install: nothing to do')
        return 0
    for step in steps:
        print(f'# {step.why}\n{shlex.join(step.command)}')
        if options.dry_run and step.content:
            print(''.join(f'    | {line}\n' for line in step.content.splitlines()), end='')
    if options.dry_run:
        return 0
    if not (options.yes or _is_wanted()):
        print('install: nothing was changed')
        return 1
    for step in steps:
        done = subprocess.run(step.command, check=False)
        if done.returncode:
            raise InstallError(f'{shlex.join(step.command)}: failed with exit code '
                               f'{done.returncode}; correct the cause and run the installer '
                               'again, it continues from here')
    print('install: done')
    return 0


def _is_wanted() -> bool:
    try:
        return input('\nRun these commands? [y/N] ').strip().lower() == 'y'
    except EOFError:                       # no terminal, or Ctrl-D
        print()
        return False


class Site:
    """The machine to install on."""

    def __init__(self, options: argparse.Namespace, staging: Path) -> None:
        self._options = options
        self._root: Path = options.root.resolve()
        self._staging = staging
        self._is_live = self._root == Path('/')
        self._sudo = ('sudo',) if self._is_live and os.geteuid() != 0 else ()
        self._buses = [parse_bus(text) for text in options.bus]
        if options.mcu:
            check_device('--mcu', options.mcu)
        if not re.fullmatch(r'[A-Za-z0-9_][A-Za-z0-9_.-]*\$?', options.user):
            raise InstallError(f'--user {options.user!r}: not a name of a user; give e.g. robot')

    # Installing

    def install(self) -> Iterator[Step]:
        """Yield what is missing."""
        services = self._services()
        if not services:
            raise InstallError('nothing to install; give --mcu DEVICE, --bus DEVICE or '
                               '--dashboard')
        if self._options.user == 'root':
            print('note: the services will run as root; give --user NAME for another user')
        rules = list(self._file(RULES, self._rules(), 'udev rules'))
        yield from rules
        yield from self._settings(services)
        units = [step for service in services for step in self._file(
            UNITS / f'{service}.service', self._unit(service), f'service {service}')]
        yield from units
        monitor = list(self._usbmon()) if self._options.usbmon else []
        yield from monitor
        units += monitor
        if not self._is_live:
            return
        yield from self._join_group()
        if self._options.mcu:
            yield from self._end_login(os.path.basename(os.path.realpath(self._options.mcu)))
        if rules:
            yield self._run('let udev apply its rules', 'udevadm', 'control', '--reload')
            yield self._run('', 'udevadm', 'trigger', '--action=add', '--subsystem-match=tty',
                            '--subsystem-match=usb-serial', '--settle')
        if units:
            yield self._run('let systemd read the units', 'systemctl', 'daemon-reload')
        for service in services:
            if units or not _succeeds('systemctl', 'is-enabled', '--quiet', service):
                yield self._run(f'start {service} now and at every boot',
                                'systemctl', 'enable', service)
                yield self._run('', 'systemctl', 'restart', '--no-block', service)

    def _services(self) -> list[str]:
        wanted = {'vel2d_bridge': self._options.mcu, 'dxl_monitor': self._buses,
                  'dxl_dashboard': self._options.dashboard}
        return [service for service in SERVICES if wanted[service]]

    def _usbmon(self) -> Iterator[Step]:
        """Yield what lets the service, and no other user, read usbmon."""
        if not self._buses:
            raise InstallError('--usbmon: no adapter given; give --bus DEVICE')
        print(usbmon.NOTE)
        if self._is_live and not _has_group(usbmon.GROUP):
            yield self._run('make a group without members', 'groupadd', '--system', usbmon.GROUP)
        files = [step for path, (why, content) in usbmon.FILES.items()
                 for step in self._file(path, content, why)]
        yield from files
        if self._is_live and (files or not Path('/dev/usbmon0').exists()):
            yield self._run('load usbmon now', 'modprobe', 'usbmon')
            yield self._run('', 'udevadm', 'control', '--reload')
            yield self._run('', 'udevadm', 'trigger', '--subsystem-match=usbmon', '--settle')

    def _rules(self) -> str:
        mcu = [(self._options.mcu, MCU_LINK)] if self._options.mcu else []
        lines = name_rules([*mcu, *self._buses], self._is_live)
        text = (HERE / RULES.name).read_text()
        return text.replace('#@NAMES@\n', ''.join(line + '\n' for line in lines))

    def _settings(self, services: Sequence[str]) -> Iterator[Step]:
        ports = [f'usb:{link}' if self._options.usbmon else link for _, link in self._buses]
        changes = {'vel2d_bridge': {'port': MCU_LINK},
                   'dxl_monitor': {'ports': '[' + ', '.join(map(repr, ports)) + ']'}}
        if self._options.usbmon:                # usbmon shows the rate
            changes['dxl_monitor']['bauds'] = '[0]'
        yield from self._file(SETTINGS / 'environment', (HERE / 'environment').read_text(),
                              'environment of the services', keep=True)
        for service in filter(SERVICES.get, services):
            name = f'{SERVICES[service]}.yaml'
            text = _template(name)
            for key, value in changes[service].items():
                text, count = re.subn(rf'^(\s+{key}:\s).*$', rf'\g<1>{value}', text, flags=re.M)
                if count != 1:
                    raise InstallError(f'{name}: needs exactly one line with {key}; restore the '
                                       'original file')
            yield from self._file(SETTINGS / name, text, f'settings of {service}', keep=True)

    def _unit(self, service: str) -> str:
        links = {'vel2d_bridge': [MCU_LINK],
                 'dxl_monitor': [link for _, link in self._buses]}.get(service, [])
        values = {
            'USER': self._options.user,
            'COMMAND': command(service, self._options.prefix, self._options.setup),
            'DEVICES': ' '.join(device_unit(link) for link in links),
            'DOCS': str(HERE.parent / 'docs'),
        }
        text = (HERE / f'{service}.service').read_text()
        head, _, body = text.partition('\n[Unit]')
        return head.partition('deploy/install.py')[0] + 'Made by deploy/install.py.\n[Unit]' \
            + re.sub('@([A-Z]+)@', lambda match: values[match[1]], body)

    def _join_group(self) -> Iterator[Step]:
        try:
            members = grp.getgrnam(GROUP).gr_mem
        except KeyError:
            raise InstallError(f'group {GROUP}: not there; sudo groupadd {GROUP}') from None
        if self._options.user not in ('root', *members):
            yield self._run(f'{self._options.user} may open serial ports (after the next login)',
                            'usermod', '-aG', GROUP, self._options.user)

    def _end_login(self, tty: str) -> Iterator[Step]:
        getty = f'serial-getty@{tty}.service'
        if _succeeds('systemctl', 'is-active', '--quiet', getty):
            yield self._run(f'stop the login on {tty}: its text would go to the MCU',
                            'systemctl', 'disable', '--now', getty)
            yield self._run('give the port back to its group: a login leaves it to root',
                            'udevadm', 'trigger', '--action=add', '--settle', f'/dev/{tty}')
        if f'console={tty}' in _read('/proc/cmdline'):
            print(f'note: the kernel writes its console to {tty}; remove console={tty} from '
                  'the kernel command line and reboot (docs/wiring.md)')

    # Removing

    def remove(self) -> Iterator[Step]:
        """Yield what undoes an installation; settings that somebody edited stay."""
        units = [UNITS / f'{service}.service' for service in SERVICES]
        present = [unit for unit in units if os.path.lexists(self._at(unit))]
        if present and self._is_live:
            yield self._run('stop the services', 'systemctl', 'disable', '--now',
                            *(unit.stem for unit in present))
        if self._is_live:
            self._tell_what_stays()
        for path in (*present, RULES, *usbmon.FILES):
            yield from self._delete(path)
        folder = self._at(usbmon.DROP_IN.parent)
        if folder.is_dir() and not {*os.listdir(folder)} - {usbmon.DROP_IN.name}:
            yield self._run(f'remove {folder.name}, which is empty', 'rmdir', str(folder))
        if self._is_live and _has_group(usbmon.GROUP):
            # udev leaves them as they are, and the number of the group may be another's next.
            nodes = sorted(map(str, Path('/dev').glob('usbmon*')))
            if nodes:
                yield self._run('let only root read usbmon again', 'chown', 'root:root', *nodes)
                yield self._run('', 'chmod', '600', *nodes)
            yield self._run('remove the group that may read usbmon', 'groupdel', usbmon.GROUP)
        if os.path.lexists(self._at(SETTINGS)):
            yield self._run('keep the settings under another name', 'mv', '--backup=numbered',
                            '-T', str(self._at(SETTINGS)), f'{self._at(SETTINGS)}.removed')
        if present and self._is_live:
            yield self._run('let systemd and udev read their files again',
                            'systemctl', 'daemon-reload')
            yield self._run('', 'udevadm', 'control', '--reload')
            yield self._run('', 'udevadm', 'trigger', '--action=add', '--subsystem-match=tty')

    def _tell_what_stays(self) -> None:
        """Print what is left as it is, and the command that undoes each."""
        if self._options.user in _members():
            print(f'note: {self._options.user} stays in group {GROUP}; '
                  f'sudo gpasswd -d {self._options.user} {GROUP} undoes that too')
        if LOGS.exists():
            print(f'note: the logs stay in {LOGS}; sudo rm -r {LOGS} removes them')
        if STATE.exists():
            print(f'note: {STATE} keeps whether the bridge is switched off; sudo rm -r {STATE} '
                  'removes it')
        if HISTORY.exists():
            print(f'note: the history stays in {HISTORY}; sudo rm -r {HISTORY} removes it')
        rules = _read(str(RULES))
        if rules:
            print('note: an FTDI adapter keeps its latency timer of 1 ms until it is plugged in '
                  'again')
        named = rf'KERNEL=="(\w+)", SYMLINK\+="{os.path.basename(MCU_LINK)}"'
        for tty in re.findall(named, rules):
            getty = f'serial-getty@{tty}.service'
            if not _succeeds('systemctl', 'is-active', '--quiet', getty):
                print(f'note: {tty} stays without a login; if it had one, '
                      f'sudo systemctl enable --now {getty}')

    def _delete(self, path: Path) -> Iterator[Step]:
        if os.path.lexists(self._at(path)):
            yield self._run(f'remove {path.name}', 'rm', str(self._at(path)))

    # Both

    def _at(self, path: Path) -> Path:
        """Return where `path` is below the root; links lead there as on the machine itself."""
        found, parts, links = self._root, list(path.parent.parts), 0
        while parts:
            part = parts.pop(0)
            if part in ('/', '..'):
                found = self._root if part == '/' or found == self._root else found.parent
            elif not (found / part).is_symlink():
                found /= part
            elif (links := links + 1) > LINKS_LIMIT:
                raise InstallError(f'{path}: too many links lead to it; correct them')
            else:
                parts = [*Path(os.readlink(found / part)).parts, *parts]
        return found / path.name

    def _file(self, path: Path, content: str, what: str, keep: bool = False) -> Iterator[Step]:
        """Yield the command that puts a file there; nothing when it is, or is to be kept."""
        target = self._at(path)
        is_there = os.path.lexists(target)
        if is_there and (keep or (not target.is_symlink() and target.read_text() == content)):
            return
        staged = self._staging / path.name
        staged.write_text(content)
        yield self._run(what, 'install', '-D', '-m', '644', str(staged), str(target),
                        content=content)

    def _run(self, why: str, *command: str, content: str = '') -> Step:
        return Step(why or 'and', (*self._sudo, *command), content)


def _template(name: str) -> str:
    """Return the settings file as it is shipped."""
    return (HERE.parent / 'config' / name).read_text()


def _members() -> list[str]:
    try:
        return grp.getgrnam(GROUP).gr_mem
    except KeyError:
        return []


def _has_group(name: str) -> bool:
    try:
        return bool(grp.getgrnam(name))
    except KeyError:
        return False


def _succeeds(*command: str) -> bool:
    return shutil.which(command[0]) is not None \
        and subprocess.run(command, capture_output=True, check=False).returncode == 0


def _read(path: str) -> str:
    try:
        return Path(path).read_text()
    except OSError:
        return ''


if __name__ == '__main__':
    sys.exit(main())
