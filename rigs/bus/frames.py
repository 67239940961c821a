# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""
Packets of Protocol 2.0 (e-Manual, DYNAMIXEL Protocol 2.0): made and read byte by byte.

Written for the rig alone and slow on purpose: it is what the product's framer is checked with.
`Form` is what differs in the 1.0 family (frames1.py).
"""

from collections.abc import Callable
from collections.abc import Iterable
from collections.abc import Sequence
from functools import lru_cache
from functools import partial
from typing import NamedTuple

EVERYBODY = 0xFE
PING, READ, WRITE, REG_WRITE, ACTION = 0x01, 0x02, 0x03, 0x04, 0x05
REBOOT, STATUS = 0x08, 0x55
SYNC_READ, SYNC_WRITE, FAST_SYNC_READ = 0x82, 0x83, 0x8A
BULK_READ, BULK_WRITE, FAST_BULK_READ = 0x92, 0x93, 0x9A
ALERT = 0x80
RESULT_FAIL, BAD_INSTRUCTION, BAD_CRC, DATA_RANGE, DATA_LENGTH, DATA_LIMIT, ACCESS = range(1, 8)
START = b'\xff\xff\xfd\x00'


class Packet(NamedTuple):
    """One whole packet; params of a status begin behind its error byte."""

    id: int
    instruction: int
    error: int
    params: bytes


class Form(NamedTuple):
    """How packets of a protocol are made and read."""

    start: bytes
    smallest: int                  # bytes of a status without data
    size: Callable[[bytes], int]   # a status that begins so has; 0: none does
    parse: Callable[[bytes], Sequence[Packet]]
    whole: Callable[[int, int, bytes], bytes]      # ID, code, params
    number: Callable[[int], bytes]                 # an address or a size

    def read(self, number: int, at: int, size: int) -> bytes:
        return self.whole(number, READ, self.number(at) + self.number(size))

    def write(self, number: int, at: int, data: bytes) -> bytes:
        return self.whole(number, WRITE, self.number(at) + data)

    def sync_read(self, ids: Iterable[int], at: int, size: int, code: int = SYNC_READ) -> bytes:
        return self.whole(EVERYBODY, code, self.number(at) + self.number(size) + bytes(ids))

    def sync_write(self, at: int, size: int, values: Iterable[tuple[int, bytes]]) -> bytes:
        return self.whole(EVERYBODY, SYNC_WRITE, self.number(at) + self.number(size) + b''.join(
            bytes((number,)) + data for number, data in values))


@lru_cache(maxsize=1)
def _steps() -> tuple[int, ...]:
    """Return what each leading byte does to a CRC-16 with polynomial 8005, no reflection."""
    table = []
    for byte in range(256):
        rest = byte << 8
        for _ in range(8):
            rest = (rest << 1) ^ (0x8005 if rest & 0x8000 else 0)
        table.append(rest & 0xFFFF)
    return tuple(table)


def crc(data: bytes) -> bytes:
    """Return the two CRC bytes of what stands before them, low byte first."""
    steps, rest = _steps(), 0
    for byte in data:
        rest = ((rest << 8) & 0xFFFF) ^ steps[rest >> 8 ^ byte]
    return bytes((rest & 0xFF, rest >> 8))


def two(value: int) -> bytes:
    """Return a value as two bytes, low byte first."""
    return bytes((value & 0xFF, value >> 8 & 0xFF))


def stuffed(content: bytes) -> bytes:
    """Return the content with one FD behind each FF FF FD (e-Manual, Byte Stuffing)."""
    out = bytearray()
    run = 0                        # how much of FF FF FD the last bytes are
    for byte in content:
        out.append(byte)
        if byte == 0xFD and run == 2:
            out.append(0xFD)
            run = 0
        elif byte == 0xFF:
            run = min(2, run + 1)
        else:
            run = 0
    return bytes(out)


def unstuffed(content: bytes) -> bytes:
    out = bytearray()
    at = 0
    while at < len(content):
        out.append(content[at])
        if content[at - 2:at + 2] == b'\xff\xff\xfd\xfd' and at >= 2:
            at += 1
        at += 1
    return bytes(out)


def _whole(number: int, content: bytes) -> bytes:
    frame = START + bytes((number,)) + two(len(content) + 2) + content
    return frame + crc(frame)


def instruction(number: int, code: int, params: bytes = b'', *, stuff: bool = True) -> bytes:
    """Return an instruction packet; stuff=False does as the official Python SDK does."""
    content = bytes((code,)) + params
    return _whole(number, stuffed(content) if stuff else content)


def status(number: int, error: int = 0, params: bytes = b'') -> bytes:
    """Return a status packet."""
    return _whole(number, stuffed(bytes((STATUS, error)) + params))


def bulk_read(entries: Iterable[tuple[int, int, int]], *, fast: bool = False) -> bytes:
    """Return a Bulk Read of (ID, address, size)."""
    params = b''.join(bytes((number,)) + two(at) + two(size) for number, at, size in entries)
    return instruction(EVERYBODY, FAST_BULK_READ if fast else BULK_READ, params)


def accesses(packet: Packet) -> list[tuple[int, int, int]]:
    """Return (ID, address, size) of all that a group read asks for, in the order of answering."""
    params = packet.params
    if packet.instruction in (SYNC_READ, FAST_SYNC_READ):
        at, size = params[0] | params[1] << 8, params[2] | params[3] << 8
        return [(number, at, size) for number in params[4:]]
    return [(params[i], params[i + 1] | params[i + 2] << 8, params[i + 3] | params[i + 4] << 8)
            for i in range(0, len(params) - 4, 5)]


def group_writes(packet: Packet) -> list[tuple[int, int, bytes]]:
    """Return (ID, address, data) of all that a Sync Write or Bulk Write carries."""
    params, found = packet.params, []
    if packet.instruction == SYNC_WRITE:
        at, size = params[0] | params[1] << 8, params[2] | params[3] << 8
        return [(params[i], at, params[i + 1:i + 1 + size])
                for i in range(4, len(params) - size, size + 1)]
    i = 0
    while i + 5 <= len(params):
        size = params[i + 3] | params[i + 4] << 8
        found.append((params[i], params[i + 1] | params[i + 2] << 8, params[i + 5:i + 5 + size]))
        i += 5 + size
    return found


@lru_cache(maxsize=1024)               # every servo hears the same
def parse(data: bytes, *, fast: bool = False) -> tuple[Packet, ...]:
    """Return the whole packets in these bytes; fast: a combined status is not unstuffed."""
    found = []
    at = data.find(START)
    while 0 <= at <= len(data) - 10:
        end = at + 7 + (data[at + 5] | data[at + 6] << 8)
        if end - at >= 10 and end <= len(data) and crc(data[at:end - 2]) == data[end - 2:end]:
            content = data[at + 7:end - 2]
            if not (fast and data[at + 4] == EVERYBODY):
                content = unstuffed(content)
            is_status = content[0] == STATUS
            found.append(Packet(data[at + 4], content[0], content[1] if is_status else 0,
                                content[2 if is_status else 1:]))
            at = data.find(START, end)
        else:
            at = data.find(START, at + 1)
    return tuple(found)


def _size(front: bytes) -> int:
    size = 7 + (front[5] | front[6] << 8)
    return 0 if size > 1031 or front[3] or front[7] != STATUS else size


FORM = Form(START[:3], 11, _size, partial(parse, fast=True), instruction, two)
# As the official Python SDK does it in a group write: nothing is stuffed.
UNSTUFFED = FORM._replace(whole=partial(instruction, stuff=False))
read, write, sync_read, sync_write = FORM.read, FORM.write, FORM.sync_read, FORM.sync_write
