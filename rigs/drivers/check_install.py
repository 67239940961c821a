# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""The installer from its dry run to what an uninstall leaves, with a real udev and systemd."""
from __future__ import annotations

from collections.abc import Iterator

import pytest

from rigs.drivers.adapters import Adapter
from rigs.drivers.adapters import Ftdi
from rigs.drivers.guest import Guest
from rigs.drivers.guest import SOURCE
from rigs.drivers.image import VENV
from rigs.drivers.lead import Mcu

TTY = 'ttyS1'
GETTY = f'serial-getty@{TTY}'
SERIAL = 'FT9INST'
INSTALLER = f'python3 {SOURCE}/deploy/install.py --prefix {VENV}'


@pytest.fixture(scope='module')
def bus(guest: Guest) -> Iterator[Adapter]:
    """Plug an adapter in; its far end is silent."""
    mcu = Mcu()
    with mcu.running(), Ftdi(guest, mcu.path, gather=False, serial=SERIAL) as adapter:
        yield adapter


@pytest.fixture(scope='module')
def installed(guest: Guest, bus: Adapter) -> str:
    """Install as robot, where a login was on the UART; return what the installer said."""
    guest.run(f'systemctl enable --now {GETTY}')
    options = f'--mcu /dev/{TTY} --bus {bus.path}'
    dry = guest.run(f'{INSTALLER} {options} --dry-run', 'robot', timeout_s=200).out
    assert '    | User=robot' in dry
    assert guest.run('ls /etc/mecarover_serial', check=False).code
    done = guest.run(f'{INSTALLER} {options} --yes', 'robot', timeout_s=300).out
    # Without a processor of its own the guest starts ROS in minutes: here it is not waited for.
    guest.run('systemctl stop vel2d_bridge dxl_monitor', timeout_s=200)
    return done


def test_the_installer_ends_a_login_and_gives_the_port_back_to_its_group(
        guest: Guest, installed: str) -> None:
    assert f'systemctl disable --now {GETTY}' in installed
    assert guest.run(f'systemctl is-active {GETTY}', check=False).code
    assert guest.run(f'stat -c %G /dev/{TTY}').out == 'dialout\n'


def test_the_names_of_the_ports_come_with_the_rules_and_with_each_plug(
        guest: Guest, installed: str, bus: Adapter) -> None:
    assert guest.run('readlink -f /dev/mecarover_mcu').out == f'/dev/{TTY}\n'
    guest.wait('test -e /dev/mecarover_dxl')
    bus.unplug()
    guest.wait('! test -e /dev/mecarover_dxl')
    bus.plug()
    guest.wait('test -e /dev/mecarover_dxl')
    tty = guest.run('basename $(readlink -f /dev/mecarover_dxl)').out.strip()
    guest.wait(f'grep -qx 1 /sys/class/tty/{tty}/device/latency_timer')


def test_systemd_accepts_the_units_and_starts_them_at_boot(guest: Guest, installed: str) -> None:
    for unit in ('vel2d_bridge', 'dxl_monitor'):
        assert guest.run(f'systemctl is-enabled {unit}').out == 'enabled\n'
        guest.run(f'systemd-analyze verify --man=no /etc/systemd/system/{unit}.service')


def test_an_uninstall_says_what_stays_and_its_commands_undo_that(
        guest: Guest, installed: str) -> None:
    guest.run('mkdir -p /var/log/mecarover_serial')
    said = guest.run(f'{INSTALLER} --uninstall --yes', 'robot', timeout_s=200).out
    assert 'latency timer' in said
    undo = [f'sudo systemctl enable --now {GETTY}', 'sudo rm -r /var/log/mecarover_serial',
            'sudo gpasswd -d robot dialout']
    for command in undo[:2]:
        assert command in said
        guest.run(command, 'robot')
    assert undo[2] in said
    assert guest.run(f'systemctl is-active {GETTY}.service').out == 'active\n'
    left = guest.run('find /etc /var/log -path "*mecarover*"').out.splitlines()
    assert all(path.startswith('/etc/mecarover_serial.removed') for path in left), left
    guest.run(f'systemctl disable --now {GETTY}; udevadm trigger --action=add --settle /dev/{TTY}')
