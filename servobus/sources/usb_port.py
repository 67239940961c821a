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
from msg_defs.event import UNKNOWN
from servobus.sources.adapters import Adapter
from servobus.sources.adapters import Setup
from servobus.sources.usbmon import BULK
from servobus.sources.usbmon import CONTROL
from servobus.sources.usbmon import DONE
from servobus.sources.usbmon import FRONT
from servobus.sources.usbmon import HEADER_SIZE
from servobus.sources.usbmon import INPUT
from servobus.sources.usbmon import INTERRUPT
from servobus.sources.usbmon import KILLED
from servobus.sources.usbmon import SUBMITTED
from servobus.sources.usbmon import UNPLUGGED
from servobus.sources.usbmon import UsbEvent
from servobus.sources.usbmon import what_key

PENDING_TRANSFERS_MAX = 256        # transfers under way; a driver has 16 at most

UNPLUGGED_CHANGE = Change(GONE, 1)
_NO_CHANGES: Changes = []
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
        self._kinds = _kinds(place)

    def skim(self, data: bytes, at: int, decoded: list[Chunk]) -> int:
        """
        Decode the whole bulk transfers that begin here and did not fail, for Records.events().

        Nearly all events are of that kind: it takes a third of the time. decode_event() returns
        the same chunks.
        """
        unpack, kind_of, received = FRONT.unpack_from, self._kinds.get, self.adapter.received
        name, later = self._name, self.later
        size = len(data)
        last = size - HEADER_SIZE
        while at <= last:
            number, kind, seconds, us, status, moved, kept = unpack(data, at)
            side = kind_of(kind)
            begin = at + HEADER_SIZE
            end = begin + kept
            if side is None or end > size or not 0 <= us < 1_000_000 or seconds < 0:
                break
            if side is _SENT:
                if status or kept:
                    break
                self._sizes.pop(number, None)
            elif kept != moved or (status and side is IN):
                break
            else:
                line, changes = data[begin:end], _NO_CHANGES
                if side is IN:
                    line, changes = received(line)
                else:
                    _remember(self._sizes, number, moved)
                stamp = seconds * 1_000_000_000 + us * 1000 + later
                if line:
                    decoded.append(Chunk(stamp, name, line, side))
                decoded += [Chunk(stamp, name, change=change) for change in changes]
            at = end
        return at

    def decode_event(self, event: UsbEvent) -> list[Chunk]:
        """Return what an event says about the port: bytes first, then changes."""
        if (event.bus, event.device) != self.place[:2]:
            return []
        changes: Changes = []
        data, side = b'', UNKNOWN
        if event.transfer == BULK:
            data, side, changes = self._bulk_data(event)
        elif event.transfer == CONTROL:
            changes = self._control(event)
        elif event.transfer == INTERRUPT and event.is_done:
            changes = self.adapter.interrupt(event.data) if event.is_input else []
            changes += _end_of(event)
        stamp = event.stamp + self.later
        chunks = [Chunk(stamp, self._name, data, side)] if data else []
        return chunks + [Chunk(stamp, self._name, change=change) for change in changes]

    def _bulk_data(self, event: UsbEvent) -> tuple[bytes, str, Changes]:
        endpoint, is_done, status, number, _, data, size = event[3:4] + event[5:]
        if endpoint not in (self.place.bulk_in | INPUT, self.place.bulk_out):
            return b'', UNKNOWN, []
        if endpoint & INPUT:
            if not is_done:
                return b'', UNKNOWN, []
            line, changes = self.adapter.received(data)
            if status or len(data) < size:
                changes = _cut(event) + changes + _end_of(event)
            return line, IN, changes
        if not is_done:
            _remember(self._sizes, number, size)
            return data, OUT, _cut(event) if len(data) < size else []
        missing = self._sizes.pop(number, size) - size
        if not status:
            return b'', UNKNOWN, []
        return b'', UNKNOWN, [Change(NOT_SENT, missing)] * (missing > 0) + _end_of(event)

    def _control(self, event: UsbEvent) -> Changes:
        setup = self._setups.setup_of(event)
        # What is asked for comes with the setup, what the device answers at the end.
        if setup is None or (setup.kind & INPUT if event.setup else not event.data):
            return []
        return self.adapter.control(setup, event.data)


def _cut(event: UsbEvent) -> Changes:
    """Return how many bytes a capture left out."""
    missing = event.size - len(event.data)
    return [Change(LOST, missing)] if missing > 0 else []


def _end_of(event: UsbEvent) -> Changes:
    """Return whether the port was closed or unplugged."""
    if event.status == UNPLUGGED:
        return [UNPLUGGED_CHANGE]
    return [Change(CLOSED, 1)] if event.status in KILLED else []


def _kinds(place: Place) -> dict[int, str]:
    """Return what events of a bulk transfer say, by the 8 bytes of their header that tell it."""
    def key(kind: int, endpoint: int, data_flag: int) -> int:
        return what_key(kind, endpoint, place.device, place.bus, data_flag)

    return {key(DONE, place.bulk_in | INPUT, 0): IN,
            key(SUBMITTED, place.bulk_out, 0): OUT,
            key(DONE, place.bulk_out, ord('>')): _SENT}


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
