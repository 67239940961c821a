# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""
Plan: what an instruction makes the bus expect, worked out once for all its repetitions.

A master says the same few things over and over; what differs between them is the data. So the
tracker looks a plan up by the bytes that say who and where, and an answer finds its place by ID.
"""

from collections import deque
from collections.abc import Callable
from enum import Enum
from typing import Any
from typing import NamedTuple

from dxl_monitor.bus.device import Device
from dxl_monitor.bus.evidence import UNKNOWN_INSTRUCTION
from dxl_monitor.bus.table import READ
from msg_defs.crc import bare_crc16
from msg_defs.crc import CRC16_TABLE
from msg_defs.dxl_instruction import Request
from msg_defs.dxl_packet import BROADCAST
from msg_defs.dxl_packet import HEADER_CRC

# What takes an answer in: address, data, stamp, source (as Table.store).
Take = Callable[[int, bytes, int, int], object]
# What an instruction does to a device, and with which arguments: the device, more, the stamp.
Action = Callable[..., None]
Effect = tuple[Action, tuple[Any, ...]]
# What one more instruction of a plan starts, from its body and stamp; it returns the effect that
# waits for the device to accept it, None where nothing waits.
Begin = Callable[[bytes, int], Effect | None]
STAMPS_KEPT = 64
_FIRST_PART = 4                    # offset in the body of a fast reply: id, length, 0x55
_STATUS_FRONT = 5                  # a status body before its data: id, length, 0x55, error
_NO_SIZE = -1


class Due(Enum):
    """When a device must answer."""

    ALWAYS = 'at every Status Return Level'
    READ = 'at Status Return Level 1 and 2'
    ACK = 'at Status Return Level 2'


class Slot:
    """One expected status: from which device, how long its body is, and where its data go."""

    __slots__ = ('address', 'device', 'due', 'size', 'take')

    def __init__(self, device: Device, due: Due, address: int, length: int, take: Take) -> None:
        self.device = device
        self.due = due
        self.address = address
        self.size = _STATUS_FRONT + length
        self.take = take


def combined_slot(first: Device) -> Slot:
    """
    Return the slot of the one status that answers a fast read; first is the device it begins with.

    No status has its size, so the tracker always looks closer at it, and splits it.
    """
    slot = Slot(first, Due.READ, 0, 0, take_nothing)
    slot.size = _NO_SIZE
    return slot


def take_nothing(address: int, data: bytes, stamp: int, source: int) -> None:
    """Store nothing: there are no data, or the parts of the status have slots of their own."""


class FastPart(NamedTuple):
    """
    Where a device stands in a whole fast reply: offsets in its body, which begins with the ID.

    at: of its error byte; end: behind its data, where the CRC is that covers all before it;
    id: what stands behind the error byte.
    """

    at: int
    end: int
    id: int
    slot: Slot


class Plan:
    """
    One instruction. slots: who must answer, in the order of answering, by ID.

    The combined status of a fast read is the first of the slots, under the broadcast ID; parts:
    what it is made of, empty where one of them has no slot.
    oddities: the kinds of incident that each of these instructions is; the first is noted, the
    others are counted.
    """

    __slots__ = ('asked', 'begin', 'counted', 'missed', 'oddities', 'parts', 'request', 'slots',
                 'stamps')

    def __init__(self, request: Request, slots: dict[int, Slot], begin: Begin | None = None,
                 oddities: tuple[str, ...] = ()) -> None:
        self.request = request
        self.slots = slots
        self.parts = _parts(request, slots) if BROADCAST in slots else ()
        self.begin = begin
        self.oddities = oddities
        self.asked = 0
        self.counted = 0                   # how many of them the devices' counts include
        self.missed = 0
        self.stamps: deque[int] = deque(maxlen=STAMPS_KEPT)

    def take_whole(self, body: bytes, stamp: int,
                   answer: Callable[[Slot, int, bytes, int], object]) -> bool:
        """
        Take a fast reply of which every part holds; leave any other as it is and return False.

        answer: takes a part that needs more than storing: slot, error byte, data, stamp.
        """
        if not _all_hold(body, self.parts):
            return False
        for at, end, _, slot in self.parts:
            device = slot.device
            device.counts.fast_answers += 1
            if body[at] or device.odd:
                answer(slot, body[at], body[at + 2:end], stamp)
            else:
                device.counts.answers += 1
                device.heard = stamp
                device.last_error = 0
                slot.take(slot.address, body[at + 2:end], stamp, READ)
        return True

    def failed(self, there: int, last_whole: int,
               silent: dict[int, Slot]) -> tuple[list[Slot], list[int]]:
        """
        Return the IDs with a damaged part in a fast reply, and those where that is not known.

        there: how many parts came; last_whole: the ID of the last good one, behind which only the
        first is surely damaged; silent: the slots without a good part.
        """
        ids = [access.id for access in self.request.accesses[:there]]
        known = ids.index(last_whole) + 1 if last_whole in ids else 0
        bad = [number for number in ids if number in silent]
        sure = [number for number in bad if ids.index(number) < known or number == bad[0]]
        return [silent[number] for number in sure], [one for one in bad if one not in sure]

    def served(self, due: list[Slot], spoke: set[int]) -> tuple[int, int]:
        """
        Return how many of the due had their turn, and the ID that the others wait behind.

        due: the slots without an answer, in order; spoke: IDs with a damaged answer.
        """
        waiting, silent = 0, set(due)
        for slot in reversed(self.slots.values()):
            if slot.device.number in spoke:
                return len(due) - waiting, slot.device.number
            if slot not in silent:
                break
            waiting += 1
        served = len(due) - max(0, waiting - 1)
        return served, due[served - 1].device.number

    @property
    def is_understood(self) -> bool:
        """Whether it is known who answers it."""
        return not self.request.malformed and UNKNOWN_INSTRUCTION not in self.oddities

    @property
    def size(self) -> int:
        """How much memory it takes, in slots; a plan by itself is as large as eight."""
        return 8 + len(self.slots) + len(self.request.accesses)

    @property
    def address(self) -> int:
        """The address it is about, -1 if none."""
        return self.request.accesses[0].address if self.request.accesses else -1


def _parts(request: Request, slots: dict[int, Slot]) -> tuple[FastPart, ...]:
    parts: list[FastPart] = []
    at = _FIRST_PART
    for access in request.accesses:
        if access.id not in slots:
            return ()
        end = at + 2 + access.length
        parts.append(FastPart(at, end, access.id, slots[access.id]))
        at = end + 2
    return tuple(parts)


def _all_hold(body: bytes, parts: tuple[FastPart, ...]) -> bool:
    """
    Return whether a good frame is the whole fast reply of these parts, each with its own CRC.

    The last CRC alone does not tell: a device takes its CRC from what it heard, so that one is
    right too where an earlier part was damaged on the way.
    """
    if not parts or len(body) != parts[-1][1]:
        return False
    crc = HEADER_CRC
    covered = 0                    # bytes that crc covers
    for at, end, number, _ in parts:
        if body[at + 1] != number:
            return False
        if end == len(body):
            break                  # its CRC is that of the frame
        crc = bare_crc16(body[covered:end], crc, CRC16_TABLE)
        if crc != body[end] | body[end + 1] << 8:
            return False
        covered = end
    return True
