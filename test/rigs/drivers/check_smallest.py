# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""The smallest checks: the guest boots, an adapter comes and goes, a node opens a port."""


def test_udev_names_an_ftdi_adapter_by_its_serial_number_until_it_is_pulled_out(guest):
    guest.plug('bus', serial='FT4TFSGE')
    guest.wait('ls /dev/serial/by-id/*FT4TFSGE*')
    assert 'ftdi_sio' in guest.run('readlink -f /sys/class/tty/ttyUSB0/device/driver').out
    guest.unplug('bus')
    guest.wait('! ls /dev/ttyUSB0')
