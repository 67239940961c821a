# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""
Planner: instruction packets to Plans, each kind worked out once; and what they do once accepted.

A write to one device takes effect when the device acknowledges it, or when nobody contradicts:
what the device refuses never gets into its table. Without an answer to wait for, at once.
"""

from collections.abc import Callable
from functools import partial
from typing import Any

from dxl_monitor import evidence as ev
from dxl_monitor.device import Device
from dxl_monitor.evidence import Evidence
from dxl_monitor.plan import Begin
from dxl_monitor.plan import Due
from dxl_monitor.plan import Plan
from dxl_monitor.plan import Slot
from dxl_monitor.plan import Take
from dxl_monitor.roster import MAX_ID
from dxl_monitor.roster import Roster
from dxl_monitor.table import WRITTEN
from msg_defs.dxl_instruction import Access
from msg_defs.dxl_instruction import Answers
from msg_defs.dxl_instruction import bulk_write_entries
from msg_defs.dxl_instruction import Instruction
from msg_defs.dxl_instruction import is_whole_bulk_write
from msg_defs.dxl_instruction import NAMES
from msg_defs.dxl_instruction import parse
from msg_defs.dxl_instruction import Request
from msg_defs.dxl_instruction import RESET_ALL
from msg_defs.dxl_packet import BROADCAST
from msg_defs.dxl_packet import unstuff

LISTS_KEPT = 64                    # of IDs, of all Sync Writes
SLOTS_KEPT = 32_768                # the size of all plans together: 3000 different reads
BYTES_PER_SLOT = 32                # of what tells plans apart
NO_IDS = (0xFD, 0xFF)
NO_PLAN = Plan(Request(0, 0xFF, Answers.NOBODY), {})

# How much of the body tells one plan from another, where the rest is data to write.
_KEY_SIZE: dict[int, int] = {
    Instruction.WRITE: 6, Instruction.REG_WRITE: 6, Instruction.SYNC_WRITE: 8,
    Instruction.BULK_WRITE: 4,
}
_RUN = b'\xff\xff\xfd'
# Model Number, and Status Return Level of XL-320, Y, X and MX, P (e-Manual): a read that covers
# one of them may tell what the device is or does.
_TELLING = (0, 15, 17, 68, 516)

_WITH_OPTION = (Instruction.FACTORY_RESET, Instruction.CLEAR, Instruction.CONTROL_TABLE_BACKUP)

# What is done to a device; its arguments: the device, more, stamp.
Effect = Callable[..., None]


class Planner:
    """The plans of one bus. deferred: what the pending instruction will do to its device."""

    __slots__ = ('_effects', '_evidence', '_lists', '_makers', '_retired', '_roster', '_size',
                 'deferred', 'known')

    def __init__(self, roster: Roster, evidence: Evidence) -> None:
        self._roster = roster
        self._evidence = evidence
        self.known: dict[bytes, Plan] = {}     # by what tells one from another
        self._size = 0                 # of all plans, in slots
        self._lists: dict[bytes, list[Device]] = {}    # of IDs, as a Sync Write has them
        self._retired = 0              # instructions of forgotten plans
        self.deferred: tuple[Effect, tuple[Any, ...]] | None = None
        roster.renumbered = self.forget_plans
        self._effects: dict[int, Effect] = {
            Instruction.WRITE: roster.write,
            Instruction.SYNC_WRITE: roster.write,
            Instruction.BULK_WRITE: roster.write,
            Instruction.REG_WRITE: roster.register,
            Instruction.ACTION: roster.act,
            Instruction.REBOOT: roster.reboot,
            Instruction.FACTORY_RESET: roster.factory_reset,
            Instruction.CLEAR: roster.clear,
            Instruction.CONTROL_TABLE_BACKUP: roster.restore,
        }
        self._makers: dict[Answers, Callable[[Request], list[Slot]]] = {
            Answers.NOBODY: lambda request: [],
            Answers.EVERYBODY: lambda request: [],
            Answers.PING: self._ping_slots,
            Answers.DATA: self._read_slots,
            Answers.LISTED: self._read_slots,
            Answers.COMBINED: self._read_slots,
            Answers.ACK: self._ack_slots,
        }

    def plan_for(self, body: bytes, stamp: int) -> Plan:
        """Return the plan of an instruction, from the body of its frame."""
        size = _KEY_SIZE.get(body[3])
        key = body if size is None else body[:size]
        plan = self.known.get(key)
        if plan is None:
            plan = self._learn(body, stamp)
            if plan.request.malformed:
                key = body             # another one of this key may well make sense
            size = plan.size + len(key) // BYTES_PER_SLOT
            if self._size + size > SLOTS_KEPT:
                self.forget_plans()
            self._size += size
            self.known[key] = plan
        return plan

    def plans(self) -> list[Plan]:
        """Return the plans in use, with what is counted of them elsewhere brought up to date."""
        for plan in self.known.values():
            self._count(plan)
        return list(self.known.values())

    def instructions(self) -> int:
        """Return how many instructions there were since start."""
        return self._retired + sum(plan.asked for plan in self.known.values())

    def forget_plans(self) -> None:
        """Start anew: there are too many, or an ID stands for another device now."""
        self.plans()
        self._retired = self.instructions()
        self.known.clear()
        self._lists.clear()
        self._size = 0

    def carry_out(self) -> None:
        """Do what the pending instruction asked for: it was accepted."""
        if self.deferred is not None:
            effect, arguments = self.deferred
            self.deferred = None
            effect(*arguments)

    def _count(self, plan: Plan) -> None:
        new = plan.asked - plan.counted
        plan.counted = plan.asked
        for kind in plan.oddities:
            self._evidence.counts[kind] += new
        for number, slot in plan.slots.items():
            if slot.due is Due.READ and number != BROADCAST:   # of a fast read: its first device
                slot.device.reads += new

    def _learn(self, body: bytes, stamp: int) -> Plan:
        request = parse(body[3], body[0], unstuff(body[4:]))
        plan = self._plan_of(request)
        oddities = _oddities(request, body)
        if oddities:
            plan.oddities = tuple(kind for kind, *_ in oddities)
            plan.counted = 1               # noted here, and it has no reads
            for kind, *what in oddities:
                self._evidence.note(stamp, kind, *what)
        return plan

    def _plan_of(self, request: Request) -> Plan:
        if request.id in NO_IDS:
            return Plan(request, {})
        slots = {slot.device.number: slot for slot in self._makers[request.answers](request)}
        if request.answers is Answers.COMBINED and slots:
            first = next(iter(slots.values())).device
            slots = {BROADCAST: Slot(first, Due.READ, 0, -6, _nowhere), **slots}
        return Plan(request, slots, self._beginner(request))

    def _ping_slots(self, request: Request) -> list[Slot]:
        device = self._roster.device(request.id)
        return [Slot(device, Due.ALWAYS, -1, 3, partial(self._roster.pinged, device))]

    def _read_slots(self, request: Request) -> list[Slot]:
        return [self._read_slot(access) for access in request.accesses if access.id <= MAX_ID]

    def _read_slot(self, access: Access) -> Slot:
        device = self._roster.device(access.id)
        end = access.address + access.length
        take: Take = device.table.store
        if any(access.address <= at < end for at in _TELLING):
            take = partial(self._roster.read_special, device)
        return Slot(device, Due.READ, access.address, access.length, take)

    def _ack_slots(self, request: Request) -> list[Slot]:
        device = self._roster.device(request.id)
        address = request.accesses[0].address if request.accesses else -1
        return [Slot(device, Due.ACK, address, 0, partial(self._acked, device))]

    def _acked(self, device: Device, address: int, data: bytes, stamp: int, source: int) -> None:
        device.acks = True
        device.acks_missing = 0
        self.carry_out()

    def _beginner(self, request: Request) -> Begin | None:
        """Return what a repetition of this instruction starts, None for one that only asks."""
        if request.instruction == Instruction.BULK_WRITE and request.accesses:
            return partial(self._bulk_write, request.malformed)
        effect = self._effects.get(request.instruction)
        if effect is None or request.malformed:
            return None
        if request.instruction == Instruction.SYNC_WRITE:
            return self._sync_write
        if request.id != BROADCAST:
            device = self._roster.device(request.id)
            if request.accesses:
                return partial(self._defer_write, effect, device, request.accesses[0].address)
            return partial(self._defer_command, effect, device, _arguments(request))
        if request.accesses:
            return partial(self._write_all, effect, request.accesses[0].address)
        return partial(self._command_all, effect, request)

    def _defer_write(self, effect: Effect, device: Device, address: int, body: bytes,
                     stamp: int) -> None:
        self.deferred = effect, (device, address, self._content(body, 6, stamp), stamp)

    def _defer_command(self, effect: Effect, device: Device, arguments: tuple[str, ...],
                       body: bytes, stamp: int) -> None:
        self.deferred = effect, (device, *arguments, stamp)

    def _sync_write(self, body: bytes, stamp: int) -> None:
        """Write to many. A robot sends nothing as often, so this is not parsed each time."""
        params = self._content(body, 4, stamp)
        address = params[0] | params[1] << 8
        size = params[2] | params[3] << 8
        ids = params[4::size + 1]
        if 4 + len(ids) * (size + 1) != len(params):
            self._note_malformed(body, stamp)      # once it is unstuffed
            return
        devices = self._lists.get(ids)
        if devices is None:
            if len(self._lists) >= LISTS_KEPT:
                self._lists.clear()
            devices = self._lists[ids] = [self._roster.device(number) for number in ids]
        at = 5
        for device in devices:                     # as Roster.write(), which costs a call more
            data = params[at:at + size]
            at += size + 1
            device.writes += 1
            device.table.store(address, data, stamp, WRITTEN)
            if address < device.eeprom_end or address <= device.level_at < address + size:
                self._roster.follow(device, address, data, stamp)

    def _bulk_write(self, is_known: bool, body: bytes, stamp: int) -> None:
        """Write what makes sense; is_known: that not all of it does is noted already."""
        params = self._content(body, 4, stamp)
        entries = bulk_write_entries(params)
        for number, address, data in entries:
            self._roster.write(self._roster.device(number), address, data, stamp)
        if not is_known and not is_whole_bulk_write(params, entries):
            self._note_malformed(body, stamp)

    def _note_malformed(self, body: bytes, stamp: int) -> None:
        self._evidence.note(stamp, ev.MALFORMED, body[0], body[3], len(body) - 4)

    def _content(self, body: bytes, at: int, stamp: int) -> bytes:
        """Return what is written, unstuffed; a master that does not stuff is worth a note."""
        data = body[at:]
        if _RUN not in data:
            return data
        if data.count(_RUN) != data.count(_RUN + b'\xfd'):
            self._evidence.note(stamp, ev.UNSTUFFED, body[0], body[3])
        return unstuff(data)

    def _write_all(self, effect: Effect, address: int, body: bytes, stamp: int) -> None:
        data = self._content(body, 6, stamp)
        devices = list(self._roster.devices.values())
        heard = [device for device in devices if device.heard]
        for device in devices:
            effect(device, address, data, stamp, heard == [device])

    def _command_all(self, effect: Effect, request: Request, body: bytes, stamp: int) -> None:
        if request.option == RESET_ALL:
            return             # X and MX ignore that one, lest all get the same ID
        for device in list(self._roster.devices.values()):
            effect(device, *_arguments(request), stamp)


def _oddities(request: Request, body: bytes) -> list[tuple[Any, ...]]:
    """Return what is odd about an instruction: the kinds of incident, each with its details."""
    number, instruction = request.id, request.instruction
    found: list[tuple[Any, ...]] = []
    if instruction not in NAMES:
        found.append((ev.UNKNOWN_INSTRUCTION, number, instruction))
    if request.malformed:
        found.append((ev.MALFORMED, number, instruction, len(body) - 4))
    if number in NO_IDS:
        found.append((ev.BAD_ID, ev.NOBODY, number))
    return found


def _arguments(request: Request) -> tuple[str, ...]:
    return (request.option,) if request.instruction in _WITH_OPTION else ()


def _nowhere(address: int, data: bytes, stamp: int, source: int) -> None:
    """Take nothing: a combined status is split first."""
