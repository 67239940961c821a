# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""What damage looks like bit by bit, on a UART that is simulated at bit level."""

from random import Random

from doctor_case import asks
from doctor_case import case
from harness import later
import pytest

from benchmark import baseline
from msg_defs.dxl1_packet import encode as encode_1
from msg_defs.dxl_instruction import Instruction as I
from rigs.bus import frames
from rigs.bus import uart
from servobus.doctor import bit_errors
from servobus.doctor.bit_errors import DamagedPacket
from servobus.doctor.bit_errors import ExpectedPacket
from servobus.doctor.bit_errors import WrongBit

POSITION = 2048
ANSWERS = [frames.status(3, 0, (POSITION + turn % 700).to_bytes(4, 'little'))
           for turn in range(400)]
DUE = ExpectedPacket(ANSWERS[0][:8], len(ANSWERS[0]), 3)
UPWARD = f'{bit_errors.SIGNAL_LEVEL}: 0 read as 1 each time'
DOWNWARD = f'{bit_errors.SIGNAL_LEVEL}, or {bit_errors.TWO_SENDERS}: 1 read as 0 each time'


def heard(draw, answers=ANSWERS, seed=1):
    """Return what is no packet any more of these answers, each sent over a line of its own."""
    random = Random(seed)
    found = [uart.received(answer, draw(random, 10 * len(answer), 1e4 * turn), random)
             for turn, answer in enumerate(answers)]
    return b''.join(got for got, sent in zip(found, answers, strict=True) if got != sent)


def looks(noise, due=(DUE,)):
    return bit_errors.describe_damage(bit_errors.damaged_packets(noise, due))


# --- the line ----------------------------------------------------------------------------------


# --- which bits turned over ---------------------------------------------------------------------

@pytest.mark.parametrize('place', range(15))
@pytest.mark.parametrize('bit', [0, 4, 7])
def test_a_single_bit_is_found_wherever_it_is(place, bit):
    wrong = bytearray(ANSWERS[0])
    wrong[place] ^= 1 << bit
    [wreck] = bit_errors.damaged_packets(bytes(wrong), (DUE,))
    [flip] = wreck.flips
    assert (flip.at, flip.bit) == (10 * place + bit + 1, bit)
    assert flip.is_up == bool(wrong[place] >> bit & 1)


def test_in_protocol_1_the_sum_tells_bit_and_direction():
    right = encode_1(32, 0, bytes(2))
    assert right.hex() == 'ffff2004000000db'
    wrong = right[:-1] + b'\xfb'                       # as a user posted it
    [wreck] = bit_errors.damaged_packets(wrong, (ExpectedPacket(right[:5], 8, 32),))
    [flip] = wreck.flips
    assert (flip.bit, flip.is_up) == (5, True)


def test_bytes_that_are_no_packet_are_none():
    assert bit_errors.damaged_packets(Random(2).randbytes(2000), (DUE,)) == []
    assert bit_errors.damaged_packets(b''.join(ANSWERS[:20]), (DUE,)) == []
    assert bit_errors.damaged_packets(b'', (DUE,)) == []
    assert bit_errors.damaged_packets(ANSWERS[0], ()) == []


HEAD = DUE.known


@pytest.mark.parametrize('noise', [
    ANSWERS[0][:-1], HEAD + b'\0\xff\xff\0\0\0\0', HEAD + b'\0\0\0\0\0\0\xff'])
def test_a_packet_that_breaks_off_is_no_wreck(noise):
    assert bit_errors.damaged_packets(noise, (DUE,)) == []
    assert len(bit_errors.damaged_packets(HEAD + b'\0\xff\0\xff\0\xff\0', (DUE,))) == 1


# --- what it looks like ------------------------------------------------------------------------

@pytest.mark.parametrize(('draw', 'said'), later([
    (uart.varied(clock=(1.06, 1.07), noise=0.05), bit_errors.CLOCK),
    (uart.varied(rise=(0.58, 0.7), noise=0.03), DOWNWARD),
    (uart.varied(lift=(0.35, 0.37), noise=0.07), f'{bit_errors.SIGNAL_LEVEL}: 0 read as 1'),
    (uart.glitches(0.2), bit_errors.INTERFERENCE),
    (uart.beats(47.0, 0.4), bit_errors.PWM),
], 1), ids=['clock', 'edge', 'ground', 'glitches', 'PWM'])
def test_what_does_it_is_told(draw, said):
    assert looks(heard(draw)).startswith(said)


def test_two_that_answer_at_once_are_told():
    others = [frames.status(3, 0, (1000 + turn % 300).to_bytes(4, 'little'))
              for turn in range(400)]
    both = b''.join(bytes(one & other for one, other in zip(*pair, strict=True))
                    for pair in zip(ANSWERS, others, strict=True))
    assert looks(both).startswith(bit_errors.TWO_SENDERS)


def test_where_it_is_not_clear_nothing_is_said():
    random = Random(3)
    garbled = []
    for answer in ANSWERS:
        at = random.randrange(len(answer))
        garbled.append(answer[:at] + random.randbytes(3) + answer[at + 3:])
    assert looks(b''.join(garbled)) == ''
    assert looks(b''.join(answer[:random.randrange(1, 15)] for answer in ANSWERS)) == ''
    few = heard(uart.glitches(1.0), ANSWERS[:bit_errors.PICTURE_MIN - 2])
    assert looks(few) == ''
    same = bytearray(ANSWERS[0])
    same[7] ^= 0x14
    assert looks(bytes(same) * 50) == ''


# --- how much it takes -------------------------------------------------------------------------

def wreck(at=11, bit=0, is_up=True, is_late=None, device=3):
    return DamagedPacket(device, 15, (WrongBit(at, bit, is_up, is_late),))


WHOLE_HEAD = DamagedPacket(3, 15, ())


def apart(ups, downs):
    """Return wrecks with a wrong bit each, no two of them alike."""
    return [wreck(10 * at + 1, 0, at < ups) for at in range(ups + downs)]


def pairs(count, gap, others=0, other=50):
    """Return wrecks with two wrong bits so far apart; others with another distance."""
    return [DamagedPacket(3, 40, (WrongBit(20 + at, at % 7, at % 2 == 0, None),
                          WrongBit(20 + at + (gap if at < count else other), 0, True, None)))
            for at in range(count + others)]


def bursts(late):
    """Return ten wrecks with three wrong bits in a byte each, as late as these in turn."""
    return [DamagedPacket(3, 15, tuple(WrongBit(10 * at + 1 + bit, bit, True, late[at % len(late)])
                               for bit in range(3))) for at in range(10)]


@pytest.mark.parametrize(('found', 'said'), [
    ([wreck(11 + at, 7) for at in range(8)], bit_errors.CLOCK),
    ([wreck(11 + at, 7) for at in range(7)], ''),
    ([wreck(11 + at, 7) for at in range(7)] + [WHOLE_HEAD], ''),
    ([wreck(11 + at, 7) for at in range(18)] + [wreck(500), wreck(600)], bit_errors.CLOCK),
    ([wreck(11 + at, 7) for at in range(17)] + [wreck(500 + at) for at in range(3)],
     UPWARD),
    ([WHOLE_HEAD] * 19 + [wreck()], f'{bit_errors.TWO_SENDERS}: the headers are whole, data and '
                                    'checksums are not'),
    ([WHOLE_HEAD] * 18 + [wreck()] * 2, ''),
    ([WHOLE_HEAD] * 17 + [wreck()] * 3, ''),
    (apart(19, 1), UPWARD),
    (apart(1, 19), DOWNWARD),
    (apart(18, 2), ''), (apart(15, 5), ''), (apart(14, 6), bit_errors.INTERFERENCE),
    (apart(6, 14), bit_errors.INTERFERENCE),
    ([wreck(11, device=number) for number in range(8)], UPWARD),
    (bursts([None]), ''), (bursts([True] * 9 + [False]), UPWARD),
    (bursts([True] * 8 + [False] * 2), ''),
    ([wreck(11 + 10 * (at % 4)) for at in range(8)], ''),      # a quarter each: no chance
    ([wreck(11 + 10 * (at % 5)) for at in range(10)], UPWARD),
    ([wreck()] * 9, ''),                               # the same bit each time
    (pairs(16, 33), f'{bit_errors.PWM}: wrong bits about 33 bits apart, or a multiple'),
    (pairs(15, 33), bit_errors.INTERFERENCE), (pairs(16, 30), bit_errors.INTERFERENCE),
    (pairs(20, 14), bit_errors.INTERFERENCE),                # one pulse
    (pairs(18, 33, 6, 49), f'{bit_errors.PWM}: wrong bits about 16 bits apart, or a multiple'),
])
def test_a_picture_needs_enough_of_one_kind(found, said):
    assert bit_errors.describe_damage(found) == said


def test_what_is_due_is_what_answers_the_questions():
    cycles = (asks(I.READ, 3, size=2), asks(I.SYNC_READ, 4, 5), asks(I.WRITE, 6),
              asks(I.PING, 7), asks(I.PING, 8, 9), asks(I.SYNC_WRITE, 10), asks(I.READ, 3, size=2))
    of_2 = case(cycles=cycles, protocol='Dynamixel 2.0').report
    head = b'\xff\xff\xfd\0'
    assert bit_errors.expected_packets(of_2) == (
        ExpectedPacket(head + b'\3\6\0\x55', 13, 3), ExpectedPacket(head + b'\4\x08\0\x55', 15, 4),
        ExpectedPacket(head + b'\5\x08\0\x55', 15, 5), ExpectedPacket(head + b'\6\4\0\x55', 11, 6),
        ExpectedPacket(head + b'\7\7\0\x55', 14, 7))
    of_1 = case(cycles=cycles[:4], protocol='Feetech').report
    assert bit_errors.expected_packets(of_1) == (
        ExpectedPacket(b'\xff\xff\3\4\0', 8, 3), ExpectedPacket(b'\xff\xff\4\6\0', 10, 4),
        ExpectedPacket(b'\xff\xff\5\6\0', 10, 5), ExpectedPacket(b'\xff\xff\6\2\0', 6, 6),
        ExpectedPacket(b'\xff\xff\7\2\0', 6, 7))


@pytest.mark.parametrize(('turned', 'is_known'), [(7, True), (8, False)])
def test_fewer_than_an_eighth_of_the_known_bits_are_wrong(turned, is_known):
    wrong = bytearray(ANSWERS[0])
    for bit in range(turned):
        wrong[bit // 2] ^= 1 << bit % 2
    found = bit_errors.damaged_packets(bytes(wrong), (DUE,))
    assert [len(one.flips) for one in found] == [7] * is_known


# --- the baseline -------------------------------------------------------------------------------

@pytest.mark.more
def test_it_is_as_in_the_baseline():
    kind = 'two with one ID, same delay'
    cells = baseline.FAMILIES['damage'][kind]()
    assert cells == baseline.saved_of('damage')[kind], \
        'run: scripts/python -m benchmark.baseline --write'
    assert 'wrong' not in cells[3]
