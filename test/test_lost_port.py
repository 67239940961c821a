# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""What a lost port is known by when it is back, and by whom it is claimed."""
import os
from pathlib import Path

import pytest
import yaml

from vel2d_bridge.claim import identity
from vel2d_bridge.claim import is_claimed
from vel2d_bridge.claim import PortClaim

PATH = '/dev/robot'
USB = {'idVendor': '0403', 'idProduct': '6001'}


def plug(root, socket, *, number=0, port='', **files):
    """Lay down what sysfs says of a serial adapter; return its device number."""
    adapter = root / f'devices/usb1/{socket}'
    place = adapter / f'{socket}:1.0/ttyUSB{number}'
    place.mkdir(parents=True)
    for name, text in files.items():
        (adapter / name).write_text(text + '\n')
    if port:
        (place / 'port_number').write_text(port)
    device = os.makedev(188, number)
    (root / f'188:{number}').mkdir()
    (root / f'188:{number}/device').symlink_to(place)
    return device


@pytest.mark.parametrize('first, second, same', yaml.safe_load(
    Path(__file__).with_name('adapters_again.yaml').read_text(encoding='utf-8')))
def test_an_adapter_is_known_by_serial_number_or_else_by_its_socket(
        tmp_path, first, second, same):
    known = [identity(plug(tmp_path / name, **{**USB, **where}), tmp_path / name)
             for name, where in (('before', first), ('after', second))]
    relative = [one.replace(str(tmp_path / name), '') for one, name in zip(
        known, ('before', 'after'), strict=True)]
    assert (relative[0] == relative[1]) is same


def test_a_uart_on_the_board_is_known_by_its_place(tmp_path):
    for number, place in ((64, 'serial0'), (65, 'serial1')):
        (tmp_path / place).mkdir()
        (tmp_path / f'204:{number}').mkdir()
        (tmp_path / f'204:{number}/device').symlink_to(tmp_path / place)
    first, second = (identity(os.makedev(204, number), tmp_path) for number in (64, 65))
    assert first != second
    assert first.endswith('serial0')


def test_a_pty_has_no_identity():
    ends = os.openpty()
    assert identity(os.fstat(ends[1]).st_rdev) == ''
    for fd in ends:
        os.close(fd)


def test_a_claim_lasts_until_it_is_dropped_and_one_s_own_is_none():
    ends = os.openpty()
    device = os.fstat(ends[1])
    claim, another = PortClaim(), PortClaim()
    assert not is_claimed(device, PATH, '')
    claim.claim_port(ends[1], PATH)
    claim.claim_port(ends[1], PATH)
    assert is_claimed(device, PATH, another.token)
    assert not is_claimed(device, PATH, claim.token)
    another.claim_port(ends[1], PATH)
    assert is_claimed(device, PATH, claim.token)
    assert not is_claimed(device, '/dev/another', claim.token)    # it got the number
    claim.drop()
    another.drop()
    assert not is_claimed(device, PATH, '')
    for fd in ends:
        os.close(fd)


def test_what_is_no_device_is_not_claimed():
    claim = PortClaim()
    with Path(__file__).open() as file:
        claim.claim_port(file.fileno(), __file__)
    assert claim._socket is None
