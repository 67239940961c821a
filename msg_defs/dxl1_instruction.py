# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""
What an instruction of the Protocol 1.0 family asks for, in Dynamixel 1.0 and in Feetech.

A dialect is a table: how the parameters of each code are laid out, who answers. The
parameters of 2.0 say the same with wider addresses; widen_params() puts them into that form, so
that one tracker follows both. Sources: e-Manual, Protocol 1.0; Feetech, SCS Communication
Protocol; the SDKs of both makers; USB2AX and ArbotiX, their firmware. No parameters raise an
exception.
"""

from collections.abc import Callable
from typing import NamedTuple

from msg_defs.dxl1_packet import BROADCAST
from msg_defs.dxl_instruction import Access
from msg_defs.dxl_instruction import ADAPTER_READ
from msg_defs.dxl_instruction import ALERT
from msg_defs.dxl_instruction import Answers
from msg_defs.dxl_instruction import answers_of
from msg_defs.dxl_instruction import Block
from msg_defs.dxl_instruction import Instruction
from msg_defs.dxl_instruction import parse as parse_2
from msg_defs.dxl_instruction import Request
from msg_defs.dxl_instruction import RESET_ALL
from msg_defs.servo_frame import INSTRUCTION_1
from msg_defs.servo_frame import MALFORMED_1

ADAPTER_IDS = 253, BROADCAST        # USB2AX has an ID of its own, ArbotiX has none
STATUS_BITS = 0x7F                 # bit 7 of an error byte is always 0: no 0x82, 0x83, 0x92


# How the parameters of an instruction are laid out: whether these are.
def _nothing(id: int, params: bytes) -> bool:
    return not params


def _address_size(id: int, params: bytes) -> bool:
    return len(params) == 2 and params[1] > 0


def _address_data(id: int, params: bytes) -> bool:
    return len(params) > 1


def _sync_read(id: int, params: bytes) -> bool:
    """Tell whether they are address, size, IDs."""
    return id == BROADCAST and len(params) > 2 and len(set(params[2:])) == len(params) - 2


def _adapter_read(id: int, params: bytes) -> bool:
    return id in ADAPTER_IDS and _sync_read(BROADCAST, params) and params[1] > 0


def _sync_write(id: int, params: bytes) -> bool:
    """Tell whether they are address, size, (ID, data) for each."""
    return (id == BROADCAST and len(params) > 2 and params[1] > 0
            and (len(params) - 2) % (params[1] + 1) == 0)


def _bulk_read(id: int, params: bytes) -> bool:
    """Tell whether they are 00, (size, ID, address) for each."""
    return (id == BROADCAST and len(params) > 3 and len(params) % 3 == 1 and params[0] == 0
            and len(set(params[2::3])) == len(params) // 3)


def _maybe_a_word(id: int, params: bytes) -> bool:
    return len(params) in (0, 2)


class DialectInstruction(NamedTuple):
    """One instruction of a dialect; answers: to a single device, LISTED for a group."""

    fits: Callable[[int, bytes], bool]     # whether an ID and parameters do
    answers: Answers


class Dialect(NamedTuple):
    """
    What distinguishes one dialect of the family from another.

    protocol: what model files and parameters call it. errors: bits of the error byte in words.
    refusals: those of them that refuse an instruction, with the error number that 2.0 has for it;
    all others tell the state of the device.
    error_at: where the error byte is in the control table; 256 is after its end.
    identity_at: the address of Model Number.
    """

    name: str
    protocol: str
    entries: dict[int, DialectInstruction]
    errors: dict[int, str]
    refusals: dict[int, int]
    error_at: int
    identity_at: int


_COMMON: dict[int, DialectInstruction] = {
    Instruction.PING: DialectInstruction(_nothing, Answers.PING),
    Instruction.READ: DialectInstruction(_address_size, Answers.DATA),
    Instruction.WRITE: DialectInstruction(_address_data, Answers.ACK),
    Instruction.REG_WRITE: DialectInstruction(_address_data, Answers.ACK),
    Instruction.ACTION: DialectInstruction(_nothing, Answers.ACK),
    Instruction.FACTORY_RESET: DialectInstruction(_nothing, Answers.ACK),
    Instruction.SYNC_WRITE: DialectInstruction(_sync_write, Answers.NONE),
}
CALIBRATE = 0x0B
_FEETECH: dict[int, DialectInstruction] = {         # FEETECH_NAMES has the names
    0x09: DialectInstruction(_nothing, Answers.ACK),
    0x0A: DialectInstruction(_nothing, Answers.ACK),
    CALIBRATE: DialectInstruction(_maybe_a_word, Answers.ACK),
    Instruction.SYNC_READ: DialectInstruction(_sync_read, Answers.LISTED),
}

DYNAMIXEL_1 = Dialect(
    name='Dynamixel 1.0', protocol='1',
    entries={**_COMMON, Instruction.REBOOT: DialectInstruction(_nothing, Answers.ACK),
             Instruction.BULK_READ: DialectInstruction(_bulk_read, Answers.LISTED),
             ADAPTER_READ: DialectInstruction(_adapter_read, Answers.ADAPTER)},
    errors={0: 'input voltage', 1: 'angle limit', 2: 'overheating', 3: 'range', 4: 'checksum',
            5: 'overload', 6: 'instruction'},
    refusals={1: 6, 3: 4, 4: 3, 6: 2},
    error_at=256, identity_at=0)
# It is away for 0.8 s after a Reboot, and does not say so first.
FEETECH = Dialect(
    name='Feetech', protocol='feetech',
    entries={**_COMMON, Instruction.REBOOT: DialectInstruction(_nothing, Answers.NONE),
             **_FEETECH},
    errors={0: 'voltage', 1: 'angle sensor', 2: 'overheating', 3: 'current', 5: 'overload'},
    refusals={},
    error_at=65, identity_at=3)
# As long as it is not known which of the two a bus speaks: what they have in common is certain,
# and what only one of them has is understood.
UNDECIDED = Dialect(
    name='Dynamixel 1.0 or Feetech', protocol='1 or feetech',
    entries={**DYNAMIXEL_1.entries, **FEETECH.entries},
    errors={0: 'voltage', 1: 'angle limit or sensor', 2: 'overheating', 3: 'range or current',
            5: 'overload'},
    refusals={3: 4, 4: 3, 6: 2},
    error_at=256, identity_at=-1)
DIALECTS = (DYNAMIXEL_1, FEETECH, UNDECIDED)


def error_text(error: int, dialect: Dialect) -> str:
    """Return the error byte of a status in words: 'voltage, overload'; '' for 0."""
    return ', '.join(dialect.errors.get(bit, f'error bit {bit}')
                     for bit in range(8) if error >> bit & 1)


def protocol_2_error(error: int, dialect: Dialect) -> int:
    """Return an error byte as 2.0 would say it: the number of a refusal, and the alert bit."""
    number = next((number for bit, number in dialect.refusals.items() if error >> bit & 1), 0)
    state = error & ~sum(1 << bit for bit in dialect.refusals)
    return number | (ALERT if state else 0)


def fits(code: int, id: int, params: bytes, dialect: Dialect = UNDECIDED) -> bool:
    """Return whether a frame makes sense as an instruction of this dialect."""
    entry = dialect.entries.get(code)
    return entry is not None and entry.fits(id, params)


def parse(code: int, id: int, params: bytes, dialect: Dialect = UNDECIDED) -> Request:
    """Return what an instruction asks for."""
    kind, wide = widen_instruction(code, id, params)
    return parse_widened(kind, code, id, wide, dialect)


def widen_params(code: int, params: bytes) -> bytes:
    """Return parameters that fit, with addresses and sizes as wide as those of 2.0."""
    if code in (0x02, 0x82, 0x83, ADAPTER_READ):
        return bytes((params[0], 0, params[1], 0)) + params[2:]
    if code in (0x03, 0x04):
        return params[:1] + b'\0' + params[1:]
    if code == 0x92:
        return b''.join(bytes((params[at + 1], params[at + 2], 0, params[at], 0))
                        for at in range(1, len(params), 3))
    return params


def widen_instruction(code: int, id: int, params: bytes) -> tuple[int, bytes]:
    """Return of what kind the frame of an instruction is, and its parameters in widen_params()."""
    entry = UNDECIDED.entries.get(code)
    if entry is not None and not entry.fits(id, params):
        return MALFORMED_1, params
    return INSTRUCTION_1, widen_params(code, params)


def parse_widened(kind: int, code: int, id: int, params: bytes, dialect: Dialect) -> Request:
    """Return what an instruction in the form of widen_instruction() asks for."""
    entry = dialect.entries.get(code)
    if entry is None or kind == MALFORMED_1:
        return Request(code, id, Answers.NONE, malformed=entry is not None)
    if entry.answers is Answers.ADAPTER:
        return parse_2(Instruction.SYNC_READ, BROADCAST, params)._replace(
            instruction=code, answers=Answers.ADAPTER)
    request = parse_2(code, id, params)
    # A reset of Dynamixel sets the ID to 1, one of Feetech keeps it.
    sets_id = dialect is DYNAMIXEL_1 and code == Instruction.FACTORY_RESET
    return request._replace(answers=answers_of(entry.answers, id), malformed=False,
                            option=RESET_ALL if sets_id else '')


def split_adapter_status(data: bytes, accesses: tuple[Access, ...]) -> tuple[Block, ...] | None:
    """
    Return what an adapter has read of each device; None if the sizes do not fit.

    It puts FF in place of the data of a device that did not answer: that has no part.
    """
    size = accesses[0].length
    if len(data) != size * len(accesses):
        return None
    parts = [data[at:at + size] for at in range(0, len(data), size)]
    return tuple(Block(access.id, 0, part) for access, part in zip(accesses, parts, strict=True)
                 if part.strip(b'\xff'))
