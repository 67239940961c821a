# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""
Simulated servos of Protocol 1.0 and of Feetech, and the line that carries their packets.

Inside, an instruction has the parameters of 2.0, as everywhere here; only the wire differs. What
the servos do is from the e-Manual (Protocol 1.0) and, for Feetech, from its protocol text, its
SDKs and what feetech-cli measured: a write of a goal switches the torque on, a Reboot is not
answered, the error byte is the Status register.
"""

from __future__ import annotations

from collections.abc import Iterable

from dxl_monitor.model.control_table import Model
from mecarover_fakes.fake_servo import FakeDevice
from mecarover_fakes.fake_servo import Reply
from mecarover_fakes.line import AnyFramer
from mecarover_fakes.line import Line
from mecarover_fakes.registers import ACCESS
from mecarover_fakes.registers import INSTRUCTION
from mecarover_fakes.registers import OK
from mecarover_fakes.registers import RANGE
from mecarover_fakes.values import Sine
from msg_defs import dxl1_packet
from msg_defs.dxl1_instruction import CALIBRATE
from msg_defs.dxl1_instruction import common_error
from msg_defs.dxl1_instruction import Dialect
from msg_defs.dxl1_instruction import in_common
from msg_defs.dxl1_instruction import parse
from msg_defs.dxl_instruction import Instruction
from msg_defs.dxl_instruction import Request
from msg_defs.frame import Frame

BOOT_FEETECH_NS = 800_000_000
MIDDLE = 128                       # Torque Enable of an STS: the present position is the middle
FEETECH_RESET = 0x0A
# Raw, as Feetech ships an STS; other registers begin as those of Dynamixel do, or at 0.
_FACTORY = {'feetech': {'Baud Rate': 0, 'Status Return Level': 1, 'Return Delay Time': 0,
                        'Lock': 1, 'Phase': 12, 'Max Voltage Limit': 140, 'Min Voltage Limit': 40,
                        'Operating Mode': 0},
            '1': {'Baud Rate': 1, 'Max Voltage Limit': 140, 'Min Voltage Limit': 60,
                  'Return Delay Time': 0, 'Shutdown': 36, 'Alarm LED': 36}}
# Dynamixel: e-Manual, error byte. What is out of the table is out of range.
_ERRORS = {'1': {RANGE: 0x08, ACCESS: 0x08, INSTRUCTION: 0x40}, 'feetech': {}}


class Servo1(FakeDevice):
    """A servo of the 1.0 family; its error byte is a set of flags."""

    def __init__(self, number: int, model: Model, *, baud: int = 1_000_000,
                 motion: Sine | None = None) -> None:
        super().__init__(number, model, baud=baud, motion=motion)
        self.is_feetech = model.protocol == 'feetech'
        factory = bytearray(self.factory)
        for image in (factory, self.image):
            image[0:2] = bytes(2)
            at = model.by_name['Model Number'].at
            image[at:at + 2] = (model.number or 0).to_bytes(2, 'little')
            image[model.by_name['Firmware Version'].at] = 3 if self.is_feetech else 24
            for name, raw in _FACTORY[model.protocol].items():
                if name in model.by_name:
                    field = model.by_name[name]
                    image[field.at:field.end] = field.bytes_of(raw)
        self.factory = bytes(factory)
        self.set('Baud Rate', next((k for k, v in self.baud_codes.items() if v == baud),
                                   _FACTORY[model.protocol]['Baud Rate']))

    @property
    def baud_codes(self) -> dict[int, int]:
        words = self.model.by_name['Baud Rate'].enum or {}
        return {code: int(word) for code, word in words.items()}

    def error_byte(self, error: int) -> int:
        return error | self.hardware_error

    def acknowledges(self, instruction: int) -> bool:
        if instruction == Instruction.PING:
            return True
        if self.is_feetech and instruction == Instruction.REBOOT:
            return False
        is_read = instruction in (Instruction.READ, Instruction.SYNC_READ, Instruction.BULK_READ)
        level = self.get('Status Return Level', 2) + self.is_feetech
        return level >= (1 if is_read else 2)

    def answer_level(self, level: int) -> None:
        self.set('Status Return Level', level - self.is_feetech)

    def execute(self, instruction: int, params: bytes, now: int) -> Reply:
        """Do what an instruction says; the error of the reply is a set of flags."""
        if instruction == Instruction.PING:
            return Reply(OK)
        if instruction == CALIBRATE:
            self._calibrate()
            return Reply(OK)
        if instruction in (FEETECH_RESET, 0x09):
            return Reply(OK)
        if instruction == Instruction.REBOOT:
            self.restart(now, BOOT_FEETECH_NS)
            return Reply(OK)
        if instruction == Instruction.FACTORY_RESET:
            return self._reset(now)
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
        goal = self.field('Goal Position')
        angle = self.angle(now)
        if goal is not None and address < goal.end and address + len(data) > goal.at:
            self.set('Torque Enable', 1)           # a goal switches it on, in both dialects
        was_torque = self.torque
        for at, byte in enumerate(data, address):
            field = next((one for one in self.model.fields if one.at <= at < one.end), None)
            if field is not None and field.access != 'r' and at < len(self.image):
                self.image[at] = byte
        if self.is_feetech and self.get('Torque Enable') == MIDDLE:
            self._calibrate()
        self._after_write(address, address + len(data), was_torque, angle)
        return Reply(OK)

    def _is_out_of_range(self, address: int, data: bytes) -> bool:
        goal = self.model.by_name['Goal Position']
        at = goal.at - address
        limit = 1023 if self.model.by_name['CW Angle Limit'].scale == 0.0051132693 else 4095
        return 0 <= at <= len(data) - 2 and goal.code_of(data[at:at + 2]) > limit

    def _calibrate(self) -> None:
        self.rest_angle = 0.0
        self.set('Torque Enable', 0)

    def _reset(self, now: int) -> Reply:
        number, code = self.id, self.get('Baud Rate')
        self.image[:] = self.factory
        self.id = number if self.is_feetech else 1
        self.set('ID', self.id)
        if self.is_feetech:
            self.set('Baud Rate', code)
        self.restart(now)
        return Reply(OK)


class Line1(Line):
    """A line with packets of the 1.0 family."""

    header = dxl1_packet.HEADER
    repairs_headers = False
    pings_tell_model = False
    status_size = 6
    addresses = 0x100

    def __init__(self, devices: Iterable[FakeDevice], baud: int, dialect: Dialect, *,
                 waits_in_line: bool = True) -> None:
        self.dialect = dialect
        self.protocol = dialect.protocol
        super().__init__(devices, baud, waits_in_line=waits_in_line)

    def instruction_wire(self, number: int, instruction: int, params: bytes,
                         stuffed: bool) -> bytes:
        return dxl1_packet.encode(number, instruction, narrow(instruction, params))

    def status_wire(self, number: int, error: int, params: bytes) -> bytes:
        return dxl1_packet.encode(number, error, params)

    def understood(self, instruction: int, number: int, params: bytes) -> Request:
        return parse(instruction, number, narrow(instruction, params), self.dialect)

    def knows(self, instruction: int) -> bool:
        return instruction in self.dialect.entries

    def common_error(self, error: int) -> int:
        return common_error(error, self.dialect)

    def listener(self) -> AnyFramer:
        return dxl1_packet.Dxl1Framer()

    def heard(self, frame: Frame) -> tuple[int, int, bytes, bool]:
        number, code, params = frame[3:6]
        return number, code, in_common(code, number, params)[1], True


def narrow(instruction: int, params: bytes) -> bytes:
    """Return parameters of 2.0 with addresses and sizes as wide as those of 1.0."""
    if len(params) < len(b'\0\0\0'):            # nothing, or what makes no sense
        return params
    if instruction in (Instruction.READ, Instruction.SYNC_READ, Instruction.SYNC_WRITE):
        return params[:1] + params[2:3] + params[4:]
    if instruction in (Instruction.WRITE, Instruction.REG_WRITE):
        return params[:1] + params[2:]
    if instruction == Instruction.BULK_READ:
        return b'\0' + b''.join(bytes((params[at + 3], params[at], params[at + 1]))
                                for at in range(0, len(params) - 4, 5))
    return params

