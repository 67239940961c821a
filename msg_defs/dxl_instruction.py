# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""
What a Dynamixel instruction addresses: who, which range, which data, and who must answer.

e-Manual, Protocol 2.0, instruction packets. Takes the parameters unstuffed; whatever stands in
them, nothing raises: what does not fit its instruction is marked malformed.
"""

from collections.abc import Callable
from enum import Enum
from enum import IntEnum
from typing import NamedTuple

from msg_defs.crc import crc16
from msg_defs.dxl_packet import body_crc
from msg_defs.dxl_packet import BROADCAST


class Instruction(IntEnum):
    PING = 0x01
    READ = 0x02
    WRITE = 0x03
    REG_WRITE = 0x04
    ACTION = 0x05
    FACTORY_RESET = 0x06
    REBOOT = 0x08
    CLEAR = 0x10
    CONTROL_TABLE_BACKUP = 0x20
    STATUS = 0x55
    SYNC_READ = 0x82
    SYNC_WRITE = 0x83
    FAST_SYNC_READ = 0x8A
    BULK_READ = 0x92
    BULK_WRITE = 0x93
    FAST_BULK_READ = 0x9A


NAMES = {code.value: code.name.replace('_', ' ').title() for code in Instruction}

ALERT = 0x80
ERROR_NAMES = {
    1: 'Result Fail', 2: 'Instruction', 3: 'CRC', 4: 'Data Range', 5: 'Data Length',
    6: 'Data Limit', 7: 'Access',
}

MULTI_TURN = 'multi-turn'
ERROR = 'error'
STORE = 'store'
RESTORE = 'restore'
RESET_ALL = 'all'
RESET_OPTIONS = {0xFF: RESET_ALL, 0x01: 'all except ID', 0x02: 'all except ID and Baud Rate'}
# By the key bytes alone: clients disagree about the byte in front of them.
CLEAR_KEYS = {b'\x44\x58\x4c\x22': MULTI_TURN, b'\x45\x52\x43\x4c': ERROR}
BACKUP_OPTIONS = {b'\x01CTRL': STORE, b'\x02CTRL': RESTORE}


class Answers(Enum):
    """Who answers an instruction."""

    NOBODY = 'nobody'
    DATA = 'the addressed device, with data, at Status Return Level 1 and 2'
    PING = 'the addressed device, always'
    ACK = 'the addressed device, at Status Return Level 2'
    EVERYBODY = 'each device, in the order of IDs'
    LISTED = 'each listed device, in the order of the list'
    COMBINED = 'the listed devices together, in one status'


class Access(NamedTuple):
    """A range of one device's control table; data is None for a read."""

    id: int
    address: int
    length: int
    data: bytes | None


class Request(NamedTuple):
    """An instruction packet, understood."""

    instruction: int
    id: int                        # as addressed, 254 = broadcast
    answers: Answers
    accesses: tuple[Access, ...] = ()
    option: str = ''               # of Factory Reset, Clear and Backup; '' also if unknown
    malformed: bool = False


class Block(NamedTuple):
    """One device's part of a combined status."""

    id: int
    error: int
    data: bytes


def error_text(error: int) -> str:
    """Return the error byte of a status in words: 'Access, alert'; '' for 0."""
    code = error & ~ALERT
    words = [ERROR_NAMES.get(code, f'error {code}')] if code else []
    return ', '.join(words + ['alert'] * bool(error & ALERT))


def name_of(instruction: int) -> str:
    """Return 'Sync Read', or 'instruction 0x8B' for what the protocol does not know."""
    return NAMES.get(instruction) or f'instruction 0x{instruction:02X}'


def parse(instruction: int, id: int, params: bytes) -> Request:
    """Return what an instruction asks for; params are unstuffed."""
    parser = _PARSERS.get(instruction)
    if parser is None:
        return Request(instruction, id, Answers.NOBODY)
    if id != BROADCAST and instruction in _TO_MANY:
        return _malformed(instruction, id)
    return parser(instruction, id, params)


def split_combined(body: bytes, accesses: tuple[Access, ...]) -> list[Block]:
    """
    Return the parts of a fast reply whose CRC holds, up to the first that does not.

    body is all there is from the ID on, the last CRC included, cut anywhere; accesses are those
    of the instruction. Each CRC covers the wire from the header on, earlier CRCs included.
    """
    blocks: list[Block] = []
    at = 4
    crc = body_crc(body[:at])
    for access in accesses:
        end = at + 2 + access.length
        crc = crc16(body[at:end], crc)
        tail = body[end:end + 2]
        if len(tail) < 2 or body[at + 1] != access.id or crc != tail[0] | tail[1] << 8:
            break
        blocks.append(Block(access.id, body[at], body[at + 2:end]))
        crc = crc16(tail, crc)
        at = end + 2
    return blocks


def bulk_write_entries(params: bytes) -> list[tuple[int, int, bytes]]:
    """Return what a Bulk Write writes, as far as it makes sense: (ID, address, data)."""
    entries = []
    at = 0
    while at + 5 < len(params):
        end = at + 5 + (params[at + 3] | params[at + 4] << 8)
        if end > len(params):
            break
        if end > at + 5:
            entries.append((params[at], params[at + 1] | params[at + 2] << 8, params[at + 5:end]))
        at = end
    return entries


def is_whole_bulk_write(params: bytes, entries: list[tuple[int, int, bytes]]) -> bool:
    """Return whether these entries are all there is in a Bulk Write, and it writes something."""
    return bool(entries) and len(params) == sum(5 + len(data) for _, _, data in entries)


def _u16(params: bytes, at: int) -> int:
    return params[at] | params[at + 1] << 8


def _malformed(instruction: int, id: int) -> Request:
    return Request(instruction, id, Answers.NOBODY, malformed=True)


def _ping(instruction: int, id: int, params: bytes) -> Request:
    answers = Answers.EVERYBODY if id == BROADCAST else Answers.PING
    return Request(instruction, id, answers)


def _read(instruction: int, id: int, params: bytes) -> Request:
    if len(params) != 4:
        return _malformed(instruction, id)
    access = Access(id, _u16(params, 0), _u16(params, 2), None)
    answers = Answers.NOBODY if id == BROADCAST else Answers.DATA
    return Request(instruction, id, answers, (access,))


def _acknowledged(id: int) -> Answers:
    return Answers.NOBODY if id == BROADCAST else Answers.ACK


def _write(instruction: int, id: int, params: bytes) -> Request:
    if len(params) < 3:
        return _malformed(instruction, id)
    access = Access(id, _u16(params, 0), len(params) - 2, params[2:])
    return Request(instruction, id, _acknowledged(id), (access,))


def _command(instruction: int, id: int, params: bytes) -> Request:
    return Request(instruction, id, _acknowledged(id), option=_option(instruction, params))


def _option(instruction: int, params: bytes) -> str:
    if instruction == Instruction.FACTORY_RESET:
        return RESET_OPTIONS.get(params[0], '') if params else ''
    if instruction == Instruction.CLEAR:
        return CLEAR_KEYS.get(params[1:5], '')
    return BACKUP_OPTIONS.get(params, '')


def _sync_read(instruction: int, id: int, params: bytes) -> Request:
    if len(params) < 5 or len(set(params[4:])) != len(params) - 4:
        return _malformed(instruction, id)
    address, length = _u16(params, 0), _u16(params, 2)
    accesses = tuple(Access(one, address, length, None) for one in params[4:])
    return Request(instruction, id, _LISTED[instruction], accesses)


def _bulk_read(instruction: int, id: int, params: bytes) -> Request:
    if not params or len(params) % 5 or len(set(params[::5])) != len(params) // 5:
        return _malformed(instruction, id)
    accesses = tuple(Access(params[at], _u16(params, at + 1), _u16(params, at + 3), None)
                     for at in range(0, len(params), 5))
    return Request(instruction, id, _LISTED[instruction], accesses)


def _sync_write(instruction: int, id: int, params: bytes) -> Request:
    if len(params) < 5:
        return _malformed(instruction, id)
    address, length = _u16(params, 0), _u16(params, 2)
    if not length or (len(params) - 4) % (length + 1):
        return _malformed(instruction, id)
    accesses = tuple(Access(params[at], address, length, params[at + 1:at + 1 + length])
                     for at in range(4, len(params), length + 1))
    return Request(instruction, id, Answers.NOBODY, accesses)


def _bulk_write(instruction: int, id: int, params: bytes) -> Request:
    entries = bulk_write_entries(params)
    accesses = tuple(Access(one, address, len(data), data) for one, address, data in entries)
    return Request(instruction, id, Answers.NOBODY, accesses,
                   malformed=not is_whole_bulk_write(params, entries))


_LISTED: dict[int, Answers] = {
    Instruction.SYNC_READ: Answers.LISTED, Instruction.BULK_READ: Answers.LISTED,
    Instruction.FAST_SYNC_READ: Answers.COMBINED, Instruction.FAST_BULK_READ: Answers.COMBINED,
}

# Their parameters list the devices; they are sent to everybody and to nobody else.
_TO_MANY = (*_LISTED, Instruction.SYNC_WRITE, Instruction.BULK_WRITE)

_PARSERS: dict[int, Callable[[int, int, bytes], Request]] = {
    Instruction.PING: _ping,
    Instruction.READ: _read,
    Instruction.WRITE: _write,
    Instruction.REG_WRITE: _write,
    Instruction.ACTION: _command,
    Instruction.FACTORY_RESET: _command,
    Instruction.REBOOT: _command,
    Instruction.CLEAR: _command,
    Instruction.CONTROL_TABLE_BACKUP: _command,
    Instruction.SYNC_READ: _sync_read,
    Instruction.SYNC_WRITE: _sync_write,
    Instruction.FAST_SYNC_READ: _sync_read,
    Instruction.BULK_READ: _bulk_read,
    Instruction.BULK_WRITE: _bulk_write,
    Instruction.FAST_BULK_READ: _bulk_read,
}
