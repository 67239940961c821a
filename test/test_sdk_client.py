# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""
The official client drives the simulated devices while the monitor listens on the tap.

dynamixel-sdk is an oracle from outside: what the client is told is right for the device, and
what the monitor then knows is what the client was told, for every register touched.
"""

from harness import wait
from listened_bus import BAUD
from listened_bus import ListenedBus
from listened_bus import MODELS
from listened_bus import PATIENCE_MS
import pytest

from servobus.bus.decoder import Settings
from servobus.bus.expected_devices import parse_all

try:
    import dynamixel_sdk as sdk
except ImportError:
    sdk = None

pytestmark = [
    pytest.mark.realtime(bears=0.2),
    pytest.mark.skipif(sdk is None, reason='skipped: dynamixel-sdk is not installed')]

ENTRIES = ['1-3:XL430-W250', '4-5:XM540-W270', '6:MX-106', '101:BitFoot']
SERVOS = (1, 2, 3, 4, 5, 6)
FAST = (1, 2, 3, 4, 5)
ACCESS = 7
TORQUE, LED, GOAL_VELOCITY, GOAL, POSITION, VOLTAGE = 64, 65, 104, 116, 132, 144


class Bench(ListenedBus):
    """Simulated devices, the official client on the bus, a monitor on the tap."""

    def __init__(self):
        super().__init__(ENTRIES, Settings(BAUD, tuple(parse_all(ENTRIES))))
        self.port = sdk.PortHandler(self.bus.path)
        assert self.port.setBaudRate(BAUD)
        self.client = sdk.PacketHandler(2.0)

    def close(self):
        self.port.closePort()
        super().close()

    def read(self, number, address, size):
        data, result, error = self.client.readTxRx(self.port, number, address, size)
        assert result == sdk.COMM_SUCCESS
        return bytes(data), error

    def write(self, number, address, data):
        result, error = self.client.writeTxRx(self.port, number, address, len(data), list(data))
        assert result == sdk.COMM_SUCCESS
        return int(error)

    def wait_started(self, number):
        """Wait until a device that starts again answers: until then it hears nothing."""
        wait(lambda: self.client.ping(self.port, number)[1] == sdk.COMM_SUCCESS)

    def device(self, number):
        """Return what the monitor says once it has heard all that was on the bus."""
        tap = self.bus.tap
        wait(lambda: self.listener.bytes == tap.taken)
        return super().device(number)

    def known(self, number, address, size):
        """Return the bytes of a register as the monitor knows it, b'' if it does not."""
        device = self.device(number)
        for value in device.observed:
            field = value.field
            if field.at == address and field.size == size:
                return int(value.value.raw).to_bytes(
                    size, 'little', signed=field.type.startswith('i'))
        return b''


@pytest.fixture
def bench(monkeypatch):
    # The client waits 34 ms, and takes what is answered later for the answer to its next question.
    monkeypatch.setattr(sdk.port_handler, 'LATENCY_TIMER', PATIENCE_MS / 2)
    bench = Bench()
    yield bench
    bench.close()


def test_ping(bench):
    for number, model in ((1, 1060), (4, 1120), (6, 321), (101, 0xAFFE)):
        assert bench.client.ping(bench.port, number) == (model, sdk.COMM_SUCCESS, 0)
        device = bench.device(number)
        assert (device.model_number, device.state) == (model, 'connected')
    assert bench.client.ping(bench.port, 77)[1] == sdk.COMM_RX_TIMEOUT


def test_broadcast_ping(bench):
    found, result = bench.client.broadcastPing(bench.port)
    assert result == sdk.COMM_SUCCESS
    assert set(found) == {*SERVOS, 101}
    for number, (model, firmware) in found.items():
        device = bench.device(number)
        assert (device.model_number, device.firmware) == (model, firmware)


def test_read_every_register(bench):
    model = MODELS.by_name('XL430-W250')
    told = {}
    for field in model.fields:
        if field.at < 168:               # behind: indirect addresses
            data, error = bench.read(1, field.at, field.size)
            assert error == 0
            told[field.at, field.size] = data
    assert told[0, 2] == (1060).to_bytes(2, 'little')
    assert told[7, 1] == b'\x01'
    known = {place: bench.known(1, *place) for place in told}
    assert known == told


def test_write_is_obeyed_and_known(bench):
    goal = (3000).to_bytes(4, 'little')
    assert bench.write(4, TORQUE, b'\x01') == 0
    assert bench.write(4, GOAL, goal) == 0
    assert bench.known(4, GOAL, 4) == goal
    assert bench.read(4, POSITION, 4) == (goal, 0)
    assert bench.known(4, POSITION, 4) == goal


def test_refused_write_is_not_known(bench):
    assert bench.read(1, 9, 1) == (b'\x00', 0)
    assert bench.write(1, TORQUE, b'\x01') == 0
    assert bench.write(1, 9, b'\x07') == ACCESS      # EEPROM with torque on
    assert bench.known(1, 9, 1) == b'\x00'
    assert bench.device(1).last_error == 'Access'
    assert bench.read(1, 9, 1) == (b'\x00', 0)
    assert bench.device(1).last_error == ''


def test_registered_write_waits_for_action(bench):
    assert bench.read(1, LED, 1) == (b'\x00', 0)
    assert bench.client.regWriteTxRx(bench.port, 1, LED, 1, [1]) == (0, 0)
    assert bench.known(1, LED, 1) == b'\x00'
    assert bench.read(1, LED, 1) == (b'\x00', 0)
    assert bench.client.action(bench.port, 1) == sdk.COMM_SUCCESS
    wait(lambda: bench.known(1, LED, 1) == b'\x01')
    assert bench.read(1, LED, 1) == (b'\x01', 0)


def test_header_in_unstuffed_data(bench):
    # The Python SDK does not stuff what it sends, and it loses bytes of what it receives.
    data = b'\xff\xff\xfd\x00'
    assert bench.write(1, GOAL_VELOCITY, data) == 0
    assert bench.known(1, GOAL_VELOCITY, 4) == data
    assert bench.read(1, GOAL_VELOCITY, 4) == (data, 0)


def _group(bench, kind, *arguments):
    return getattr(sdk, kind)(bench.port, bench.client, *arguments)


@pytest.mark.parametrize(('method', 'ids'), [('txRxPacket', SERVOS), ('fastSyncRead', FAST)])
def test_sync_write_and_sync_read(bench, method, ids):
    for number in ids:
        assert bench.write(number, TORQUE, b'\x01') == 0
    writer = _group(bench, 'GroupSyncWrite', GOAL, 4)
    for number in ids:
        assert writer.addParam(number, (2000 + number).to_bytes(4, 'little'))
    assert writer.txPacket() == sdk.COMM_SUCCESS
    reader = _group(bench, 'GroupSyncRead', POSITION, 4)
    for number in ids:
        assert reader.addParam(number)
    assert getattr(reader, method)() == sdk.COMM_SUCCESS
    for number in ids:
        assert reader.getData(number, POSITION, 4) == 2000 + number
        assert bench.known(number, GOAL, 4) == (2000 + number).to_bytes(4, 'little')
        assert bench.known(number, POSITION, 4) == (2000 + number).to_bytes(4, 'little')


@pytest.mark.parametrize(('method', 'ids'), [('txRxPacket', SERVOS), ('fastBulkRead', FAST)])
def test_bulk_write_and_bulk_read(bench, method, ids):
    places = {number: (LED, 1) if number % 2 else (VOLTAGE, 2) for number in ids}
    writer = _group(bench, 'GroupBulkWrite')
    for number in ids:
        assert writer.addParam(number, LED, 1, [1])
    assert writer.txPacket() == sdk.COMM_SUCCESS
    reader = _group(bench, 'GroupBulkRead')
    for number, place in places.items():
        assert reader.addParam(number, *place)
    assert getattr(reader, method)() == sdk.COMM_SUCCESS
    for number, (address, size) in places.items():
        told = reader.getData(number, address, size)
        assert told == (1 if address == LED else 120)
        assert bench.known(number, address, size) == told.to_bytes(size, 'little')


def test_reboot(bench):
    assert bench.write(2, TORQUE, b'\x01') == 0
    assert bench.read(2, 20, 4)[1] == 0
    assert bench.known(2, TORQUE, 1) == b'\x01'
    assert bench.client.reboot(bench.port, 2)[0] == sdk.COMM_SUCCESS
    assert bench.known(2, TORQUE, 1) in (b'', b'\x00')
    bench.wait_started(2)
    assert bench.known(2, 20, 4) == bytes(4)         # EEPROM stays known
    assert bench.read(2, TORQUE, 1) == (b'\x00', 0)
    assert bench.known(2, TORQUE, 1) == b'\x00'


def test_factory_reset(bench):
    assert bench.read(3, 9, 1) == (b'\x00', 0)
    keep_id_and_baud = 0x02
    result, error = bench.client.factoryReset(bench.port, 3, keep_id_and_baud)
    assert (result, error) == (sdk.COMM_SUCCESS, 0)
    assert bench.known(3, 9, 1) == b''
    bench.wait_started(3)
    assert bench.read(3, 9, 1) == (b'\xfa', 0)       # Return Delay Time of the factory
    assert bench.known(3, 9, 1) == b'\xfa'


def test_new_id_is_followed(bench):
    assert bench.write(3, 7, b'\x21') == 0
    assert bench.read(0x21, 7, 1) == (b'\x21', 0)
    assert bench.known(0x21, 7, 1) == b'\x21'
    assert bench.device(0x21).model_name == 'XL430-W250'
