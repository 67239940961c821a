# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""What instructions ask for, and combined replies cut at every byte."""

import json
from pathlib import Path
import struct

from packets import packets_in
import pytest

from msg_defs.crc import crc16
from msg_defs.dxl_instruction import Access
from msg_defs.dxl_instruction import Answers
from msg_defs.dxl_instruction import error_text
from msg_defs.dxl_instruction import Instruction
from msg_defs.dxl_instruction import name_of
from msg_defs.dxl_instruction import parse
from msg_defs.dxl_packet import BROADCAST
from msg_defs.dxl_packet import Framer
from msg_defs.dxl_packet import HEADER
from msg_defs.dxl_packet import STATUS

VECTORS = Path(__file__).parents[2] / 'shared' / 'data' / 'dxl_vectors.json'


def words(*numbers):
    return struct.pack(f'<{len(numbers)}H', *numbers)


def combined(blocks):
    """Build a fast reply as the devices do, each with its own CRC over all bytes before it."""
    length = 1 + sum(len(block.data) + 4 for block in blocks)
    frame = HEADER + bytes([BROADCAST]) + words(length) + bytes([STATUS])
    for block in blocks:
        frame += bytes([block.error, block.id]) + block.data
        frame += words(crc16(frame))
    return frame




@pytest.mark.parametrize(('instruction', 'number', 'params', 'answers', 'accesses'), [
    (0x01, 1, b'', Answers.PING, ()),
    (0x01, BROADCAST, b'', Answers.EVERYBODY, ()),
    (0x02, 1, words(132, 4), Answers.DATA, (Access(1, 132, 4, None),)),
    (0x02, BROADCAST, words(132, 4), Answers.NONE, (Access(BROADCAST, 132, 4, None),)),
    (0x03, 1, words(116) + b'\x00\x02', Answers.ACK, (Access(1, 116, 2, b'\x00\x02'),)),
    (0x04, 1, words(116) + b'\x01', Answers.ACK, (Access(1, 116, 1, b'\x01'),)),
    (0x03, BROADCAST, words(64) + b'\x01', Answers.NONE, (Access(BROADCAST, 64, 1, b'\x01'),)),
    (0x05, BROADCAST, b'', Answers.NONE, ()),
    (0x08, 1, b'', Answers.ACK, ()),
    (0x82, BROADCAST, words(132, 4) + b'\x02\x01', Answers.LISTED,
     (Access(2, 132, 4, None), Access(1, 132, 4, None))),
    (0x8A, BROADCAST, words(132, 4) + b'\x02', Answers.COMBINED, (Access(2, 132, 4, None),)),
    (0x83, BROADCAST, words(116, 2) + b'\x01\x00\x02\x02\x01\x02', Answers.NONE,
     (Access(1, 116, 2, b'\x00\x02'), Access(2, 116, 2, b'\x01\x02'))),
    (0x92, BROADCAST, b'\x01' + words(144, 2) + b'\x02' + words(146, 1), Answers.LISTED,
     (Access(1, 144, 2, None), Access(2, 146, 1, None))),
    (0x9A, BROADCAST, b'\x01' + words(144, 2), Answers.COMBINED, (Access(1, 144, 2, None),)),
    (0x93, BROADCAST, b'\x01' + words(32, 2) + b'\xa0\x00\x02' + words(31, 1) + b'\x50',
     Answers.NONE, (Access(1, 32, 2, b'\xa0\x00'), Access(2, 31, 1, b'\x50'))),
    (0x8B, 1, b'\x01\x02', Answers.NONE, ()),
])
def test_who_is_addressed_and_who_answers(instruction, number, params, answers, accesses):
    request = parse(instruction, number, params)
    assert (request.answers, request.accesses) == (answers, accesses)
    assert not request.malformed


@pytest.mark.parametrize(('instruction', 'params'), [
    (0x02, b''), (0x02, b'\x00\x00\x01'), (0x03, b'\x40\x00'), (0x82, words(132, 4)),
    (0x82, words(132, 4) + b'\x01\x01'), (0x83, words(116, 4) + b'\x01\x00'),
    (0x83, words(116, 0) + b'\x01'), (0x92, b''), (0x92, b'\x01\x02\x03'),
    (0x92, (b'\x01' + words(0, 1)) * 2), (0x93, b'\x01' + words(0, 9) + b'\x01'), (0x93, b''),
])
def test_parameters_that_do_not_fit_are_malformed(instruction, params):
    request = parse(instruction, 1, params)
    assert request.malformed
    assert request.answers is Answers.NONE
    assert request.accesses == ()


def test_names_and_errors_in_words():
    assert name_of(Instruction.FAST_SYNC_READ) == 'Fast Sync Read'
    assert name_of(0x8B) == 'instruction 0x8B'
    assert [error_text(error) for error in (0, 0x80, 7, 0x87, 9)] == [
        '', 'alert', 'Access', 'Access, alert', 'error 9']


def test_published_instructions_are_understood():
    if not VECTORS.is_file():
        pytest.skip('skipped: the published vectors are not here')
    for vector in json.loads(VECTORS.read_text())['vectors']:
        packets = packets_in(Framer(), bytes.fromhex(vector['hex']), 0)
        if not packets or vector['direction'] != 'instruction':
            continue
        packet = packets[0]
        request = parse(packet.instruction, packet.id, packet.params)
        decoded = vector['decoded']
        assert not request.malformed, vector
        if 'address' in decoded:
            assert request.accesses[0].address == decoded['address']
        if 'length' in decoded:
            assert request.accesses[0].length == decoded['length']
