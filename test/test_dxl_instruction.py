# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""What instructions ask for, and combined replies cut at every byte."""

import json
from pathlib import Path

from packets import instructions_of
from packets import packets_in
import pytest

from msg_defs.dxl_instruction import error_text
from msg_defs.dxl_instruction import Instruction
from msg_defs.dxl_instruction import name_of
from msg_defs.dxl_instruction import parse
from msg_defs.dxl_packet import Framer

VECTORS = Path(__file__).parents[2] / 'shared' / 'data' / 'dxl_vectors.json'


@pytest.mark.parametrize(('instruction', 'number', 'params', 'answers', 'accesses'),
                         instructions_of('2.0'))
def test_who_is_addressed_and_who_answers(instruction, number, params, answers, accesses):
    request = parse(instruction, number, params)
    is_malformed = answers == 'malformed'
    assert (request.malformed, request.answers.name, request.accesses) \
        == (is_malformed, 'NONE' if is_malformed else answers, accesses)


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
