# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""
What the registers of a simulated device hold: from the factory, as configured, and in motion.

Values are in the units of the model files (rad, rad/s, A, V, °C) and become raw numbers through
each field's own scale, so any model with the usual register names moves.
"""

from __future__ import annotations

from collections.abc import Callable
import math
from pathlib import Path
from typing import NamedTuple

from servobus.model.checked_yaml import read_yaml
from servobus.model.control_table import Field
from servobus.model.control_table import Model
from servobus.model.control_table import STRUCTS

FACTORY = read_yaml(Path(__file__).with_name('factory.yaml'))
VOLTAGE = 12.0
TEMPERATURE = 38.0
TORQUE_PER_RAD_S = 0.4       # A at 1 rad/s: friction enough for a plausible current


class Sine(NamedTuple):
    """The swing of a joint: angle (rad) = amplitude * sin(2 pi t / period + phase)."""

    amplitude: float = 0.6
    period_s: float = 3.0
    phase: float = 0.0

    def angle(self, now_s: float) -> float:
        """Return the angle (rad) at a time."""
        return self.amplitude * math.sin(math.tau * now_s / self.period_s + self.phase)

    def velocity(self, now_s: float) -> float:
        """Return the velocity (rad/s) at a time."""
        rate = math.tau / self.period_s
        return self.amplitude * rate * math.cos(rate * now_s + self.phase)


class LiveState(NamedTuple):
    """What a device does at one moment, for its live registers."""

    now_s: float
    angle: float
    velocity: float
    voltage: float
    temperature: float
    up_s: float                  # since its last start
    id: int


Live = tuple[int, int, Callable[[LiveState], bytes]]


def pack(field: Field, value: float) -> bytes:
    """Return the bytes of a register for a value in its unit, limited to its range."""
    number = value if field.scale is None else (value - field.offset) / field.scale
    return pack_raw(field, number)


def pack_raw(field: Field, number: float) -> bytes:
    """Return the bytes of a register for a raw number, limited to its range."""
    if field.type[0] == 'f':
        return STRUCTS[field.type].pack(number)
    if field.sign_bit is not None and number < 0:      # direction and magnitude apart
        number = min(round(-number), (1 << field.sign_bit) - 1) | 1 << field.sign_bit
    signed = field.type[0] == 'i'
    end = 1 << 8 * field.size - signed
    return min(max(round(number), -end * signed), end - 1).to_bytes(
        field.size, field.byte_order, signed=signed)


# The second figure replaces a unit where the model file leaves the register raw.
_SERVO: dict[str, Callable[[LiveState], float]] = {
    'Present Position': lambda state: state.angle,
    'Present Velocity': lambda state: state.velocity,
    'Present Current': lambda state: TORQUE_PER_RAD_S * state.velocity,
    'Present Load': lambda state: 10 * state.velocity,
    'Present PWM': lambda state: 10 * state.velocity,
    'Present Input Voltage': lambda state: state.voltage,
    'Present Temperature': lambda state: state.temperature,
    'Realtime Tick': lambda state: state.up_s % 32.767,
    'Moving': lambda state: float(abs(state.velocity) > 0.05),
}
_RAW = {'Present Position': (2048, 651.9), 'Present Velocity': (0, 41.7),
        'Present Current': (0, 300.0), 'Realtime Tick': (0, 1000.0)}
_BY_UNIT: dict[str, Callable[[LiveState], float]] = {
    'V': lambda state: state.voltage,
    'A': lambda state: 0.8 + TORQUE_PER_RAD_S * abs(state.velocity),
    'm/s^2': lambda state: 9.81 * math.cos(state.angle),
    'rad/s': lambda state: state.velocity,
}
_LOGIC_VOLTAGE = 5.0             # on every board's VCC
_IDENTITY = ('Model', 'Firmware', 'Error', 'Information', 'Reserved', 'Status', 'Registered')


def live_registers(model: Model) -> list[Live]:
    """Return (begin, end, bytes of a state) for each register that moves by itself."""
    # By name, so that aliases count: XL-320 has its own names for some of them.
    find = _servo if 'Present Position' in model.by_name else _sensor
    return [(field.at, field.end, value) for name, field in model.by_name.items()
            if (value := find(name, field)) is not None]


def _servo(name: str, field: Field) -> Callable[[LiveState], bytes] | None:
    value = _SERVO.get(name)
    if value is not None and field.scale is None and name in _RAW:
        zero, per_unit = _RAW[name]
        return lambda state: pack_raw(field, zero + per_unit * value(state))
    return value and (lambda state: pack(field, value(state)))


def _sensor(name: str, field: Field) -> Callable[[LiveState], bytes] | None:
    """Go by unit and size: boards have no register names in common."""
    if field.access != 'r' or name in FACTORY['registers']['2'] \
            or any(word in name for word in _IDENTITY):
        return None
    if name == 'VCC':
        return lambda state: pack(field, _LOGIC_VOLTAGE)
    if field.unit in _BY_UNIT:
        return lambda state: pack(field, _BY_UNIT[field.unit](state))
    if field.type[0] == 'f':
        return lambda state: pack_raw(field, math.sin(state.now_s + field.at))
    swing = 1000 if field.size > 1 else 50
    return lambda state: pack_raw(field, swing * (1.2 + math.sin(state.now_s + field.at)))


def initial_image(model: Model, firmware: int, size: int) -> bytearray:
    """Return the control table as it leaves the factory."""
    image = bytearray(size)
    number = model.number or 0
    if model.protocol == '2':           # what a Ping is answered with
        image[0:2] = number.to_bytes(2, 'little')
    numbers = {'Model Number': number, 'Firmware Version': firmware}
    shipped = FACTORY['registers']
    for name, raw in (shipped['2'] | numbers | shipped[model.protocol]).items():
        field = model.by_name.get(name)
        if field is not None:
            image[field.at:field.end] = pack_raw(field, raw)
    for address, data, count in model.indirect:         # each points at its own data byte
        for index in range(count):
            at = address + 2 * index
            image[at:at + 2] = (data + index).to_bytes(2, 'little')
    return image
