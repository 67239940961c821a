# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""Packets on the wire: published vectors both ways, every kind of damage, every kind of split."""

from itertools import product
import json
from pathlib import Path
import random
from typing import Any

from hypothesis import given
from hypothesis import strategies as st
from packets import packets_in
from packets import packets_left
import pytest

from msg_defs.crc import crc16
from msg_defs.dxl_packet import BROADCAST
from msg_defs.dxl_packet import encode
from msg_defs.dxl_packet import Framer
from msg_defs.dxl_packet import HEADER
from msg_defs.dxl_packet import MAX_FRAME
from msg_defs.dxl_packet import Packet
from msg_defs.dxl_packet import STATUS
from msg_defs.dxl_packet import stuff
from msg_defs.dxl_packet import unstuff
from msg_defs.frame import Flaw
from msg_defs.frame import INSTRUCTION_2
from msg_defs.frame import is_good
from msg_defs.frame import IS_STATUS

DATA = Path(__file__).parents[2] / 'shared' / 'data'
VECTORS = DATA / 'dxl_vectors.json'
TRACE = DATA / 'bus_trace_head.bin'
NO_VECTORS = 'skipped: the published vectors are not here'
NO_TRACE = 'skipped: the robot trace is not here'

PING = encode(1, 0x01)
READ = encode(1, 0x02, b'\x84\x00\x04\x00')
REPLY = encode(1, STATUS, b'\xa6\x00\x00\x00', error=0)
GARBAGE = [b'', b'\x00', b'\xff', b'\xff\xff', b'\xff\xff\xfd', b'\xff\xff\xff\xfd', HEADER,
           HEADER + b'\x01', bytes(range(250)), b'\xff' * 40]


def vectors() -> list[dict[str, Any]]:
    if not VECTORS.is_file():
        pytest.skip(NO_VECTORS)
    found: list[dict[str, Any]] = json.loads(VECTORS.read_text())['vectors']
    return found


def feed(data: bytes, sizes: list[int] | None = None) -> tuple[list[Packet], Framer]:
    """Feed in chunks of these sizes, the rest at once; then flush. Checks the byte accounting."""
    framer = Framer()
    found: list[Packet] = []
    at = 0
    for size in [*(sizes or []), len(data)]:
        found += packets_in(framer, data[at:at + size], 0)
        at += size
        assert framer.bytes == framer.packet_bytes + framer.noise_bytes + framer.pending
        assert framer.pending < MAX_FRAME
    found += packets_left(framer)
    assert framer.pending == 0
    assert framer.bytes == framer.packet_bytes + framer.noise_bytes == len(data)
    assert framer.packets == len(found)
    return found, framer


def summary(framer: Framer) -> tuple[int, ...]:
    return (framer.packets, framer.repaired, framer.crc_errors, framer.truncated,
            framer.bad_length, framer.noise_bytes)


def test_vectors_decode_and_the_invalid_ones_do_not() -> None:
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


def test_vectors_encode_to_the_same_bytes() -> None:
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


def test_vectors_in_any_split_with_garbage_around() -> None:
    rng = random.Random(1)
    for vector in vectors():
        if not vector['valid']:
            continue
        wire = bytes.fromhex(vector['hex'])
        alone, _ = feed(wire)
        for garbage in GARBAGE:
            data = garbage + wire + garbage
            whole, counts = feed(data)
            assert alone[0][2:] in [packet[2:] for packet in whole], (vector, garbage)
            for sizes in ([1] * len(data), [rng.randint(1, 9) for _ in range(len(data))]):
                found, counted = feed(data, sizes)
                assert found == whole
                assert summary(counted) == summary(counts)


def test_stuffing_is_undone_for_all_payloads() -> None:
    checked = 0
    for length in range(4, 8):
        for values in product(b'\xff\xfd\x00\x01', repeat=length):
            data = bytes(values)
            assert unstuff(stuff(data)) == data
            checked += 1
    assert checked == 21_760


@pytest.mark.parametrize(('plain', 'stuffed'), [
    ('ff ff fd', 'ff ff fd fd'),
    ('ff ff ff fd', 'ff ff ff fd fd'),
    ('ff ff fd fd', 'ff ff fd fd fd'),
    ('ff ff fd ff ff fd', 'ff ff fd fd ff ff fd fd'),
    ('ff fd fd', 'ff fd fd'),
])
def test_stuffing_is_a_sliding_match(plain: str, stuffed: str) -> None:
    assert stuff(bytes.fromhex(plain)) == bytes.fromhex(stuffed)


def test_a_header_inside_a_frame_that_passes_is_data() -> None:
    inner = HEADER + b'\x01\x03\x00\x01'
    found, framer = feed(encode(7, 0x03, b'\x74\x00' + inner, stuffed=False) + PING)
    assert [packet.id for packet in found] == [7, 1]
    assert found[0].params == b'\x74\x00' + inner
    assert summary(framer)[1:] == (0, 0, 0, 0, 0)


def test_after_a_failed_crc_the_frames_inside_are_found() -> None:
    cut = READ[:-3]
    found, framer = feed(cut + PING + REPLY)
    assert [packet.instruction for packet in found] == [0x01, STATUS]
    assert framer.truncated == 1
    assert framer.noise_bytes == len(cut)


def test_a_frame_that_never_ends_is_given_up_on_an_idle_line() -> None:
    framer = Framer()
    assert packets_in(framer, encode(1, STATUS, bytes(900), error=0)[:-20] + PING, 0) == []
    assert [packet.instruction for packet in packets_left(framer)] == [0x01]
    assert framer.truncated == 1


def test_a_frame_cut_at_every_byte_is_given_up_on_an_idle_line() -> None:
    for wire in (PING, READ, REPLY):
        for size in range(len(wire)):
            found, framer = feed(wire[:size])
            assert found == []
            assert framer.truncated == (size > 6)


def test_every_single_bit_flip_is_rejected() -> None:
    for wire in (PING, READ, REPLY):
        for bit in range(8 * len(wire)):
            damaged = bytearray(wire)
            damaged[bit // 8] ^= 1 << bit % 8
            found, framer = feed(bytes(damaged))
            if bit < 8:                            # the first header byte, which is made good
                assert framer.repaired == len(found) == 1
            else:
                assert found == []


@pytest.mark.parametrize('first', [b'', b'\x00', b'\xfe', b'\x7f', b'\xfd'])
def test_a_damaged_first_header_byte_is_repaired(first: bytes) -> None:
    found, framer = feed(PING + first + REPLY[1:] + PING)
    assert [packet.repaired for packet in found] == [False, True, False]
    assert found[1].params == b'\xa6\x00\x00\x00'
    assert summary(framer) == (3, 1, 0, 0, 0, 0)


def test_a_damaged_first_byte_does_not_excuse_a_wrong_crc() -> None:
    found, framer = feed(b'\x00' + REPLY[1:-1] + b'\x00' + PING)
    assert [packet.instruction for packet in found] == [0x01]
    assert framer.repaired == 0


def test_the_robot_trace() -> None:
    if not TRACE.is_file():
        pytest.skip(NO_TRACE)
    data = TRACE.read_bytes()
    found, framer = feed(data)
    assert summary(framer) == (8969, 57, 311, 26, 45, 53_020)
    pings = [packet for packet in found if packet.instruction == 0x01]
    assert [packet.id for packet in pings] == list(range(1, 21))
    for size in (1, 7, 64, 4096):
        split, counted = feed(data, [size] * (len(data) // size))
        assert split == found
        assert summary(counted) == summary(framer)


# --- exactly what is said of a frame, without any published data ---

RUN = b'\xff\xff\xfd'
BAD_REPLY = REPLY[:-1] + bytes([REPLY[-1] ^ 1])


def test_stuffing_is_on_the_wire_and_not_in_the_packet() -> None:
    wire = encode(1, 0x03, RUN)
    assert wire[8:-2] == RUN + b'\xfd'
    assert feed(wire)[0][0].params == RUN
    assert encode(1, 0x03, RUN, stuffed=False)[8:-2] == RUN
    assert feed(encode(1, STATUS, RUN + b'\x07', error=0))[0][0].params == RUN + b'\x07'


def test_a_fast_reply_is_never_unstuffed() -> None:
    data = RUN + b'\xfd\xfd'
    combined, single = encode(BROADCAST, STATUS, data, 0, False), encode(1, STATUS, data, 0, False)
    assert [packet.params for packet in feed(combined + single)[0]] == [data, RUN + b'\xfd']


def test_stamps_are_those_of_the_deciding_chunk() -> None:
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
def test_what_is_wrong_is_said_exactly(
        wire: bytes, reason: str, counts: tuple[int, int, int]) -> None:
    framer = Framer()
    framer.frames(PING)
    damaged = [one for one in framer.frames(wire) + framer.flush_frames() if not is_good(one)]
    [(begin, end, kind, number, code, data, flaw)] = damaged
    assert flaw == Flaw(reason, length=int.from_bytes(wire[5:7], 'little'))
    assert (number, code) == (wire[4], wire[7] if kind == INSTRUCTION_2 else STATUS)
    assert data == wire[4:4 + len(data)]
    assert reason != 'length' or len(data) == 4      # who, how long and what: no more is known
    assert (begin, end) == (len(PING), len(PING) + 4 + len(data))
    assert (framer.crc_errors, framer.truncated, framer.bad_length) == counts


def test_how_much_noise_is_ahead_of_a_damaged_frame_is_said() -> None:
    framer = Framer()
    framer.frames(PING + bytes(30))
    damaged = framer.frames(b'\x01' * 5 + BAD_REPLY + PING)[0]
    flaw = damaged[6]
    assert flaw is not None
    assert (flaw.reason, flaw.noise_length) == ('crc', 35)


def test_the_longest_length_is_waited_for_and_judged_by_its_crc() -> None:
    framer = Framer()
    wire = HEADER + b'\x01\x00\x04\x03' + bytes(1021)
    assert packets_in(framer, wire, 0) == []
    assert (framer.pending, framer.bad_length) == (len(wire), 0)
    packets_in(framer, bytes(2), 0)
    assert (framer.crc_errors, framer.bad_length) == (1, 0)


def test_an_impossible_length_is_judged_with_its_instruction() -> None:
    framer = Framer()
    framer.frames(HEADER + b'\x01\xff\xff')
    assert framer.bad_length == 0
    [frame] = framer.frames(b'\x55')
    assert frame[2:6] == (IS_STATUS, 1, STATUS, b'\x01\xff\xff\x55')


def test_a_status_without_an_error_byte_is_no_packet_whatever_its_crc() -> None:
    assert feed(encode(1, STATUS))[0] == []
    assert feed(encode(1, 0x01))[0] != []


def test_a_header_that_may_be_none_is_not_counted_as_damaged() -> None:
    _, framer = feed(b'\x00' + BAD_REPLY[1:] + PING)
    assert summary(framer) == (1, 0, 0, 0, 0, len(REPLY))
    _, framer = feed(PING + BAD_REPLY[1:] + PING)
    assert summary(framer) == (2, 0, 0, 0, 0, len(REPLY) - 1)


def test_a_packet_behind_noise_is_not_held_back() -> None:
    framer = Framer()
    packets_in(framer, bytes(50) + READ[:8], 0)
    assert len(packets_in(framer, READ[8:], 0)) == 1


@pytest.mark.parametrize('first', [b'', b'\x00'])
def test_the_first_frame_of_a_stream_may_have_a_damaged_header_too(first: bytes) -> None:
    framer = Framer()
    [packet] = packets_in(framer, first + REPLY[1:], 0)
    assert (packet.repaired, packet.params) == (True, b'\xa6\x00\x00\x00')
    assert summary(framer) == (1, 1, 0, 0, 0, 0)


@pytest.mark.parametrize('length', [0, 1, 2])
def test_what_is_too_short_for_an_instruction_is_no_packet_whatever_its_crc(length: int) -> None:
    frame = HEADER + b'\x01' + length.to_bytes(2, 'little')
    found, framer = feed(frame + crc16(frame).to_bytes(2, 'little') + PING)
    assert [packet.instruction for packet in found] == [0x01]
    assert framer.bad_length == 1


def test_nothing_is_said_of_good_frames_directly_behind_each_other() -> None:
    framer = Framer()
    frames = framer.frames(PING + READ + REPLY[:5]) + framer.frames(REPLY[5:])
    assert [frame[6] for frame in frames] == [None, None, None]


# --- pauses --------------------------------------------------------------------------------------

FAST = encode(0xFE, STATUS, HEADER + bytes(20), error=0, stuffed=False)


@pytest.mark.parametrize('cut', range(1, len(FAST)))
def test_a_frame_around_a_pause_is_whole(cut: int) -> None:
    framer = Framer()
    assert packets_in(framer, FAST[:cut], 0) == []
    framer.interrupt()
    assert len(packets_in(framer, FAST[cut:], 0)) == 1
    assert (framer.noise_bytes, framer.truncated) == (0, 0)


def test_a_header_behind_a_pause_ends_the_frame_before_it() -> None:
    framer = Framer()
    packets_in(framer, FAST[:20], 0)
    framer.interrupt()
    assert [packet.instruction for packet in packets_in(framer, encode(1, 1), 0)] == [1]
    assert (framer.noise_bytes, framer.truncated, framer.pending) == (20, 1, 0)


def test_a_frame_in_three_pieces_waits_for_the_last() -> None:
    framer = Framer()
    packets_in(framer, FAST[:12], 0)
    framer.interrupt()
    assert packets_in(framer, FAST[12:30], 0) == []
    assert len(packets_in(framer, FAST[30:], 0)) == 1


@given(st.lists(st.one_of(st.none(), st.binary(max_size=12), st.sampled_from(
    [HEADER, HEADER[:2], HEADER[2:], FAST, FAST[:9], encode(1, 1)])), max_size=12))
def test_pauses_anywhere_raise_nothing_and_lose_no_byte(pieces: list[bytes | None]) -> None:
    framer = Framer()
    for piece in pieces:
        if piece is None:
            framer.interrupt()
        else:
            framer.frames(piece)
    assert framer.bytes == sum(len(piece) for piece in pieces if piece)
    assert framer.packet_bytes + framer.noise_bytes + framer.pending == framer.bytes
