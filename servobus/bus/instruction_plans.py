# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""
Planner: instruction packets to Plans, each kind worked out once; and what they do once accepted.

A write to one device takes effect when the device acknowledges it, or does not refuse it: what
the device refuses never gets into its table. Where no answer is due it takes effect at once.
"""

from collections.abc import Container
from functools import partial
from itertools import islice
from struct import Struct
from typing import Any

from msg_defs.dxl1_instruction import CALIBRATE
from msg_defs.dxl1_instruction import parse_widened
from msg_defs.dxl_instruction import Access
from msg_defs.dxl_instruction import Answers
from msg_defs.dxl_instruction import bulk_write_entries
from msg_defs.dxl_instruction import Instruction
from msg_defs.dxl_instruction import is_whole_bulk_write
from msg_defs.dxl_instruction import KINDS
from msg_defs.dxl_instruction import NAMES
from msg_defs.dxl_instruction import parse
from msg_defs.dxl_instruction import Request
from msg_defs.dxl_instruction import RESET_ALL
from msg_defs.dxl_instruction import span_at
from msg_defs.dxl_packet import BROADCAST
from msg_defs.servo_frame import INSTRUCTION_2
from servobus.bus import evidence as ev
from servobus.bus.device import Device
from servobus.bus.evidence import Evidence
from servobus.bus.expected_devices import MAX_ID_1
from servobus.bus.plan import Accept
from servobus.bus.plan import Action
from servobus.bus.plan import Begin
from servobus.bus.plan import combined_slot
from servobus.bus.plan import Due
from servobus.bus.plan import Plan
from servobus.bus.plan import Slot
from servobus.bus.registry import DeviceRegistry
from servobus.bus.table import NO_SPAN
from servobus.bus.table import WRITTEN

PLANS_SEARCHED = 64                # a master repeats fewer
TARGETS_KEPT = 64                  # different lists of IDs in Sync Writes
SLOTS_KEPT = 32_768                # the size of all plans together: 3000 different reads
BYTES_PER_SLOT = 32                # so many bytes of a plan's key count as one slot
_ADDRESS_SIZE = 2                  # in front of what is written
NO_PLAN = Plan(Request(0, 0xFF, Answers.NONE), {})

_KEY_SIZE = {code: kind.key_size for code, kind in KINDS.items()}
# What makes two instructions differ: kind, ID, code, parameters; where there are data to
# write, the parameters in front of them, and how many there are in all.
RawInstruction = tuple[int, int, int, bytes]
Key = RawInstruction | tuple[int, int, int, bytes, int]
# One device of a Sync Write; whether the write may change what the device is or does.
Target = tuple[Device, Accept, bool]


class Planner:
    """The plans of one bus."""

    def __init__(self, registry: DeviceRegistry, evidence: Evidence) -> None:
        self._registry = registry
        self._evidence = evidence
        self.known: dict[Key, Plan] = {}
        self._size = 0                 # size of all plans, in slots
        # Of a Sync Write, by address, size and IDs.
        self._targets: dict[bytes, tuple[list[Target], Struct]] = {}
        self._retired = 0              # instructions of forgotten plans
        self._actions: dict[int, Action] = {
            Instruction.WRITE: registry.write,
            Instruction.SYNC_WRITE: registry.write,
            Instruction.BULK_WRITE: registry.write,
            Instruction.REG_WRITE: registry.register_write,
            Instruction.ACTION: registry.write_registered,
            Instruction.REBOOT: registry.reboot,
            Instruction.FACTORY_RESET: registry.factory_reset,
            Instruction.CLEAR: registry.clear,
            Instruction.CONTROL_TABLE_BACKUP: registry.restore,
            CALIBRATE: registry.calibrate,
        }

    def plan_for(self, raw: RawInstruction, stamp: int) -> Plan:
        """Return the plan of an instruction: kind, ID, code and parameters of its frame."""
        kind, number, code, params = raw
        size = _KEY_SIZE.get(code)
        key: Key = raw
        if size is not None:
            key = kind, number, code, params[:size], len(params)
        plan = self.known.get(key)
        if plan is None:
            plan = self._make_plan(raw, stamp)
            if plan.request.malformed:
                key = raw             # another with this front may well make sense
            size = plan.slots_size + (4 + len(key[3])) // BYTES_PER_SLOT
            if self._size + size > SLOTS_KEPT or not self._registry.plans_hold:
                self.forget_plans()
            self._size += size
            self.known[key] = plan
        return plan

    def request_of(self, raw: RawInstruction) -> Request:
        """Return what an instruction says, with its own data; a plan has those of its first."""
        kind, id, code, params = raw
        if kind == INSTRUCTION_2:
            return parse(code, id, params)
        return parse_widened(kind, code, id, params, self._registry.dialect)

    def updated_plans(self) -> list[Plan]:
        """Return the plans in use, with what is counted of them elsewhere brought up to date."""
        if not self._registry.plans_hold:
            self.forget_plans()
        for plan in self.known.values():
            self._count_repetitions(plan)
        return list(self.known.values())

    def has_answer(self, number: int, size: int) -> bool:
        """Return whether an instruction of this master has an answer with so many data."""
        return any(number in plan.slots and plan.slots[number].size == size
                   for plan in islice(self.known.values(), PLANS_SEARCHED))

    def instruction_count(self) -> int:
        """Return how many instructions there were since start."""
        return self._retired + sum(plan.asked for plan in self.known.values())

    def forget_plans(self) -> None:
        """Begin again: there are too many plans, or they are outdated."""
        self._registry.plans_hold = True
        self.updated_plans()
        self._retired = self.instruction_count()
        self.known.clear()
        self._targets.clear()
        self._size = 0

    def _count_repetitions(self, plan: Plan) -> None:
        new = plan.asked - plan.counted
        plan.counted = plan.asked
        for kind in plan.oddities:
            self._evidence.counts[kind] += new
        for number, slot in plan.slots.items():
            if slot.due is Due.READ and number != BROADCAST:   # a fast read: its first device
                slot.device.counts.reads += new

    def _make_plan(self, raw: RawInstruction, stamp: int) -> Plan:
        kind, id, code, params = raw
        names: Container[int] = NAMES
        request = self.request_of(raw)
        if kind != INSTRUCTION_2:
            names = self._registry.dialect.entries
            self._registry.highest = MAX_ID_1
            for number in {request.id, *(access.id for access in request.accesses)} - {BROADCAST}:
                self._registry.set_device_dialect(self._registry.device(number))
        if code != Instruction.SYNC_WRITE:     # see _find_targets()
            for access in request.accesses:
                self._registry.device(access.id).record_use(access.address, access.length)
        oddities: list[tuple[Any, ...]] = []         # arguments of add_incident()
        if code not in names:
            oddities.append((ev.UNKNOWN_INSTRUCTION, id, code))
        if request.malformed:
            oddities.append((ev.MALFORMED, id, code, len(params)))
        if self._registry.is_impossible_id(request.id):
            oddities.append((ev.BAD_ID, ev.NO_DEVICE, id))
            plan = Plan(request, {})
        else:
            plan = self._plan_of(request, code in names)
        if oddities:
            plan.oddities = tuple(one for one, *_ in oddities)
            plan.counted = 1               # noted here, and it has no reads
            for one in oddities:
                self._evidence.add_incident(stamp, *one)
        return plan

    def _plan_of(self, request: Request, is_known: bool) -> Plan:
        slots = {slot.device.number: slot for slot in self._slots_of(request)}
        if request.answers is Answers.COMBINED and slots:
            first = next(iter(slots.values())).device
            slots = {BROADCAST: combined_slot(first), **slots}
        elif request.answers is Answers.ADAPTER and slots:
            slots[BROADCAST] = combined_slot(next(reversed(slots.values())).device)
        return Plan(request, slots, self._begin_of(request) if is_known else None)

    def _slots_of(self, request: Request) -> list[Slot]:
        """Return the statuses that answer an instruction, one of each device."""
        if request.answers in (Answers.NONE, Answers.EVERYBODY):
            return []
        if request.answers not in (Answers.PING, Answers.ACK):
            return [self._read_slot(access) for access in request.accesses
                    if access.id <= self._registry.highest]
        device = self._registry.device(request.id)
        if request.answers is Answers.ACK:
            return [Slot(device, Due.ACK, (request.address, 0), 0, device.accept_ack)]
        size = 3 if device.dialect is None else 0      # the 1.0 family answers without data
        return [Slot(device, Due.ALWAYS, NO_SPAN, size, device.accept_pong)]

    def _read_slot(self, access: Access) -> Slot:
        device = self._registry.device(access.id)
        accept: Accept = device.table.keep
        if device.is_defined_by(access.address, access.length):
            accept = partial(self._registry.accept_defining_read, device)
        return Slot(device, Due.READ, (access.address, access.length), access.length, accept)

    def _begin_of(self, request: Request) -> Begin | None:
        """Return what a repetition of this instruction starts, None for one that only asks."""
        if request.instruction == Instruction.BULK_WRITE and request.accesses:
            return partial(self._bulk_write, request.malformed)
        action = self._actions.get(request.instruction)
        if action is None or request.malformed:
            return None
        if request.instruction == Instruction.SYNC_WRITE:
            return self._sync_write
        if request.id != BROADCAST:
            device = self._registry.device(request.id)
            if request.accesses:
                address = request.address
                return lambda params, stamp: (
                    action, (device, address, params[_ADDRESS_SIZE:], stamp))
            arguments = _arguments(request)
            return lambda _, stamp: (action, (device, *arguments, stamp))
        if request.accesses:
            return partial(self._write_all, action, request.address)
        return partial(self._command_all, action, request)

    def _sync_write(self, params: bytes, stamp: int) -> None:
        """Write to many. Robots send this most of all, so it is not parsed each time."""
        span = address, size = span_at(params)
        ids = params[4::size + 1]
        if 4 + len(ids) * (size + 1) != len(params):
            self._add_malformed(Instruction.SYNC_WRITE, params, stamp)
            return
        key = params[:4] + ids
        targets, layout = self._targets.get(key) or self._find_targets(key, address, size, ids)
        parts = layout.unpack_from(params, 4)      # all at once: slices of each cost more
        for (device, keep, is_changed), data in zip(targets, parts, strict=True):
            device.counts.writes += 1              # DeviceRegistry.write() costs a call more
            if is_changed or device.is_unresolved:
                self._registry.follow_write(device, address, data, stamp)
            keep(span, data, stamp, WRITTEN)

    def _find_targets(self, key: bytes, address: int, size: int,
                      ids: bytes) -> tuple[list[Target], Struct]:
        """Return the devices of a Sync Write, and the layout of ID and data of each."""
        if len(self._targets) >= TARGETS_KEPT:
            self._targets.clear()
        devices = [self._registry.device(number) for number in ids]
        for device in devices:
            device.record_use(address, size)
        found = self._targets[key] = [
            (one, one.table.keep, one.is_changed_by(address, size))
            for one in devices], Struct(f'x{size}s' * len(ids))
        return found

    def _bulk_write(self, is_known: bool, params: bytes, stamp: int) -> None:
        """Write what makes sense; is_known: that not all of it does is noted already."""
        entries = bulk_write_entries(params)
        for number, address, data in entries:
            self._registry.write(self._registry.device(number), address, data, stamp)
        if not is_known and not is_whole_bulk_write(params, entries):
            self._add_malformed(Instruction.BULK_WRITE, params, stamp)

    def _add_malformed(self, code: int, params: bytes, stamp: int) -> None:
        self._evidence.add_incident(stamp, ev.MALFORMED, BROADCAST, code, len(params))

    def _write_all(self, action: Action, address: int, params: bytes, stamp: int) -> None:
        devices = list(self._registry.devices.values())
        heard = [device for device in devices if device.heard]
        for device in devices:
            action(device, address, params[_ADDRESS_SIZE:], stamp, heard == [device])

    def _command_all(self, action: Action, request: Request, params: bytes, stamp: int) -> None:
        if request.option == RESET_ALL:
            return             # X and MX ignore it: all would get the same ID
        for device in list(self._registry.devices.values()):
            action(device, *_arguments(request), stamp)


def _arguments(request: Request) -> tuple[str, ...]:
    kind = KINDS.get(request.instruction)
    return (request.option,) if kind is not None and kind.options else ()
