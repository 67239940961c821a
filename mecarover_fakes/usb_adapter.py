# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""
Fake USB serial adapters: what usbmon would show of one while its port is used. Pure.

The inverse of servobus.sources: bytes with a side become events of /dev/usbmonN, one after the
other. Each method returns such events; stamps are ns since 1970.
"""

from __future__ import annotations

from collections.abc import Callable
import struct
from typing import NamedTuple

_HEAD = struct.Struct('<QBBBBHBBqiiII8siiII')
_CONTROL, _BULK = 2, 3
_SUBMIT, _DONE = b'SC'
_IN_PROGRESS, _SHUT_DOWN = -115, -108
_DATA_FOLLOW, _NO_SETUP = 0, ord('-')
_CP210X_ESCAPE = 0xEC
_CH341_CLOCK = 48_000_000
BUS, DEVICE = 1, 7


Requests = list[tuple[bytes, bytes]]         # setup and data of each


class Family(NamedTuple):
    """A kind of adapter: its identity, bulk endpoints, and the requests that set a rate."""

    vendor: int
    product: int
    version: int
    packet_size: int
    endpoints: tuple[int, int]     # towards the host, with its bit, and from the host
    interface_class: int
    set_baud: Callable[[int], Requests]
    status: bytes = b''            # in front of each packet to the host


def _setup(kind: int, request: int, value: int, target: int, size: int = 0) -> bytes:
    return struct.pack('<BBHHH', kind, request, value, target, size)


def _ftdi(clock: int, upper: int) -> Callable[[int], Requests]:
    """Return what sets the divisor of a chip with this clock (e.g. 3 MHz), in eighths."""
    def set_baud(baud: int) -> Requests:
        eighths = round(8 * clock / baud)
        value = eighths >> 3 | (0, 3, 2, 4, 1, 5, 6, 7)[eighths & 7] << 14
        if clock == 3_000_000:
            value = {8: 0, 12: 1}.get(eighths, value)
        return [(_setup(0x40, 9, 1, 0), b''),
                (_setup(0x40, 3, value & 0xFFFF, upper | value >> 16), b'')]
    return set_baud


def _cdc(baud: int) -> Requests:
    return [(_setup(0x21, 0x20, 0, 0, 7), struct.pack('<IBBB', baud, 0, 0, 8)),
            (_setup(0x21, 0x22, 3, 0), b'')]


def _ch341(baud: int) -> Requests:
    for prescale in range(3, -1, -1):
        divisor = round(_CH341_CLOCK / (baud << 12 - 3 * prescale - 1))
        if 2 <= divisor <= 256:
            break
    target = (0x100 - divisor) << 8 | 0x80 | 1 << 2 | prescale
    return [(_setup(0x40, 0x9A, 0x1312, target), b'')]


def _cp210x(baud: int) -> Requests:
    return [(_setup(0x41, 0x1E, 0, 0, 4), baud.to_bytes(4, 'little'))]


FAMILIES = {
    'ftdi': Family(0x0403, 0x6014, 0x0900, 512, (0x81, 0x02), 0xFF, _ftdi(12_000_000, 2),
                   b'\x32\x60'),
    'ft232r': Family(0x0403, 0x6001, 0x0600, 64, (0x81, 0x02), 0xFF, _ftdi(3_000_000, 0),
                     b'\x01\x60'),
    'cdc-acm': Family(0x1A86, 0x55D3, 0x0445, 64, (0x82, 0x02), 0x0A, _cdc),
    'ch341': Family(0x1A86, 0x7523, 0x0264, 32, (0x82, 0x02), 0xFF, _ch341),
    'cp210x': Family(0x10C4, 0xEA60, 0x0100, 64, (0x82, 0x01), 0xFF, _cp210x),
}


class FakeAdapter:
    """
    One adapter; transfer_size: bytes of one transfer to the host, status bytes included.

    has_events: of a CP210x that reports line errors within its data.
    """

    def __init__(self, family: str, transfer_size: int = 512, has_events: bool = False) -> None:
        self._family = FAMILIES[family]
        self._transfer_size = transfer_size
        self._has_events = has_events
        self._number = 0xFFFF_8880_0000_0000

    def plug(self, stamp: int) -> bytes:
        """Tell what the adapter is, as when it is plugged in."""
        one = self._family
        device = struct.pack('<BBHBBBBHHHBBBB', 18, 1, 0x200, 0, 0, 0, 64, one.vendor,
                             one.product, one.version, 1, 2, 3, 1)
        endpoints = b''.join(struct.pack('<BBBBHB', 7, 5, address, 2, one.packet_size, 0)
                             for address in one.endpoints)
        body = struct.pack('<BBBBBBBBB', 9, 4, 0, 0, 2, one.interface_class, 0, 0, 0) + endpoints
        whole = struct.pack('<BBHBBBBB', 9, 2, 9 + len(body), 1, 1, 0, 0x80, 50) + body
        return b''.join(self._request(_setup(0x80, 6, kind << 8, 0, len(answer)), stamp,
                                      answer=answer)
                        for kind, answer in ((1, device), (2, whole)))

    def set_baud(self, baud: int, stamp: int) -> bytes:
        """Have the master set its rate, as when it opens the port."""
        requests = self._family.set_baud(baud)
        if self._has_events:
            requests.append((_setup(0x41, 0x15, _CP210X_ESCAPE, 0), b''))
        return b''.join(self._request(setup, stamp, data) for setup, data in requests)

    def sent(self, data: bytes, stamp: int) -> bytes:
        """Tell of bytes that the master wrote."""
        return self._request(b'', stamp, data)

    def received(self, data: bytes, stamp: int) -> bytes:
        """Tell of bytes that came from the bus, in as many transfers as they need."""
        if self._has_events:
            data = data.replace(bytes([_CP210X_ESCAPE]), bytes([_CP210X_ESCAPE, 0]))
        status = self._family.status
        packet = min(self._family.packet_size, self._transfer_size)
        size = max(1, packet - len(status))
        packets = [status + data[at:at + size] for at in range(0, len(data), size)]
        count = self._transfer_size // packet
        return b''.join(self._handed(b''.join(packets[at:at + count]), stamp)
                        for at in range(0, len(packets), count))

    def idle(self, stamp: int) -> bytes:
        """Tell of a transfer without bytes of the line: what a latency timer sends."""
        return self._handed(self._family.status, stamp)

    def unplug(self, stamp: int) -> bytes:
        """Tell of what ends a transfer when the adapter is pulled out."""
        return self._handed(b'', stamp, _SHUT_DOWN)

    def _handed(self, data: bytes, stamp: int, status: int = 0) -> bytes:
        """Return what a transfer to the host ends with."""
        return self._event(_DONE, _BULK, self._family.endpoints[0], stamp, status, data)

    def _request(self, setup: bytes, stamp: int, data: bytes = b'', answer: bytes = b'') -> bytes:
        """Return begin and end of a transfer from the host; setup: of a control request."""
        kind = _CONTROL if setup else _BULK
        endpoint = setup[0] & 0x80 if setup else self._family.endpoints[1]
        return self._event(_SUBMIT, kind, endpoint, stamp, _IN_PROGRESS, data, setup) \
            + self._event(_DONE, kind, endpoint, stamp, 0, answer, size=len(data or answer))

    def _event(self, kind: int, transfer: int, endpoint: int, stamp: int, status: int,
               data: bytes, setup: bytes = b'', size: int | None = None) -> bytes:
        """Return an event; the number of a transfer is free again after its end."""
        seconds, ns = divmod(stamp, 1_000_000_000)
        data_flag = _DATA_FOLLOW if data else ord('<' if endpoint & 0x80 else '>')
        head = _HEAD.pack(self._number, kind, transfer, endpoint, DEVICE, BUS,
                          0 if setup else _NO_SETUP, data_flag, seconds, ns // 1000, status,
                          len(data) if size is None else size, len(data), setup, 0, 0, 0, 0)
        self._number += 0x100 * (kind == _DONE)
        return head + data
