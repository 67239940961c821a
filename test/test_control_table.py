# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""Raw -> shown, by hand from the e-Manual, over all families; and how numbers are written."""

import math
import random

import pytest

from dxl_monitor.bus.table import READ
from dxl_monitor.bus.table import size_of
from dxl_monitor.bus.table import Table
from dxl_monitor.model.control_table import Bits
from dxl_monitor.model.control_table import Field
from dxl_monitor.model.control_table import number_text
from dxl_monitor.model.control_table import Span
from dxl_monitor.model.control_table import STRUCTS
from dxl_monitor.model.models import Models

MODELS = Models()

# model, field, raw -> key and text as a person reads them. The number on the right is the sum
# as done on paper: X 2 pi / 4096 a step with zero at 2048, 0.229 rev/min = 0.02398 rad/s, ...
SPOTS = [
    ('MX-28', 'Present Load', -1000, 'Present Load (%)', '-100'),
    ('MX-28', 'Acceleration Limit', 100, 'Acceleration Limit (rad/s^2)', '37.451'),
    ('MX-64', 'Present Position', 3072, 'Present Position (rad)', '1.5708'),
    ('MX-64', 'Present Position', -2048, 'Present Position (rad)', '-6.28319'),
    ('MX-64', 'Baud Rate', 4, 'Baud Rate (bit/s)', '2000000'),
    ('MX-106', 'Present Current', 1000, 'Present Current (A)', '3.36'),
    ('MX-106', 'Goal Current', -1, 'Goal Current (A)', '-0.00336'),
    ('MX-106', 'Return Delay Time', 250, 'Return Delay Time (s)', '0.0005'),
    ('MX-106', 'Drive Mode', 3, 'Drive Mode',
     'reverse direction, follower of a dual joint, velocity-based profile'),
    ('XL430-W250', 'Present Position', 2048, 'Present Position (rad)', '0'),
    ('XL430-W250', 'Present Position', 0, 'Present Position (rad)', '-3.14159'),
    ('XL430-W250', 'Present Velocity', -100, 'Present Velocity (rad/s)', '-2.3981'),
    ('XL430-W250', 'Present Load', 250, 'Present Load (%)', '25'),
    ('XL430-W250', 'Present Input Voltage', 121, 'Present Input Voltage (V)', '12.1'),
    ('XL430-W250', 'Present Temperature', 43, 'Present Temperature (°C)', '43'),
    ('XL430-W250', 'Hardware Error Status', 0x24, 'Hardware Error Status',
     'overheating, overload'),
    ('XL430-W250', 'Shutdown', 52, 'Shutdown', 'overheating, electrical shock, overload'),
    ('XL430-W250', 'Operating Mode', 4, 'Operating Mode', 'extended position'),
    ('2XL430-W250', 'Moving Status', 0x31, 'Moving Status', 'in position, trapezoidal profile'),
    ('XC430-W150', 'Status Return Level', 1, 'Status Return Level', 'ping and read'),
    ('XM430-W350', 'Present Current', -372, 'Present Current (A)', '-1.00068'),
    ('XM430-W350', 'Goal PWM', -885, 'Goal PWM (%)', '-100.005'),
    ('XM430-W350', 'Bus Watchdog', 50, 'Bus Watchdog (s)', '1'),
    ('XM430-W350', 'Bus Watchdog', -1, 'Bus Watchdog (s)', 'tripped'),
    ('XM430-W350', 'Homing Offset', -1024, 'Homing Offset (rad)', '-1.5708'),
    ('XM430-W350', 'Secondary ID', 255, 'Secondary ID', 'none'),
    ('XH430-V350', 'Present Current', 500, 'Present Current (A)', '0.67'),
    ('XD540-T270', 'External Port Mode 3', 2, 'External Port Mode 3', 'input pulled up'),
    ('XW430-T200', 'Present Current', 100, 'Present Current (A)', '0.269'),
    ('XL330-M288', 'Present Current', -1500, 'Present Current (A)', '-1.5'),
    ('XL330-M288', 'PWM Slope', 140, 'PWM Slope (V/s)', '276.78'),
    ('XC330-T288', 'Hardware Error Status', 1, 'Hardware Error Status', 'input voltage'),
    ('XL-320', 'Present Position', 0, 'Present Position (rad)', '-2.61799'),
    ('XL-320', 'Present Position', 1023, 'Present Position (rad)', '2.61799'),
    ('XL-320', 'Present Load', 1024 + 300, 'Present Load (%)', '-30'),
    ('XL-320', 'Hardware Error Status', 5, 'Hardware Error Status', 'overload, input voltage'),
    ('XL-320', 'LED', 6, 'LED', 'cyan'),
    ('XL-320', 'Present Voltage', 74, 'Present Voltage (V)', '7.4'),
    ('PH54-200-S500', 'Present Position', 250962, 'Present Position (rad)', '1.5708'),
    ('PH54-200-S500', 'Present Velocity', -2900, 'Present Velocity (rad/s)', '-3.03687'),
    ('PH54-200-S500', 'Present Current', -9300, 'Present Current (A)', '-9.3'),
    ('PH54-200-S500', 'Baud Rate', 9, 'Baud Rate (bit/s)', '10500000'),
    ('PH54-200-S500', 'Shutdown', 58, 'Shutdown',
     'hall sensor, encoder, electrical shock, overload'),
    ('PM42-010-S260', 'Goal Position', -131594, 'Goal Position (rad)', '-1.5708'),
    ('H42-20-S300-R(A)', 'Present Position', 303750, 'Present Position (rad)', '3.14159'),
    ('H54-100-S500-R(A)', 'Goal PWM', 2009, 'Goal PWM (%)', '100.048'),
    ('RH-P12-RN(A)', 'Present Current', 820, 'Present Current (A)', '0.82'),
    ('RH-P12-RN(A)', 'Present Position', 740, 'Present Position (rad)', '1.13515'),
    ('YM070-210-R099', 'Error Code', 0x0B, 'Error Code', 'multi-turn position lost'),
    ('YM070-210-R099', 'Present Current', -1190, 'Present Current (A)', '-11.9'),
    ('YM080-230-M001', 'Controller State', 5, 'Controller State', 'running'),
    ('YM080-230-M001', 'Present Position', 131072, 'Present Position (rad)', '1.5708'),
    ('YM080-230-M001', 'Moving Status', 0x40, 'Moving Status', 'no profile'),
    ('YM080-230-M001', 'Moving Status', 0x05, 'Moving Status',
     'in position, moving, no profile, out of position limits'),
    ('OMY-HAT', 'Present Input Voltage', 2412, 'Present Input Voltage (V)', '24.12'),
    ('HX5-D20 Finger 1 Joint 1', 'Present Position', 1024, 'Present Position (rad)', '-1.5708'),
    ('FFW-SG2-DRIVE-1', 'Present Velocity', 100, 'Present Velocity (rad/s)', '0.10472'),
    ('FFW-SG2-STEER-1', 'Error Code', 18, 'Error Code', 'bus watchdog'),
    ('Rhoban DXL Board', 'VBAT', 855, 'VBAT (V)', '16.5322'),
    ('Rhoban DXL Board', 'Current', 512, 'Current (A)', '9.8485'),
    ('Rhoban DXL Board', 'Power On', 1023, 'Power On', 'yes'),
    ('Rhoban DXL Board', 'Power On', 500, 'Power On', '500'),
    ('Rhoban DXL Board', 'RGB LED 2', 0xFF8000, 'RGB LED 2', '0x00FF8000'),
    ('BitFoot', 'Back Left', 100000, 'Back Left', '100000'),
    ('Bit-Bots IMU', 'Gyro Z', -180.0, 'Gyro Z (rad/s)', '-3.14159'),
    ('Bit-Bots IMU', 'Gyro Range', 3, 'Gyro Range', '2000 deg/s'),
    ('Bit-Bots IMU', 'Orientation W', 0.7071067690849304, 'Orientation W', '0.707107'),
]


def named(name):
    return MODELS.by_name(name)


@pytest.mark.parametrize(('name', 'register', 'raw', 'key', 'text'), SPOTS)
def test_spot(name, register, raw, key, text):
    field = named(name).by_name[register]
    value = field.decode(STRUCTS[field.type].pack(raw))
    assert (field.key, value.text, value.raw) == (key, text, raw)


@pytest.mark.parametrize(('name', 'selector', 'code', 'register', 'raw', 'key', 'text'), [
    ('XL430-W250', 'Drive Mode', 0, 'Profile Velocity', 100, 'Profile Velocity (rad/s)', '2.3981'),
    ('XL430-W250', 'Drive Mode', 4, 'Profile Velocity', 100, 'Profile Velocity (s)', '0.1'),
    ('XL430-W250', 'Drive Mode', 5, 'Profile Acceleration', 50,
     'Profile Acceleration (s)', '0.05'),
    ('XL430-W250', None, 0, 'Profile Velocity', 100, 'Profile Velocity', '100'),
    ('XL-320', 'Control Mode', 2, 'Present Speed', 1324, 'Present Speed (rad/s)', '-3.4872'),
    ('XL-320', 'Control Mode', 1, 'Moving Speed', 512, 'Moving Speed (%)', '51.2'),
    ('XM540-W270', 'External Port Mode 2', 0, 'External Port Data 2', 4095,
     'External Port Data 2 (V)', '3.3'),
    ('XM540-W270', 'External Port Mode 2', 1, 'External Port Data 2', 1,
     'External Port Data 2', '1'),
    ('FFW-G10-RCU', 'Motor3 Drive Mode', 0, 'Motor3 Present Current', -250,
     'Motor3 Present Current (A)', '-2.5'),
])
def test_a_meaning_hangs_on_another_register(name, selector, code, register, raw, key, text):
    model, table = named(name), Table()
    table.limit = size_of(model)
    if selector:
        table.store(model.by_name[selector].at, bytes((code,)), 1, READ)
    field = model.by_name[register]
    table.store(field.at, STRUCTS[field.type].pack(raw), 1, READ)
    seen = table.observed_of(model, (register,), 1)[0]
    assert (seen.field.key, seen.value.text) == (key, text)


@pytest.mark.parametrize(('number', 'decimals', 'text'), [
    (0.1 + 0.2, 3, '0.3'), (-0.0, 3, '0'), (-0.0000001, 5, '0'), (1e-7, None, '0.0000001'),
    (123456789.0, None, '123457000'), (12.50, 3, '12.5'), (100, None, '100'),
    (2**32, None, '4294967296'),
    (1.570796, 5, '1.5708'), (3.0000001, 6, '3'), (0.00269, 5, '0.00269'),
    (-1e20, None, '-1' + 20 * '0'),
])
def test_a_number_is_short_and_bare(number, decimals, text):
    assert number_text(number, decimals) == text


@pytest.mark.parametrize('bad', [math.nan, math.inf, -math.inf])
def test_what_is_no_number_has_no_number(bad):
    value = Field(0, 'Force', 'f32').decode(STRUCTS['f32'].pack(bad))
    assert value.number is None
    assert value.text == str(bad)


def test_unknown_codes_and_bits_are_told():
    mode = Field(0, 'Mode', 'u8', enum={1: 'on'}, spans=(Span(5, 9, 'spare'),))
    flags = Field(0, 'Flags', 'u8', flags=(Bits(0, 1, ('', 'hot')), Bits(4, 3, ('', 'a'))))
    assert [mode.decode(bytes((code,))).text for code in (1, 2, 7)] == [
        'on', 'unknown (2)', 'spare']
    assert [flags.decode(bytes((code,))).text for code in (0, 1, 0x83, 0x30)] == [
        'none', 'hot', 'hot, bit 1, bit 7', 'bits 4+ = 3']


def test_the_text_says_the_number_within_the_resolution_of_the_register():
    generator = random.Random(4)
    for number in MODELS.names():
        model = MODELS.get(number)
        for field in model.fields:
            value = field.decode(generator.randbytes(field.size))
            if field.scale is not None and value.number is not None and not field.in_words:
                coarse = max(abs(field.scale), abs(value.number) * 1e-5)
                assert abs(float(value.text) - value.number) <= coarse / 2, field
                assert 'e' not in value.text


def test_decode_takes_the_fields_that_are_whole():
    model = named('MX-106')
    data = bytes(range(12))
    assert [field.name for field, _ in model.decode(126, data)] == [
        'Present Current', 'Present Velocity', 'Present Position']
    assert [field.name for field, _ in model.decode(127, data[:5])] == ['Present Velocity']
