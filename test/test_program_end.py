# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""
What is said of programs as they are: how they end, search, rest, and read too late.

The bytes are those of Feetech servos, as the manual has them; the program is a list of what it
writes and reads, and of what it leaves unread.
"""

import pytest

from msg_defs.dxl1_packet import encode
from msg_defs.event import BAUD
from msg_defs.event import Change
from msg_defs.event import Chunk
from msg_defs.event import CLOSED
from msg_defs.event import IN
from msg_defs.event import OUT
from msg_defs.event import PURGED
from msg_defs.event import UNREAD
from msg_defs.reports import Level
from servobus.bus.report import FAILED
from servobus.bus.report import OWN
from servobus.bus.report import RAISED
from servobus.bus.report import ROBBER
from servobus.examination import Examination
from servobus.model.models import Models
from servobus.sources import tap_sender as sent
from servobus.sources.capture import Wire
from servobus.sources.tap_reader import TapRecord
from servobus.tools.doctor.program import Openings
from servobus.tools.doctor.verdict import make_verdict

MS = 1_000_000
MODELS = Models()
WIRE = Wire('arm', 0)
PING, READ, SYNC_READ = 1, 2, 0x82
PLACE = b'\x38\x02'                  # 2 bytes at 56
SIX = (1, 2, 3, 4, 5, 6)


class Script:
    """What a program does with its port, in ms; the tap reports it."""

    def __init__(self):
        self.now = 1000.0
        self.chunks = []
        self.change(BAUD, 1_000_000)
        self.change(UNREAD, 0)

    def change(self, what, value, after=0.0):
        self.now += after
        self.chunks.append(Chunk(int(self.now * MS), 'arm', change=Change(what, value)))

    def write(self, packet, after=2.0):
        self.now += after
        self.chunks.append(Chunk(int(self.now * MS), 'arm', packet, OUT))

    def read(self, packet, after=1.5):
        self.now += after
        self.chunks.append(Chunk(int(self.now * MS), 'arm', packet, IN))

    def ping(self, number, *, answers=True):
        self.write(encode(number, PING, b''))
        if answers:
            self.read(encode(number, 0, b''))
            self.write(encode(number, READ, b'\x03\x02'))
            self.read(encode(number, 0, b'\x09\x03'))
        else:
            self.now += 50

    def ask(self, number, answer=b'\x00\x08', wait=36.0):
        self.write(encode(number, READ, PLACE))
        if answer is not None:
            self.read(encode(number, 0, answer))
        else:
            self.now += wait

    def end(self, unread=0, after=0.0):
        self.change(UNREAD, unread, after)
        self.change(CLOSED, 1)


def verdict_of(program, failed=''):
    examination = Examination(MODELS)
    for chunk in program.chunks:
        examination.feed_chunk(chunk, WIRE)
    examination.finish(examination.last, True, failed)
    return make_verdict('x', examination.buses(True), 1.0, True)


def told(program, failed=''):
    """Return what is wrong, at WARN or worse, and what is unknown."""
    said = verdict_of(program, failed)
    return ({(one.rule, one.who[:3]) for one in said.wrong if one.level > Level.OK},
            list(said.unknown))


def handshake(*absent):
    """Return LeRobot at its start: it pings all, then raises if one is missing."""
    program = Script()
    for number in SIX:
        program.ping(number, answers=number not in absent)
    return program


@pytest.mark.parametrize('absent', [(6,), (3,), (2, 3, 4, 5, 6), (1, 6)], ids=str)
def test_who_is_missing_at_the_start_is_named(absent):
    program = handshake(*absent)
    program.end()
    who = {f'{number:03}' for number in absent}
    named = told(program, RAISED)[0]
    assert {(rule, one[:3]) for rule, one in named} == (
        {('no_answer', who.pop())} if len(absent) == 1 else {('no_answer', f'{min(absent):03}')})


def test_nobody_at_all_is_no_single_servo():
    program = handshake(*SIX)
    program.end()
    assert told(program, RAISED)[0] == {('all_silent', 'the')}


@pytest.mark.parametrize('failed', [FAILED, RAISED])
def test_a_servo_on_which_a_program_ends(failed):
    program = handshake()
    for _ in range(20):
        for number in SIX:
            program.ask(number)
    program.ask(3, None)
    program.end()
    assert told(program, failed)[0] == {('no_answer', '003')}
    assert told(program)[0] == set()


@pytest.mark.parametrize(('wait', 'unread'), [(3.0, 0), (36.0, 8), (36.0, 2)])
def test_a_question_that_had_no_time_accuses_none(wait, unread):
    program = handshake()
    program.ask(3, None, wait)
    program.end(unread)
    wrong, unknown = told(program, RAISED)
    assert wrong == set()
    assert any('whether this answers is unknown' in text for text in unknown)


def test_an_answer_that_was_thrown_away_is_none_that_did_not_come():
    program = handshake()
    program.ask(3, None)
    program.change(PURGED, 1)
    program.end()
    assert told(program, RAISED)[0] == set()


def test_an_answer_that_was_damaged_at_the_end():
    program = handshake()
    for _ in range(20):
        program.ask(1)
    program.write(encode(1, READ, PLACE))
    program.read(b'\xff\xff\x01\x04\x00\x10\x00\x00')
    program.end(after=40.0)
    assert told(program, RAISED)[0] == {('damaged_answers', '001')}


@pytest.mark.parametrize('which', [2, 6])
def test_a_ping_whose_answer_was_damaged_at_the_start(which):
    """LeRobot counts that servo as missing; the answer is there, and it is not whole."""
    program = Script()
    for number in SIX:
        program.write(encode(number, PING, b''))
        answer = encode(number, 0, b'')
        program.read(answer[:-1] + b'\x00' if number == which else answer)
    program.end()
    assert told(program, RAISED)[0] == {('damaged_answers', f'{which:03}')}


def group(*answers):
    return b''.join(answers)


def test_answers_that_are_read_after_the_next_question_accuse_none():
    """Servo 3 is damaged; the program stops reading there and does not clear its input."""
    ask = encode(0xFE, SYNC_READ, PLACE + bytes(SIX))
    whole = [encode(number, 0, b'\x00\x08') for number in SIX]
    program = handshake()
    for turn in range(150):
        if turn and turn % 10 == 0:
            program.change(UNREAD, 24)
        elif turn > 1 and turn % 10 == 1:
            program.change(UNREAD, 0)
        program.write(ask, after=14.0)
        late = group(*whole[3:]) if turn and turn % 10 == 0 else b''
        if turn % 10 == 9:
            program.read(group(*whole[:2], whole[2][:5] + b'\x55\x00\x00'))
        else:
            program.read(late + group(*whole))
    program.end()
    wrong, _ = told(program)
    assert wrong <= {('damaged_answers', '003'), ('noise', 'the')}
    assert {who for _, who in wrong} <= {'003', 'the'}


def test_a_program_that_is_always_one_answer_behind_is_no_silent_bus():
    program = handshake()
    for turn in range(120):
        number = SIX[turn % 6]
        if turn:
            program.change(UNREAD, 8)
        program.write(encode(number, READ, PLACE), after=10.0)
        if turn:
            program.read(encode(SIX[(turn - 1) % 6], 0, b'\x00\x08'), after=0.3)
    program.end(8)
    assert told(program)[0] == set()


def test_a_program_that_reads_long_after_it_asked_misses_nothing():
    program = handshake()
    for turn in range(12):
        program.ask(SIX[turn % 6], None, 2500.0)
        program.read(encode(SIX[turn % 6], 0, b'\x00\x08'))
    program.end()
    assert not {rule for rule, _ in told(program)[0]} & {'no_answer', 'missed_answers'}


@pytest.mark.parametrize(('late', 'pause', 'rules'), [
    (15.6, 0.5, {('latency_timer', 'the')}), (1.2, 15.467, set()), (1.2, 15.0, set())],
    ids=['a timer of 16 ms', 'a loop at 60 Hz', 'it sleeps for 15 ms'])
def test_a_period_that_a_program_makes_is_no_latency(late, pause, rules):
    program = handshake()
    for turn in range(300):
        program.write(encode(SIX[turn % 6], READ, PLACE), after=pause)
        program.read(encode(SIX[turn % 6], 0, b'\x00\x08'), after=late)
    program.end()
    assert told(program)[0] == rules


# --- healthy programs that look like a fault, and the fault beside them ----------------------

def test_a_search_over_some_ids_and_rates_accuses_none():
    program = Script()
    for rate in (1_000_000, 500_000, 250_000, 128_000, 115_200):
        program.change(BAUD, rate)
        for number in SIX:
            program.ping(number, answers=number == 1 and rate == 1_000_000)
    program.end()
    assert told(program)[0] == set()


@pytest.mark.parametrize('rates', [3, 6])
def test_a_program_to_which_not_one_byte_comes_back(rates):
    program = Script()
    for rate in range(rates):
        program.change(BAUD, 1_000_000 // (1 + rate))
        program.write(encode(0xFE, PING, b''), after=800.0)
    program.end(after=800.0)
    assert told(program)[0] == {('all_silent', 'the')}
    assert 'baud rate, protocol and ID' in verdict_of(program).wrong[0].message


def test_broadcast_pings_faster_than_their_answers_are_no_noise():
    program = handshake()
    for turn in range(8):
        program.write(encode(0xFE, PING, b''), after=300.0)
        program.read(encode(1, 0, b'') + b'\xff\xff\x02\x02\x10\x10' * (1 + turn % 2), after=2.0)
    program.end()
    assert 'noise' not in {rule for rule, _ in told(program)[0]}


def test_a_program_that_rests_is_not_at_fault():
    program = handshake()
    for turn in range(400):
        program.ask(SIX[turn % 6])
        program.now += 2500.0 if turn in (200, 300) else 10.0
    program.end()
    assert told(program)[0] == set()


def test_a_program_that_writes_all_the_time_and_reads_nothing():
    program = handshake()
    for turn in range(300):
        if turn:
            program.change(UNREAD, 6 * turn)
        program.write(encode(SIX[turn % 6], 3, b'\x2a\x00\x08'), after=10.0)
    program.end(1800)
    assert told(program)[0] == set()


def test_an_error_bit_of_feetech_is_what_is_now():
    program = handshake()
    for turn in range(300):
        number = SIX[turn % 6]
        program.write(encode(number, READ, PLACE), after=4.0)
        program.read(encode(number, int(number == 3 and turn > 60), b'\x00\x08'))
    program.end()
    [entry] = [one for one in verdict_of(program).wrong if one.level > Level.OK]
    assert (entry.rule, entry.who[:3]) == ('voltage', '003')
    assert entry.message.startswith('voltage error in its answers')
    assert 'Reboot' not in entry.message


def test_an_answer_that_is_read_long_after_it_was_due_is_no_other_masters():
    program = handshake()
    for _ in range(12):
        program.ask(4, None, 36.0)
        program.ask(5)
        program.now += 200.0
        program.read(encode(4, 0, b'\x00\x08'))
    program.end()
    assert 'foreign_answers' not in {rule for rule, _ in told(program)[0]}


def test_a_program_that_tries_many_rates_has_none():
    program = handshake()
    for rate in (57_600, 115_200, 500_000, 250_000):
        program.change(BAUD, rate, 50)
        program.ping(1, answers=False)
    assert 'several baud rates' in verdict_of(program).head


@pytest.mark.parametrize(('said', 'others'), [
    ('+1 +2 1 2 1 2', OWN), ('+1 +2 1 1 1 1', ''), ('+1 +2 1 1 2 2', ''),
    ('+1 1 -1 +2 2 -2 +1 1 -1 +2 2', ''),          # one after the other
    ('+1 +2 1 2 1 robbed 1', ROBBER), ('+1 +2 1 2 1 -2 robbed 1', ''),
    ('+1 1 +2 2 r1', ROBBER), ('+1 1 r1 +2 2 r2', ''), ('+1 1 +2 r2 r2', ''),
], ids=['two', 'one idle', 'handed on', 'in turns', 'robbed', 'unplugged', 'reads of the other',
        'each reads its own', 'one writes, one reads'])
def test_two_who_ask_on_one_port_are_noticed(said, others):
    openings = Openings()
    for word in said.split():
        openings.is_robbed |= word == 'robbed'
        if word[-1].isdigit():
            kind = {'+': sent.OPENED, '-': CLOSED, 'r': IN}.get(word[0], OUT)
            openings.count_record('arm', TapRecord(1, 'arm', kind, b'', 0, int(word[-1])))
    assert openings.found.get('arm', '') == others
