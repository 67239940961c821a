# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""
Simulated servos of Protocol 1.0 and of Feetech.

Inside, an instruction has the parameters of 2.0, as everywhere here; only the wire differs. What
the servos do is from the e-Manual (Protocol 1.0) and, for Feetech, from its protocol text, its
SDKs and what feetech-cli measured: a write of a goal switches the torque on, a Reboot is not
answered, the error byte is the Status register.
"""

from __future__ import annotations

from mecarover_fakes.fake_servo import FakeDevice
from mecarover_fakes.fake_servo import Reply
from mecarover_fakes.registers import ACCESS
from mecarover_fakes.registers import INSTRUCTION
from mecarover_fakes.registers import LIMIT
from mecarover_fakes.registers import OK
from mecarover_fakes.registers import RANGE
from msg_defs.dxl1_instruction import CALIBRATE
from msg_defs.dxl_instruction import FEETECH_NAMES
from msg_defs.dxl_instruction import Instruction

BOOT_FEETECH_NS = 800_000_000
MIDDLE = 128                       # Torque Enable of an STS: the present position is the middle
# Dynamixel: e-Manual, error byte. What is out of the table is out of range.
_ERRORS = {'1': {LIMIT: 0x02, RANGE: 0x08, ACCESS: 0x08, INSTRUCTION: 0x40}, 'feetech': {}}


class Servo1(FakeDevice):
    """A servo of the 1.0 family; its error byte is a set of flags."""

    def error_byte(self, error: int) -> int:
        return error | self.hardware_error

    def acknowledges(self, instruction: int) -> bool:
        return super().acknowledges(instruction) and not (
            self.is_feetech and instruction == Instruction.REBOOT)

    def execute(self, instruction: int, params: bytes, now: int) -> Reply:
        """Do what an instruction says; the error of the reply is a set of flags."""
        if instruction == CALIBRATE:
            self._calibrate()
        elif instruction == Instruction.REBOOT:
            self.restart(now, BOOT_FEETECH_NS)
        if instruction in (Instruction.PING, Instruction.REBOOT, *FEETECH_NAMES):
            return Reply(OK)
        if instruction == Instruction.FACTORY_RESET:       # Feetech keeps ID and Baud Rate
            params = b'\x02' if self.is_feetech else b'\xff'
        reply = super().execute(instruction, params, now)
        return Reply(_ERRORS[self.model.protocol].get(reply.error, OK), reply.params)

    def read(self, address: int, length: int, now: int) -> Reply:
        """Return registers; where Feetech has none it reads 0."""
        reply = super().read(address, length, now)
        if self.is_feetech and reply.error:
            return Reply(OK, bytes(length))
        return reply

    def write(self, address: int, data: bytes, now: int) -> Reply:
        """Write what may be written; bytes of registers that are read only stay."""
        if not self.is_feetech and (self._is_out_of_range(address, data)
                                    or not self.is_readable(address, address + len(data))):
            return Reply(RANGE)
        angle, end = self.angle(now), address + len(data)
        goal = self._written('Goal Position', address, end)
        if goal and address <= goal.at and goal.end <= end:
            if not self.is_feetech and self.is_beyond(goal, address, data):
                return Reply(LIMIT)
            self.set('Torque Enable', 1)           # a goal switches it on, in both dialects
        was_torque = self.torque
        for at, byte in enumerate(data, address):
            if at in self.writable:
                self.image[at] = byte
        if self.is_feetech and self.get('Torque Enable') == MIDDLE:
            self._calibrate()
        self._after_write(address, end, was_torque, angle)
        return Reply(OK)

    def _is_out_of_range(self, address: int, data: bytes) -> bool:
        goal = self.model.by_name['Goal Position']
        at = goal.at - address
        limit = 1023 if self.model.by_name['CW Angle Limit'].scale == 0.0051132693 else 4095
        return 0 <= at <= len(data) - 2 and goal.code_of(data[at:at + 2]) > limit

    def _calibrate(self) -> None:
        self.rest_angle = 0.0
        self.set('Torque Enable', 0)
