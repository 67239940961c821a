# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""Stable names of serial adapters: what udev knows about them, the rule, the systemd unit."""
from __future__ import annotations

from collections import Counter
from collections.abc import Iterable
from collections.abc import Mapping
from collections.abc import Sequence
import os
import re
import subprocess

MCU_LINK = '/dev/mecarover_mcu'
BUS_LINK = '/dev/mecarover_dxl'
_IDENTITY = ('ID_VENDOR_ID', 'ID_MODEL_ID', 'ID_SERIAL_SHORT', 'ID_USB_INTERFACE_NUM')


class InstallError(Exception):
    """What keeps the installation from running: 'thing: reason; remedy'."""


def check_device(option: str, device: str) -> None:
    """Refuse what udev or systemd would read as more than the name of a device."""
    if not re.fullmatch(r'/dev/[\w/.:+,@=-]+', device, re.ASCII):
        raise InstallError(f'{option} {device!r}: not a device; give e.g. /dev/ttyUSB0')


def parse_bus(text: str) -> tuple[str, str]:
    """Return device and link of a --bus option."""
    name, _, device = text.rpartition('=')
    check_device('--bus', device)
    if name and not re.fullmatch('[A-Za-z0-9]+', name):
        raise InstallError(f'--bus {text}: a name has letters and digits only; change it')
    return device, BUS_LINK + (f'_{name}' if name else '')


def name_rules(links: Sequence[tuple[str, str]], is_here: bool = True) -> list[str]:
    """
    Return the rules that give each adapter its name; links: (device, name) of each.

    is_here: the devices are those of this machine, so its udev knows them.
    """
    if twice := _twice(os.path.realpath(device) if is_here else device for device, _ in links):
        raise InstallError(f'{twice}: given twice; each port has one reader')
    if twice := _twice(link for _, link in links):
        raise InstallError(f'--bus: two would be {twice}; give each its name, as '
                           '--bus left=/dev/ttyUSB0 --bus right=/dev/ttyUSB1')
    if not is_here:
        return [_rule_elsewhere(device, link) for device, link in links]
    facts = {device: _udev_facts(device) for device, _ in links}
    for device, of in facts.items():
        if of.get('SUBSYSTEM', 'tty') != 'tty':
            raise InstallError(f'{device}: not a serial port; give e.g. /dev/ttyUSB0')
    identities = Counter(_identity(one) for one in facts.values())
    return [_rule(device, facts[device], link, identities[_identity(facts[device])] == 1)
            for device, link in links]


def _twice(names: Iterable[str]) -> str:
    """Return the first name that is there twice, '' if none is."""
    return next((name for name, times in Counter(names).items() if times > 1), '')


def _rule_elsewhere(device: str, link: str) -> str:
    """Return the rule for an adapter of another machine: of its name alone."""
    name = device.removeprefix('/dev/')
    if name.startswith(('ttyUSB', 'ttyACM')):
        print(f'note: --root: udev of this machine is not asked, so {link} will be any adapter '
              f'that is called {name} there; give its /dev/serial/by-id/... name')
    # 60-serial.rules of udev has made by-id and by-path by then.
    return f'{"SYMLINK" if "/" in name else "KERNEL"}=="{name}", {_symlink(link)}'


def _symlink(link: str) -> str:
    return f'SYMLINK+="{os.path.basename(link)}", TAG+="systemd"'


def _identity(facts: Mapping[str, str]) -> tuple[str | None, ...]:
    return tuple(facts.get(key) for key in _IDENTITY)


def _rule(device: str, facts: Mapping[str, str], link: str, is_alone: bool) -> str:
    """Return the rule for one adapter, wherever it is plugged if no other looks the same."""
    symlink = _symlink(link)
    if facts.get('ID_BUS') != 'usb':
        return f'KERNEL=="{os.path.basename(os.path.realpath(device))}", {symlink}'
    keys: tuple[str, ...] = _IDENTITY
    if 'ID_SERIAL_SHORT' not in facts or not is_alone:
        why = 'no serial number' if 'ID_SERIAL_SHORT' not in facts \
            else f"the same serial number as another adapter, {facts['ID_SERIAL_SHORT']}"
        print(f'note: {device} has {why}: its name belongs to the USB socket, so do not move its '
              'plug')
        keys = ('ID_PATH',)
    return ', '.join([f'ENV{{{key}}}=="{facts[key]}"' for key in keys if key in facts] + [symlink])


def _udev_facts(device: str) -> dict[str, str]:
    try:
        done = subprocess.run(['udevadm', 'info', '--query=property', f'--name={device}'],
                              capture_output=True, text=True, check=True)
    except FileNotFoundError:
        return {}
    except subprocess.CalledProcessError:
        raise InstallError(
            f'{device}: udev does not know it; plug it in (a UART: enable it, docs/wiring.md), '
            'or give another device (ls /dev/serial/by-id)') from None
    return dict(line.split('=', 1) for line in done.stdout.splitlines() if '=' in line)


def device_unit(link: str) -> str:
    """Return the systemd unit of a device, escaped as systemd-escape --path does."""
    escaped = re.sub(r'[^A-Za-z0-9:_.]', lambda match: f'\\x{ord(match[0]):02x}', link[5:])
    return f'dev-{escaped}.device'
