# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""
Events of a USB bus, as usbmon (Linux) and USBPcap (Windows) write them down. Pure.

Sources: kernel Documentation/usb/usbmon.rst; tcpdump.org, link types 189 and 220; desowin.org,
USBPcap capture format. What is not an event gives None; nothing here raises on what is in a file.
"""

from __future__ import annotations

from collections.abc import Callable
from collections.abc import Iterator
import struct
from typing import Any
from typing import NamedTuple

ISO, INTERRUPT, CONTROL, BULK = range(4)
INPUT = 0x80                       # bit of an endpoint address: towards the host
KILLED = (-2, -104)                # the port was closed
UNPLUGGED = -108                   # the device is gone
SUBMITTED, DONE, FAILED = b'SCE'
KINDS = frozenset(b'SCE')
_SETUP_FLAGS = frozenset(b'\0-Z')

HEADER_SIZE = 64
OLD_HEADER_SIZE = 48
SETUP_SIZE = 8
EVENT_MAX_BYTES = 1 << 24          # bytes of one event; the kernel keeps less than 256 KiB
_KEY_FORMAT = 'BBBBHBB'            # kind, transfer, endpoint, device, bus, two flags
_HEADER = f'Q{_KEY_FORMAT}qiiII8s'  # the first 48 bytes; 16 more follow in the newer form
_HEADERS = {'<': struct.Struct('<' + _HEADER), '>': struct.Struct('>' + _HEADER)}
# The same up to the setup: number, header_key(), seconds, us, status, size, kept bytes.
FRONT = struct.Struct('<QQqiiII')
_PCAP_HEAD = struct.Struct('<HQIHBHHBBI')
_SETUP_STAGE = 0
_GONE = 0xC0007000                 # USBD_STATUS_DEVICE_GONE
_CANCELED = 0xC0010000


class UsbEvent(NamedTuple):
    """
    One event of a transfer; stamp: ns since 1970.

    is_done: the transfer ended, with `status` (0 is well, else -errno); before that it was asked
    for. setup: of a control transfer that begins. data: with what is asked of an output, and with
    what an input ends. size: bytes asked for, or moved; data are fewer where the capture was cut.
    """

    stamp: int
    bus: int
    device: int
    endpoint: int                  # with the bit INPUT
    transfer: int
    is_done: bool
    status: int
    number: int                    # the transfer's, the same at its beginning and its end
    setup: bytes
    data: bytes
    size: int

    @property
    def is_input(self) -> bool:
        """Whether the bytes go to the host."""
        return bool(self.endpoint & INPUT)


def decode(packet: bytes, order: str = '<', header_size: int = HEADER_SIZE) -> UsbEvent | None:
    """
    Return the event of a header and the data after it, None for what is none.

    order: of the bytes, '<' or '>'. header_size: 64, or 48 in the older form.
    """
    if len(packet) < header_size:
        return None
    fields = _HEADERS[order].unpack_from(packet)
    if fields[1] not in KINDS or fields[2] > BULK:
        return None
    return _event(fields, packet[header_size:header_size + fields[12]])


def header_key(kind: int, endpoint: int, device: int, bus: int, data_flag: int) -> int:
    """Return the 8 bytes that say what an event of a bulk transfer is about, as FRONT has them."""
    return int.from_bytes(struct.pack(f'<{_KEY_FORMAT}', kind, BULK, endpoint, device, bus,
                                      ord('-'), data_flag), 'little')


def _event(fields: tuple[Any, ...], data: bytes) -> UsbEvent:
    (number, kind, transfer, endpoint, device, bus, setup_flag, data_flag, seconds, us, status,
     size, _, setup) = fields
    is_done = kind != SUBMITTED
    return UsbEvent(seconds * 1_000_000_000 + us * 1000, bus, device, endpoint, transfer, is_done,
                    status, number,
                    setup if transfer == CONTROL and not is_done and not setup_flag else b'',
                    b'' if data_flag or transfer == ISO else data, size)


def decode_usbpcap(packet: bytes, stamp: int) -> UsbEvent | None:
    """Return the event of a packet of link type 249, which has no stamp of its own."""
    if len(packet) < _PCAP_HEAD.size:
        return None
    (header_size, number, status, _, info, bus, device, endpoint, transfer,
     size) = _PCAP_HEAD.unpack_from(packet)
    if transfer > BULK or not _PCAP_HEAD.size <= header_size <= len(packet):
        return None
    data = packet[header_size:header_size + size]
    setup = b''
    if transfer == CONTROL and header_size > _PCAP_HEAD.size \
            and packet[_PCAP_HEAD.size] == _SETUP_STAGE:
        setup, data = data[:SETUP_SIZE], data[SETUP_SIZE:]
        size -= len(setup)
        setup = setup if len(setup) == SETUP_SIZE else b''
    is_done = bool(info & 1)
    return UsbEvent(stamp, bus, device, endpoint, transfer, is_done, _errno(status), number, setup,
                    b'' if transfer == ISO else data, size)


def _errno(status: int) -> int:
    """Return a status of Windows as one of Linux."""
    known = {0: 0, _GONE: UNPLUGGED, _CANCELED: KILLED[0]}
    return known.get(status, -5 if status >> 30 == 3 else 0)


class Records:
    """
    Events in a row without a frame around them, as /dev/usbmonN gives them.

    Takes pieces of any size. What cannot be a header is skipped up to the next that can be one;
    `skipped` counts these bytes.
    """

    def __init__(self) -> None:
        self.skipped = 0
        self.rest = b''            # begin of an event

    def events(self, piece: bytes,
               skim: Callable[[bytes, int], int] | None = None) -> Iterator[UsbEvent]:
        """
        Yield the events that this piece completes; to be used up.

        skim: takes the events at a place that it can take faster, and returns where the first one
        begins that it leaves.
        """
        data = self.rest + piece if self.rest else piece
        at = 0
        unpack = _HEADERS['<'].unpack_from
        last = len(data) - HEADER_SIZE
        while at <= last:
            if skim is not None and (at := skim(data, at)) > last:
                break
            fields = unpack(data, at)
            if not _is_header(fields):
                at += 1
                self.skipped += 1
                continue
            begin = at + HEADER_SIZE
            end = begin + fields[12]
            if end > len(data):
                break
            at = end
            yield _event(fields, data[begin:end])
        self.rest = data[at:]


def is_record(data: bytes) -> bool:
    """Tell whether an event may begin so."""
    return len(data) >= HEADER_SIZE and _is_header(_HEADERS['<'].unpack_from(data))


def _is_header(fields: tuple[Any, ...]) -> bool:
    (_, kind, transfer, endpoint, device, bus, setup_flag, _, seconds, us, _, size, kept,
     _) = fields
    return (kind in KINDS and transfer <= BULK and device < 128
            and not endpoint & 0x70 and bus < 4096 and setup_flag in _SETUP_FLAGS
            and seconds >= 0 and 0 <= us < 1_000_000 and kept <= EVENT_MAX_BYTES
            and (kept <= size or transfer == ISO))
