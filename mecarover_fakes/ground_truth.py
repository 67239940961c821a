# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""
What a perfect listener must know after the simulated traffic: the oracle of the monitor's tests.

It gets each exchange after the faults did their work, and unlike a listener it knows who sent
what. Bytes count as known only where the rules of the monitor let them be known: data of a good
status after a good instruction, with nothing damaged between the two.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass
from dataclasses import field
import math
from typing import Any

from mecarover_fakes.line import Answer
from mecarover_fakes.line import Burst
from mecarover_fakes.line import Exchange
from mecarover_fakes.line import Line
from msg_defs.dxl_instruction import ALERT
from msg_defs.dxl_instruction import Answers
from msg_defs.dxl_instruction import Instruction
from msg_defs.dxl_instruction import Request
from msg_defs.dxl_packet import BROADCAST

MISSED_LIMIT = 4                 # more missed answers than this in a row: disconnected


@dataclass
class Known:
    """What can be known of one ID."""

    asked: int = 0               # answers that were due
    answered: int = 0            # came undamaged
    missed: int = 0              # did not come, or damaged
    waiting: int = 0             # after a silent device: their turn never came
    missed_in_a_row: int = 0
    statuses: int = 0            # undamaged ones, due or not
    errors: Counter[int] = field(default_factory=Counter)
    alert: bool = False
    model_number: int | None = None
    firmware: int | None = None
    table: dict[int, int] = field(default_factory=dict)
    registered: tuple[int, bytes] | None = None

    @property
    def state(self) -> str:
        """The word for it: unseen, connected or disconnected."""
        if self.missed_in_a_row > MISSED_LIMIT:
            return 'disconnected'
        return 'connected' if self.statuses else 'unseen'

    def store(self, address: int, data: bytes) -> None:
        """Note bytes of the control table."""
        self.table.update(enumerate(data, address))

    def as_json(self) -> dict[str, Any]:
        """Return it for --truth."""
        return {
            'state': self.state, 'asked': self.asked, 'answered': self.answered,
            'missed': self.missed, 'waiting': self.waiting, 'statuses': self.statuses,
            'errors': {str(number): count for number, count in sorted(self.errors.items())},
            'alert': self.alert, 'model_number': self.model_number, 'firmware': self.firmware,
            'table': spans(self.table)}


class GroundTruth:
    """Collects exchanges; `exact` is False once something happened that blurs the counts."""

    def __init__(self, line: Line) -> None:
        self._line = line
        self.known: dict[int, Known] = {}
        self.exact = True
        self.bytes = 0
        self.instructions = 0
        self.statuses = 0            # frames, a combined one counts once
        self.damaged = 0             # bursts

    def of(self, number: int) -> Known:
        """Return what can be known of an ID."""
        return self.known.setdefault(number, Known())

    def count(self, bursts: list[Burst]) -> None:
        """Count the bytes on the line."""
        self.bytes += sum(len(burst.data) for burst in bursts)
        self.damaged += sum(not burst.intact for burst in bursts)

    def take(self, exchange: Exchange) -> None:
        """Learn from an exchange."""
        damaged = [burst.start for burst in exchange.bursts if not burst.intact]
        combined = exchange.request.answers is Answers.COMBINED
        # A block of a combined status is lost with one before it (its CRC).
        lost_from = min((answer.burst.start for answer in exchange.answers
                         if combined and not answer.burst.intact), default=math.inf)
        good = [answer for answer in exchange.answers
                if answer.burst.intact and answer.burst.start <= lost_from]
        complete = len(good) == len(exchange.request.accesses)
        self.statuses += complete if combined else len(good)
        for answer in good:
            self._hear(answer)
        if exchange.bursts[0].intact:
            self.instructions += 1
            self._judge(exchange, {answer.id for answer in good})
            self._learn(exchange.request, [answer for answer in good
                                           if answer.burst.start < min(damaged, default=math.inf)])

    def _hear(self, answer: Answer) -> None:
        known = self.of(answer.id)
        known.statuses += 1
        known.missed_in_a_row = 0
        known.alert = bool(answer.error & ALERT)
        number = answer.error & ~ALERT
        if number:
            known.errors[number] += 1

    def _judge(self, exchange: Exchange, heard: set[int]) -> None:
        sent = {answer.id for answer in exchange.answers}
        if exchange.request.answers is Answers.EVERYBODY:
            for number in heard:     # more devices may be there
                self.of(number).asked += 1
                self.of(number).answered += 1
        in_line = exchange.request.answers in (Answers.LISTED, Answers.COMBINED)
        stopped = False
        for number in exchange.due:
            known = self.of(number)
            known.asked += 1
            if number in heard:
                known.answered += 1
            elif stopped and number not in sent:
                known.waiting += 1
            else:
                known.missed += 1
                known.missed_in_a_row += 1
                rest = exchange.due[exchange.due.index(number):]
                stopped = in_line and not sent.intersection(rest)

    # --- control tables --------------------------------------------------------------------

    def _learn(self, request: Request, answers: list[Answer]) -> None:
        learn = _LEARNING.get(request.instruction, GroundTruth._learn_nothing)
        good = [answer for answer in answers if not answer.error & ~ALERT]
        if learn in _FROM_ANSWERS or good == answers:
            learn(self, request, good)

    def _learn_nothing(self, request: Request, answers: list[Answer]) -> None:
        pass

    def _learn_model(self, request: Request, answers: list[Answer]) -> None:
        """Note what a Ping says; with another model nothing known before holds."""
        for answer in answers:
            if len(answer.params) != 3:
                continue
            known = self.of(answer.id)
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

    def _learn_read(self, request: Request, answers: list[Answer]) -> None:
        accesses = {access.id: access for access in request.accesses}
        for answer in answers:
            access = accesses.get(answer.id)
            if access and len(answer.params) == access.length:
                self.of(answer.id).store(access.address, answer.params)

    def _learn_write(self, request: Request, answers: list[Answer]) -> None:
        for access in request.accesses:
            for number in self._meant(access.id):
                self._store_written(number, access.address, access.data or b'')

    def _learn_reg_write(self, request: Request, answers: list[Answer]) -> None:
        for access in request.accesses:
            for number in self._meant(access.id):
                self.of(number).registered = access.address, access.data or b''

    def _learn_action(self, request: Request, answers: list[Answer]) -> None:
        for number in self._meant(request.id):
            known = self.of(number)
            if known.registered is not None:
                self._store_written(number, *known.registered)
                known.registered = None

    def _learn_restart(self, request: Request, answers: list[Answer]) -> None:
        """Forget what is in RAM; of a Factory Reset, everything."""
        for number in self._meant(request.id):
            known, device = self.of(number), self._line.at(number)
            kept = set() if device is None or request.instruction == Instruction.FACTORY_RESET \
                else device.eeprom
            known.registered = None
            known.table = {at: byte for at, byte in known.table.items() if at in kept}

    def _meant(self, number: int) -> list[int]:
        return list(self.known) if number == BROADCAST else [number]

    def _store_written(self, number: int, address: int, data: bytes) -> None:
        self.of(number).store(address, data)
        if self._line.at(number) is not None:
            return
        for device in self._line.chain:      # it may have just left for the ID that was written
            field = device.field('ID')
            if field and address <= field.at < address + len(data) \
                    and device.id == data[field.at - address] and device.id != number:
                self.known[device.id] = self.known.pop(number)
                return

    def as_json(self) -> dict[str, Any]:
        """Return everything for --truth."""
        return {
            'exact': self.exact, 'bytes': self.bytes, 'instructions': self.instructions,
            'statuses': self.statuses, 'damaged': self.damaged,
            'devices': {str(number): self.known[number].as_json()
                        for number in sorted(self.known)}}


_Learn = Callable[[GroundTruth, Request, list[Answer]], None]
_READ, _WRITE = GroundTruth._learn_read, GroundTruth._learn_write
_LEARNING: dict[int, _Learn] = {      # a test wants a row for each instruction
    Instruction.PING: GroundTruth._learn_model,
    Instruction.READ: _READ,
    Instruction.SYNC_READ: _READ,
    Instruction.BULK_READ: _READ,
    Instruction.FAST_SYNC_READ: _READ,
    Instruction.FAST_BULK_READ: _READ,
    Instruction.WRITE: _WRITE,
    Instruction.SYNC_WRITE: _WRITE,
    Instruction.BULK_WRITE: _WRITE,
    Instruction.REG_WRITE: GroundTruth._learn_reg_write,
    Instruction.ACTION: GroundTruth._learn_action,
    Instruction.REBOOT: GroundTruth._learn_restart,
    Instruction.FACTORY_RESET: GroundTruth._learn_restart,
    Instruction.CLEAR: GroundTruth._learn_nothing,
    Instruction.CONTROL_TABLE_BACKUP: GroundTruth._learn_nothing,
}
_FROM_ANSWERS = (GroundTruth._learn_model, _READ)     # others: where no answer has an error


def spans(table: dict[int, int]) -> dict[str, str]:
    """Return the bytes of a table as runs: first address -> hex."""
    runs: dict[int, bytearray] = {}
    first = -1
    for at in sorted(table):
        if first < 0 or at != first + len(runs[first]):
            first = at
            runs[first] = bytearray()
        runs[first].append(table[at])
    return {str(at): run.hex() for at, run in runs.items()}
