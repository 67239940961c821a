# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""Rules of the doctor about Feetech servos: found where they are true, and only there."""

from dxl_monitor.bus.decoder import Settings
from dxl_monitor.bus.expected import Expected
from dxl_monitor.model.models import Models
from dxl_monitor.monitor import Monitor
from msg_defs.dxl1_packet import encode

MODELS = Models()
MS = 1_000_000
S = 1_000 * MS


class Bus:
    """Three STS3215; each instruction and its answer are chunks of their own."""

    def __init__(self):
        self.monitor = Monitor('arm', MODELS, Settings(
            baud=1_000_000, protocol='feetech',
            devices=tuple(Expected(number, 'STS3215') for number in (1, 2, 3))))
        self.now = 100 * S

    def ask(self, number, code, params=b'', answer=b''):
        for packet in (encode(number, code, params), encode(number, 0, answer)):
            self.now += MS
            self.monitor.feed(packet, self.now)

    def poll(self, seconds):
        """Read positions for a while."""
        for _ in range(round(20 * seconds)):
            for number in (1, 2, 3):
                self.ask(number, 2, b'\x38\2', b'\0\x08')
            self.now += 44 * MS
            if _ % 20 == 0:
                self.monitor.report(self.now)

    def findings(self):
        return {one.rule: (one.device, one.message)
                for one in self.monitor.report(self.now).findings}


def test_nothing_is_said_of_a_well_arm():
    bus = Bus()
    for number in (1, 2, 3):
        bus.ask(number, 2, b'\0\2', b'\3\x0a')
        bus.ask(number, 3, b'\x37\0')                  # unlock, limit, calibrate, lock
        bus.ask(number, 3, b'\x09\0\0')
        bus.ask(number, 3, b'\x06\0')                  # 1 MBd in every table
        bus.ask(number, 0x0B)
        bus.ask(number, 3, b'\x37\1')
    bus.poll(2)
    assert not {'baud_code', 'lock', 'calibrated_twice', 'mixed_firmware'} & bus.findings().keys()


def test_writes_to_a_locked_eeprom():
    bus = Bus()
    bus.ask(1, 2, b'\x37\1', b'\1')
    bus.poll(1)
    bus.ask(1, 3, b'\x09\0\0')
    bus.ask(2, 2, b'\x37\1', b'\0')                 # this one is open
    bus.ask(2, 3, b'\x09\0\0')
    bus.ask(2, 3, b'\x37\1')
    device, message = bus.findings()['lock']
    assert device == 1
    assert 'write 0 to Lock before it' in message


def test_a_middle_that_is_set_twice():
    bus = Bus()
    bus.ask(3, 3, b'\x28\x80')
    bus.ask(3, 3, b'\x28\1')
    assert 'calibrated_twice' not in bus.findings()
    bus.ask(3, 3, b'\x28\x80')
    assert bus.findings()['calibrated_twice'][0] == 3


def test_a_dip_of_the_supply_is_not_another_voltage():
    bus = Bus()
    bus.ask(1, 2, b'\x0e\2', bytes((140, 40)))
    for tenths in (120, 80, 120, 80, 120):
        bus.ask(1, 2, b'\x3e\1', bytes([tenths]))
        bus.poll(1)
        assert 'wrong_supply' not in bus.findings()


def test_a_servo_with_the_other_byte_order():
    bus = Bus()
    bus.ask(1, 2, b'\2\1', b'\0')
    assert 'layout' not in bus.findings()
    bus.ask(2, 2, b'\2\1', b'\1')
    assert bus.findings()['layout'][0] == 2


def test_an_id_of_253_is_a_servo():
    bus = Bus()
    for _ in range(5):
        bus.ask(253, 2, b'\x38\2', b'\0\x08')
    report = bus.monitor.report(bus.now)
    assert {one.id: one.totals.answers for one in report.devices}[253] == 5
    assert 'impossible_id' not in bus.findings()


def test_an_answer_that_lost_its_first_byte_is_counted_and_not_believed():
    bus = Bus()
    bus.poll(1)
    for _ in range(6):
        bus.now += MS
        bus.monitor.feed(encode(2, 2, b'\x38\2'), bus.now)
        bus.now += MS
        bus.monitor.feed(encode(2, 0, b'\x11\x07')[1:], bus.now)
        bus.poll(0.1)
    device = {one.id: one for one in bus.monitor.report(bus.now).devices}[2]
    assert (device.totals.beheaded, device.totals.missed) == (6, 6)
    assert bus.findings()['turnaround'][0] == 2


def test_a_servo_that_is_calibrated_twice():
    bus = Bus()
    bus.ask(3, 0x0B)
    bus.ask(3, 0x0B)
    assert bus.findings()['calibrated_twice'][0] == 3


def test_different_firmware_in_one_arm():
    bus = Bus()
    for number, minor in ((1, b'\x0a'), (2, b'\x0a'), (3, b'\x09')):
        bus.ask(number, 2, b'\0\2', b'\3' + minor)
    device, message = bus.findings()['mixed_firmware']
    assert device is None
    assert 'STS3215 with different firmware, 3.9 in 003' in message
