# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""
One serial port on USB: events of the bus become bytes with a side, and changes. Pure.

Bytes to the line are reported when the host handed them over, bytes from the line when they came
to the host. Neither is the time on the wire: an adapter gathers what it receives.
"""

from __future__ import annotations

from typing import Any
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
from servobus.sources.usbmon import DONE
from servobus.sources.usbmon import FRONT
from servobus.sources.usbmon import header_key
from servobus.sources.usbmon import HEADER_SIZE
from servobus.sources.usbmon import INPUT
from servobus.sources.usbmon import INTERRUPT
from servobus.sources.usbmon import KILLED
from servobus.sources.usbmon import SUBMITTED
from servobus.sources.usbmon import UNPLUGGED
from servobus.sources.usbmon import UsbEvent

PENDING_TRANSFERS_MAX = 256        # transfers under way; a driver has 16 at most

UNPLUGGED_CHANGE = Change(GONE, 1)
_SENT = 'sent'                     # the end of an output


class Place(NamedTuple):
    """Where a port is on USB; bulk endpoints without the bit of the direction."""

    bus: int
    device: int
    bulk_in: int
    bulk_out: int

    @property
    def words(self) -> str:
        """How a person names it: '1.7', and with the endpoint where the chip has several."""
        return f'{self.bus}.{self.device}' + (f':{self.bulk_in}' if self.bulk_in > 1 else '')


class UsbPort:
    """
    The port at one place. Give it every event of the bus, or those of its device.

    It makes chunks of `name`, with the stamps of the events; `later`: ns to another clock.
    """

    def __init__(self, place: Place, adapter: Adapter, name: str) -> None:
        self.place = place
        self.adapter = adapter
        self._name = name
        self.later = 0                                 # ns that are added to stamps
        self._setups = Setups()
        self._sizes: dict[int, int] = {}               # data on their way to the adapter
        self._sides = {(place.bulk_in | INPUT, True): IN, (place.bulk_out, False): OUT,
                       (place.bulk_out, True): _SENT}
        # The same by the 8 bytes of a header that tell it.
        self._kinds = {
            header_key(DONE if is_done else SUBMITTED, endpoint, place.device, place.bus,
                       ord('>') if side is _SENT else 0): side
            for (endpoint, is_done), side in self._sides.items()}

    def skim(self, data: bytes, at: int, decoded: list[Chunk]) -> int:
        """
        Decode the whole bulk transfers that begin here and did not fail, for Records.events().

        Nearly all events are of that kind: it takes half of the time of decode_event(), which
        returns the same chunks.
        """
        unpack, side_of, transfer = FRONT.unpack_from, self._kinds.get, self._transfer
        size = len(data)
        last = size - HEADER_SIZE
        while at <= last:
            number, kind, seconds, us, status, moved, kept = unpack(data, at)
            side = side_of(kind)
            begin = at + HEADER_SIZE
            end = begin + kept
            if side is None or end > size or kept > moved or (status and side is not OUT) \
                    or not 0 <= us < 1_000_000 or seconds < 0:
                break
            stamp = seconds * 1_000_000_000 + us * 1000 + self.later
            decoded += transfer(side, number, data[begin:end], moved, status, stamp)
            at = end
        return at

    def decode_event(self, event: UsbEvent) -> list[Chunk]:
        """Return what an event says about the port: bytes first, then changes."""
        if (event.bus, event.device) != self.place[:2]:
            return []
        chunks: list[Chunk] = []
        changes: Changes = []
        stamp = event.stamp + self.later
        if event.transfer == BULK:
            side = self._sides.get((event.endpoint, event.is_done))
            if side is not None:
                chunks = self._transfer(side, event.number, event.data, event.size,
                                        event.status, stamp)
                changes = _end_of(event)
        elif event.transfer == CONTROL:
            changes = self._control(event)
        elif event.transfer == INTERRUPT and event.is_done:
            changes = self.adapter.interrupt(event.data) if event.is_input else []
            changes += _end_of(event)
        return chunks + [Chunk(stamp, self._name, change=change) for change in changes]

    def _transfer(self, side: str, number: int, data: bytes, size: int, status: int, stamp: int
                  ) -> list[Chunk]:
        """Return what a bulk transfer of so many bytes says; data: those that were kept."""
        changes: Changes = []
        if side is _SENT:
            missing, data = self._sizes.pop(number, size) - size, b''
            if status and missing > 0:         # Windows says 0 for what went well
                changes = [Change(NOT_SENT, missing)]
        else:
            if len(data) < size:
                changes = [Change(LOST, size - len(data))]
            if side is IN:
                data, found = self.adapter.received(data)
                changes += found
            else:
                _remember(self._sizes, number, size)
        chunks = [Chunk(stamp, self._name, data, side)] if data else []
        if changes:
            chunks += [Chunk(stamp, self._name, change=change) for change in changes]
        return chunks

    def _control(self, event: UsbEvent) -> Changes:
        setup = self._setups.setup_of(event)
        # What is asked for comes with the setup, what the device answers at the end.
        if setup is None or (setup.kind & INPUT if event.setup else not event.data):
            return []
        return self.adapter.control(setup, event.data)


def _end_of(event: UsbEvent) -> Changes:
    """Return whether the port was closed or unplugged; what was only asked for says nothing."""
    if event.status == UNPLUGGED:
        return [UNPLUGGED_CHANGE]
    return [Change(CLOSED, 1)] if event.status in KILLED else []


def _remember(transfers: dict[Any, Any], number: object, kept: object) -> None:
    """Keep something by the number of its transfer, and not more than can be under way."""
    transfers[number] = kept
    if len(transfers) > PENDING_TRANSFERS_MAX:
        del transfers[next(iter(transfers))]


class Setups:
    """The setup packets of the control transfers under way: only its beginning has one."""

    def __init__(self) -> None:
        self._packets: dict[tuple[int, int, int], bytes] = {}

    def setup_of(self, event: UsbEvent) -> Setup | None:
        """Return that of the transfer of an event, None where its beginning was not seen."""
        key = event.bus, event.device, event.number
        if event.setup:
            _remember(self._packets, key, event.setup)
        packet = self._packets.get(key)
        return None if packet is None else Setup.of(packet)
