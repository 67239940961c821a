# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""
Unchanged clients of Protocol 1.0 and Feetech drive the simulated servos, the monitor listens.

dynamixel-sdk (protocol 1.0), feetech-servo-sdk (what LeRobot uses) and rustypot are oracles from
outside: what they are told is right for the servo, and the monitor then knows what they know.
GroupBulkRead of dynamixel-sdk 4.1.0 ends in a TypeError with protocol 1.0: not used here.
"""

import time

from harness import wait
from listened_bus import BAUD
from listened_bus import ListenedBus
from listened_bus import PATIENCE_MS
import pytest

from servobus.bus.decoder import Settings

try:
    import dynamixel_sdk
    import scservo_sdk
except ImportError:
    dynamixel_sdk = scservo_sdk = None
try:
    import rustypot
except ImportError:
    rustypot = None

pytestmark = [
    pytest.mark.realtime(bears=0.2),
    pytest.mark.skipif(scservo_sdk is None or dynamixel_sdk is None,
                       reason='skipped: dynamixel-sdk or feetech-servo-sdk is not installed')]
needs_rustypot = pytest.mark.skipif(rustypot is None,
                                    reason='skipped: rustypot is not installed')

SO_101 = (1, 2, 3, 4, 5, 6)


class Bench(ListenedBus):
    """Simulated servos of one dialect on a bus, a monitor on the tap."""

    def __init__(self, dialect, *entries):
        super().__init__(entries, Settings(BAUD), dialect)

    def shown(self, number):
        device = self.device(number)
        return {} if device is None else {one.field.name: one.value.text
                                          for one in device.observed}

    def knows(self, number, **fields):
        """Wait until the monitor shows this of a servo; underscores stand for spaces."""
        want = {name.replace('_', ' '): value for name, value in fields.items()}
        wait(lambda: want.items() <= self.shown(number).items())


def sdk(module, version, bench):
    """Return the port and the packet handler of an SDK, patient with a slow machine."""
    port = module.PortHandler(bench.bus.path)
    assert port.setBaudRate(BAUD)
    port.setPacketTimeout = lambda size: port.setPacketTimeoutMillis(PATIENCE_MS)
    return port, module.PacketHandler(version)


@pytest.fixture
def so_101():
    bench = Bench('feetech', '1-6:STS3215')
    yield bench
    bench.close()


def test_feetech_sdk(so_101):
    port, client = sdk(scservo_sdk, 0, so_101)
    for number in SO_101:
        assert client.ping(port, number) == (777, 0, 0)
    assert client.write2ByteTxRx(port, 3, 42, 3072) == (0, 0)
    assert client.read1ByteTxRx(port, 3, 40) == (1, 0, 0)      # the goal switched it on
    assert client.read2ByteTxRx(port, 3, 56)[:2] == (3072, 0)
    assert client.read1ByteTxRx(port, 3, 62) == (120, 0, 0)
    so_101.devices[2].latch(0x20, 0)
    assert client.read2ByteTxRx(port, 3, 56)[2] == 0x20
    so_101.knows(3, Model_Number='777', Goal_Position='1.5708', Present_Position='1.5708',
                 Present_Input_Voltage='12', Torque_Enable='on',
                 Hardware_Error_Status='overload')
    port.closePort()
    found = so_101.report()
    assert {device.id: (device.model_name, device.totals.missed) for device in found.devices} \
        == dict.fromkeys(SO_101, ('STS3215', 0))
    assert (found.counters['CRC Errors'], found.counters['Noise Bytes']) == (0, 0)
    assert so_101.monitor.decoder.choice.dialect.name == 'Feetech'


def test_dynamixel_sdk_with_protocol_1():
    bench = Bench('dxl1', '1:AX-12A', '2:MX-28(1.0)', '7:RX-64')
    port, client = sdk(dynamixel_sdk, 1.0, bench)
    for number, model in ((1, 12), (2, 29), (7, 64)):
        assert client.ping(port, number) == (model, 0, 0)
    assert client.write2ByteTxRx(port, 1, 30, 768) == (0, 0)
    assert client.write2ByteTxRx(port, 1, 30, 5000) == (0, 0x08)           # range
    assert client.read2ByteTxRx(port, 1, 36)[:2] == (768, 0)
    assert client.regWriteTxRx(port, 2, 30, 2, [0, 12]) == (0, 0)
    assert client.action(port, 2) == 0
    assert client.read2ByteTxRx(port, 2, 36)[:2] == (3072, 0)
    assert client.write1ByteTxRx(port, 7, 16, 1) == (0, 0)
    assert client.write1ByteTxOnly(port, 7, 25, 1) == 0                    # without an answer now
    time.sleep(0.02)
    assert client.read1ByteTxRx(port, 7, 25)[:2] == (1, 0)
    bench.knows(1, Model_Number='12', Goal_Position='1.309', Present_Position='1.309')
    bench.knows(2, Present_Position='1.5708')
    bench.knows(7, LED='on')
    port.closePort()
    found = bench.report()
    assert [(one.model_name, one.totals.missed) for one in found.devices] == [
        ('AX-12A', 0), ('MX-28(1.0)', 0), ('RX-64', 0)]
    assert found.devices[0].errors == {(3, 30, 4): 1}
    assert bench.monitor.decoder.choice.dialect.name == 'Dynamixel 1.0'
    bench.close()


@needs_rustypot
def test_rustypot_with_feetech(so_101):
    client = rustypot.Sts3215PyController(so_101.bus.path, BAUD, 1.0)
    assert client.ping(4)
    client.write_goal_position(4, 0.5)
    assert client.read_present_position(4)[0] == pytest.approx(0.5, abs=0.002)
    client.sync_write_goal_position([1, 2], [0.25, -0.25])
    assert client.sync_read_present_position([1, 2]) == pytest.approx([0.25, -0.25], abs=0.002)
    assert client.read_present_voltage(4) == [120]
    assert client.read_model(4) == [777]
    del client
    so_101.knows(4, Present_Input_Voltage='12', Model_Number='777')
    assert so_101.shown(4)['Present Position'][:4] in ('0.49', '0.50')


@needs_rustypot
def test_rustypot_reads_a_big_endian_servo():
    bench = Bench('feetech', '9:SCS0009')
    client = rustypot.Scs0009PyController(bench.bus.path, BAUD, 1.0)
    client.write_goal_position(9, 0.7)
    assert client.read_present_position(9)[0] == pytest.approx(0.7, abs=0.006)
    assert client.read_model(9) == [0x0405]
    bench.knows(9, Model_Number='1029')
    assert bench.shown(9)['Goal Position'][:4] in ('0.69', '0.70', '0.71')
    del client
    bench.close()
