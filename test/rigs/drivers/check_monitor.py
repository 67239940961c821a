# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""A bus is heard on adapters of its own: all of it, and the right one in each place."""
from __future__ import annotations

from contextlib import ExitStack
import json
import time

import pytest

from rigs.drivers.adapters import Acm
from rigs.drivers.adapters import Ftdi
from rigs.drivers.lead import bus_of

SECONDS = 10.0
CYCLES_PER_S = 25.0             # an emulated processor reads no full bus of this rate
FEW_CYCLES_PER_S = 2.0
SETTLE_S = 2.0                  # for what is on its way when the bus falls silent
START_S = 200.0


def listen(guest, port, *options):
    """Start dxl_dump on a port of the guest, as robot, and wait until it has it open."""
    dump = guest.start('dump', f'dxl_dump {port} {" ".join(options)}', 'robot')
    guest.wait(f'ls -l /proc/*/fd 2>/dev/null | grep -q "$(readlink -f {port})$"',
               timeout_s=START_S)
    return dump


@pytest.mark.parametrize('kind', (Ftdi, Acm), ids=lambda kind: kind.driver)
def test_every_byte_of_19_devices_at_2000000_baud_is_heard(guest, kind, record_property):
    with bus_of('1-19:MX-64', CYCLES_PER_S) as bus, kind(guest, bus.path, gather=False) as adapter:
        dump = listen(guest, adapter.path, '--summary')
        bus.start(SECONDS)
        while bus.is_running:
            time.sleep(SETTLE_S)
        time.sleep(SETTLE_S)
        dump.signal('INT')
        guest.until(lambda: not dump.is_active())
        [heard] = [json.loads(line) for line in dump.log().splitlines() if line.startswith('{')]
    sent = bus.totals()['bus']
    assert (sent['overrun'], sent['unheard']) == (0, 0)
    assert heard['bytes'] == sent['sent']
    assert [heard[name] for name in ('crc_errors', 'truncated', 'noise_bytes')] == [0, 0, 0]
    assert len(heard['missed']) == 19
    record_property('figure', f'{heard["bytes"]} bytes in {SECONDS:.0f} s')


def heard_ids(dump):
    """Return which devices answered, as this dump lists them."""
    packets = [json.loads(line) for line in dump.log().splitlines() if line.startswith('{')]
    return {one['id'] for one in packets if one['instruction'] == 'Status'}


def test_two_adapters_that_change_places_stay_the_bus_that_they_are(guest):
    with ExitStack() as stack:
        buses = [stack.enter_context(bus_of(devices, FEW_CYCLES_PER_S))
                 for devices in ('1-3:MX-64', '11-13:MX-64')]
        left, right = (stack.enter_context(Ftdi(guest, bus.path, gather=False, serial=serial))
                       for bus, serial in zip(buses, ('FTLEFT', 'FTRIGHT'), strict=True))
        dumps = [listen(guest, one.path, '--json') for one in (left, right)]
        for bus in buses:
            bus.start()
        for dump, wanted in zip(dumps, ({1, 2, 3}, {11, 12, 13}), strict=True):
            guest.until(lambda dump=dump, wanted=wanted: heard_ids(dump) == wanted)
        before = guest.run(f'readlink -f {left.path} {right.path}').out.split()
        left.unplug()
        right.unplug()
        right.plug()
        left.plug()
        assert guest.run(f'readlink -f {right.path} {left.path}').out.split() == before
        known = [len(dump.log()) for dump in dumps]
        for dump, length in zip(dumps, known, strict=True):
            dump.wait_for('the port is open again')
            guest.until(lambda dump=dump, length=length: len(dump.log()) > length + 2000)
        assert [heard_ids(dump) for dump in dumps] == [{1, 2, 3}, {11, 12, 13}]
        for dump in dumps:
            dump.stop()
