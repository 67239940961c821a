# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""
The control table of a simulated device: its bytes, and which accesses the device refuses.

Error numbers are those of a status (e-Manual, Protocol 2.0): access, range, length of a write, and
goals beyond its limits.
"""

from __future__ import annotations

from math import tau

from mecarover_fakes.values import FACTORY
from mecarover_fakes.values import initial_image
from mecarover_fakes.values import pack_raw
from servobus.model.control_table import Field
from servobus.model.control_table import Model

OK, RESULT_FAIL, INSTRUCTION, RANGE, LENGTH, LIMIT, ACCESS = 0, 1, 2, 4, 5, 6, 7
POSITION_CONTROL = 3             # a value of Operating Mode
TURN_STEPS = 4096                # the X and MX series have these; others keep no limits
_LIMITS = 'Min Position Limit', 'Max Position Limit'
_ANGLE_LIMITS = 'CW Angle Limit', 'CCW Angle Limit'
WATCHDOG_TRIPPED = 0xFF
_TABLE = 256                     # bytes, of a model without a file


class Registers:
    """Bytes of one device, with the factory's as they are before anything is set."""

    def __init__(self, model: Model, firmware: int) -> None:
        self.model = model
        self._spans = _spans(model)
        self.factory = bytes(initial_image(model, firmware, max(end for _, end in self._spans)))
        self.image = bytearray(self.factory)
        self.eeprom = {at for field in model.fields if field.memory == 'eeprom'
                       for at in range(field.at, field.end)}
        self.writable = {at for field in model.fields if field.access != 'r'
                         for at in range(field.at, field.end)}

    def field(self, name: str) -> Field | None:
        """Return the register of that name, None where the model has none."""
        return self.model.by_name.get(name)

    def get(self, name: str, default: int = 0) -> int:
        """Return the raw number in a register, `default` where the model has none."""
        field = self.field(name)
        if field is None:
            return default
        return field.code_of(self.bytes_in(field))

    def bytes_in(self, field: Field) -> bytes:
        """Return the bytes of a register."""
        return bytes(self.image[field.at:field.end])

    def set(self, name: str, raw: float) -> None:
        """Put a raw number into a register, by no instruction; nothing where it has none."""
        field = self.field(name)
        if field is not None:
            self.image[field.at:field.end] = pack_raw(field, raw)

    @property
    def torque(self) -> bool:
        """Whether the motor is on; a board has none."""
        return bool(self.get('Torque Enable'))

    @property
    def follows_goals(self) -> bool:
        """Whether goal positions move it: its mode is for them, and it has some force."""
        return self.get('Operating Mode', -1) not in FACTORY['modes_without_goals'].get(
            self.model.protocol, ()) and all(self.get(name, 1) for name in FACTORY['forces'])

    def within_limits(self, goal: float) -> float:
        """Return how far a goal (rad, or raw) takes it; limits that are the same are none."""
        names = _LIMITS if _LIMITS[0] in self.model.by_name else _ANGLE_LIMITS
        low, high = (0.0 if field is None else field.decode(self.bytes_in(field)).number or 0.0
                     for field in map(self.field, names))
        return min(max(goal, low), high) if low < high else goal

    def is_beyond(self, field: Field, address: int, data: bytes) -> bool:
        """Tell whether a goal among written data is beyond its limits."""
        goal = field.decode(data[field.at - address:field.end - address]).number or 0.0
        return self.within_limits(goal) != goal

    def is_readable(self, address: int, end: int) -> bool:
        """Tell whether there is anything in this range, and nothing beyond the table."""
        return address < end <= len(self.image) and any(
            first < end and last > address for first, last in self._spans)

    def resolve(self, address: int) -> int:
        """Follow an indirect data byte to the register that it shows, one level deep."""
        for pointers, data, count in self.model.indirect:
            if data <= address < data + count:
                at = pointers + 2 * (address - data)
                target = int.from_bytes(self.image[at:at + 2], 'little')
                return target if target < len(self.image) else address
        return address

    def write_error(self, address: int, data: bytes) -> int:
        """Return why a write is refused, OK if it is not."""
        end = address + len(data)
        if not self.is_readable(address, end):
            return ACCESS
        return next((error for field in self.model.fields
                     if field.at < end and field.end > address
                     and (error := self._field_error(field, address, data))), OK)

    def _field_error(self, field: Field, address: int, data: bytes) -> int:
        if field.access == 'r' or (field.memory == 'eeprom' and self.torque):
            return ACCESS
        if field.at < address or field.end > address + len(data):
            return LENGTH
        raw = int.from_bytes(data[field.at - address:field.end - address], 'little')
        low, high = FACTORY['limits'].get(field.name, (0, raw))
        tripped = field.name.startswith('Goal') and self.get('Bus Watchdog') == WATCHDOG_TRIPPED
        if not low <= raw <= high or tripped:
            return RANGE
        has_limits = field.name == 'Goal Position' and field.scale \
            and round(tau / field.scale) == TURN_STEPS \
            and self.get('Operating Mode') == POSITION_CONTROL
        return LIMIT if has_limits and self.is_beyond(field, address, data) else OK


def _spans(model: Model) -> list[tuple[int, int]]:
    """Return (begin, end) of all that there is in the table."""
    spans = [(field.at, field.end) for field in model.fields]
    for pointers, data, count in model.indirect:
        spans += [(pointers, pointers + 2 * count), (data, data + count)]
    return spans or [(0, _TABLE)]
