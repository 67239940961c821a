# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""
Packets of Protocol 2.0 (e-Manual, DYNAMIXEL Protocol 2.0): made and read byte by byte.

Written for the rig alone and slow on purpose: it is what the product's framer is checked with.
`Form` is what differs in the 1.0 family (frames1.py).
"""

from collections.abc import Callable
from collections.abc import Sequence
from functools import lru_cache
from functools import partial
from struct import unpack_from
from typing import NamedTuple

from crcmod import mkCrcFun

EVERYBODY = 0xFE
PING, READ, WRITE, STATUS = 0x01, 0x02, 0x03, 0x55
SYNC_READ, SYNC_WRITE, FAST_SYNC_READ = 0x82, 0x83, 0x8A
ALERT = 0x80
BAD_INSTRUCTION, DATA_RANGE, DATA_LENGTH, DATA_LIMIT, ACCESS = 2, 4, 5, 6, 7
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
    ping_size: int                 # bytes of data that the answer to a Ping has
    whole: Callable[[int, int, bytes], bytes]      # ID, code, params
    number: Callable[[int], bytes]                 # an address or a size

    def read(self, number, at, size):
        return self.whole(number, READ, self.number(at) + self.number(size))

    def write(self, number, at, data):
        return self.whole(number, WRITE, self.number(at) + data)

    def sync_read(self, ids, at, size, code=SYNC_READ):
        return self.whole(EVERYBODY, code, self.number(at) + self.number(size) + bytes(ids))

    def sync_write(self, at, size, values):
        return self.whole(EVERYBODY, SYNC_WRITE, self.number(at) + self.number(size) + b''.join(
            bytes((number,)) + data for number, data in values))


_crc16 = mkCrcFun(0x18005, initCrc=0, rev=False)


def crc(data):
    """Return the two CRC bytes of what stands before them, low byte first."""
    return two(_crc16(data))


def two(value):
    """Return a value as two bytes, low byte first."""
    return (value & 0xFFFF).to_bytes(2, 'little')


def stuffed(content):
    """Return the content with one FD behind each FF FF FD (e-Manual, Byte Stuffing)."""
    return content.replace(START[:3], START[:3] + b'\xfd')


def unstuffed(content):
    return content.replace(START[:3] + b'\xfd', START[:3])


def _whole(number, content):
    frame = START + bytes((number,)) + two(len(content) + 2) + content
    return frame + crc(frame)


def instruction(number, code, params=b'', *, stuff=True):
    """Return an instruction packet; stuff=False does as the official Python SDK does."""
    content = bytes((code,)) + params
    return _whole(number, stuffed(content) if stuff else content)


def status(number, error=0, params=b''):
    """Return a status packet."""
    return _whole(number, stuffed(bytes((STATUS, error)) + params))


def accesses(packet):
    """Return (ID, address, size) of all that a group read asks for, in the order of answering."""
    at, size = unpack_from('<HH', packet.params)
    return [(number, at, size) for number in packet.params[4:]]


def group_writes(packet):
    """Return (ID, address, data) of all that a Sync Write carries."""
    params = packet.params
    at, size = unpack_from('<HH', params)
    return [(params[i], at, params[i + 1:i + 1 + size])
            for i in range(4, len(params) - size, size + 1)]


@lru_cache(maxsize=1024)               # every servo hears the same
def parse(data, *, fast=False):
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


def _size(front):
    size = 7 + (front[5] | front[6] << 8)
    return 0 if size > 1031 or front[3] or front[7] != STATUS else size


FORM = Form(START[:3], 11, _size, partial(parse, fast=True), 3, instruction, two)
# As the official Python SDK does it in a group write: nothing is stuffed.
UNSTUFFED = FORM._replace(whole=partial(instruction, stuff=False))
read, write, sync_read, sync_write = FORM.read, FORM.write, FORM.sync_read, FORM.sync_write
