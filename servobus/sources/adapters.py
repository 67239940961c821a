# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""
What USB serial adapters say on USB: the bytes of the line, and how the line is set. Pure.

Sources: Linux drivers ftdi_sio, cdc-acm, ch341 and cp210x; USB class definitions for CDC, PSTN
subclass, 6.3.11 and 6.5.4.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

from msg_defs.event import BAUD
from msg_defs.event import BREAK
from msg_defs.event import Change
from msg_defs.event import Changes
from msg_defs.event import DTR
from msg_defs.event import FRAMING
from msg_defs.event import LATENCY_TIMER
from msg_defs.event import OVERRUN
from msg_defs.event import PARITY
from msg_defs.event import PURGED
from msg_defs.event import RTS

_VENDOR_OUT, _VENDOR_INTERFACE_OUT, _CLASS_OUT = 0x40, 0x41, 0x21
# Chips divide their own clock, so what they make is near the rate that was asked for.
_USUAL_RATES = (9600, 19_200, 38_400, 57_600, 76_800, 115_200, 128_000, 222_222, 230_400, 250_000,
                460_800, 500_000, 921_600, 1_000_000, 1_500_000, 2_000_000, 2_250_000, 2_500_000,
                3_000_000, 4_000_000, 4_500_000, 6_000_000, 10_500_000)
_ERRORS = ((0x02, OVERRUN), (0x04, PARITY), (0x08, FRAMING), (0x10, BREAK))    # FTDI, CP210x
_NEAR = 0.025                      # 4.5 MBd of an FT232H are 4.571 MBd


class Setup(NamedTuple):
    """The setup packet of a control transfer (USB 2.0, 9.3)."""

    kind: int                      # bmRequestType
    request: int
    value: int
    target: int                    # wIndex

    @classmethod
    def of(cls, packet: bytes) -> Setup:
        return cls(packet[0], packet[1], int.from_bytes(packet[2:4], 'little'),
                   int.from_bytes(packet[4:6], 'little'))


class UsbIdentity(NamedTuple):
    """What a device says it is; interface_class: of the interface with the bulk endpoints."""

    vendor: int
    product: int
    version: int = 0               # bcdDevice
    interface_class: int | None = None


def usual_rate(rate: float) -> int:
    """Return the rate that was meant by one that a divider makes."""
    near = min(_USUAL_RATES, key=lambda one: abs(one - rate))
    return near if abs(near - rate) <= _NEAR * near else round(rate)


def _lines(value: int) -> Changes:
    """Return the modem lines that a request sets: which in the high byte, how in the low one."""
    return [Change(what, value >> bit & 1) for bit, what in ((0, DTR), (1, RTS))
            if value >> 8 >> bit & 1]


def _errors(status: int, bits: Sequence[tuple[int, str]] = _ERRORS) -> Changes:
    """Return the line errors in a status byte."""
    return [Change(what, 1) for bit, what in bits if status & bit]


class Adapter:
    """
    An adapter that carries the bytes of the line alone; others override what differs.

    packet_size: of its bulk endpoint towards the host. is_multi: the chip has several ports. From
    the host all adapters carry these bytes alone.
    """

    name = 'unknown adapter'
    VENDOR = INTERFACE_CLASS = -1  # what a device says of itself that is one
    DEVICES: tuple[tuple[int, int], ...] = ()      # vendor and product
    IDLE_SIZE = 0                  # a transfer to the host of no more bytes carries no data
    MULTI: tuple[int, ...] = ()    # the versions (bcdDevice) that have several ports

    @classmethod
    def matches(cls, identity: UsbIdentity) -> bool:
        """Return whether a device that says this of itself is one."""
        return identity.vendor == cls.VENDOR or identity[:2] in cls.DEVICES \
            or identity.interface_class == cls.INTERFACE_CLASS

    @classmethod
    def is_set_up_by(cls, setup: Setup, data: bytes) -> bool:
        """Return whether only this family takes such a control transfer."""
        return False

    def __init__(self, packet_size: int = 64, is_multi: bool = False) -> None:
        self.packet_size = packet_size
        self.is_multi = is_multi

    def received(self, data: bytes) -> tuple[bytes, Changes]:
        """Return the bytes of the line in one transfer to the host, and what else it says."""
        return data, []

    def control(self, setup: Setup, data: bytes) -> Changes:
        """Return what a control transfer sets; data: what went with it in either direction."""
        return []

    def interrupt(self, data: bytes) -> Changes:
        """Return what a transfer of the interrupt endpoint says."""
        return []


class Ftdi(Adapter):
    """
    FT232R, FT232H, FT2232 and the like.

    Each packet to the host begins with two status bytes, also inside one transfer: modem lines,
    and the line status; its errors count only where bytes follow.
    """

    name = 'FTDI'
    VENDOR = 0x0403
    IDLE_SIZE = _STATUS_SIZE = 2
    _ERROR_BITS = 0x1E             # those of _ERRORS
    MULTI = (0x0500, 0x0700, 0x0800, 0x2800, 0x2900, 0x3300)
    _EIGHTHS = (0, 3, 2, 4, 1, 5, 6, 7)       # by the code in bits 14 to 16 of the divisor

    @classmethod
    def is_set_up_by(cls, setup: Setup, data: bytes) -> bool:
        return setup.kind == _VENDOR_OUT and setup.request in (3, 9) and setup.target & 0xFF < 8

    def received(self, data: bytes) -> tuple[bytes, Changes]:
        line = b''
        changes: Changes = []
        for at in range(0, len(data), self.packet_size):
            packet = data[at:at + self.packet_size]
            line += packet[self._STATUS_SIZE:]
            if len(packet) > self._STATUS_SIZE and packet[1] & self._ERROR_BITS:
                changes += _errors(packet[1])
        return line, changes

    def control(self, setup: Setup, data: bytes) -> Changes:
        kind, request, value, _ = setup
        if kind != _VENDOR_OUT:
            return []
        if request == 0 and value in (1, 2):
            return [Change(PURGED, value)]
        if request == 1:
            return _lines(value)
        if request == 3:
            return [Change(BAUD, self._baud(setup))]
        return [Change(LATENCY_TIMER, value & 0xFF)] if request == 9 else []

    def _baud(self, setup: Setup) -> int:
        high, low = setup.target >> 8, setup.target & 0xFF
        upper = high if high or self.is_multi else low     # else the low byte is the port's number
        code = setup.value >> 14 | (upper & 1) << 2
        eighths = 8 * (setup.value & 0x3FFF) + self._EIGHTHS.index(code)
        base = 96_000_000 if upper & 2 else 24_000_000
        return usual_rate(base / {0: 8, 8: 12}.get(eighths, eighths))


class CdcAcm(Adapter):
    """Boards that are a USB modem to the host: CH343, OpenRB-150, OpenCR and the like."""

    name = 'CDC-ACM'
    INTERFACE_CLASS = 0x0A         # the data of a modem
    _NOTICE = b'\xa1\x20'
    _HEAD_SIZE, _STATE_SIZE = 8, 2
    _ERRORS = ((0x04, BREAK), (0x10, FRAMING), (0x20, PARITY), (0x40, OVERRUN))
    _rest = b''                # begin of a notice that is longer than a packet

    @classmethod
    def is_set_up_by(cls, setup: Setup, data: bytes) -> bool:
        return setup.kind == _CLASS_OUT and setup.request == 0x20 and len(data) == 7

    def control(self, setup: Setup, data: bytes) -> Changes:
        if setup.kind != _CLASS_OUT:
            return []
        if setup.request == 0x20 and len(data) >= 7:
            return [Change(BAUD, int.from_bytes(data[:4], 'little'))]
        if setup.request == 0x22:
            return [Change(DTR, setup.value & 1), Change(RTS, setup.value >> 1 & 1)]
        return []

    def interrupt(self, data: bytes) -> Changes:
        # Boards with an endpoint of 8 bytes cut the 10 bytes of a notice; Linux joins them too.
        if data[:2] != self._NOTICE:
            data = self._rest + data
        self._rest = b''
        size = self._HEAD_SIZE + self._STATE_SIZE
        if data[:2] != self._NOTICE[:len(data)]:
            return []
        if len(data) < size:
            self._rest = data
            return []
        return _errors(data[self._HEAD_SIZE], self._ERRORS)


class Ch341(Adapter):
    """CH340 and CH341."""

    name = 'CH340/CH341'
    _WRITE_REGISTER, _MODEM = 0x9A, 0xA4
    _DIVISOR = 0x1312              # the two registers of prescaler and divisor
    DEVICES = ((0x1A86, 0x7523), (0x1A86, 0x7522), (0x1A86, 0x5523), (0x4348, 0x5523),
               (0x1A86, 0xE523), (0x2184, 0x0057), (0x9986, 0x7523))

    @classmethod
    def is_set_up_by(cls, setup: Setup, data: bytes) -> bool:
        return setup[:3] == (_VENDOR_OUT, cls._WRITE_REGISTER, cls._DIVISOR)

    def control(self, setup: Setup, data: bytes) -> Changes:
        kind, request, value, target = setup
        if kind != _VENDOR_OUT:
            return []
        if request == self._MODEM:             # the lines are inverted
            return [Change(DTR, ~value >> 5 & 1), Change(RTS, ~value >> 6 & 1)]
        if request == self._WRITE_REGISTER and value == self._DIVISOR:
            scale = 12 - 3 * (target & 3) - (target >> 2 & 1)
            return [Change(BAUD, usual_rate(48e6 / ((0x100 - (target >> 8)) << scale)))]
        return []


class Cp210x(Adapter):
    """
    CP2102, CP2104 and the like.

    Where the driver asked for events, bytes to the host are escaped: ESC 00 is ESC itself,
    ESC 01 status byte is a byte with a line error, ESC 02 status and ESC 03 status are none.
    """

    name = 'CP210x'
    VENDOR = 0x10C4
    _SIZES = (2, 4, 3, 3)          # bytes of each message after ESC
    _escape = b''
    _rest = b''                # begin of an escape that is not all here

    @classmethod
    def is_set_up_by(cls, setup: Setup, data: bytes) -> bool:
        return setup[:2] == (_VENDOR_INTERFACE_OUT, 0x1E) and len(data) == 4

    def control(self, setup: Setup, data: bytes) -> Changes:
        kind, request, value, _ = setup
        if kind != _VENDOR_INTERFACE_OUT:
            return []
        if request == 0x1E and len(data) >= 4:
            return [Change(BAUD, int.from_bytes(data[:4], 'little'))]
        if request == 0x01 and value:
            return [Change(BAUD, usual_rate(3_686_400 / value))]
        if request == 0x07:
            return _lines(value)
        if request == 0x12:
            return [Change(PURGED, (1 if value & 0x0A else 0) | (2 if value & 0x05 else 0))]
        if request == 0x15:
            self._escape = bytes([value & 0xFF]) if value & 0xFF else b''
        return []

    def received(self, data: bytes) -> tuple[bytes, Changes]:
        if not self._escape:
            return data, []
        data = self._rest + data
        found: list[bytes] = []
        changes: Changes = []
        at = 0
        while (mark := data.find(self._escape, at)) >= 0:
            found.append(data[at:mark])
            kind = data[mark + 1] if mark + 1 < len(data) else 0
            at = mark + (self._SIZES[kind] if kind < len(self._SIZES) else 1)
            if at > len(data) or mark + 1 == len(data):
                self._rest = data[mark:]
                return b''.join(found), changes
            if kind == 0 or kind >= len(self._SIZES):      # itself, or no escape at all
                found.append(self._escape)
            elif kind == 1:
                changes += _errors(data[mark + 2])
                found.append(data[mark + 3:at])
        self._rest = b''
        return b''.join(found) + data[at:], changes


# All that is understood. What matches several is the first of them.
FAMILIES: tuple[type[Adapter], ...] = (Ftdi, CdcAcm, Ch341, Cp210x)


def adapter_of(identity: UsbIdentity, packet_size: int = 64) -> Adapter | None:
    """Return the adapter that a device is; None: none that is understood."""
    family = next((one for one in FAMILIES if one.matches(identity)), None)
    return None if family is None else family(packet_size or 64, identity.version in family.MULTI)


def family_by_request(setup: Setup, data: bytes) -> type[Adapter] | None:
    """Return the family that is set up with this control transfer, if one surely is."""
    return next((one for one in FAMILIES if one.is_set_up_by(setup, data)), None)
