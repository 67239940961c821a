# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""
Plan: what an instruction makes the bus expect, worked out once for all its repetitions.

A master says the same few things over and over; what differs between them is the data. So the
tracker looks a plan up by the bytes that say who and where, and an answer finds its place by ID.
"""

from collections import deque
from collections.abc import Callable
from dataclasses import dataclass
from enum import Enum
from math import inf
from struct import Struct
from typing import Any

from msg_defs.crc import bare_crc16
from msg_defs.crc import CRC16_TABLE
from msg_defs.dxl_instruction import Access
from msg_defs.dxl_instruction import Answers
from msg_defs.dxl_instruction import Request
from msg_defs.dxl_packet import BROADCAST
from msg_defs.dxl_packet import HEADER_CRC
from servobus.bus.device import Device
from servobus.bus.evidence import UNKNOWN_INSTRUCTION
from servobus.bus.table import NO_SPAN
from servobus.bus.table import Span

# What takes an answer in: address and size, data, stamp, source (as Table.keep); returns True
# where the answer accepts what the instruction wrote.
Accept = Callable[[Span, bytes, int, int], bool | None]
# What an instruction does to a device, and with which arguments: the device, more, the stamp.
Action = Callable[..., None]
Effect = tuple[Action, tuple[Any, ...]]
# What one more instruction of a plan starts, from its parameters and stamp: the effect that
# waits for the device to accept it, None where nothing waits.
Begin = Callable[[bytes, int], Effect | None]
STAMPS_KEPT = 64
_NO_SIZE = -1
STATUS_OVERHEAD, STATUS_OVERHEAD_1 = 11, 6  # bytes of a status without its data; in the 1.0 family


class Due(Enum):
    """When a device must answer."""

    ALWAYS = 'at every Status Return Level'
    READ = 'at Status Return Level 1 and 2'
    ACK = 'at Status Return Level 2'


@dataclass(eq=False)
class Slot:
    """One expected status: from which device, of how many data, and where these go."""

    device: Device
    due: Due
    span: Span
    size: int
    accept: Accept

    @property
    def status_size(self) -> int:
        """How many bytes the status has on the wire."""
        return self.size + (STATUS_OVERHEAD if self.device.dialect is None else STATUS_OVERHEAD_1)


def combined_slot(first: Device) -> Slot:
    """
    Return the slot of the one status that answers a fast read; first is the device it begins with.

    No status has its size, so the tracker always looks closer at it, and splits it.
    """
    return Slot(first, Due.READ, NO_SPAN, _NO_SIZE, ignore_data)


def ignore_data(span: Span, data: bytes, stamp: int, source: int) -> None:
    """Store nothing: there are no data, or the parts of the status have slots of their own."""


class FastReply:
    """
    The whole fast reply to an instruction, each part with its own CRC.

    Struct takes all parts out of the body in one call: slices of each cost more.
    """

    def __init__(self, accesses: tuple[Access, ...], slots: dict[int, Slot]) -> None:
        self.slots = [slots[access.id] for access in accesses]
        self._ids = tuple(access.id for access in accesses)
        # The ID, length and 0x55 of the frame; then error byte, ID and data of each part. Its CRC
        # follows, but for the last part: that CRC is the one of the frame.
        self._fields = Struct('<4x' + 'H'.join(f'BB{access.length}s' for access in accesses))
        # What each of those CRCs covers beyond the one before, which it covers too.
        self._covered = Struct('<' + ''.join(
            f'{(6 if n == 0 else 4) + access.length}s'
            for n, access in enumerate(accesses[:-1])))

    def unpack(self, body: bytes) -> tuple[Any, ...]:
        """
        Return error byte, ID, data and CRC of all parts in a row; () unless each part holds.

        The last CRC alone does not tell: a device takes its CRC from what it heard, so that one
        is right too where an earlier part was damaged on the way.
        """
        if len(body) != self._fields.size:
            return ()
        fields = self._fields.unpack(body)
        if fields[1::4] != self._ids:
            return ()
        crc = HEADER_CRC
        for covered, sent in zip(self._covered.unpack_from(body), fields[3::4], strict=True):
            crc = bare_crc16(covered, crc, CRC16_TABLE)
            if crc != sent:
                return ()
        return fields


class Plan:
    """
    One instruction. slots: who must answer, in the order of answering, by ID.

    The combined status of a fast read is the first of the slots, under the broadcast ID;
    fast_reply: what it is made of, None where a part of it has no slot. oddities: the kinds
    of incident that each of these instructions is; the first is noted, the others are counted.
    """

    def __init__(self, request: Request, slots: dict[int, Slot],
                 begin: Begin | None = None) -> None:
        self.request = request
        self.slots = slots
        self.first = next((slot.device for slot in slots.values()), None)
        self.fast_reply = FastReply(request.accesses, slots) if BROADCAST in slots \
            and request.answers is not Answers.ADAPTER and all(
                access.id in slots for access in request.accesses) else None
        self.begin = begin
        self.oddities: tuple[str, ...] = ()
        self.asked = 0
        self.counted = 0                   # how many of them the devices' counts include
        self.missed = 0
        self.stamps: deque[int] = deque(maxlen=STAMPS_KEPT)

    def asks(self, device: Device, size: int) -> bool:
        """Return whether a device has to answer it with so many bytes."""
        slot = self.slots.get(device.number)
        return slot is not None and slot.size == size

    def damaged_parts(self, there: int, last_whole: int,
               silent: dict[int, Slot]) -> tuple[list[Slot], list[int]]:
        """
        Return the IDs with a damaged part in a fast reply, and those where that is not known.

        there: how many parts came; last_whole: the ID of the last good one, after which only the
        first is surely damaged; silent: the slots without a good part.
        """
        ids = [access.id for access in self.request.accesses[:there]]
        known = ids.index(last_whole) + 1 if last_whole in ids else 0
        bad = [number for number in ids if number in silent]
        sure = [number for number in bad if ids.index(number) < known or number == bad[0]]
        return [silent[number] for number in sure], [one for one in bad if one not in sure]

    def find_blocker(self, due: list[Slot], damaged_ids: set[int]) -> tuple[int, int]:
        """
        Return how many of the due had their turn, and the ID that the others wait for.

        due: the slots without an answer, in order; damaged_ids: IDs with a damaged answer.
        """
        if len(due) == 1 and not damaged_ids:
            return 1, due[0].device.number     # the usual case, without a look at all slots
        if self.request.answers is Answers.ADAPTER:
            return len(due), due[-1].device.number     # it waits for each of them itself
        waiting, silent = 0, set(due)
        for slot in reversed(self.slots.values()):
            if slot.device.number in damaged_ids:
                return len(due) - waiting, slot.device.number
            if slot not in silent:
                break
            waiting += 1
        served = len(due) - max(0, waiting - 1)
        return served, due[served - 1].device.number

    @property
    def answers_size(self) -> float:
        """How many bytes answer it, infinite where that is not known."""
        known = self.slots and BROADCAST not in self.slots
        return sum(slot.status_size for slot in self.slots.values()) if known else inf

    @property
    def is_understood(self) -> bool:
        """Whether it is known who answers it."""
        return not self.request.malformed and UNKNOWN_INSTRUCTION not in self.oddities

    @property
    def slots_size(self) -> int:
        """How much memory it takes, in slots; a plan by itself is as large as eight."""
        return 8 + len(self.slots) + len(self.request.accesses)
