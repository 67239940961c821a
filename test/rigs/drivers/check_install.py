# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""
The installer and its services, with a real udev and systemd.

From its dry run, over an unplugging, kill -9 and a reboot, to what an uninstall leaves.
"""
from __future__ import annotations

import pytest

from rigs.drivers.adapters import Ftdi
from rigs.drivers.guest import INSIDE
from rigs.drivers.guest import SOURCE
from rigs.drivers.guest import Unit
from rigs.drivers.guest import WITHOUT_ROS
from rigs.drivers.image import VENV
from rigs.drivers.lead import bus_of
from rigs.drivers.lead import Lead
from rigs.drivers.lead import Mcu

TTY = 'ttyS1'
GETTY = f'serial-getty@{TTY}'
SERIAL = 'FT9INST'
INSTALLER = f'python3 {SOURCE}/deploy/install.py --prefix {VENV}'
SERVICES = ('vel2d_bridge', 'dxl_monitor', 'dxl_dashboard')
OPEN = {'vel2d_bridge': '/dev/mecarover_mcu: open', 'dxl_monitor': '/dev/mecarover_dxl: open'}
# Where the processor is emulated a node starts in a minute, and the dead man is slow, too.
PATIENCE = r'[Service]\nTimeoutStartSec=infinity\nTimeoutStopSec=60\nWatchdogSec=600\n'
START_S = 600.0
# Waits until the page knows the last device of the bus.
ON_PAGE = """
import time
import urllib.request
while True:
    try:
        page = urllib.request.urlopen('http://127.0.0.1:8420/metrics', timeout=60).read().decode()
    except OSError:
        page = ''
    if 'mecarover_device_level' in page and 'id="3"' in page:
        break
    time.sleep(2)
"""


@pytest.fixture(scope='module')
def bus(guest):
    """Plug an adapter in; three devices answer a master at its far end, once in a second."""
    with bus_of('1-3:MX-64', rate=1.0) as fake, Ftdi(
            guest, fake.path, gather=False, serial=SERIAL) as adapter:
        fake.start()
        yield adapter


@pytest.fixture(scope='module')
def mcu(guest):
    """Put an MCU at the far end of the UART."""
    mcu = Mcu()
    with mcu.running(), Lead(guest.uart, mcu.path, gather=True):
        yield mcu


@pytest.fixture(scope='module')
def wanted(guest, request):
    """Tell whether the services are to run."""
    return guest.has_kvm or bool(request.config.getoption('--services'))


@pytest.fixture(scope='module')
def installed(guest, bus, mcu, wanted):
    """Install as robot, where a login was on the UART; return what the installer said."""
    if not guest.has_kvm:
        for service in SERVICES:
            folder = f'/etc/systemd/system/{service}.service.d'
            guest.run(f"mkdir -p {folder} && printf '{PATIENCE}' > {folder}/patience.conf")
    guest.run(f'systemctl enable --now {GETTY}')
    options = f'--mcu /dev/{TTY} --bus {bus.path} --dashboard'
    dry = guest.run(f'{INSTALLER} {options} --dry-run', 'robot', timeout_s=200).out
    assert '    | User=robot' in dry
    assert guest.run('ls /etc/mecarover_serial', check=False).code
    # It starts the three services, each with a Python of its own.
    done = guest.run(f'{INSTALLER} {options} --yes', 'robot', timeout_s=START_S).out
    if not wanted:
        guest.run(f'systemctl stop {" ".join(SERVICES)}', timeout_s=200)
    return done


@pytest.fixture(scope='module')
def services(guest, installed, wanted):
    """Wait until what the installer started runs."""
    if not wanted:
        pytest.skip('without KVM the services start in minutes; --services runs this')
    wait_started(guest)


def wait_started(guest):
    """Wait until the ports are open and the page shows what the monitor hears."""
    for service, said in OPEN.items():
        Unit(guest, service).wait_for(said, timeout_s=START_S)
    guest.run('python3 -', stdin=ON_PAGE, timeout_s=START_S)


def test_the_installer_ends_a_login_and_gives_the_port_back_to_its_group(guest, installed):
    assert f'systemctl disable --now {GETTY}' in installed
    assert guest.run(f'systemctl is-active {GETTY}', check=False).code
    assert guest.run(f'stat -c %G /dev/{TTY}').out == 'dialout\n'


def test_the_names_of_the_ports_come_with_the_rules_and_with_each_plug(guest, installed, bus):
    assert guest.run('readlink -f /dev/mecarover_mcu').out == f'/dev/{TTY}\n'
    guest.wait('test -e /dev/mecarover_dxl')
    bus.unplug()
    guest.wait('! test -e /dev/mecarover_dxl')
    bus.plug()
    guest.wait('test -e /dev/mecarover_dxl')
    tty = guest.run('basename $(readlink -f /dev/mecarover_dxl)').out.strip()
    guest.wait(f'grep -qx 1 /sys/class/tty/{tty}/device/latency_timer')


def test_systemd_accepts_the_units_and_starts_them_at_boot(guest, installed):
    for unit in SERVICES:
        assert guest.run(f'systemctl is-enabled {unit}').out == 'enabled\n'
        guest.run(f'systemd-analyze verify --man=no /etc/systemd/system/{unit}.service')


def test_the_installer_starts_the_bridge_which_stops_the_rover_first(guest, services, mcu):
    guest.until(lambda: mcu.set_points)
    assert all(point.is_stop for point in mcu.set_points)


def test_the_installer_starts_the_page_which_shows_what_the_monitor_hears(guest, services):
    assert guest.run('stat -c %U /var/lib/mecarover_dashboard').out == 'robot\n'
    for service in SERVICES:
        assert guest.run(f'systemctl show -P ActiveState,SubState {service}').out.split() == [
            'active', 'running']


def test_the_monitors_service_outlives_its_adapter(guest, services, bus):
    monitor = Unit(guest, 'dxl_monitor')
    before = monitor.pid()
    bus.unplug()
    monitor.wait_for('/dev/mecarover_dxl', 'plug', timeout_s=START_S)
    bus.plug()
    monitor.wait_for(OPEN[monitor.name], times=2, timeout_s=START_S)
    assert monitor.pid() == before


def test_what_is_killed_systemd_starts_again_and_the_rover_stops_and_drives_on(guest, services,
                                                                               mcu):
    units = [Unit(guest, service) for service in SERVICES]
    before = [unit.pid() for unit in units]
    planner = guest.start('planner', f'env -u {WITHOUT_ROS} python {INSIDE}/commands.py', 'robot')
    guest.until(lambda: mcu.drives, START_S)
    for unit in units:
        unit.signal('KILL')
    guest.until(lambda: not mcu.drives)
    guest.until(lambda: mcu.drives, START_S)
    planner.stop()
    guest.until(lambda: not mcu.drives)
    Unit(guest, 'dxl_monitor').wait_for(OPEN['dxl_monitor'], times=3, timeout_s=START_S)
    guest.run('python3 -', stdin=ON_PAGE, timeout_s=START_S)
    for unit, pid in zip(units, before, strict=True):
        assert unit.pid() not in ('0', pid)
        assert guest.run(f'systemctl show -P NRestarts {unit.name}').out == '1\n'


def test_after_a_reboot_all_services_are_back(guest, services, mcu):
    known = len(mcu.set_points)
    guest.reboot()
    wait_started(guest)
    ended = len(mcu.set_points)
    guest.until(lambda: len(mcu.set_points) > ended)
    assert all(point.is_stop for point in mcu.set_points[known:])
    assert guest.run('readlink -f /dev/mecarover_mcu').out == f'/dev/{TTY}\n'
    assert guest.run(f'systemctl is-active {GETTY}', check=False).code


def test_an_uninstall_says_what_stays_and_its_commands_undo_that(guest, installed):
    said = guest.run(f'{INSTALLER} --uninstall --yes', 'robot', timeout_s=200).out
    assert 'latency timer' in said
    for service in SERVICES:
        assert guest.run(f'systemctl is-active {service}', check=False).code
    stays = [f'sudo rm -r /var/{name}' for name in (
        'log/mecarover_serial', 'lib/mecarover_serial', 'lib/mecarover_dashboard')]
    for command in (f'sudo systemctl enable --now {GETTY}', *stays):
        assert command in said
        guest.run(command, 'robot')
    assert 'sudo gpasswd -d robot dialout' in said
    assert guest.run(f'systemctl is-active {GETTY}.service').out == 'active\n'
    left = guest.run('find /etc /var/log /var/lib -path "*mecarover*"').out.splitlines()
    assert all(path.startswith('/etc/mecarover_serial.removed') for path in left), left
    guest.run('rm -rf ' + ' '.join(f'/etc/systemd/system/{one}.service.d' for one in SERVICES))
    guest.run(f'systemctl disable --now {GETTY}; udevadm trigger --action=add --settle /dev/{TTY}')
