# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""What systemd hears from a node, and that nothing goes wrong where there is none."""
import os
import socket

import pytest

from mecarover_serial.systemd import Systemd


@pytest.mark.parametrize('is_abstract', [False, True])
def test_the_manager_hears_every_state(tmp_path, is_abstract):
    name = f'@mecarover_test_{os.getpid()}' if is_abstract else str(tmp_path / 'notify')
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as manager:
        manager.bind(name.replace('@', '\0'))
        systemd = Systemd({'NOTIFY_SOCKET': name})
        systemd.notify('READY=1')
        systemd.notify('WATCHDOG=1')
        systemd.notify('STOPPING=1')
        assert [manager.recv(100) for _ in range(3)] == [b'READY=1', b'WATCHDOG=1', b'STOPPING=1']
        systemd._socket.close()


def test_without_a_manager_nothing_happens(tmp_path):
    for environment in ({}, {'NOTIFY_SOCKET': str(tmp_path / 'not_there')}):
        systemd = Systemd(environment)
        systemd.notify('READY=1')
        systemd.notify('WATCHDOG=1')
        assert systemd.watchdog_s is None
        systemd._socket.close()


@pytest.mark.parametrize('environment, seconds', [
    ({'WATCHDOG_USEC': '10000000'}, 10.0),
    ({'WATCHDOG_USEC': '10000000', 'WATCHDOG_PID': str(os.getpid())}, 10.0),
    ({'WATCHDOG_USEC': '10000000', 'WATCHDOG_PID': '1'}, None),     # meant for our parent
    ({'WATCHDOG_USEC': '0'}, None),
    ({'WATCHDOG_USEC': 'soon'}, None),
    ({'WATCHDOG_USEC': '10²'}, None),
])
def test_the_watchdog_is_ours_only_if_it_is_meant_for_us(environment, seconds):
    assert Systemd(environment).watchdog_s == seconds
