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

from dxl_monitor.device import Device
from msg_defs.dxl_instruction import NAMES
from msg_defs.dxl_instruction import Request

# What takes an answer in: address, data, stamp, source (as Table.store).
Take = Callable[[int, bytes, int, int], None]
Begin = Callable[[bytes, int], None]
STAMPS_KEPT = 64


class Due(Enum):
    """When a device must answer."""

    ALWAYS = 'at every Status Return Level'
    READ = 'at Status Return Level 1 and 2'
    ACK = 'at Status Return Level 2'


class Slot:
    """One expected status: whose, how long its body is, and where its data go."""

    __slots__ = ('address', 'device', 'due', 'size', 'take')

    def __init__(self, device: Device, due: Due, address: int, length: int, take: Take) -> None:
        self.device = device
        self.due = due
        self.address = address
        self.size = 5 + length             # of the body of a status: id, length, 0x55, error
        self.take = take


class Plan:
    """
    One instruction. slots: who must answer, in the order of answering, by ID.

    Of a fast read the combined status is the first of the slots, under the broadcast ID. begin:
    what one more of these instructions starts, from its body and stamp. oddities: the kinds of
    incident that each of them is; the first is noted, the others are counted.
    """

    __slots__ = ('asked', 'begin', 'counted', 'missed', 'oddities', 'request', 'slots', 'stamps')

    def __init__(self, request: Request, slots: dict[int, Slot], begin: Begin | None = None,
                 oddities: tuple[str, ...] = ()) -> None:
        self.request = request
        self.slots = slots
        self.begin = begin
        self.oddities = oddities
        self.asked = 0
        self.counted = 0                   # of `asked`: already counted elsewhere too
        self.missed = 0
        self.stamps: deque[int] = deque(maxlen=STAMPS_KEPT)

    @property
    def is_understood(self) -> bool:
        """Whether it is known who answers it."""
        return self.request.instruction in NAMES and not self.request.malformed

    @property
    def size(self) -> int:
        """How much memory it takes, in slots; a plan by itself is as large as eight."""
        return 8 + len(self.slots) + len(self.request.accesses)

    @property
    def address(self) -> int:
        """The address it is about, -1 if none."""
        return self.request.accesses[0].address if self.request.accesses else -1
