# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""
An SO-101 as LeRobot drives it, in simulated time: the books of the fake are ours.

Sync Read of 2 bytes at 56 from six servos, Sync Write of 2 at 42, 60 times a second at 1 MBd. One
servo is unplugged for a while, one reports a voltage error, which makes its answers look like
instructions.
"""

from harness import later
import pytest

from mecarover_fakes.fake_bus import make_devices
from mecarover_fakes.fake_bus import make_line
from mecarover_fakes.line import MASTER
from mecarover_fakes.master import Master
from mecarover_fakes.traffic import Ask
from mecarover_fakes.traffic import none
from msg_defs.event import IN
from msg_defs.event import OUT
from msg_defs.event import UNKNOWN
from servobus.bus.decoder import Settings
from servobus.model.models import Models
from servobus.monitor import Monitor

MODELS = Models()
BAUD = 1_000_000
PERIOD_NS = 16_666_667
CYCLES = 900                       # a quarter of a minute; the whole one takes 4 times as long
START = 10**12
IDS = range(1, 7)
READ = Ask(0xFE, 0x82, bytes((56, 0, 2, 0, *IDS)), True)


def write(step):
    where = (2000 + step % 500).to_bytes(2, 'little')
    return Ask(0xFE, 0x83, bytes((42, 0, 2, 0)) + b''.join(
        bytes([one]) + where for one in IDS), True)


@pytest.mark.parametrize(('protocol', 'has_sides'), later([
    ('auto', False), ('auto', True), ('feetech', False), ('feetech', True)], 1))
def test_an_so_101_on_the_move(protocol, has_sides):
    devices = make_devices(['1-6:STS3215'], MODELS, BAUD, moving=False, dialect='feetech')
    master = Master(make_line(devices, BAUD, 'feetech', waits_in_line=False), none)
    monitor = Monitor('arm', MODELS, Settings(baud=BAUD, protocol=protocol))
    now = 0
    for step in range(CYCLES):
        devices[5].silent = 300 <= step < 400
        if step == 500:
            devices[1].latch(0x01, now)
        now = step * PERIOD_NS
        for ask in (READ, write(step)):
            bursts = master.respond(ask, now)
            for burst in bursts:
                side = (OUT if burst.sender == MASTER else IN) if has_sides else UNKNOWN
                stamp = burst.start if side == OUT else burst.end
                monitor.feed(burst.data, START + stamp, side)
            now = bursts[-1].end + 400_000
    report = monitor.report(START + now + 2_000_000_000)
    truth = master.truth
    assert report.counters['Noise Bytes'] == report.counters['CRC Errors'] == 0
    assert report.counters['Pending Bytes'] == 0
    assert report.counters['Instructions'] == 2 * CYCLES
    assert report.counters['Packets'] == 8 * CYCLES - 100
    assert 'undecided packet' not in report.kinds
    for device in report.devices:
        mine = truth.known[device.id]
        assert (device.totals.answers, device.totals.missed) == (
            mine.answered, mine.missed), device.id
        assert device.totals.writes == CYCLES
    assert [device.totals.missed for device in report.devices] == [0, 0, 0, 0, 0, 100]
    assert [device.alert for device in report.devices] == [
        False, True, False, False, False, False]
