# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""
What a Dynamixel instruction addresses: who, which range, which data, and who must answer.

e-Manual, Protocol 2.0, instruction packets. Takes the parameters unstuffed; nothing
in them raises: what does not fit its instruction is marked malformed.
"""

from collections.abc import Callable
from collections.abc import Mapping
from enum import Enum
from enum import IntEnum
from struct import Struct
from typing import NamedTuple

from msg_defs.crc import crc16
from msg_defs.dxl_packet import BROADCAST
from msg_defs.dxl_packet import HEADER
from msg_defs.dxl_packet import HEADER_CRC


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

FEETECH_NAMES = {0x09: 'Parameter Backup', 0x0A: 'Reset', 0x0B: 'Calibrate'}
# No servo has it: the adapters USB2AX and ArbotiX read each listed servo of Protocol 1.0.
ADAPTER_READ = 0x84
_ADAPTER_NAMES = {ADAPTER_READ: 'Sync Read by the adapter'}

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
RESET_OPTIONS = {b'\xff': RESET_ALL, b'\x01': 'all except ID',
                 b'\x02': 'all except ID and Baud Rate'}
# By the key bytes alone: clients disagree about the byte in front of them.
CLEAR_KEYS = {b'\x44\x58\x4c\x22': MULTI_TURN, b'\x45\x52\x43\x4c': ERROR}
BACKUP_OPTIONS = {b'\x01CTRL': STORE, b'\x02CTRL': RESTORE}


class Answers(Enum):
    """Who answers an instruction."""

    NONE = 'no device'
    DATA = 'the addressed device, with data, at Status Return Level 1 and 2'
    PING = 'the addressed device, always'
    ACK = 'the addressed device, at Status Return Level 2'
    EVERYBODY = 'each device, in the order of IDs'
    LISTED = 'each listed device, in the order of the list'
    COMBINED = 'the listed devices together, in one status'
    ADAPTER = 'the adapter, with what it read of each listed device, in one status'


_OF_ONE_DEVICE = (Answers.PING, Answers.DATA, Answers.ACK)


class Access(NamedTuple):
    """A range of one device's control table; data is None for a read."""

    id: int
    address: int
    length: int
    data: bytes | None = None


class Request(NamedTuple):
    """An instruction packet, understood."""

    instruction: int
    id: int                        # as addressed, 254 = broadcast
    answers: Answers
    accesses: tuple[Access, ...] = ()
    option: str = ''               # for Factory Reset, Clear and Backup; '' also if unknown
    malformed: bool = False

    @property
    def address(self) -> int:
        """The address that it is about, the first one of several; -1 for none."""
        return self.accesses[0].address if self.accesses else -1


# What parameters address, as far as they make sense, and whether all of them do.
Parsed = tuple[tuple[Access, ...], bool]
MALFORMED: Parsed = (), False
span_at = Struct('<HH').unpack_from        # address and length


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
    """Return 'Sync Read', or 'instruction 0x8B' for what no protocol knows."""
    return (NAMES.get(instruction) or FEETECH_NAMES.get(instruction)
            or _ADAPTER_NAMES.get(instruction) or f'instruction 0x{instruction:02X}')


def answers_of(answers: Answers, id: int) -> Answers:
    """Return who answers at this ID what one device, or each listed one, answers like that."""
    if id != BROADCAST or answers not in _OF_ONE_DEVICE:
        return answers
    return Answers.EVERYBODY if answers is Answers.PING else Answers.NONE


def parse(instruction: int, id: int, params: bytes) -> Request:
    """Return what an instruction asks for; params are unstuffed."""
    kind = KINDS.get(instruction)
    if kind is None:
        return Request(instruction, id, Answers.NONE)
    is_to_one = kind.answers in _OF_ONE_DEVICE
    accesses, is_whole = kind.parse(id, params) if is_to_one or id == BROADCAST else MALFORMED
    answers = answers_of(kind.answers, id) if is_whole else Answers.NONE
    option = kind.options.get(params[kind.options_at], '')
    return Request(instruction, id, answers, accesses, option, malformed=not is_whole)


def split_combined(body: bytes, accesses: tuple[Access, ...]) -> list[Block]:
    """
    Return the parts of a fast reply with a good CRC, up to the first with a bad one.

    body is all there is from the ID on, the last CRC included, cut anywhere; accesses are those
    of the instruction. Each CRC covers the wire from the header on, earlier CRCs included. They
    are looked at in a good frame too: a device takes its CRC from what it heard, so the last one
    is right also where an earlier part was damaged on the way.
    """
    blocks: list[Block] = []
    size = len(body) - 2
    covered = 0                    # bytes that crc covers, from the ID on
    crc = HEADER_CRC
    for access in accesses:
        at = covered + (2 if covered else 4)
        end = at + 2 + access.length
        crc = crc16(body[covered:end], crc)
        if end > size or body[at + 1] != access.id or crc != body[end] | body[end + 1] << 8:
            break
        blocks.append(Block(access.id, body[at], body[at + 2:end]))
        covered = end
    return blocks


def blocks_in(body: bytes, accesses: tuple[Access, ...]) -> int:
    """Return how many parts of a fast reply are there, damaged or not, before another packet."""
    end = body.find(HEADER, 4)
    left = (len(body) if end < 0 else end) - 4
    for number, access in enumerate(accesses):
        left -= access.length + 4
        if left < 0:
            return number
    return len(accesses)


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


def _command(id: int, params: bytes) -> Parsed:
    return (), True


def _read(id: int, params: bytes) -> Parsed:
    return ((Access(id, *span_at(params)),), True) if len(params) == 4 else MALFORMED


def _write(id: int, params: bytes) -> Parsed:
    if len(params) < 3:
        return MALFORMED
    data = params[2:]
    return (Access(id, int.from_bytes(params[:2], 'little'), len(data), data),), True


def _sync_read(id: int, params: bytes) -> Parsed:
    ids = params[4:]
    if not ids or len(set(ids)) != len(ids):
        return MALFORMED
    accesses = [Access(one, *span_at(params)) for one in ids]
    return tuple(accesses), True


def _bulk_read(id: int, params: bytes) -> Parsed:
    if not params or len(params) % 5 or len(set(params[::5])) != len(params) // 5:
        return MALFORMED
    accesses = [Access(params[at], *span_at(params, at + 1)) for at in range(0, len(params), 5)]
    return tuple(accesses), True


def _sync_write(id: int, params: bytes) -> Parsed:
    if len(params) < 5:
        return MALFORMED
    address, length = span_at(params)
    if not length or (len(params) - 4) % (length + 1):
        return MALFORMED
    accesses = [Access(params[at], address, length, params[at + 1:at + 1 + length])
                for at in range(4, len(params), length + 1)]
    return tuple(accesses), True


def _bulk_write(id: int, params: bytes) -> Parsed:
    entries = bulk_write_entries(params)
    accesses = [Access(one, address, len(data), data) for one, address, data in entries]
    return tuple(accesses), is_whole_bulk_write(params, entries)


class Kind(NamedTuple):
    """
    What is known of an instruction.

    answers: who answers it; one that no single device answers is sent to the broadcast ID alone.
    parse: from its ID and parameters. key_size: how many of its parameters tell one from another
    where the rest is data to write; None: all. options: what it may do, by the parameters at a
    place.
    """

    answers: Answers
    parse: Callable[[int, bytes], Parsed] = _command
    options: Mapping[bytes, str] = {}
    options_at: slice = slice(None)
    key_size: int | None = None


KINDS: dict[int, Kind] = {
    Instruction.PING: Kind(Answers.PING),
    Instruction.READ: Kind(Answers.DATA, _read),
    Instruction.WRITE: Kind(Answers.ACK, _write, key_size=2),
    Instruction.REG_WRITE: Kind(Answers.ACK, _write, key_size=2),
    Instruction.ACTION: Kind(Answers.ACK),
    Instruction.FACTORY_RESET: Kind(Answers.ACK, options=RESET_OPTIONS, options_at=slice(1)),
    Instruction.REBOOT: Kind(Answers.ACK),
    Instruction.CLEAR: Kind(Answers.ACK, options=CLEAR_KEYS, options_at=slice(1, 5)),
    Instruction.CONTROL_TABLE_BACKUP: Kind(Answers.ACK, options=BACKUP_OPTIONS),
    Instruction.SYNC_READ: Kind(Answers.LISTED, _sync_read),
    Instruction.SYNC_WRITE: Kind(Answers.NONE, _sync_write, key_size=4),
    Instruction.FAST_SYNC_READ: Kind(Answers.COMBINED, _sync_read),
    Instruction.BULK_READ: Kind(Answers.LISTED, _bulk_read),
    Instruction.BULK_WRITE: Kind(Answers.NONE, _bulk_write, key_size=0),
    Instruction.FAST_BULK_READ: Kind(Answers.COMBINED, _bulk_read),
}
