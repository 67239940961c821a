# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""What a user is told of a port that cannot be used: as root, of group dialout, as a stranger."""

import pytest

from rigs.drivers.guest import INSIDE

TTY = 'ttyS1'
GETTY = f'serial-getty@{TTY}'
USERS = ('root', 'robot', 'stranger')


def look(guest, port, user, *options):
    """Return what the nodes would say of a port, as this user."""
    done = guest.run(f'python {INSIDE}/look.py {port} {" ".join(options)}', user, check=False)
    assert done.err == ''
    return done.out


@pytest.fixture
def getty(guest):
    """Offer a login at the 16550, as Debian does where `console=` names a port."""
    guest.run(f'systemctl start {GETTY}')
    guest.wait(f'pgrep -t {TTY} agetty')
    yield
    guest.run(f'systemctl stop {GETTY}; udevadm trigger --action=add --settle /dev/{TTY}')


@pytest.mark.parametrize('user', USERS)
def test_a_login_that_systemd_started_is_seen(guest, getty, user):
    assert 'agetty' in guest.run(f'pgrep -a -t {TTY}').out
    assert f'/dev/{TTY}' not in guest.run(f'pgrep -a -t {TTY}').out, 'its arguments tell nothing'
    told = look(guest, f'/dev/{TTY}', user, '115200', '--closed')
    assert 'agetty (pid' in told
    assert f'systemctl disable --now {GETTY}' in told


def test_a_port_that_a_login_left_comes_back_with_the_remedy_that_is_told(guest, getty):
    guest.run(f'systemctl stop {GETTY}')
    assert guest.run(f'stat -c %G /dev/{TTY}').out == 'tty\n'
    told = look(guest, f'/dev/{TTY}', 'robot')
    assert 'usermod' not in told
    remedy = told.partition('; ')[2].partition(' gives it back')[0]
    guest.run(f'{remedy} && udevadm settle', 'robot')
    assert look(guest, f'/dev/{TTY}', 'robot') == 'open\n'


@pytest.mark.parametrize('user', USERS)
@pytest.mark.parametrize(('path', 'words'), [
    ('/etc/passwd', 'a file; give the port itself'),
    ('/etc', 'a directory; give the port itself'),
    ('/dev/vda', 'a disk; give the port itself'),
    ('/dev/ttyS2', 'this name has no UART'),
    ('/dev/ttyS9', 'is not there; plug it in or set another port'),
])
def test_what_is_no_port_is_told_as_what_it_is(guest, path, words, user):
    told = look(guest, path, user)
    assert f'{path}: {words}' in told
    assert 'sudo' not in told


def test_the_kernels_console_is_told(guest):
    assert 'the kernel writes its console here' in look(
        guest, '/dev/ttyS0', 'robot', '115200', '--closed')


def test_a_stranger_is_told_the_group_and_how_to_join_it(guest):
    told = look(guest, f'/dev/{TTY}', 'stranger')
    assert 'it belongs to group dialout' in told
    assert 'sudo usermod -aG dialout stranger' in told


def test_who_holds_a_port_is_told(guest):
    holder = guest.start('holder', f'python -c "import serial, time; '
                         f"port = serial.Serial('/dev/{TTY}', exclusive=True); "
                         'print(\'held\', flush=True); time.sleep(600)"', 'robot')
    holder.wait_for('held')
    assert 'in use by python (pid' in look(guest, f'/dev/{TTY}', 'robot')
    holder.stop()
    assert look(guest, f'/dev/{TTY}', 'robot') == 'open\n'
