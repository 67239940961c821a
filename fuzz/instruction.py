# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""Instruction packets: parameters to what they address, and stuffing."""

from fuzz.script import Script
from msg_defs.dxl_instruction import Answers
from msg_defs.dxl_instruction import bulk_write_entries
from msg_defs.dxl_instruction import error_text
from msg_defs.dxl_instruction import Instruction as I
from msg_defs.dxl_instruction import name_of
from msg_defs.dxl_instruction import parse
from msg_defs.dxl_packet import encode
from msg_defs.dxl_packet import Framer
from msg_defs.dxl_packet import stuff
from msg_defs.dxl_packet import unstuff


def check(data):
    """
    Check one instruction packet.

    Never raises; nothing is made up: accesses spell the parameters again; what is malformed has
    none; stuffing is undone; a packet comes back as it was sent.
    """
    script = Script(data)
    instruction, number, params = script.byte(), script.byte(), script.rest()
    request = parse(instruction, number, params)
    assert (request.instruction, request.id) == (instruction, number)
    assert name_of(instruction)
    assert isinstance(error_text(number), str)
    if request.malformed:
        assert request.answers is Answers.NOBODY
        assert not request.accesses
    elif instruction in _SPELL:
        assert _SPELL[instruction](request.accesses) == params
    bulk_write_entries(params)
    assert unstuff(stuff(params)) == params
    # A run of FF FF FD that begins in the instruction byte is of no instruction there is.
    if instruction not in (I.STATUS, 0xFF) and len(params) < 900:
        comes_back(number, instruction, params)


def comes_back(number, instruction, params):
    [packet] = Framer().feed(encode(number, instruction, params), 1)
    assert packet[2:] == (number, instruction, None, params, False)


def _u16(value):
    return value.to_bytes(2, 'little')


def _one(accesses):
    [access] = accesses
    return _u16(access.address) + (_u16(access.length) if access.data is None else access.data)


def _sync(accesses):
    """Spell what all have in common once."""
    first = accesses[0]
    assert all((one.address, one.length) == (first.address, first.length) for one in accesses)
    return _u16(first.address) + _u16(first.length) + b''.join(
        bytes([one.id]) + (one.data or b'') for one in accesses)


def _bulk(accesses):
    return b''.join(bytes([one.id]) + _u16(one.address) + _u16(one.length) + (one.data or b'')
                    for one in accesses)


_SPELL = {
    I.READ: _one, I.WRITE: _one, I.REG_WRITE: _one,
    I.SYNC_READ: _sync, I.FAST_SYNC_READ: _sync, I.SYNC_WRITE: _sync,
    I.BULK_READ: _bulk, I.FAST_BULK_READ: _bulk, I.BULK_WRITE: _bulk,
}
