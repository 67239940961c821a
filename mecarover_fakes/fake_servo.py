# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""
One simulated Dynamixel device: what it does with an instruction, and what can befall it.

Knows no wire and no clock: `now` (ns) is an argument, a Reply comes back (or None for silence).
Rules from the e-Manual, Protocol 2.0: access, ranges, Status Return Level, Reg Write and Action,
Factory Reset, Reboot, Clear, Control Table Backup, Bus Watchdog, latched hardware errors.
"""

from __future__ import annotations

from collections.abc import Callable
import sys
from typing import NamedTuple

from mecarover_fakes.registers import ACCESS
from mecarover_fakes.registers import INSTRUCTION
from mecarover_fakes.registers import LENGTH
from mecarover_fakes.registers import OK
from mecarover_fakes.registers import Registers
from mecarover_fakes.registers import RESULT_FAIL
from mecarover_fakes.registers import WATCHDOG_TRIPPED
from mecarover_fakes.values import FACTORY
from mecarover_fakes.values import live_registers
from mecarover_fakes.values import LiveState
from mecarover_fakes.values import Sine
from mecarover_fakes.values import TEMPERATURE
from mecarover_fakes.values import VOLTAGE
from msg_defs.dxl_instruction import ALERT
from msg_defs.dxl_instruction import BACKUP_OPTIONS
from msg_defs.dxl_instruction import CLEAR_KEYS
from msg_defs.dxl_instruction import Instruction
from msg_defs.dxl_instruction import RESTORE
from msg_defs.dxl_instruction import STORE
from servobus.model.control_table import Field
from servobus.model.control_table import Model

BOOT_NS = 200_000_000            # deaf after a start
WATCHDOG_UNIT_NS = 20_000_000

_KEPT_BY_RESET = {b'\xff': (), b'\x01': ('ID',), b'\x02': ('ID', 'Baud Rate')}


class Reply(NamedTuple):
    """The content of a status: error number (without the alert bit) and parameters."""

    error: int
    params: bytes = b''


class FakeDevice(Registers):
    """A device on a bus that runs at `baud`; it moves by `motion` while its torque is on."""

    def __init__(self, number: int, model: Model, *, baud: int = 1_000_000,
                 motion: Sine | None = None) -> None:
        self.firmware = FACTORY['firmware_of_protocol'].get(model.protocol) \
            or _by_prefix('firmware', model.name) or 1
        super().__init__(model, self.firmware)
        self.baud = baud
        self.motion = motion
        self.silent = False
        self.hardware_error = 0
        self.voltage = VOLTAGE
        self.temperature = TEMPERATURE
        self.rest_angle = 0.0                # its angle while it does not move by `motion`
        self.up_at = 0
        self.extra_delay_ns = 0
        self.is_feetech = model.protocol == 'feetech'
        self._registered: tuple[int, bytes] | None = None
        self._live = live_registers(model)
        self._backup: bytes | None = None
        self.renumber(number)
        self.set('Return Delay Time', 0)
        self.set('Baud Rate', next((code for code, rate in self.baud_codes.items()
                                    if rate == baud), self.get('Baud Rate')))

    @property
    def return_delay_ns(self) -> int:
        """Time between an instruction and the status."""
        return 2000 * self.get('Return Delay Time') + self.extra_delay_ns

    @property
    def has_fast_reads(self) -> bool:
        """Whether this model and firmware know Fast Sync Read and Fast Bulk Read."""
        since = _by_prefix('fast_since', self.model.name)
        return since is not None and self.firmware >= since + ('330' in self.model.name)

    @property
    def baud_codes(self) -> dict[int, int]:
        """What the codes of Baud Rate mean (bit/s)."""
        field = self.field('Baud Rate')
        words = field.enum if field is not None and field.enum else {}
        return {code: int(word) for code, word in words.items()}

    def is_listening(self, baud: int, now: int) -> bool:
        """Tell whether it takes part in the traffic of a bus at `baud`."""
        return not self.silent and self.baud == baud and now >= self.up_at

    def error_byte(self, error: int) -> int:
        """Return the error byte of a status: the number, and the alert bit while latched."""
        return error | ALERT if self.hardware_error else error

    def acknowledges(self, instruction: int) -> bool:
        """Tell whether Status Return Level lets it answer this instruction."""
        level = self.get('Status Return Level', 2) + self.is_feetech
        return instruction == Instruction.PING or level >= (1 if instruction in _READS else 2)

    def answer_level(self, level: int) -> None:
        """Answer Pings (0), reads too (1), or everything (2)."""
        self.set('Status Return Level', level - self.is_feetech)

    # --- what happens to it ----------------------------------------------------------------

    def latch(self, bits: int, now: int) -> None:
        """Latch a hardware error: alert on every status, motor off, until the next start."""
        self.rest_angle = self.angle(now)
        self.hardware_error = bits
        self.set('Hardware Error Status', bits)
        self.set('Torque Enable', 0)

    def restart(self, now: int, boot_ns: int = BOOT_NS) -> None:
        """Start as after power-on: RAM at its defaults, deaf while booting."""
        self.rest_angle = self.angle(now)
        for at in range(2, len(self.image)):
            if at not in self.eeprom:
                self.image[at] = self.factory[at]
        self.hardware_error = 0
        self._registered = None
        self.up_at = now + boot_ns

    def renumber(self, number: int) -> None:
        """Give it an ID by no instruction, also one that is taken."""
        self.set('ID', number)
        self.id = number

    def become(self, number: int) -> None:
        """Claim another model number (thesis, experiment 3)."""
        self.image[0:2] = number.to_bytes(2, 'little')

    def angle(self, now: int) -> float:
        """Return the joint's angle (rad)."""
        return self._state(now).angle

    def watch(self, silence_ns: int) -> None:
        """Let the Bus Watchdog know how long the bus was without an instruction."""
        field = self.field('Bus Watchdog')
        limit = 0 if field is None else self.image[field.at]
        if field and 0 < limit < 128 and self.torque and silence_ns > limit * WATCHDOG_UNIT_NS:
            self.image[field.at] = WATCHDOG_TRIPPED

    # --- instructions ----------------------------------------------------------------------

    def execute(self, instruction: int, params: bytes, now: int) -> Reply:
        """Do what an instruction to this device says; the reply may be kept back by the level."""
        handler = _HANDLERS.get(instruction)
        return Reply(INSTRUCTION) if handler is None else handler(self, params, now)

    def read(self, address: int, length: int, now: int) -> Reply:
        """Return the registers from `address` on."""
        if not self.is_readable(address, address + length):
            return Reply(ACCESS)
        places = [self.resolve(at) for at in range(address, address + length)]
        self._refresh(set(places), now)
        return Reply(OK, bytes(self.image[at] for at in places))

    def write(self, address: int, data: bytes, now: int) -> Reply:
        """Write registers; all or nothing."""
        error = self.write_error(address, data)
        if error == OK:
            was_torque, angle = self.torque, self.angle(now)
            for at, byte in enumerate(data, address):
                self.image[self.resolve(at)] = byte
            self._after_write(address, address + len(data), was_torque, angle)
        return Reply(error)

    def _refresh(self, places: set[int], now: int) -> None:
        state = self._state(now)
        for first, last, value in self._live:
            if not places.isdisjoint(range(first, last)):
                self.image[first:last] = value(state)

    def _state(self, now: int) -> LiveState:
        moving = self.motion if self.torque or self.field('Torque Enable') is None else None
        now_s = now * 1e-9
        return LiveState(now_s, self.rest_angle if moving is None else moving.angle(now_s),
                         0.0 if moving is None else moving.velocity(now_s),
                         self.voltage, self.temperature, (now - self.up_at) * 1e-9, self.id)

    def _after_write(self, address: int, end: int, was_torque: bool, before: float) -> None:
        """Let the device follow what was written to its own settings."""
        if self.hardware_error and self._written('Torque Enable', address, end):
            self.set('Torque Enable', 0)             # shut down: it stays off until a start
        self._follow_address(address, end)
        goal = self._written('Goal Position', address, end)
        if goal is not None and self.motion is None and self.torque and self.follows_goals:
            angle = goal.decode(self.bytes_in(goal)).number or 0.0
            self.rest_angle = self.within_limits(angle) if self.is_feetech else angle
        if was_torque != self.torque:
            self.rest_angle = before

    def _follow_address(self, address: int = 0, end: int = sys.maxsize) -> None:
        """Follow ID, and Baud Rate where it is in this range of registers."""
        self.id = self.get('ID', self.id)
        for name in ('Baud Rate', 'Baud Rate (Bus)'):
            if self._written(name, address, end):
                self.baud = self.baud_codes.get(self.get(name), self.baud)

    def _written(self, name: str, address: int, end: int) -> Field | None:
        field = self.field(name)
        return field if field is not None and field.at < end and field.end > address else None

    def _on_ping(self, params: bytes, now: int) -> Reply:
        return Reply(OK, bytes(self.image[0:2]) + bytes([self.firmware]))

    def _on_read(self, params: bytes, now: int) -> Reply:
        if len(params) != 4:
            return Reply(INSTRUCTION)
        return self.read(_word(params), _word(params[2:]), now)

    def _on_write(self, params: bytes, now: int) -> Reply:
        if len(params) < 3:
            return Reply(LENGTH)
        return self.write(_word(params), params[2:], now)

    def _on_reg_write(self, params: bytes, now: int) -> Reply:
        address, data = _word(params), params[2:]
        error = self.write_error(address, data)
        if error == OK:
            self._registered = address, data
            self.set('Registered Instruction', 1)
        return Reply(error)

    def _on_action(self, params: bytes, now: int) -> Reply:
        if self._registered is None:
            return Reply(RESULT_FAIL)
        address, data = self._registered
        self._registered = None
        self.set('Registered Instruction', 0)
        return self.write(address, data, now)

    def _on_factory_reset(self, params: bytes, now: int) -> Reply:
        names = _KEPT_BY_RESET.get(params[:1])
        if names is None:
            return Reply(INSTRUCTION)
        kept = {name: self.get(name) for name in names}
        self.image[:] = self.factory
        for name, raw in kept.items():
            self.set(name, raw)
        self._follow_address()
        self.restart(now)
        return Reply(OK)

    def _on_reboot(self, params: bytes, now: int) -> Reply:
        self.restart(now)
        return Reply(OK)

    def _on_clear(self, params: bytes, now: int) -> Reply:
        return Reply(OK if params[1:] in CLEAR_KEYS and not self.torque else RESULT_FAIL)

    def _on_backup(self, params: bytes, now: int) -> Reply:
        option = BACKUP_OPTIONS.get(params)
        if option is None or not self.has_fast_reads:
            return Reply(INSTRUCTION)
        if self.torque or (option == RESTORE and self._backup is None):
            return Reply(RESULT_FAIL)
        if self._backup is None or option == STORE:
            self._backup = bytes(self.image)
        else:
            self.image[:] = self._backup
            self.restart(now)
        return Reply(OK)


_READS = frozenset({
    Instruction.READ, Instruction.SYNC_READ, Instruction.BULK_READ, Instruction.FAST_SYNC_READ,
    Instruction.FAST_BULK_READ})
_HANDLERS: dict[int, Callable[[FakeDevice, bytes, int], Reply]] = {
    Instruction.PING: FakeDevice._on_ping,
    Instruction.READ: FakeDevice._on_read,
    Instruction.WRITE: FakeDevice._on_write,
    Instruction.REG_WRITE: FakeDevice._on_reg_write,
    Instruction.ACTION: FakeDevice._on_action,
    Instruction.FACTORY_RESET: FakeDevice._on_factory_reset,
    Instruction.REBOOT: FakeDevice._on_reboot,
    Instruction.CLEAR: FakeDevice._on_clear,
    Instruction.CONTROL_TABLE_BACKUP: FakeDevice._on_backup,
}


def _word(params: bytes) -> int:
    return int.from_bytes(params[:2], 'little')


def _by_prefix(table: str, name: str) -> int | None:
    return next((value for prefix, value in FACTORY[table].items() if name.startswith(prefix)),
                None)
