# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""
Which serial ports there are in a stream of USB events, from what the events say. Pure.

Best are the descriptors that devices send when they are plugged in (USB 2.0, 9.6). Without these
the requests of the drivers count, and at last the bytes: FTDI's status bytes, headers of servos.
"""

from __future__ import annotations

from collections import defaultdict
from typing import NamedTuple

from servobus.sources.adapters import Adapter
from servobus.sources.adapters import adapter_of
from servobus.sources.adapters import CdcAcm
from servobus.sources.adapters import family_by_request
from servobus.sources.adapters import Ftdi
from servobus.sources.adapters import UsbIdentity
from servobus.sources.usb_port import Place
from servobus.sources.usb_port import Setups
from servobus.sources.usbmon import BULK
from servobus.sources.usbmon import CONTROL
from servobus.sources.usbmon import INPUT
from servobus.sources.usbmon import UsbEvent

_GET_DESCRIPTOR = (0x80, 6)
_DEVICE, _CONFIGURATION, _INTERFACE, _ENDPOINT = 1, 2, 4, 5
_DEVICE_SIZE = 18
_BULK_KIND = 2                     # in an endpoint's attributes
_SMALL, _LARGE = 64, 512           # packets of a full-speed and of a high-speed device
_SMALL_MARK, _LARGE_MARK = 1, 2    # low half of FTDI's first status byte: the size of packets
_HEADER = b'\xff\xff'              # what every packet of a servo begins with
_UNKNOWN = UsbIdentity(0, 0)


class Found(NamedTuple):
    """A serial port; size: bytes of its bulk transfers so far."""

    place: Place
    adapter: Adapter
    identity: UsbIdentity
    interface: int
    size: int

    @property
    def words(self) -> str:
        """One line for a person who has to choose."""
        vendor, product = self.identity[:2]
        numbers = f' {vendor:04x}:{product:04x}' if vendor else ''
        return f'{self.place.words} {self.adapter.name}{numbers}, {self.size} bytes'


class _Endpoint(NamedTuple):
    address: int
    packet_size: int
    interface: int
    interface_class: int


class _UsbDevice:
    """What is known of one device."""

    def __init__(self) -> None:
        self.identity = _UNKNOWN
        self.endpoints: list[_Endpoint] = []   # bulk ones, as it described them
        self.seen: dict[int, int] = {}         # bulk endpoint: bytes
        self.by_request: type[Adapter] | None = None
        self.is_ftdi: bool | None = None       # from its status bytes; None: nothing came yet
        self.is_large = False                  # no status bytes where a small packet begins
        self.has_header = False

    def add_descriptor(self, data: bytes) -> None:
        """Add a descriptor of the device, or those of a configuration."""
        if len(data) >= _DEVICE_SIZE and data[1] == _DEVICE:
            self.identity = UsbIdentity(_word(data, 8), _word(data, 10), _word(data, 12))
        if data[1:2] == bytes([_CONFIGURATION]):
            endpoints = _endpoints(data)
            self.endpoints = endpoints or self.endpoints

    def add_bulk(self, event: UsbEvent) -> None:
        data = event.data
        self.seen[event.endpoint] = self.seen.get(event.endpoint, 0) + len(data)
        if not event.is_input:
            self.has_header |= _HEADER in data
        elif data:
            self.is_ftdi = self.is_ftdi is not False and _is_status(data, 0)
            self.is_large |= data[0] & 0x0F == _LARGE_MARK or not all(
                _is_status(data, at) for at in range(0, len(data), _SMALL))

    def ports(self, bus: int, device: int) -> list[Found]:
        found = []
        for incoming, outgoing in self._pairs():
            adapter = self._adapter(incoming)
            if adapter is not None:
                size = self.seen.get(incoming.address, 0) + self.seen.get(outgoing, 0)
                found.append(Found(Place(bus, device, incoming.address & ~INPUT, outgoing),
                                   adapter, self.identity, incoming.interface, size))
        return found

    def _pairs(self) -> list[tuple[_Endpoint, int]]:
        """Return the bulk endpoints that belong together: of one interface, or in order."""
        ends = self.endpoints or [_Endpoint(one, 0, 0, -1) for one in sorted(self.seen)]
        pairs = []
        for number in sorted({one.interface for one in ends}):
            mine = [one for one in ends if one.interface == number]
            incoming = [one for one in mine if one.address & INPUT]
            outgoing = [one.address for one in mine if not one.address & INPUT]
            pairs += list(zip(incoming, outgoing, strict=False))
        return pairs

    def _adapter(self, incoming: _Endpoint) -> Adapter | None:
        if self.endpoints:
            return adapter_of(self.identity._replace(interface_class=incoming.interface_class),
                              incoming.packet_size)
        size = _LARGE if self.is_large else _SMALL
        known = adapter_of(self.identity, size)
        if known is not None:
            return known
        if self.by_request is not None:
            return self.by_request(size)
        if self.is_ftdi and self.has_header:
            return Ftdi(size)
        return CdcAcm(size) if self.has_header and not self.identity.vendor else None


def described_ports(descriptors: bytes, bus: int, device: int) -> list[Found]:
    """Return the serial ports of a device, from its own descriptor and those that follow it."""
    described = _UsbDevice()
    described.add_descriptor(descriptors[:_DEVICE_SIZE])
    described.add_descriptor(descriptors[_DEVICE_SIZE:])
    return described.ports(bus, device)


class Survey:
    """Give it all events; `ports` says at any time what was found."""

    def __init__(self) -> None:
        self._devices: defaultdict[tuple[int, int], _UsbDevice] = defaultdict(_UsbDevice)
        self._setups = Setups()

    def add_event(self, event: UsbEvent) -> None:
        is_bulk = event.transfer == BULK
        if not (event.data if is_bulk else event.transfer == CONTROL):
            return
        device = self._devices[event.bus, event.device]
        if is_bulk:
            device.add_bulk(event)
        else:
            self._add_control(device, event)

    def ports(self) -> list[Found]:
        """Return the serial ports, by bus and device."""
        return [found for (bus, number), device in sorted(self._devices.items())
                for found in device.ports(bus, number)]

    def _add_control(self, device: _UsbDevice, event: UsbEvent) -> None:
        setup = self._setups.setup_of(event)
        if setup is None:
            return
        if (setup.kind, setup.request) == _GET_DESCRIPTOR:
            device.add_descriptor(event.data)
        else:
            device.by_request = family_by_request(setup, event.data) or device.by_request


def _word(data: bytes, at: int) -> int:
    return int.from_bytes(data[at:at + 2], 'little')


def _is_status(data: bytes, at: int) -> bool:
    """Tell whether FTDI's two status bytes may stand here."""
    return len(data) - at >= 2 and data[at] & 0x0F in (_SMALL_MARK, _LARGE_MARK)


def _endpoints(data: bytes) -> list[_Endpoint]:
    """Return the bulk endpoints that a configuration describes."""
    found: list[_Endpoint] = []
    number, kind, at = 0, -1, 0
    while at + 2 <= len(data) and (size := data[at]) >= 2:
        part = data[at:at + size]
        at += size
        if part[1] == _INTERFACE and len(part) >= 6:
            number, kind = part[2], part[5]
        elif part[1] == _ENDPOINT and len(part) >= 6 and part[3] & 3 == _BULK_KIND:
            found.append(_Endpoint(part[2], _word(part, 4) & 0x7FF, number, kind))
    return found
