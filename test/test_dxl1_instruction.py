# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""What instructions of the 1.0 family ask for, by dialect, and how 2.0 would say the same."""

from hypothesis import given
from hypothesis import settings
from hypothesis import strategies as st
from packets import instructions_of
import pytest

from msg_defs.dxl1_instruction import DIALECTS
from msg_defs.dxl1_instruction import DYNAMIXEL_1
from msg_defs.dxl1_instruction import error_text
from msg_defs.dxl1_instruction import FEETECH
from msg_defs.dxl1_instruction import fits
from msg_defs.dxl1_instruction import parse
from msg_defs.dxl1_instruction import protocol_2_error
from msg_defs.dxl1_instruction import UNDECIDED
from msg_defs.dxl1_instruction import widen_params
from msg_defs.dxl1_packet import BROADCAST
from msg_defs.dxl_instruction import Access
from msg_defs.dxl_instruction import Answers
from msg_defs.dxl_instruction import parse as parse_2


@pytest.mark.parametrize(('code', 'number', 'params', 'answers', 'accesses'),
                         instructions_of('1.0'))
def test_both_dialects_understand(code, number, params, answers, accesses):
    if answers == 'malformed':
        request = parse(code, number, params)
        assert (request.malformed, request.answers, request.accesses) == (True, Answers.NONE, ())
        assert not fits(code, number, params)
        return
    for dialect in DIALECTS:
        request = parse(code, number, params, dialect)
        assert (request.answers.name, request.accesses) == (answers, accesses)
        assert not request.malformed
    # The other protocol, parsed by its own rules, says the same; it has options to a reset.
    said = parse_2(code, number, widen_params(code, params))
    assert (said.answers.name, said.accesses, said.malformed) == (answers, accesses, False)


def test_what_only_one_of_them_has():
    bulk, sync = b'\0\2\1\x1e\2\2\x24', b'\x38\2\1\2\3'
    asked = (Access(1, 30, 2, None), Access(2, 36, 2, None))
    assert parse(0x92, BROADCAST, bulk, DYNAMIXEL_1).accesses == asked
    assert parse_2(0x92, BROADCAST, widen_params(0x92, bulk)).accesses == asked
    asked = tuple(Access(one, 56, 2, None) for one in (1, 2, 3))
    assert parse(0x82, BROADCAST, sync, FEETECH).accesses == asked
    assert parse_2(0x82, BROADCAST, widen_params(0x82, sync)).accesses == asked
    assert not fits(0x92, BROADCAST, bulk, FEETECH)
    assert not fits(0x82, BROADCAST, sync, DYNAMIXEL_1)
    for code in (0x09, 0x0A, 0x0B):
        assert fits(code, 1, b'', FEETECH)
        assert not fits(code, 1, b'', DYNAMIXEL_1)
    assert all(fits(code, BROADCAST, params) for code, params in ((0x92, bulk), (0x82, sync)))


def test_an_error_byte_is_a_set_of_flags():
    assert error_text(0, FEETECH) == ''
    assert error_text(0x25, FEETECH) == 'voltage, overheating, overload'
    assert error_text(0x24, DYNAMIXEL_1) == 'overheating, overload'
    assert error_text(0x52, DYNAMIXEL_1) == 'angle limit, checksum, instruction'
    assert error_text(0x10, FEETECH) == 'error bit 4'


@pytest.mark.parametrize(('error', 'dialect', 'said'), [
    (0, DYNAMIXEL_1, 0), (0x24, DYNAMIXEL_1, 0x80), (0x40, DYNAMIXEL_1, 2), (0x08, DYNAMIXEL_1, 4),
    (0x10, DYNAMIXEL_1, 3), (0x02, DYNAMIXEL_1, 6), (0x41, DYNAMIXEL_1, 0x82),
    (0x02, FEETECH, 0x80), (0x08, FEETECH, 0x80), (0x21, FEETECH, 0x80), (0x01, UNDECIDED, 0x80),
])
def test_what_refuses_an_instruction_and_what_tells_a_state(error, dialect, said):
    assert protocol_2_error(error, dialect) == said


@settings(max_examples=500)
@given(st.sampled_from([1, 2, 3, 4, 5, 6, 8, 9, 10, 11, 0x82, 0x83, 0x92, 0, 0x55]),
       st.sampled_from([0, 1, 253, BROADCAST, 255]), st.binary(max_size=60),
       st.sampled_from(DIALECTS))
def test_nothing_raises_and_2_0_says_the_same(code, number, params, dialect):
    request = parse(code, number, params, dialect)
    assert request.malformed == (code in dialect.entries
                                 and not fits(code, number, params, dialect))
    if fits(code, number, params, dialect):
        assert parse_2(code, number, widen_params(code, params)).accesses == request.accesses
