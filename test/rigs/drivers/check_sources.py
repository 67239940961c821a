# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""A bus is heard without a second adapter while dynamixel-sdk drives it: usbmon and a tap."""
from __future__ import annotations

import json

import pytest

from rigs.drivers.adapters import Acm
from rigs.drivers.adapters import Ftdi
from rigs.drivers.adapters import KINDS
from rigs.drivers.guest import SOURCE
from rigs.drivers.image import VENV
from rigs.drivers.lead import bus_of

TAP = 'arm'
INSTALLER = f'python3 {SOURCE}/deploy/install.py --prefix {VENV}'
MASTER = """
import sys
import dynamixel_sdk as sdk
port = sdk.PortHandler(sys.argv[1])
assert port.setBaudRate(1000000)
port.setPacketTimeout = lambda *_: port.setPacketTimeoutMillis(5000)
packet = sdk.PacketHandler(2.0)
for servo in (1, 2, 3):
    assert packet.ping(port, servo)[0] == 321
    assert packet.read4ByteTxRx(port, servo, 132)[1] == 0
port.closePort()
"""
SAID = [part for servo in (1, 2, 3) for part in (
    ('out', 'Ping', servo), ('in', 'Status', servo),
    ('out', 'Read', servo), ('in', 'Status', servo))]


@pytest.fixture
def bus():
    with bus_of('1-3:MX-106', baud=1_000_000) as bus:
        bus.start()
        yield bus


def test_the_installer_lets_the_service_alone_read_usbmon_and_takes_that_back(guest, bus):
    monitors = 'stat -c "%U %G %a" /dev/usbmon1'
    with Ftdi(guest, bus.path, gather=False, serial='FTUSBMON') as adapter:
        guest.run(f'{INSTALLER} --bus {adapter.path} --usbmon --yes', 'robot', timeout_s=300)
        guest.run('systemctl stop dxl_monitor', timeout_s=200)          # ROS takes minutes here
        assert guest.run(monitors).out == 'root mecarover_usbmon 640\n'
        dump = 'dxl_dump usb:/dev/mecarover_dxl --seconds 1'
        assert 'belongs to root' in guest.run(dump, 'robot', check=False, timeout_s=200).err
        unit = guest.run('systemctl show -P SupplementaryGroups dxl_monitor').out.split()
        assert unit == ['dialout', 'mecarover_usbmon']
        groups = ' '.join(f'-p SupplementaryGroups={group}' for group in unit)
        guest.run(f'systemd-run -q --wait --pipe --uid=robot {groups} -E PATH=$PATH {dump}',
                  timeout_s=200)
        guest.run(f'{INSTALLER} --uninstall --yes', 'robot', timeout_s=300)
        assert guest.run(monitors).out == 'root root 600\n'
        assert guest.run('getent group mecarover_usbmon', check=False).code


@pytest.mark.parametrize('kind', (Ftdi, Acm), ids=lambda kind: kind.driver)
def test_usbmon_shows_every_packet_of_a_master_and_follows_its_adapter(guest, bus, kind,
                                                                       record_property):
    guest.run('modprobe -r usbmon', check=False)
    with kind(guest, bus.path, gather=False) as adapter:
        path = guest.run(f'readlink -f {adapter.path}').out.strip()
        refused = guest.run(f'dxl_dump usb:{path} --seconds 1', check=False)
        assert 'sudo modprobe usbmon' in refused.err
        guest.run('modprobe usbmon')
        refused = guest.run(f'dxl_dump usb:{path} --seconds 1', 'robot', check=False)
        assert 'belongs to root' in refused.err
        dump = guest.start('dump', f'dxl_dump usb:{path} --json --full')
        guest.wait('ls -l /proc/*/fd 2>/dev/null | grep -q usbmon')
        guest.run(f'python - {adapter.path}', 'robot', stdin=MASTER, timeout_s=300)
        guest.wait(f'[ $(journalctl -q -u {dump.name} -o cat | grep -c Status) -ge 6 ]')
        adapter.unplug()
        dump.wait_for(path, 'is not there')
        adapter.plug()
        dump.wait_for('the port is open again')
        guest.run(f'python - {adapter.path}', 'robot', stdin=MASTER, timeout_s=300)
        guest.wait(f'[ $(journalctl -q -u {dump.name} -o cat | grep -c Status) -ge 12 ]')
        dump.signal('INT')
        log = dump.log()
        dump.stop()
    record_property('figure', f'{both_sides(log, 2)} packets, both sides')


@pytest.mark.parametrize('by', ['tap', 'strace'])
@pytest.mark.parametrize('kind', KINDS, ids=lambda kind: kind.driver)
def test_a_tap_shows_every_packet_of_a_master_and_follows_it_to_its_next_start(guest, bus, kind,
                                                                               by,
                                                                               record_property):
    guest.run('sysctl -q kernel.yama.ptrace_scope=1')          # as Ubuntu has it
    dump = guest.start('dump', f'dxl_dump tap:{TAP} --json --full', 'robot')
    guest.wait(f'ls /tmp/mecarover_serial-*/{TAP}.*', timeout_s=200)
    with kind(guest, bus.path, gather=False) as adapter:
        for wanted in (6, 12):
            guest.run(f'dxl_tap {TAP} --by {by} -- python - {adapter.path}', 'robot', stdin=MASTER,
                      timeout_s=300)
            guest.wait(f'[ $(journalctl -q -u {dump.name} -o cat | grep -c Status) -ge {wanted} ]')
            adapter.unplug()
            adapter.plug()
    dump.signal('INT')
    log = dump.log()
    dump.stop()
    record_property('figure', f'{both_sides(log, 2)} packets, both sides')


def both_sides(log, times):
    """Hold that a dump shows what the master and the servos said; return how many packets."""
    packets = [json.loads(line) for line in log.splitlines() if line.startswith('{')]
    assert [(one['side'], one['instruction'], one['id']) for one in packets] == times * SAID
    return len(packets)
