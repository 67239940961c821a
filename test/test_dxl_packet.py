# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""Packets on the wire: published vectors both ways, every kind of damage, every kind of split."""

import json
from pathlib import Path

from hypothesis import given
from hypothesis import strategies as st
from packets import fed
from packets import packets_in
from packets import packets_left
import pytest

from msg_defs.dxl_packet import BROADCAST
from msg_defs.dxl_packet import encode
from msg_defs.dxl_packet import Framer
from msg_defs.dxl_packet import HEADER
from msg_defs.dxl_packet import MAX_FRAME
from msg_defs.dxl_packet import STATUS
from msg_defs.dxl_packet import stuff
from msg_defs.dxl_packet import unstuff
from msg_defs.servo_frame import Flaw
from msg_defs.servo_frame import INSTRUCTION_2
from msg_defs.servo_frame import is_good

DATA = Path(__file__).parents[2] / 'shared' / 'data'
VECTORS = DATA / 'dxl_vectors.json'
NO_VECTORS = 'skipped: the published vectors are not here'

PING = encode(1, 0x01)
READ = encode(1, 0x02, b'\x84\x00\x04\x00')
REPLY = encode(1, STATUS, b'\xa6\x00\x00\x00', error=0)


def vectors():
    if not VECTORS.is_file():
        pytest.skip(NO_VECTORS)
    return json.loads(VECTORS.read_text())['vectors']


def feed(data, sizes=()):
    return fed(Framer(), packets_in, MAX_FRAME, data, sizes)


def test_vectors_decode_and_the_invalid_ones_do_not():
    for vector in vectors():
        found, framer = feed(bytes.fromhex(vector['hex']))
        assert len(found) == vector['valid'], vector
        if not vector['valid']:
            continue
        packet = found[0]
        wire_params = bytes.fromhex(vector['wire_params_hex'])
        combined = packet.id == BROADCAST and packet.instruction == STATUS
        assert packet.id == vector['id']
        assert packet.instruction == int(vector['instruction'].split('0x')[1][:2], 16)
        assert packet.error == vector.get('error_byte')
        assert packet.params == (wire_params if combined else unstuff(wire_params))
        assert framer.noise_bytes == 0


def test_vectors_encode_to_the_same_bytes():
    checked = 0
    for vector in vectors():
        wire = bytes.fromhex(vector['hex'])
        found, _ = feed(wire)
        for packet in found:
            rule = stuff(packet.params) == bytes.fromhex(vector['wire_params_hex'])
            assert encode(packet.id, packet.instruction, packet.params, packet.error,
                          stuffed=rule and packet.id != BROADCAST) == wire, vector
            checked += 1
    assert checked == sum(vector['valid'] for vector in vectors())


# --- exactly what is said of a frame, without any published data ---

RUN = b'\xff\xff\xfd'
BAD_REPLY = REPLY[:-1] + bytes([REPLY[-1] ^ 1])


def test_stamps_are_those_of_the_deciding_chunk():
    framer = Framer()
    assert packets_in(framer, READ, 5)[0].stamp == 5
    begun = encode(1, 0x03, bytes(100))[:9]
    packets_in(framer, begun + PING, 6)
    assert [packet.stamp for packet in packets_left(framer, 7)] == [7]
    packets_in(framer, begun + PING, 8)
    assert [packet.stamp for packet in packets_left(framer)] == [0]


@pytest.mark.parametrize(('wire', 'reason', 'counts'), [
    (BAD_REPLY, 'crc', (1, 0, 0)),
    (REPLY[:-1], 'cut', (0, 1, 0)),
    (REPLY[:9] + PING, 'cut', (0, 1, 0)),
    (encode(1, STATUS, b'1234567', 0)[:-3] + RUN, 'cut', (0, 1, 0)),
    (encode(1, STATUS, b'1234567', 0)[:-2] + b'\xff\xff', 'cut', (0, 1, 0)),
    (HEADER + b'\x01\x01\x04\x03' + bytes(20), 'length', (0, 0, 1)),
    (HEADER + b'\x01\x02\x00\x03' + bytes(20), 'length', (0, 0, 1)),
], ids=['crc', 'cut by silence', 'cut by a header', 'ends in FF FF FD', 'ends in FF FF', 'long',
        'short'])
def test_what_is_wrong_is_said_exactly(wire, reason, counts):
    framer = Framer()
    framer.frames(PING)
    damaged = [one for one in framer.frames(wire) + framer.flush_frames() if not is_good(one)]
    [(begin, end, kind, number, code, data, flaw)] = damaged
    assert flaw == Flaw(reason, length=int.from_bytes(wire[5:7], 'little'))
    assert (number, code) == (wire[4], wire[7] if kind == INSTRUCTION_2 else STATUS)
    assert data == wire[4:4 + len(data)]
    assert reason != 'length' or len(data) == 4      # who, how long and what: no more is known
    assert (begin, end) == (len(PING), len(PING) + 4 + len(data))
    assert tuple(framer.damaged.values()) == counts


# --- pauses --------------------------------------------------------------------------------------

FAST = encode(0xFE, STATUS, HEADER + bytes(20), error=0, stuffed=False)


@pytest.mark.parametrize('cut', range(1, len(FAST)))
def test_a_frame_around_a_pause_is_whole(cut):
    framer = Framer()
    assert packets_in(framer, FAST[:cut], 0) == []
    framer.interrupt()
    assert len(packets_in(framer, FAST[cut:], 0)) == 1
    assert (framer.noise_bytes, framer.damaged['cut']) == (0, 0)


def test_a_header_behind_a_pause_ends_the_frame_before_it():
    framer = Framer()
    packets_in(framer, FAST[:20], 0)
    framer.interrupt()
    assert [packet.instruction for packet in packets_in(framer, encode(1, 1), 0)] == [1]
    assert (framer.noise_bytes, framer.damaged['cut'], framer.pending) == (20, 1, 0)


@given(st.lists(st.one_of(st.none(), st.binary(max_size=12), st.sampled_from(
    [HEADER, HEADER[:2], HEADER[2:], FAST, FAST[:9], encode(1, 1)])), max_size=12))
def test_pauses_anywhere_raise_nothing_and_lose_no_byte(pieces):
    framer = Framer()
    for piece in pieces:
        if piece is None:
            framer.interrupt()
        else:
            framer.frames(piece)
    assert framer.bytes == sum(len(piece) for piece in pieces if piece)
    assert framer.packet_bytes + framer.noise_bytes + framer.pending == framer.bytes
