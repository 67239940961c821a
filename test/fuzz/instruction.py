# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""Instruction packets: parameters to what they address, and stuffing."""

from fuzz import reference
from fuzz.script import INSTRUCTIONS
from fuzz.script import Script
from fuzz.script import TRICKY
from msg_defs.dxl_instruction import Answers
from msg_defs.dxl_instruction import bulk_write_entries
from msg_defs.dxl_instruction import error_text
from msg_defs.dxl_instruction import Instruction as I
from msg_defs.dxl_instruction import name_of
from msg_defs.dxl_instruction import parse
from msg_defs.dxl_packet import encode
from msg_defs.dxl_packet import Framer
from msg_defs.dxl_packet import packet_of
from msg_defs.dxl_packet import stuff
from msg_defs.dxl_packet import unstuff
from rigs.bus import frames
from rigs.bus.frames import two

# By the e-Manual: what has parameters of one form only; all else takes any.
KEYS = {b'DXL"': 'multi-turn', b'ERCL': 'error'}
BACKUP = {b'\x01CTRL': 'store', b'\x02CTRL': 'restore'}
RESETS = {b'\xff': 'all', b'\x01': 'all except ID', b'\x02': 'all except ID and Baud Rate'}
LISTED = {0x82: Answers.LISTED, 0x92: Answers.LISTED,
          0x8A: Answers.COMBINED, 0x9A: Answers.COMBINED}
TO_MANY = (*LISTED, 0x83, 0x93)     # sent to the broadcast ID alone
ACKNOWLEDGED = (0x03, 0x04, 0x05, 0x06, 0x08, 0x10, 0x20)
OPTIONS = {
    0x06: lambda params: RESETS.get(params[:1], ''),
    0x10: lambda params: KEYS.get(params[1:5], ''),
    0x20: lambda params: BACKUP.get(params, ''),
}


def check(data):
    """
    Check one instruction packet.

    Never raises; nothing is made up and nothing left out: what is well formed by the e-Manual
    has accesses that spell the parameters again, its option and who must answer; what is
    malformed has none of these, but for a Bulk Write's writes up to where it is cut; stuffing is
    that of fuzz/reference.py and is undone; a packet comes back as it was sent.
    """
    script = Script(data)
    kind = script.byte()
    instruction = script.byte() if kind > 200 else INSTRUCTIONS[kind % len(INSTRUCTIONS)]
    number = 0xFE if script.byte() > 200 else script.byte()
    params = make_params(script, instruction) if script.byte() < 150 else script.take_rest()
    request = parse(instruction, number, params)
    assert (request.instruction, request.id) == (instruction, number)
    assert name_of(instruction)
    assert bool(error_text(number)) == (number > 0)
    is_well_formed = _WELL_FORMED.get(instruction, lambda params: True)(params) and (
        number == 0xFE or instruction not in TO_MANY)
    assert request.malformed != is_well_formed
    if request.malformed:
        assert request.answers is Answers.NONE
        assert not request.accesses or (number, instruction) == (0xFE, I.BULK_WRITE)
    else:
        assert request.answers is answers(instruction, number)
        assert request.option == OPTIONS.get(instruction, lambda params: '')(params)
        spell = _SPELL.get(instruction, lambda accesses: b'')
        assert spell(request.accesses) == (params if instruction in _SPELL else b'')
        assert instruction not in _OWN or {one.id for one in request.accesses} == {number}
    assert bulk_write_entries(params) == _bulk_entries(params)
    assert stuff(params) == frames.stuffed(params)
    assert unstuff(params) == frames.unstuffed(params)
    assert unstuff(stuff(params)) == params
    # A run of FF FF FD that begins in the instruction byte is of no instruction there is.
    if instruction not in (I.STATUS, 0xFF) and len(params) < 700:
        comes_back(number, instruction, params)


def answers(instruction, number):
    if instruction == 0x01:
        return Answers.EVERYBODY if number == 0xFE else Answers.PING
    if instruction in LISTED:
        return LISTED[instruction]
    if number != 0xFE:
        if instruction == 0x02:
            return Answers.DATA
        if instruction in ACKNOWLEDGED:
            return Answers.ACK
    return Answers.NONE


def comes_back(number, instruction, params):
    wire = encode(number, instruction, params)
    content = bytes([instruction]) + frames.stuffed(params)
    head = b'\xff\xff\xfd\x00' + bytes([number]) + two(len(content) + 2) + content
    assert wire == head + two(reference.crc16(head))
    packet, = (packet_of(one, 1) for one in Framer().frames(wire))
    assert packet[2:] == (number, instruction, None, params, False)


def make_params(script, instruction):
    """Return parameters of about the right form."""
    length = script.pick((0, 1, 2, 4, 4, 7, 300))
    where, size = two(script.word()), two(length)
    ids = [script.byte() for _ in range(script.byte() % 6)]
    if instruction in (0x92, 0x9A):
        made = b''.join(bytes([one]) + where + size for one in ids)
    elif instruction == 0x93:
        made = b''.join(bytes([one]) + where + size + _content(script, length) for one in ids)
    elif instruction == 0x83:
        made = where + size + b''.join(bytes([one]) + _content(script, length) for one in ids)
    elif instruction in (0x82, 0x8A, 0x02):
        made = where + size + bytes(ids if instruction != 0x02 else [])
    elif instruction in OPTIONS:
        made = script.pick((b'\x01DXL"', b'\x02ERCL', b'\x01ERCL', b'\x01CTRL', b'\x02CTRL',
                            b'\xff', b'\x01', b'\x02', b'\x03', b''))
    else:
        made = where + _content(script, length)
    return made[:-1] if script.byte() > 220 else made + script.take_bytes(script.byte() // 128)


def _content(script, size):
    return b''.join(script.pick(TRICKY) if script.byte() > 150 else script.take_bytes(4)
                    for _ in range(size // 4 + 1)).ljust(size, b'\xff')[:size]


def _one(accesses):
    [access] = accesses
    return two(access.address) + (two(access.length) if access.data is None else access.data)


def _sync(accesses):
    """Spell what all have in common once."""
    first = accesses[0]
    assert all((one.address, one.length) == (first.address, first.length) for one in accesses)
    return two(first.address) + two(first.length) + b''.join(
        bytes([one.id]) + (one.data or b'') for one in accesses)


def _bulk(accesses):
    return b''.join(bytes([one.id]) + two(one.address) + two(one.length) + (one.data or b'')
                    for one in accesses)


def _bulk_entries(params):
    """Return what is written by ID, address, size and so many bytes, up to what is cut."""
    entries = []
    while len(params) >= 5:
        number, content = params[0], params[5:]
        address, size = (int.from_bytes(params[at:at + 2], 'little') for at in (1, 3))
        if size > len(content):
            break
        entries += [(number, address, content[:size])] * bool(size)
        params = content[size:]
    return entries


def _is_bulk_write(params):
    entries = _bulk_entries(params)
    return bool(entries) and params == b''.join(
        bytes([number]) + two(address) + two(len(data)) + data
        for number, address, data in entries)


def _is_sync_write(params):
    size = int.from_bytes(params[2:4], 'little')
    return size > 0 and len(params) > 4 and (len(params) - 4) % (size + 1) == 0


def _is_sync_read(params):
    return len(params) > 4 and len(set(params[4:])) == len(params[4:])


def _is_bulk_read(params):
    ids = params[::5]
    return len(params) > 0 and len(params) % 5 == 0 and len(set(ids)) == len(ids)


_OWN = (I.READ, I.WRITE, I.REG_WRITE)      # concern the device that is addressed
_SPELL = {
    I.READ: _one, I.WRITE: _one, I.REG_WRITE: _one,
    I.SYNC_READ: _sync, I.FAST_SYNC_READ: _sync, I.SYNC_WRITE: _sync,
    I.BULK_READ: _bulk, I.FAST_BULK_READ: _bulk, I.BULK_WRITE: _bulk,
}
_WELL_FORMED = {
    I.READ: lambda params: len(params) == 4,
    I.WRITE: lambda params: len(params) > 2, I.REG_WRITE: lambda params: len(params) > 2,
    I.SYNC_READ: _is_sync_read, I.FAST_SYNC_READ: _is_sync_read, I.SYNC_WRITE: _is_sync_write,
    I.BULK_READ: _is_bulk_read, I.FAST_BULK_READ: _is_bulk_read, I.BULK_WRITE: _is_bulk_write,
}
