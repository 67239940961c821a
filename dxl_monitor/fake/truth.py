# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""
What a perfect listener must know after the simulated traffic: the oracle of the monitor's tests.

It gets each exchange after the faults did their work, and unlike a listener it knows who sent
what. Bytes count as known only where the rules of the monitor let them be known: data of a good
status after a good instruction, with nothing damaged between the two.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from dxl_monitor.fake.device import FakeDevice
from dxl_monitor.fake.line import Answer
from dxl_monitor.fake.line import Burst
from dxl_monitor.fake.line import Exchange
from dxl_monitor.fake.line import Line
from msg_defs.dxl_instruction import Access
from msg_defs.dxl_instruction import ALERT
from msg_defs.dxl_instruction import Answers
from msg_defs.dxl_instruction import Instruction
from msg_defs.dxl_packet import BROADCAST

MISSED_LIMIT = 4                 # more missed answers than this in a row: disconnected


class Known:
    """What can be known of one ID."""

    __slots__ = ('alert', 'answered', 'asked', 'bytes', 'errors', 'firmware', 'missed',
                 'missed_in_a_row', 'model_number', 'registered', 'statuses', 'waiting')

    def __init__(self) -> None:
        self.asked = 0               # answers that were due
        self.answered = 0            # came undamaged
        self.missed = 0              # did not come, or damaged
        self.waiting = 0             # after a silent device: their turn never came
        self.missed_in_a_row = 0
        self.statuses = 0            # undamaged ones, due or not
        self.errors: dict[int, int] = {}
        self.alert = False
        self.model_number: int | None = None
        self.firmware: int | None = None
        self.bytes: dict[int, int] = {}
        self.registered: tuple[int, bytes] | None = None

    @property
    def state(self) -> str:
        """The word for it: unseen, connected or disconnected."""
        if self.missed_in_a_row > MISSED_LIMIT:
            return 'disconnected'
        return 'connected' if self.statuses else 'unseen'

    def store(self, address: int, data: bytes) -> None:
        """Note bytes of the control table."""
        self.bytes.update(enumerate(data, address))

    def as_json(self) -> dict[str, Any]:
        """Return it for --truth."""
        return {
            'state': self.state, 'asked': self.asked, 'answered': self.answered,
            'missed': self.missed, 'waiting': self.waiting, 'statuses': self.statuses,
            'errors': {str(number): count for number, count in sorted(self.errors.items())},
            'alert': self.alert, 'model_number': self.model_number, 'firmware': self.firmware,
            'table': spans(self.bytes)}


class Truth:
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
        understood = exchange.bursts[0].intact
        self.instructions += understood
        broken_at = min((burst.start for burst in exchange.bursts if not burst.intact),
                        default=None)
        good = [answer for answer in exchange.answers
                if answer.burst.intact and not self._behind_damage(exchange, answer)]
        combined = exchange.request.answers is Answers.COMBINED
        complete = len(good) == len(exchange.request.accesses)
        self.statuses += complete if combined else len(good)
        for answer in good:
            self._hear(answer)
        if not understood:
            return
        self._judge(exchange, {answer.id for answer in good})
        clean = [answer for answer in good
                 if broken_at is None or answer.burst.start < broken_at]
        self._learn(exchange, clean)

    def _behind_damage(self, exchange: Exchange, answer: Answer) -> bool:
        """Tell whether the block of a combined status is lost with one before it (its CRC)."""
        return exchange.request.answers is Answers.COMBINED and any(
            not other.burst.intact and other.burst.start < answer.burst.start
            for other in exchange.answers)

    def _hear(self, answer: Answer) -> None:
        known = self.of(answer.id)
        known.statuses += 1
        known.missed_in_a_row = 0
        known.alert = bool(answer.error & ALERT)
        number = answer.error & ~ALERT
        if number:
            known.errors[number] = known.errors.get(number, 0) + 1

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
                stopped = in_line and number not in sent and self._rest_is_silent(exchange, number)

    def _rest_is_silent(self, exchange: Exchange, number: int) -> bool:
        rest = exchange.due[exchange.due.index(number) + 1:]
        return not set(rest) & {answer.id for answer in exchange.answers}

    # --- control tables --------------------------------------------------------------------

    def _learn(self, exchange: Exchange, answers: list[Answer]) -> None:
        learn = _LEARNING.get(exchange.request.instruction)
        if learn is not None:
            learn(self, exchange, answers)

    def _learn_nothing(self, exchange: Exchange, answers: list[Answer]) -> None:
        pass

    def _learn_model(self, exchange: Exchange, answers: list[Answer]) -> None:
        for answer in answers:
            if len(answer.params) == 3:
                self._learn_identity(answer.id, answer.params)

    def _learn_identity(self, number: int, params: bytes) -> None:
        """Note what a Ping says; with another model nothing known before holds."""
        known = self.of(number)
        model_number = int.from_bytes(params[:2], 'little')
        if known.model_number not in (None, model_number):
            known.bytes = {}
        known.model_number = model_number
        known.firmware = params[2]
        known.store(0, params[:2])
        device = self._line.at(number)
        if device is not None and device.model.number == model_number:
            field = device.field('Firmware Version')
            if field is not None:
                known.store(field.at, params[2:])

    def _learn_read(self, exchange: Exchange, answers: list[Answer]) -> None:
        accesses = {access.id: access for access in exchange.request.accesses}
        for answer in answers:
            access = accesses.get(answer.id)
            if access and not answer.error & ~ALERT and len(answer.params) == access.length:
                self.of(answer.id).store(access.address, answer.params)

    def _learn_write(self, exchange: Exchange, answers: list[Answer]) -> None:
        if _refused(answers):
            return
        for access in exchange.request.accesses:
            for number in self._targets(access):
                self._store_written(number, access.address, access.data or b'')

    def _learn_reg_write(self, exchange: Exchange, answers: list[Answer]) -> None:
        if not _refused(answers):
            for access in exchange.request.accesses:
                for number in self._targets(access):
                    self.of(number).registered = access.address, access.data or b''

    def _learn_action(self, exchange: Exchange, answers: list[Answer]) -> None:
        wanted = exchange.request.id
        for number in [wanted] if wanted != BROADCAST else list(self.known):
            known = self.of(number)
            if known.registered is not None and not _refused(answers):
                self._store_written(number, *known.registered)
                known.registered = None

    def _learn_restart(self, exchange: Exchange, answers: list[Answer]) -> None:
        if not _refused(answers):
            for known, device in self._addressed(exchange.request.id):
                known.registered = None
                kept = _kept_by_restart(device)
                known.bytes = {at: byte for at, byte in known.bytes.items() if at in kept}

    def _learn_reset(self, exchange: Exchange, answers: list[Answer]) -> None:
        if not _refused(answers):
            for known, _ in self._addressed(exchange.request.id):
                known.registered = None
                known.bytes = {}

    def _targets(self, access: Access) -> list[int]:
        return list(self.known) if access.id == BROADCAST else [access.id]

    def _addressed(self, number: int) -> list[tuple[Known, FakeDevice | None]]:
        numbers = list(self.known) if number == BROADCAST else [number]
        return [(self.of(one), self._line.at(one)) for one in numbers]

    def _store_written(self, number: int, address: int, data: bytes) -> None:
        known = self.of(number)
        known.store(address, data)
        device = self._line.at(number)
        if device is None:           # it may have just left for the ID that was written
            self._move(number, address, data)

    def _move(self, number: int, address: int, data: bytes) -> None:
        for device in self._line.chain:
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


def _refused(answers: list[Answer]) -> bool:
    return any(answer.error & ~ALERT for answer in answers)


def _kept_by_restart(device: FakeDevice | None) -> set[int]:
    if device is None:
        return set()
    return {at for field in device.model.fields if field.memory == 'eeprom'
            for at in range(field.at, field.end)}


_Learn = Callable[[Truth, Exchange, list[Answer]], None]
_LEARNING: dict[int, _Learn] = {      # a test wants a row for each instruction
    Instruction.PING: Truth._learn_model,
    Instruction.READ: Truth._learn_read,
    Instruction.SYNC_READ: Truth._learn_read,
    Instruction.BULK_READ: Truth._learn_read,
    Instruction.FAST_SYNC_READ: Truth._learn_read,
    Instruction.FAST_BULK_READ: Truth._learn_read,
    Instruction.WRITE: Truth._learn_write,
    Instruction.SYNC_WRITE: Truth._learn_write,
    Instruction.BULK_WRITE: Truth._learn_write,
    Instruction.REG_WRITE: Truth._learn_reg_write,
    Instruction.ACTION: Truth._learn_action,
    Instruction.REBOOT: Truth._learn_restart,
    Instruction.FACTORY_RESET: Truth._learn_reset,
    Instruction.CLEAR: Truth._learn_nothing,
    Instruction.CONTROL_TABLE_BACKUP: Truth._learn_nothing,
}


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
