# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""What serial_port.py and the monitor take for granted of a driver, asked of each driver."""
from __future__ import annotations

import json

import pytest

from rigs.drivers.adapters import Ftdi
from rigs.drivers.adapters import KINDS
from rigs.drivers.guest import INSIDE
from rigs.drivers.lead import Mcu

ANOTHER = 'set a rate that the adapter supports'


@pytest.mark.parametrize('kind', KINDS, ids=lambda kind: kind.driver)
def test_hupcl_exclusive_opening_pending_bytes_and_error_counters_are_as_the_nodes_assume(guest,
                                                                                          kind,
                                                                                          record_property):
    mcu = Mcu()
    with mcu.running(), kind(guest, mcu.path, gather=True) as adapter:
        facts = json.loads(guest.run(f'python {INSIDE}/facts.py {adapter.path}', 'robot').out)
    assert facts['hupcl'] is False
    assert facts['second'] == 'Device or resource busy'
    assert facts['pending after 1 s'] == 0
    assert facts['line errors'] == 0
    assert 'Bad file descriptor' in facts['read only']
    record_property('figure', f'TIOCOUTQ at most {facts["pending at most"]} of {facts["written"]}')


@pytest.fixture
def ftdi(guest):
    mcu = Mcu()
    with mcu.running(), Ftdi(guest, mcu.path, gather=False) as adapter:
        yield adapter


def test_a_user_of_dialout_sets_the_latency_timer_without_a_udev_rule(guest, ftdi):
    timer = f'/sys/class/tty/$(basename $(readlink -f {ftdi.path}))/device/latency_timer'
    guest.run(f'echo 16 > {timer}')         # as FTDI adapters come; QEMU's comes with 0
    guest.run(f'python {INSIDE}/facts.py {ftdi.path}', 'robot')
    assert guest.run(f'cat {timer}').out == '1\n'


@pytest.mark.parametrize(('baud', 'told'), [
    (3_000_000, 'open'),
    (4_000_000, f'the driver sets 9600 baud, not the 4000000 that was asked for; {ANOTHER}'),
], ids=('3000000', '4000000'))
def test_a_rate_is_taken_or_refused_without_guessing_a_ceiling(guest, ftdi, baud, told):
    said = guest.run(f'python {INSIDE}/look.py {ftdi.path} {baud}', 'robot', check=False).out
    assert said.removeprefix(f'{ftdi.path}: ') == told + '\n'
