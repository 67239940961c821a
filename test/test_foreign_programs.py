# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""
What programs of other authors make of a fault, each with a healthy look-alike.

What is said: (ms after the one before, side, bytes or a Change). foreign_programs.yaml has what
can be written down; here is what changes from turn to turn.
"""

from itertools import count
from itertools import islice
from pathlib import Path

from heard_bus import Bus
import pytest
import yaml

from msg_defs.diagnostics import Level
from msg_defs.dxl_packet import encode
from msg_defs.dxl_packet import STATUS
from msg_defs.event import BAUD
from msg_defs.event import Change
from msg_defs.event import GAVE_UP
from msg_defs.event import IN
from msg_defs.event import OUT
from msg_defs.event import PURGED
from msg_defs.event import UNREAD
from servobus.bus.report import RAISED
from servobus.doctor.finding_log import BusSummary
from servobus.doctor.finding_log import FindingLog
from servobus.tools.doctor.verdict import make_verdict

EMPTY = Change(UNREAD, 0)


def packet(number, *body):
    """Return a packet of the 1.0 family."""
    head = bytes([number, len(body) + 1, *body])
    return b'\xff\xff' + head + bytes([~sum(head) & 255])


def packet_2(number, code, *params):
    return encode(number, code, bytes(params))


def status_2(number, error, *params):
    return encode(number, STATUS, bytes(params), error=error)


SAYS = {'>': (OUT, packet), '<': (IN, packet), '>>': (OUT, packet_2), '<<': (IN, status_2),
        '<x': (IN, lambda *values: bytes(values))}


def played(parts):
    for part in parts:
        times, _, text = part.rpartition('*')
        for turn in count() if part.startswith('*') else range(int(times or 1)):
            for step in text.split(';'):
                ms, what, said = step.split(maxsplit=2)
                side, make = SAYS.get(what, ('', None))
                said = said.replace('t', str(turn % 200))
                yield float(ms), side, b''.join(
                    make(*map(int, one.split())) for one in said.split('+')
                ) if make else Change(what, int(said))


def throws_the_rest_away():
    """Read three by a Sync Read; where an answer is damaged, leave the next one unread, or not."""
    first, second, third = (encode(number, STATUS, bytes(4), error=0) for number in (1, 2, 3))
    yield 0, '', EMPTY
    for turn in count():
        is_left = turn % 4 == 1
        yield 20, OUT, encode(254, 0x82, bytes((132, 0, 4, 0, 1, 2, 3)))
        yield 1, IN, first + (second[:-1] + b'\x55' if turn % 4 < 2 else second) + (
            b'' if is_left else third)
        yield 0.1, '', Change(UNREAD, 15 * is_left)
        yield 0, '', Change(PURGED, 1)
        yield 0, '', EMPTY


def written_first(*setup):
    """Write to EEPROM before anything says what the device is; it is silent from then on."""
    for said in setup:
        yield 5, OUT, said
        yield 1, IN, packet(1, 0)
    for turn in count():
        for number in (1, 2):
            for asked, answer in ((packet(number, 3, 42, turn % 200, 8), packet(number, 0)),
                                  (packet(number, 2, 56, 2), packet(number, 0, turn % 200, 8))):
                yield 3, OUT, asked
                if number == 2:
                    yield 1, IN, answer
                else:
                    yield 20, OUT, packet(2, 1)
                    yield 1, IN, packet(2, 0)


def read(number, at, size):
    return encode(number, 2, bytes((at, 0, size, 0)))


def flushes(ms, answered, of_2):
    """Throw away what is to be sent, after each question; so many of five are answered."""
    yield 0, '', EMPTY
    for turn in count():
        number = 1 + turn % 2
        lost = 40, '', Change(GAVE_UP, 0)
        is_answered = turn // 2 % 5 < (of_2 if number == 2 else answered)
        yield 5, OUT, packet(number, 2, 56, 2)
        yield ms, '', Change(PURGED, 2)
        yield (1, IN, packet(number, 0, 0, 8)) if is_answered else lost


def hurries(ms, *spoilt):
    """Ask three servos at 115200 Bd, wait so long after each, and read what is there."""
    yield 0, '', Change(BAUD, 115_200)
    yield 0, '', EMPTY
    before = b''
    for turn in count():
        for number in (1, 2, 3):
            yield 17 if number == 1 else ms, '', Change(UNREAD, len(before))
            yield 0, OUT, packet(number, 2, 36, 2)
        there = spoilt[turn % len(spoilt)] if spoilt else b''.join(
            packet(number, 0, 0, 2) for number in (1, 2))
        yield ms, IN, before + there
        before = packet(3, 0, 0, 2)


def gives_up(ms, pause, *delays):
    """Throw away what is there, ask, wait so long; servos answer after these times."""
    now = said = 0.0
    is_vain, due = False, []
    for turn in count():
        number = 1 + turn % len(delays)
        rest = pause if number == 1 else 0.1
        now += rest
        waiting = sum(at <= now for at, _ in due)
        due = due[waiting:]
        vain = [('', Change(GAVE_UP, int(1000 * rest)))] * is_vain
        steps = [('', Change(UNREAD, 8 * waiting)), *vain, ('', Change(PURGED, 1)), *vain,
                 (OUT, packet(number, 2, 56, 2))]
        for side, what in steps:
            yield now - said, side, what
            said = now
        due = sorted([*due, (now + delays[number - 1], number)])
        is_vain = due[0][0] > now + ms
        if is_vain:
            now += ms
        else:
            now, number = due.pop(0)
            yield now - said, IN, packet(number, 0, turn % 200, 8)
            said = now


def goes(*turns, rounds=999, first=()):
    """Ask that again and again, after some first; what is not answered is waited for."""
    yield 0, '', EMPTY
    for asked, answer in [*first, *rounds * turns]:
        yield 20, OUT, asked
        yield (1, IN, answer) if answer else (40, '', Change(GAVE_UP, 0))
    yield 0, '', EMPTY


def write_2(number, at, *data):
    return encode(number, 3, bytes((at, 0, *data))), encode(number, STATUS, b'', error=0)


def read_2(number, at, size):
    return read(number, at, size), encode(number, STATUS, bytes(size), error=0)


CLIPPED = *8 * (b'\xff\xff\1\4\0\0\2\x80',), b'\xff\xff\x88\xf0\4\0\2\xf0'


def one_way(mode, goal):
    """Set an operating mode, then send goals by Sync Write, and read the position."""
    yield from goes(write_2(1, 11, mode), write_2(1, 64, 1), rounds=1)
    for turn in count():
        there = goal + turn % 40
        yield 20, OUT, encode(254, 0x83, bytes((116, 0, 4, 0, 1)) + there.to_bytes(4, 'little'))
        yield 20, OUT, read(1, 132, 4)
        yield 1, IN, encode(1, STATUS, min(4095, there).to_bytes(4, 'little'), error=0)


def follows(place_of):
    """Send two goals by turns to a servo of Feetech, and read where it is."""
    for turn in count():
        goal = 1800 + turn // 30 % 2 * 400
        yield 20, OUT, packet(1, 3, 41, 50, *goal.to_bytes(2, 'little'), 0, 0, 32, 3)
        yield 1, IN, packet(1, 0)
        yield 20, OUT, packet(1, 2, 56, 2)
        yield 1, IN, packet(1, 0, *(place_of(turn, goal) % 4096).to_bytes(2, 'little'))


def lost_acks(each):
    """Write and read; some acknowledgements of servo 2 get lost, several in a row, or all."""
    for turn in count():
        for number in (1, 2):
            is_lost = number == 2 and (turn % 8 < each)
            yield from goes((write_2(number, 116, turn % 200, 8, 0, 0)[0],
                             b'' if is_lost else encode(number, STATUS, b'', error=0)),
                            read_2(number, 132, 4), rounds=1)


def read_in_part(comes, whole=1):
    """Write to and read two servos; of what comes only as much is read as is due, or none."""
    yield 0, '', EMPTY
    for turn in count():
        number = 1 + turn % 2
        asked, answer = packet(number, 2, 56, 2), packet(number, 0, turn % 200, 8)
        if turn % 3 < 2:
            asked, answer = packet(number, 3, 42, turn % 200, 8), packet(number, 0)
        came, size = comes(number, asked, answer), whole * len(answer)
        yield 40, OUT, asked
        yield 1, IN, came[:size]
        yield 0.1, '', Change(UNREAD, len(came) - size)
        yield 0, '', Change(PURGED, 1)
        yield 0, '', EMPTY


def reads_by_count(of_2, size=8):
    """Ask two servos, read as many bytes as an answer has, never clear; so many of ID 2."""
    waiting = b''
    for turn in count():
        number = 1 + turn % 2
        yield 3, '', Change(UNREAD, len(waiting))
        yield 0, OUT, packet(number, 2, 56, 2)
        for more in range(of_2 if number == 2 else 1):
            waiting += packet(number, 0, turn % 200, more)
        yield 1, IN, waiting[:size]
        waiting = waiting[size:]


def leaves_acknowledgements():
    """Write to two servos, leave the acknowledgements unread, and read a position of each."""
    waiting = b''
    for turn in range(10_000):
        for instruction, data in (3, (42, turn % 250, 4)), (2, (56, 2)):
            for number in 1, 2:
                yield 3, '', Change(UNREAD, len(waiting))
                yield 0, OUT, packet(number, instruction, *data)
                waiting += packet(number, 0, *((turn % 200, 1) if instruction == 2 else ()))
                if instruction == 2:
                    yield 1, IN, waiting[:8]
                    waiting = waiting[8:]


def reads_its_echo(size):
    """Read a count of bytes of what an adapter echoes and servos answer; never clear the input."""
    waiting = b''
    for turn in range(10_000):
        number = 1 + turn % 2
        asked = packet(number, 2, 56, 2)
        yield 3, '', Change(UNREAD, len(waiting))
        yield 0, OUT, asked
        echo = asked if turn % 4 else asked[:-1] + b'\0'      # the answer came into it
        waiting += echo + packet(number, 0, turn % 200, 1)
        yield 1, IN, waiting[:size]
        waiting = waiting[size:]


@pytest.mark.parametrize(('said', 'failed', 'found'), [
    *((played(parts), failed, found) for found, failed, *parts in yaml.safe_load(
        Path(__file__).with_name('foreign_programs.yaml').read_text())),
    (throws_the_rest_away(), '', 'damaged_answers'),
    (read_in_part(lambda _, asked, answer: answer, 0), '', 'impatient_master'),
    (read_in_part(lambda _, asked, answer: answer), '', ''),
    (read_in_part(lambda _, asked, answer: asked + answer), '', 'echo'),
    (read_in_part(lambda number, asked, answer: number % 2 * b'\0\0' + answer), '', ''),
    (read_in_part(lambda _, asked, answer: b'\xfe\0\xfe\0' + answer), '', 'noise'),
    (read_in_part(lambda number, asked, answer: answer + number % 2 * b'\x28\1'), '',
     'duplicate_id'),
    (read_in_part(lambda number, asked, answer: answer + b'\0'), '', ''),
    (read_in_part(lambda number, asked, answer: answer if number == 2 else
                  answer[:3] + b'\x64' + answer[4:]), '', 'damaged_answers'),
    (follows(lambda turn, goal: 1800 + 40 * turn), '', 'operating_mode'),
    (follows(lambda turn, goal: goal - 200 // (1 + turn % 30)), '', ''),
    (reads_by_count(2), '', 'duplicate_id'), (reads_by_count(1), '', ''),
    (reads_by_count(1, 7), '', 'unread_answers'),
    (reads_its_echo(11), '', 'echo'),
    (leaves_acknowledgements(), '', 'unread_answers'),
    (one_way(3, 4300), '', 'goal_limits'), (one_way(4, 4300), '', ''),
    (one_way(3, 2000), '', ''),
    (lost_acks(3), '', 'missed_answers'), (lost_acks(8), '', 'no_acks'),
    (written_first(packet(1, 3, 5, 7)), '', 'id_moved'),
    (written_first(packet(1, 3, 6, 4)), '', 'baud_moved'),
    (written_first(), '', 'no_answer'),
    (flushes(0.2, 2, 3), '', 'not_sent'), (flushes(0.2, 5, 5), '', ''),
    (flushes(4, 5, 0), '', 'no_answer'), (islice(flushes(0.2, 5, 0), 7), RAISED, 'not_sent'),
    (islice(flushes(4, 5, 0), 7), RAISED, 'no_answer'),
    (hurries(1.04, *CLIPPED), '', 'impatient_master unread_answers'), (hurries(1.04), '', ''),
    (hurries(2), '', ''),
    (gives_up(1, 3, 4, 0.3), '', 'late_answers'), (gives_up(1, 3, 4, 4), '', 'late_answers'),
    (gives_up(2, 20, 0.3, 4, 0.3), '', 'late_answers'), (gives_up(5, 20, 9), '', 'late_answers'),
    (gives_up(2, 20, 4, 4, 4), '', 'late_answers unread_answers'),
    (gives_up(5, 20, 0.3, 4), '', ''),
], ids=lambda one: getattr(one, '__name__', None))
def test_a_foreign_program_meets_a_fault(said, failed, found):
    bus, met = Bus(), set()
    for turn, side in enumerate(heard(bus, said)):
        if turn % 40 == 39 or not side:
            met |= {one.rule for one in bus.report().findings if one.level > Level.OK}
        if turn == 280:
            break
    else:
        bus.monitor.end(bus.now, failed)
        met |= {one.rule for one in bus.report().findings if one.level > Level.OK}
    assert ' '.join(sorted(met)) == found


def heard(bus, said):
    """Let a bus hear what is said; yield the side of each."""
    for ms, side, what in said:
        bus.wait(ms / 1000)
        if side:
            bus.monitor.feed(what, bus.now, side)
        else:
            bus.monitor.change(what, bus.now)
        yield side


def test_one_that_answers_no_reads_either_is_an_error_at_the_end_too():
    bus = Bus()
    for _ in heard(bus, islice(written_first(), 300)):
        bus.report()
    bus.monitor.end(bus.now)
    [found] = [one for one in bus.report().findings if one.device == 1]
    assert (found.rule, found.level) == ('no_answer', Level.ERROR)


@pytest.mark.parametrize(('finds', 'levels'), [(True, []), (False, [Level.ERROR])])
def test_a_search_over_rates_is_no_silence_once_it_finds(finds, levels):
    bus, log = Bus(), FindingLog()
    for rate in (9600, 57_600):
        bus.monitor.change(Change(BAUD, rate), bus.now)
        for _ in range(10):
            bus.wait(0.2)
            bus.monitor.feed(encode(254, 1), bus.now, OUT)
            log.add_report(bus.report())
    if finds:
        bus.wait(0.001)
        bus.monitor.feed(encode(1, STATUS, b'\x24\x04\x2e', error=0), bus.now, IN)
    bus.wait(0.2)
    bus.monitor.end(bus.now)
    log.add_report(bus.report())
    assert [one.finding.level for one in log.entries() if one.finding.level] == levels


@pytest.mark.parametrize(('answer', 'is_unknown'), [(b'', True), (packet(1, 0), False)])
def test_writes_without_one_byte_back_are_no_clean_bill(answer, is_unknown):
    bus = Bus()
    for _ in range(10):
        bus.monitor.feed(packet(1, 3, 42, 0, 8), bus.now, OUT)
        bus.wait(0.01)
        if answer:
            bus.monitor.feed(answer, bus.now, IN)
        bus.wait(0.5)
    bus.monitor.end(bus.now)
    report = bus.report()
    assert any('not one byte' in one.message for one in report.doubts) == is_unknown
    assert not report.findings


@pytest.mark.parametrize(('parts', 'is_behind'), [
    (['* 5 unread 8; 0 > 1 2 56 2; 1 < 1 0 t 8'], True),
    (['* 5 unread 8; 0 > 1 2 56 2; 1 < 1 0 t 8; 5 unread 0; 0 > 1 2 56 2; 1 < 1 0 t 8'], False),
    (['* 5 unread 8; 0 purged 1; 0 > 1 2 56 2; 1 < 1 0 t 8'], False),
    (['* 5 unread 6; 0 > 1 3 42 0 8'], False),
])
def test_a_program_that_reads_old_answers_may_not_mean_to(parts, is_behind):
    bus = Bus()
    assert [*heard(bus, islice(played(parts), 280))]
    assert any('earlier answers' in one.message for one in bus.report().doubts) == is_behind


def test_what_late_answers_spoil_has_a_cause():
    bus, log = Bus(), FindingLog()
    for turn, _ in enumerate(heard(bus, islice(gives_up(2, 20, 4, 4, 0.3), 2000))):
        if turn % 40 == 39:
            log.add_report(bus.report())
    said = make_verdict('run', [BusSummary.of('', log.last, log, True)], 10, True)
    assert [(one.rule, one.who) for one in said.wrong] == [('unread_answers', 'the bus')]
    assert any(one.level for one in log.last.devices if one.id != 1)
    assert not any('cause is unknown' in one for one in said.unknown)


@pytest.mark.parametrize(('last', 'seconds', 'found'), [
    ('9 > 2 2 56 2', 3, [2]), ('9 > 2 2 56 2', 1, []), ('9 > 2 2 56 2; 40 gave_up_us 0', 3, []),
    ('9 > 2 3 42 0 8', 3, []), ('9 > 2 2 56 2; 1 < 2 0 0 8', 3, [])])
def test_a_program_that_waits_for_ever_names_the_device(last, seconds, found):
    bus = Bus()
    assert [*heard(bus, islice(played([
        '0 unread 0', '9 * 9 > 1 2 56 2; 1 < 1 0 t 8; 9 > 2 2 56 2; 1 < 2 0 t 8', last]), 99))]
    bus.wait(seconds)
    bus.monitor.end(bus.now)
    assert [one.device for one in bus.report().findings if one.level is Level.ERROR] == found


@pytest.mark.parametrize(('heard_once', 'says'), [
    (b'ets Jul 29 2019 12:21:46\r\n', 'text, but no packet: `ets Jul 29 2019 12:21:46`'),
    (bytes(range(128, 160)), 'bytes, but no packet: set `bauds`')])
def test_text_without_a_packet_is_no_wrong_rate(heard_once, says):
    bus = Bus()
    bus.hear(heard_once)
    bus.wait(2)
    bus.monitor.flush_if_idle(bus.now)
    assert bus.report().message.startswith(says)
