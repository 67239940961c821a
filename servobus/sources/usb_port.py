# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""
One serial port on USB: events of the bus become bytes with a side, and changes. Pure.

Bytes to the line are reported when the host handed them over, bytes from the line when they came
to the host. Neither is the time on the wire: an adapter gathers what it receives.
"""

from __future__ import annotations

from typing import NamedTuple

from msg_defs.event import Change
from msg_defs.event import Changes
from msg_defs.event import Chunk
from msg_defs.event import CLOSED
from msg_defs.event import GONE
from msg_defs.event import IN
from msg_defs.event import LOST
from msg_defs.event import NOT_SENT
from msg_defs.event import OUT
from servobus.sources.adapters import Adapter
from servobus.sources.adapters import Setup
from servobus.sources.usbmon import BULK
from servobus.sources.usbmon import CONTROL
from servobus.sources.usbmon import INPUT
from servobus.sources.usbmon import INTERRUPT
from servobus.sources.usbmon import KILLED
from servobus.sources.usbmon import UNPLUGGED
from servobus.sources.usbmon import UsbEvent

PENDING_TRANSFERS_MAX = 256        # transfers under way; a driver has 16 at most

UNPLUGGED_CHANGE = Change(GONE, 1)


class Place(NamedTuple):
    """Where a port is on USB; bulk endpoints without the bit of the direction, 0: any."""

    bus: int
    device: int
    bulk_in: int = 0
    bulk_out: int = 0

    @property
    def words(self) -> str:
        """How a person names it: '1.7', and with the endpoint where the chip has several."""
        return f'{self.bus}.{self.device}' + (f':{self.bulk_in}' if self.bulk_in > 1 else '')


class UsbPort:
    """
    The port at one place. Give it every event of the bus, or those of its device.

    It makes chunks of `name`, with the stamps of the events.
    """

    def __init__(self, place: Place, adapter: Adapter, name: str) -> None:
        self.place = place
        self.adapter = adapter
        self._name = name
        self._bulk = {place.bulk_in | INPUT: IN, place.bulk_out: OUT} if place.bulk_in else None
        self._setups: dict[int, bytes] = {}            # control transfers under way
        self._sizes: dict[int, int] = {}               # data on their way to the adapter

    def decode_event(self, event: UsbEvent) -> list[Chunk]:
        """Return what an event says about the port: bytes first, then changes."""
        if (event.bus, event.device) != self.place[:2]:
            return []
        if event.transfer == BULK:
            return self._decode_bulk(event)
        changes: Changes = []
        if event.transfer == CONTROL:
            changes = self._control(event)
        elif event.transfer == INTERRUPT and event.is_done:
            changes = self.adapter.interrupt(event.data) if event.is_input else []
            changes += _end_of(event)
        return self._chunks(event, '', b'', changes)

    def _decode_bulk(self, event: UsbEvent) -> list[Chunk]:
        if self._bulk is not None and event.endpoint not in self._bulk:
            return []
        if event.is_input:
            if not event.is_done:
                return []
            data, changes = self.adapter.received(event.data)
            return self._chunks(event, IN, data, _cut(event) + changes + _end_of(event))
        if not event.is_done:
            _remember(self._sizes, event.number, event.size)
            return self._chunks(event, OUT, event.data, _cut(event))
        missing = self._sizes.pop(event.number, event.size) - event.size
        if not event.status:
            return []
        return self._chunks(event, '', b'',
                            [Change(NOT_SENT, missing)] * (missing > 0) + _end_of(event))

    def _chunks(self, event: UsbEvent, side: str, data: bytes, changes: Changes) -> list[Chunk]:
        chunks = [Chunk(event.stamp, self._name, data, side)] if data else []
        return chunks + [Chunk(event.stamp, self._name, change=change) for change in changes]

    def _control(self, event: UsbEvent) -> Changes:
        """Join a control transfer: the setup comes first, what the device answers at the end."""
        if event.setup:
            _remember(self._setups, event.number, event.setup)
            setup = Setup.of(event.setup)
            return [] if setup.kind & INPUT else self.adapter.control(setup, event.data)
        packet = self._setups.get(event.number)
        if packet is None or not event.data:
            return []
        return self.adapter.control(Setup.of(packet), event.data)


def _cut(event: UsbEvent) -> Changes:
    """Return how many bytes a capture left out."""
    missing = event.size - len(event.data)
    return [Change(LOST, missing)] if missing > 0 else []


def _end_of(event: UsbEvent) -> Changes:
    """Return whether the port was closed or unplugged."""
    if event.status in UNPLUGGED[:1]:
        return [UNPLUGGED_CHANGE]
    return [Change(CLOSED, 1)] if event.status in KILLED else []


def _remember(memory: dict[int, bytes] | dict[int, int], number: int, what: object) -> None:
    """Keep something by the number of its transfer, and not more than can be under way."""
    memory[number] = what                              # type: ignore[assignment]
    if len(memory) > PENDING_TRANSFERS_MAX:
        del memory[next(iter(memory))]
