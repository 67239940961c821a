# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""
What is said of programs as they are: how they end, search, rest, and read too late.

The bytes are those of Feetech servos, as the manual has them; the program is a list of what it
writes and reads, and of what it leaves unread.
"""

from pathlib import Path
from random import Random

import pytest
from test_foreign_programs import played
import yaml

from msg_defs import dxl_packet
from msg_defs.diagnostics import Level
from msg_defs.dxl1_packet import encode
from msg_defs.event import Change
from msg_defs.event import Chunk
from msg_defs.event import CLOSED
from msg_defs.event import IN
from msg_defs.event import OUT
from msg_defs.event import PURGED
from msg_defs.event import UNREAD
from servobus.bus.report import OTHER_PART
from servobus.bus.report import STOLE_REPLIES
from servobus.examination import Examination
from servobus.model.models import Models
from servobus.sources import tap_sender as sent
from servobus.sources.capture import Wire
from servobus.sources.tap_reader import TapRecord
from servobus.tools.doctor.program_source import Openings
from servobus.tools.doctor.verdict import make_verdict

MS = 1_000_000
MODELS = Models()
WIRE = Wire('arm', 0)
READ, SYNC_READ = 2, 0x82
PLACE = b'\x38\x02'                  # 2 bytes at 56
SIX = (1, 2, 3, 4, 5, 6)
ROWS = yaml.safe_load(Path(__file__).with_name('program_end.yaml').read_text())


class Script:
    """What a program does with its port, in ms; the tap reports it."""

    def __init__(self, *parts):
        self.now = 1000.0
        self.chunks = []
        for ms, side, what in played(parts):
            if side:
                (self.write if side == OUT else self.read)(what, ms)
            else:
                self.change(what.what, what.value, ms)

    def change(self, what, value, after=0.0):
        self.now += after
        self.chunks.append(Chunk(int(self.now * MS), 'arm', change=Change(what, value)))

    def write(self, packet, after=2.0):
        self.now += after
        self.chunks.append(Chunk(int(self.now * MS), 'arm', packet, OUT))

    def read(self, packet, after=1.5):
        self.now += after
        self.chunks.append(Chunk(int(self.now * MS), 'arm', packet, IN))

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


@pytest.mark.parametrize(('found', 'failed', 'parts'), [
    (found, failed, parts) for found, failed, *parts in ROWS['rows']])
def test_what_is_said_of_a_program(found, failed, parts):
    wrong, unknown = told(Script(*parts), failed)
    is_unknown = any('whether this answers is unknown' in text for text in unknown)
    said = [f'{rule} {who}' for rule, who in sorted(wrong)] + ['?'] * is_unknown
    assert ' '.join(said) == found


def test_answers_that_are_read_after_the_next_question_accuse_none():
    """Servo 3 is damaged; the program stops reading there and does not clear its input."""
    ask = encode(0xFE, SYNC_READ, PLACE + bytes(SIX))
    whole = [encode(number, 0, b'\x00\x08') for number in SIX]
    program = Script(ROWS['handshake'])
    for turn in range(150):
        if turn and turn % 10 == 0:
            program.change(UNREAD, 24)
        elif turn > 1 and turn % 10 == 1:
            program.change(UNREAD, 0)
        program.write(ask, after=14.0)
        late = b''.join(whole[3:]) if turn and turn % 10 == 0 else b''
        if turn % 10 == 9:
            program.read(b''.join(whole[:2]) + whole[2][:5] + b'\x55\x00\x00')
        else:
            program.read(late + b''.join(whole))
    program.end()
    wrong, _ = told(program)
    assert wrong <= {('damaged_answers', '003'), ('noise', 'the')}
    assert {who for _, who in wrong} <= {'003', 'the'}


# --- healthy programs that look like a fault, and the fault beside them ----------------------


def test_a_program_that_rests_is_not_at_fault():
    program = Script(ROWS['handshake'])
    for turn in range(400):
        program.write(encode(SIX[turn % 6], READ, PLACE))
        program.read(encode(SIX[turn % 6], 0, b'\x00\x08'))
        program.now += 2500.0 if turn in (200, 300) else 10.0
    program.end()
    assert told(program)[0] == set()


def test_a_program_that_writes_all_the_time_and_reads_nothing():
    program = Script(ROWS['handshake'])
    for turn in range(300):
        if turn:
            program.change(UNREAD, 6 * turn)
        program.write(encode(SIX[turn % 6], 3, b'\x2a\x00\x08'), after=10.0)
    program.end(1800)
    assert told(program)[0] == set()


@pytest.mark.parametrize(('between', 'rest', 'is_said'), [
    (encode(2, READ, PLACE), True, True), (encode(2, READ, PLACE), False, False),
    (encode(0xFE, 0x83, b'\x2a\x02\x01\x00\x08'), True, False)],
    ids=['a question', 'its end is lost', 'another thread writes a goal'])
def test_a_program_that_asks_before_it_has_read_an_answer_to_its_end(between, rest, is_said):
    program, answers = Script(ROWS['handshake']), [encode(one, 0, b'\x00\x08') for one in (1, 2)]
    for _ in range(20):
        program.write(encode(1, READ, PLACE), after=10.0)
        program.read(answers[0][:3], after=0.3)
        program.write(between, after=0.1)
        program.read(answers[0][3:] * rest, after=0.3)
        if between[2] == 2:
            program.read(answers[1], after=0.5)
    program.end()
    assert (('unread_answers', 'the') in told(program)[0]) == is_said


@pytest.mark.parametrize(('after_ms', 'many', 'is_said'), [(0.2, 1, True), (3.0, 1, False),
                                                          (0.2, 2, False)],
                         ids=['asks on at once', 'another thread asks', 'reads all'])
def test_a_program_that_takes_the_answer_of_one_for_that_of_another(after_ms, many, is_said):
    """The answers come two questions late."""
    program, read = Script(ROWS['handshake']), 0
    for turn in range(200):
        program.write(encode(SIX[turn % 6], READ, PLACE), after=after_ms if turn % 6 else 20.0)
        program.change(UNREAD, 0)
        if turn % many == 1 % many and turn > 1:
            program.read(b''.join(encode(SIX[one % 6], 0, b'\0\x08')
                                  for one in range(read, read + many)), after=4.0)
            read += many
    program.end()
    assert any('another device' in one.message for one in verdict_of(program).wrong) == is_said


@pytest.mark.parametrize(('speed', 'left', 'is_said'), [
    (b'\xff\xff\xff\xff\xfd\x07', 1, True), (b'\xff\xff\xff\xff\xfd\x07', 0, False),
    (b'\xff\xff\xff\xff\xfc\x07', 1, False), (b'\xff\xff\xfd\xff\xff\xfd', 1, False)],
    ids=['a fixed count', 'by its Length', 'nothing is stuffed', 'twice stuffed'])
@pytest.mark.parametrize('is_discarded', [True, False])
def test_a_program_that_leaves_the_stuffing_unread(speed, left, is_said, is_discarded):
    program = Script('0 baud 1000000; 0 unread 0')
    for turn in range(60):
        answer = dxl_packet.encode(1, 0x55, speed if turn % 9 == 0 else bytes(6), error=0)
        rest = left if turn % 9 == 0 else 0
        program.write(dxl_packet.encode(1, 2, b'\x80\0\x06\0'), after=20.0)
        program.read(answer[:len(answer) - rest])
        program.change(UNREAD, rest)
        if is_discarded:
            program.change(PURGED, 1)
            program.change(UNREAD, 0)
        elif rest:
            program.write(dxl_packet.encode(2, 2, b'\x80\0\x06\0'), after=20.0)
            program.read(answer[-rest:] + dxl_packet.encode(2, 0x55, bytes(6), error=0))
            program.change(UNREAD, 0)
    program.end()
    assert any('byte stuffing' in one.message for one in verdict_of(program).wrong) == is_said


@pytest.mark.parametrize(('steps_a_cycle', 'is_said'), [(34, False), (136, False), (0, True)])
def test_a_joint_that_goes_back_and_forth_twice_a_second_follows_its_goals(steps_a_cycle, is_said):
    """Each report finds it at the same place, with the goal before or after its change."""
    random, program = Random(10), Script(ROWS['handshake'])
    goal = place = 2048
    program.write(encode(0xFE, 0x83, b'\x28\x01\x01\x01'))
    for _ in range(250):
        place += max(-steps_a_cycle, min(steps_a_cycle, goal - place))
        program.write(encode(1, READ, PLACE), after=18.0 + 2.0 * random.random())
        program.read(encode(1, 0, place.to_bytes(2, 'little')))
        goal = 2048 + (136 if (program.now + 10.0) % 500 > 250 else -136)
        program.write(encode(0xFE, 0x83, b'\x2a\x02\x01' + goal.to_bytes(2, 'little')))
    program.end()
    assert (('torque_off', '001') in told(program)[0]) == is_said


def test_an_error_bit_of_feetech_is_what_is_now():
    program = Script(ROWS['handshake'])
    for turn in range(300):
        number = SIX[turn % 6]
        program.write(encode(number, READ, PLACE), after=4.0)
        program.read(encode(number, int(number == 3 and turn > 60), b'\x00\x08'))
    program.end()
    [entry] = [one for one in verdict_of(program).wrong if one.level > Level.OK]
    assert (entry.rule, entry.who[:3]) == ('voltage', '003')
    assert entry.message.startswith('voltage error in its answers')
    assert 'Reboot' not in entry.message


@pytest.mark.parametrize(('said', 'others'), [
    ('+1 +2 1 2 1 2', OTHER_PART), ('+1 +2 1 1 1 1', ''), ('+1 +2 1 1 2 2', ''),
    ('+1 1 -1 +2 2 -2 +1 1 -1 +2 2', ''),          # one after the other
    ('+1 +2 1 2 1 robbed 1', STOLE_REPLIES), ('+1 +2 1 2 1 -2 robbed 1', ''),
    ('+1 1 +2 2 r1', STOLE_REPLIES), ('+1 1 r1 +2 2 r2', ''), ('+1 1 +2 r2 r2', ''),
    ('+1 t1 t1 t1', OTHER_PART), ('+1 t2 t2 t2', STOLE_REPLIES), ('+1 t2 t2 t2 t1', STOLE_REPLIES),
    ('+1 t1 t1', ''), ('+1 t2 t2', ''), ('+1 t3', STOLE_REPLIES),
    ('+1 1 t1 robbed 1', STOLE_REPLIES),
], ids=['two', 'one idle', 'handed on', 'in turns', 'robbed', 'unplugged', 'reads of the other',
        'each reads its own', 'one writes, one reads', 'threads', 'processes', 'both',
        'threads, twice', 'processes, twice', 'a thread has died', 'a thread is robbed'])
def test_two_who_ask_on_one_port_are_noticed(said, others):
    openings = Openings()
    for word in said.split():
        openings.is_robbed |= word == 'robbed'
        if word[-1].isdigit():
            kind = {'+': sent.OPENED, '-': CLOSED, 'r': IN, 't': sent.TWO_READERS}.get(
                word[0], OUT)
            value, opening = (int(word[-1]), 1) if word[0] == 't' else (0, int(word[-1]))
            openings.count_record('arm', TapRecord(1, 'arm', kind, b'', value, opening))
    assert openings.found.get('arm', '') == others
