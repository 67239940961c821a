# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""The simulated device and the line: what the protocol page says a device does, on paper time."""

import pytest

from mecarover_fakes.dxl1_servo import Servo1
from mecarover_fakes.fake_servo import FakeDevice
from mecarover_fakes.line import Line
from mecarover_fakes.registers import ACCESS
from mecarover_fakes.registers import LENGTH
from mecarover_fakes.registers import LIMIT
from mecarover_fakes.registers import OK
from mecarover_fakes.registers import RANGE
from mecarover_fakes.registers import RESULT_FAIL
from mecarover_fakes.traffic import words
from mecarover_fakes.values import Sine
from msg_defs.dxl_instruction import Instruction
from msg_defs.dxl_packet import BROADCAST
from servobus.model.control_table import UNKNOWN
from servobus.model.models import Models

MODELS = Models()
BAUD = 1_000_000
S = 1_000_000_000
TORQUE, LED, GOAL, POSITION = 64, 65, 116, 132


def make(number=1, name='XM430-W350', *, motion=None, return_delay=0, firmware=0):
    device = FakeDevice(number, MODELS.by_name(name), baud=BAUD, motion=motion)
    device.set('Return Delay Time', return_delay)
    device.firmware = firmware or device.firmware
    return device


def write(device, address, data):
    return device.execute(Instruction.WRITE, words(address) + data, 0).error


@pytest.mark.parametrize('number', MODELS.names())
def test_every_model_answers_for_all_its_registers_and_moves(number):
    model = MODELS.get(number)
    device = FakeDevice(1, model, motion=Sine(amplitude=0.5))
    device.set('Torque Enable', 1)
    for field in model.fields:
        reply = device.read(field.at, field.size, S)
        assert reply.error == OK
        assert len(reply.params) == field.size
    position = model.by_name.get('Present Position')
    if position is not None and position.scale:
        raw = device.read(position.at, position.size, S).params
        number_read = position.decode(raw).number
        assert number_read == pytest.approx(Sine(amplitude=0.5).angle(1.0), abs=position.scale)
    if model.protocol == '2':            # a Ping of the 1.0 family is answered without a number
        assert device.execute(Instruction.PING, b'', 0).params[:2] == number.to_bytes(2, 'little')


def test_unknown_model_is_bare_memory():
    device = FakeDevice(1, UNKNOWN)
    assert write(device, 100, b'\x01\x02') == OK
    assert device.read(100, 2, 0).params == b'\x01\x02'


def test_refused_accesses():
    device = make()
    assert device.read(5000, 1, 0).error == ACCESS
    assert device.read(90 + 400, 1, 0).error == ACCESS          # a hole in the table
    assert write(device, POSITION, bytes(4)) == ACCESS          # read-only
    assert write(device, GOAL, bytes(2)) == LENGTH              # half a register
    assert write(device, TORQUE, b'\x02') == RANGE
    assert write(device, 7, b'\xfd') == RANGE                   # no ID
    assert write(device, TORQUE, b'\x01') == OK
    assert write(device, 9, b'\x00') == ACCESS                  # EEPROM with torque on


@pytest.mark.parametrize(('name', 'registers', 'goal', 'error', 'place'), [
    ('STS3215', {'Min Position Limit': 1200, 'Max Position Limit': 2800}, 3500, OK, 2800),
    ('STS3215', {'Min Position Limit': 1200, 'Max Position Limit': 2800}, 600, OK, 1200),
    ('STS3215', {'Min Position Limit': 1200, 'Max Position Limit': 2800}, 1300, OK, 1300),
    ('STS3215', {}, 0x9001, OK, 0),                             # -4097
    ('STS3215', {'Max Position Limit': 0}, 5000, OK, 5000),     # it counts turns
    ('STS3215', {'Torque Limit': 0}, 3000, OK, 2048),
    ('STS3215', {'Operating Mode': 1}, 3000, OK, 2048),
    ('AX-12A', {'CW Angle Limit': 200, 'CCW Angle Limit': 800}, 900, 2, 512),
    ('AX-12A', {'CW Angle Limit': 200, 'CCW Angle Limit': 800}, 800, OK, 800),
    ('XL430-W250', {'Torque Enable': 1}, 4096, LIMIT, 2048),
    ('XL430-W250', {'Torque Enable': 1}, 4095, OK, 4095),
    ('XL430-W250', {'Torque Enable': 1, 'Operating Mode': 4}, 5000, OK, 5000),
    ('XL430-W250', {'Torque Enable': 1, 'Operating Mode': 0}, 3000, OK, 2048),
    ('XL430-W250', {}, 3000, OK, 2048)])
def test_a_joint_goes_as_far_as_its_limits_and_its_torque_let_it(name, registers, goal, error,
                                                                 place):
    model = MODELS.by_name(name)
    device = (FakeDevice if model.protocol == '2' else Servo1)(1, model)
    for register, raw in registers.items():
        device.set(register, raw)
    field, seen = model.by_name['Goal Position'], model.by_name['Present Position']
    assert write(device, field.at, field.bytes_of(goal)) == error
    assert seen.code_of(device.read(seen.at, seen.size, 0).params) == place


def test_a_refused_write_changes_nothing():
    device = make()
    before = bytes(device.image)
    assert write(device, LED, b'\x01\x00\x00\x07') != OK        # runs into a later register
    assert bytes(device.image) == before


def test_indirect_data_is_the_register_it_points_at():
    device = make()
    assert write(device, 168, words(LED)) == OK
    assert write(device, 224, b'\x01') == OK
    assert device.image[LED] == 1
    assert device.read(224, 1, 0).params == b'\x01'


def test_latched_error_keeps_the_torque_off():
    device = make()
    device.latch(0x20, 0)
    write(device, TORQUE, b'\x01')
    assert not device.torque
    assert device.get('Hardware Error Status') == 0x20


@pytest.mark.parametrize(('option', 'number', 'baud'), [
    (b'\xff', 1, 57600), (b'\x01', 9, 57600), (b'\x02', 9, BAUD)])
def test_factory_reset(option, number, baud):
    device = make(9)
    assert device.execute(Instruction.FACTORY_RESET, option, 0).error == OK
    assert (device.id, device.get('ID'), device.baud) == (number, number, baud)
    assert device.get('Return Delay Time') == 250


def test_backup_and_restore():
    device = make()
    write(device, 20, b'\x07\x00\x00\x00')
    assert device.execute(Instruction.CONTROL_TABLE_BACKUP, b'\x02CTRL', 0).error == RESULT_FAIL
    assert device.execute(Instruction.CONTROL_TABLE_BACKUP, b'\x01CTRL', 0).error == OK
    write(device, 20, b'\x08\x00\x00\x00')
    assert device.execute(Instruction.CONTROL_TABLE_BACKUP, b'\x02CTRL', 0).error == OK
    assert device.image[20] == 7


def test_clear_needs_its_key_and_the_torque_off():
    device = make()
    assert device.execute(Instruction.CLEAR, b'\x01DXL"', 0).error == OK
    assert device.execute(Instruction.CLEAR, b'\x01', 0).error == RESULT_FAIL
    write(device, TORQUE, b'\x01')
    assert device.execute(Instruction.CLEAR, b'\x01DXL"', 0).error == RESULT_FAIL


# --- the line ------------------------------------------------------------------------------

def test_return_delay_and_wire_time():
    device = make(return_delay=250)
    exchange = Line([device], BAUD).exchange(1, Instruction.PING, b'', 1000)
    asked, answer = exchange.bursts
    assert (asked.start, asked.end) == (1000, 1000 + 10 * 10_000)
    assert (answer.start, answer.end) == (asked.end + 500_000, asked.end + 500_000 + 14 * 10_000)


def test_broadcasts_reach_all_and_only_ping_is_answered_in_order_of_ids():
    line = Line([make(7), make(3), make(5)], BAUD)
    assert not line.exchange(BROADCAST, Instruction.WRITE, words(LED) + b'\x01', 0).answers
    assert [device.image[LED] for device in line.chain] == [1, 1, 1]
    assert not line.exchange(BROADCAST, Instruction.READ, words(LED, 1), 0).answers
    exchange = line.exchange(BROADCAST, Instruction.PING, b'', 0)
    assert [answer.id for answer in exchange.answers] == [3, 5, 7]


def test_malformed_and_unknown_instructions_are_refused_by_the_device():
    line = Line([make()], BAUD)
    for code, params in ((Instruction.READ, b'\x00'), (0x77, b''), (Instruction.WRITE, b'\x41')):
        exchange = line.exchange(1, code, params, 0)
        assert exchange.answers[0].error & 0x7F in (2, LENGTH)
