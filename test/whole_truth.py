# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""
What a perfect listener must know of the control tables after the simulated traffic.

Bytes count as known only where the rules of the monitor let them be known: data of a good status
after a good instruction, with nothing damaged between the two.
"""

from __future__ import annotations

from collections import defaultdict
from dataclasses import dataclass
from dataclasses import field

from mecarover_fakes.ground_truth import good_answers
from mecarover_fakes.ground_truth import GroundTruth
from msg_defs.dxl_instruction import ALERT
from msg_defs.dxl_instruction import Instruction
from msg_defs.dxl_packet import BROADCAST


@dataclass
class KnownTable:
    """What can be known of the registers of one ID."""

    model_number: int | None = None
    firmware: int | None = None
    table: dict[int, int] = field(default_factory=dict)
    registered: tuple[int, bytes] | None = None

    def store(self, address, data):
        """Note bytes of the control table."""
        self.table.update(enumerate(data, address))


class WholeTruth(GroundTruth):
    """The counts, and what can be known of the control tables."""

    def __init__(self, line):
        super().__init__()
        self._line = line
        self.tables = defaultdict(KnownTable)

    def count_exchange(self, exchange):
        super().count_exchange(exchange)
        damaged = [burst.start for burst in exchange.bursts if not burst.intact]
        if exchange.bursts[0].intact:
            self._learn(exchange.request, [answer for answer in good_answers(exchange)
                                           if not damaged or answer.burst.start < min(damaged)])

    def _learn(self, request, answers):
        learn = LEARNING.get(request.instruction, WholeTruth._learn_nothing)
        good = [answer for answer in answers if not answer.error & ~ALERT]
        if learn in _FROM_ANSWERS or good == answers:
            learn(self, request, good)

    def _learn_nothing(self, request, answers):
        pass

    def _learn_model(self, request, answers):
        """Note what a Ping says; with another model nothing known before holds."""
        for answer in answers:
            if len(answer.params) != 3:
                continue
            known = self.tables[answer.id]
            model_number = int.from_bytes(answer.params[:2], 'little')
            if known.model_number not in (None, model_number):
                known.table = {}
            known.model_number = model_number
            known.firmware = answer.params[2]
            known.store(0, answer.params[:2])
            device = self._line.at(answer.id)
            if device is not None and device.model.number == model_number \
                    and (field := device.field('Firmware Version')) is not None:
                known.store(field.at, answer.params[2:])

    def _learn_read(self, request, answers):
        accesses = {access.id: access for access in request.accesses}
        for answer in answers:
            access = accesses.get(answer.id)
            if access and len(answer.params) == access.length:
                self.tables[answer.id].store(access.address, answer.params)

    def _learn_write(self, request, answers):
        for access in request.accesses:
            for number in self._meant(access.id):
                self._store_written(number, access.address, access.data or b'')

    def _learn_reg_write(self, request, answers):
        for access in request.accesses:
            for number in self._meant(access.id):
                self.tables[number].registered = access.address, access.data or b''

    def _learn_action(self, request, answers):
        for number in self._meant(request.id):
            known = self.tables[number]
            if known.registered is not None:
                self._store_written(number, *known.registered)
                known.registered = None

    def _learn_restart(self, request, answers):
        """Forget what is in RAM; of a Factory Reset, everything."""
        for number in self._meant(request.id):
            known, device = self.tables[number], self._line.at(number)
            kept = set() if device is None or request.instruction == Instruction.FACTORY_RESET \
                else device.eeprom
            known.registered = None
            known.table = {at: byte for at, byte in known.table.items() if at in kept}

    def _meant(self, number):
        return [*{*self.known, *self.tables}] if number == BROADCAST else [number]

    def _store_written(self, number, address, data):
        self.tables[number].store(address, data)
        if self._line.at(number) is not None:
            return
        for device in self._line.chain:      # it may have just left for the ID that was written
            field = device.field('ID')
            if field and address <= field.at < address + len(data) \
                    and device.id == data[field.at - address] and device.id != number:
                self.tables[device.id] = self.tables.pop(number)
                self.known[device.id] = self.known.pop(number)
                return


_READ, _WRITE = WholeTruth._learn_read, WholeTruth._learn_write
LEARNING = {      # a row for each instruction
    Instruction.PING: WholeTruth._learn_model,
    Instruction.READ: _READ,
    Instruction.SYNC_READ: _READ,
    Instruction.BULK_READ: _READ,
    Instruction.FAST_SYNC_READ: _READ,
    Instruction.FAST_BULK_READ: _READ,
    Instruction.WRITE: _WRITE,
    Instruction.SYNC_WRITE: _WRITE,
    Instruction.BULK_WRITE: _WRITE,
    Instruction.REG_WRITE: WholeTruth._learn_reg_write,
    Instruction.ACTION: WholeTruth._learn_action,
    Instruction.REBOOT: WholeTruth._learn_restart,
    Instruction.FACTORY_RESET: WholeTruth._learn_restart,
    Instruction.CLEAR: WholeTruth._learn_nothing,
    Instruction.CONTROL_TABLE_BACKUP: WholeTruth._learn_nothing,
}
_FROM_ANSWERS = (WholeTruth._learn_model, _READ)     # others: where no answer has an error
