# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""
Packets of the Protocol 1.0 family, Dynamixel 1.0 and Feetech: made and read byte by byte.

After the e-Manual (Protocol 1.0) and the SCS Communication Protocol; written for the rig alone.
"""

from collections.abc import Iterable
from typing import NamedTuple

EVERYBODY = 0xFE
PING, READ, WRITE, REG_WRITE, ACTION = 0x01, 0x02, 0x03, 0x04, 0x05
SYNC_READ, SYNC_WRITE = 0x82, 0x83         # the first with Feetech only
ADAPTER_SYNC_READ = 0x84                   # the USB2AX adapter has it, no servo
HEAD = b'\xff\xff'
SMALLEST = 6                               # bytes of a packet without parameters


class Packet(NamedTuple):
    """One packet; code: the instruction, or the error bits of a status."""

    id: int
    code: int
    params: bytes


def packet(number: int, code: int, params: bytes = b'') -> bytes:
    """Return a packet as it stands on the wire."""
    body = bytes((number, len(params) + 2, code)) + params
    return HEAD + body + bytes((255 - sum(body) % 256,))


def read(number: int, at: int, size: int) -> bytes:
    return packet(number, READ, bytes((at, size)))


def write(number: int, at: int, data: bytes) -> bytes:
    return packet(number, WRITE, bytes((at,)) + data)


def sync_read(ids: Iterable[int], at: int, size: int, code: int = SYNC_READ) -> bytes:
    return packet(EVERYBODY, code, bytes((at, size, *ids)))


def sync_write(at: int, size: int, values: Iterable[tuple[int, bytes]]) -> bytes:
    return packet(EVERYBODY, SYNC_WRITE, bytes((at, size)) + b''.join(
        bytes((number,)) + data for number, data in values))


def parse(data: bytes) -> list[Packet]:
    """Return the whole packets in these bytes."""
    found = []
    at = data.find(HEAD)
    while 0 <= at <= len(data) - SMALLEST:
        end = at + 4 + data[at + 3]
        if data[at + 2] != 0xFF and data[at + 3] >= 2 and end <= len(data) \
                and sum(data[at + 2:end]) % 256 == 255:
            found.append(Packet(data[at + 2], data[at + 4], data[at + 5:end - 1]))
            at = data.find(HEAD, end)
        else:
            at = data.find(HEAD, at + 1)
    return found
