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

from msg_defs.dxl_packet import body_crc
from msg_defs.dxl_packet import encode
from msg_defs.dxl_packet import HEADER
from msg_defs.dxl_packet import STATUS
from msg_defs.event import BAUD
from msg_defs.event import Change
from msg_defs.event import GAVE_UP
from msg_defs.event import IN
from msg_defs.event import OUT
from msg_defs.event import PURGED
from msg_defs.event import UNREAD
from msg_defs.reports import Level
from servobus.bus.report import FAILED
from servobus.bus.report import RAISED
from servobus.doctor.finding_log import BusSummary
from servobus.doctor.finding_log import FindingLog
from servobus.tools.doctor.verdict import make_verdict

RATE, EMPTY = Change(BAUD, 1_000_000), Change(UNREAD, 0)


def packet(number, *body):
    """Return a packet of the 1.0 family."""
    head = bytes([number, len(body) + 1, *body])
    return b'\xff\xff' + head + bytes([~sum(head) & 255])


def packet_2(number, code, *params):
    return encode(number, code, bytes(params))


def status_2(number, error, *params):
    return encode(number, STATUS, bytes(params), error=error)


SAYS = {'>': (OUT, packet), '<': (IN, packet), '>>': (OUT, packet_2), '<<': (IN, status_2)}


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


def twice(ms, servos=3):
    """Read three servos in turn; of ID 2 there are two, or a master that is not heard."""
    for turn in count():
        number = 1 + turn % servos
        yield 0.2, OUT, packet(number, 2, 56, 2)
        if turn > 1 and number == 3:
            yield ms, IN, packet(2, 0, 132, 3)
        yield 9, IN, packet(number, 0, 0, 8)


def passed_by(*ids, twice):
    """Read four registers of three servos; answers come one behind, the first of them twice."""
    sizes, waiting = (4, 2, 2, 1), b''
    for turn in count():
        number, register = 1 + turn // 4 % 3, turn % 4
        answer = packet(number, 0, *bytes(sizes[register]))
        yield 0.2 if register else 5, OUT, packet(number, 2, 56 + 4 * register, sizes[register])
        if waiting:
            yield 0.2, IN, waiting
        is_behind = number in ids and (register or not twice)
        if not is_behind:
            yield 1, IN, answer
        waiting = answer if number in ids else b''


def echoed(error=0):
    for turn in count():
        asked = packet(1 + turn % 3, 2, 56, 2)
        yield 20, OUT, asked
        if not error:
            yield 0.2, IN, asked
        yield 1, IN, packet(1 + turn % 3, error, turn % 250, 8)


def sync_reads(of_servos):
    """Write three torques of AX-12, then ask all at once; or one after the other."""
    for number in (1, 2, 3):
        yield 5, OUT, packet(number, 3, 24, 1)
        yield 1, IN, packet(number, 0)
    while True:
        yield 20, OUT, packet(254, 0x82, 36, 2, 1, 2, 3)
        for number in range(1, 1 + of_servos):
            yield 5, OUT, packet(number, 2, 36, 2)
            yield 1, IN, packet(number, 0, 0, 2)


def searches(answer):
    for rate in (4800, 9600, 19200, 38400, 57600):
        yield 500, '', Change(BAUD, rate)
        yield 500, OUT, packet(254, 1)
    yield 500, '', RATE
    yield 500, OUT, packet(254, 1)
    if answer:
        yield 1, IN, answer


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


def short(late):
    """Let servo 2 answer 1 byte to reads of 2, and be late that often."""
    for turn in count():
        number = 1 + turn % 3
        yield 5, OUT, packet(number, 2, 56, 2)
        if number == 2 and turn < 3 * late:
            yield 20, OUT, packet(number, 2, 56, 2)
        yield 1, IN, packet(number, 0, *([0] if number == 2 else [0, 8]))


def read(number, at, size):
    return encode(number, 2, bytes((at, 0, size, 0)))


def ahead(damaged=0):
    """Ask one servo for four registers 2 ms apart, look for each at once only, then read all."""
    yield 0, '', EMPTY
    for turn in count():
        for at, size in ((132, 4), (126, 2), (146, 1), (144, 2)):
            yield 0.2, '', Change(GAVE_UP, 0)
            yield 2, OUT, read(1, at, size)
        for size in (4, 2, 1, 2):
            answer = encode(1, STATUS, bytes(size), error=0)
            spoilt = answer[:-1] + b'\x55' if turn % 2 and size == damaged else answer
            yield 1 if size == 4 else 0.3, IN, spoilt
        yield 90, '', EMPTY


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


def breaks_off(silent):
    """Read six servos by Fast Sync Read, of which the fifth is silent, or not asked."""
    ids = bytes((1, 2, 3, 4, 5, 6) if silent else (1, 2, 3, 4))
    while True:
        body = bytes((254, 1 + 8 * len(ids), 0, STATUS))
        for number in ids[:4]:
            body += bytes((0, number, 0, 8, 0, 0))
            body += body_crc(body).to_bytes(2, 'little')
        yield 0.2, OUT, encode(254, 0x8A, bytes((132, 0, 4, 0)) + ids)
        yield 2, IN, HEADER + body
        yield 30, '', Change(GAVE_UP, 0)


def limited(beyond):
    """Send goals to an AX-12, some of them beyond its limits, and read the position."""
    for turn in count():
        yield 5, OUT, packet(1, 3, 30, 144, 1 + turn % 2)
        yield 1, IN, packet(1, 2 if 8 <= turn < 8 + beyond else 0)
        yield 5, OUT, packet(1, 2, 36, 2)
        yield 1, IN, packet(1, 0, 0, 2)


def waited_for(code, before):
    """End on a question to servo 2 that is not answered, as were some before."""
    yield 0, '', EMPTY
    for turn in range(8):
        for number in (1, 2):
            yield 5, OUT, packet(number, code, *((42, 0, 8) if code == 3 else ()))
            if number == 1 or turn < 7 - before or turn in range(7 - before, 7, 2):
                yield 1, IN, packet(number, 0)
            else:
                yield 40, '', Change(GAVE_UP, 0)
    yield 0, '', EMPTY


def goes(*turns, rounds=999, first=()):
    """Ask that again and again, after some first; what is not answered is waited for."""
    yield 0, '', EMPTY
    for asked, answer in [*first, *rounds * turns]:
        yield 20, OUT, asked
        yield (1, IN, answer) if answer else (40, '', Change(GAVE_UP, 0))
    yield 0, '', EMPTY


def ping_2(number):
    return encode(number, 1), encode(number, STATUS, b'\x24\x04\x2e', error=0)


def write_2(number, at, *data):
    return encode(number, 3, bytes((at, 0, *data))), encode(number, STATUS, b'', error=0)


def read_2(number, at, size):
    return read(number, at, size), encode(number, STATUS, bytes(size), error=0)


ASKED, ACKED = packet(1, 2, 56, 2), packet(1, 3, 40, 1)
COLLIDED = b'\xdf\xdf\1\0\0\x20\0\xfd'       # two servos answered
CLIPPED = *8 * (b'\xff\xff\1\4\0\0\2\x80',), b'\xff\xff\x88\xf0\4\0\2\xf0'
SILENT_WRITE = write_2(2, 64, 1)[0], b''
SEARCH = [(packet(number, 1), packet(number, 0) if number < 3 else b'') for number in range(20)]
BEYOND, REFUSED = ((write_2(1, 116, 0, 99, 0, 0)[0], encode(1, STATUS, b'', error=error))
                   for error in (6, 7))
BOTH = ping_2(1), ping_2(2)
UNREAD_2 = read(2, 132, 4), b''
FAST = encode(254, 0x8A, bytes((132, 0, 4, 0, 2))), b''


def one_way(mode, goal):
    """Set an operating mode, then send goals by Sync Write, and read the position."""
    yield from goes(write_2(1, 11, mode), write_2(1, 64, 1), rounds=1)
    for turn in count():
        there = goal + turn % 40
        yield 20, OUT, encode(254, 0x83, bytes((116, 0, 4, 0, 1)) + there.to_bytes(4, 'little'))
        yield 20, OUT, read(1, 132, 4)
        yield 1, IN, encode(1, STATUS, min(4095, there).to_bytes(4, 'little'), error=0)


def lost_acks(each):
    """Write and read; some acknowledgements of servo 2 get lost, several in a row, or all."""
    for turn in count():
        for number in (1, 2):
            is_lost = number == 2 and (turn % 8 < each)
            yield from goes((write_2(number, 116, turn % 200, 8, 0, 0)[0],
                             b'' if is_lost else encode(number, STATUS, b'', error=0)),
                            read_2(number, 132, 4), rounds=1)


def locks(*registers):
    """Write to EEPROM of a Feetech servo, and to Lock (55), then move it."""
    first = [(packet(1, *one), packet(1, 0, *(one[0] == 2) * (9, 3))) for one in registers]
    yield from goes((packet(1, 3, 41, 50, 0, 8, 0, 0, 9, 0), packet(1, 0)), (
        packet(1, 2, 56, 15), packet(1, 0, *bytes(15))), first=[
            *first, (packet(1, 3, 40, 1), packet(1, 0))])


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


def cut_off(unread):
    """End on an acknowledgement after a stray byte, of which so many bytes are not read."""
    yield from goes(SEARCH[2], rounds=1)
    yield 5, OUT, ACKED
    yield 1, IN, b'\xfe' + packet(1, 0)[:-1]
    yield 0, '', Change(UNREAD, unread)


def all_away(but):
    """Ask three servos that are silent together for a while, or all but one."""
    for turn in count():
        number = 1 + turn % 3
        is_away = 8 < turn < 20 and number != but
        yield from islice(goes((packet(number, 2, 56, 2), b'' if is_away else packet(
            number, 0, turn % 200, 8)), rounds=1), 1, 3)


def paces(slow):
    """Ask every 40 ms, in some turns later."""
    for turn in count():
        yield 39 + slow(turn), OUT, ASKED
        yield 1, IN, packet(1, 0, 0, 8)


def by_chance(each):
    """Damage the answers of three servos; an error byte comes with a good sum, one in so many."""
    for turn in count():
        number = 1 + turn % 3
        yield 20, OUT, packet(number, 2, 56, 2)
        error = 32 * (turn % each == 1)
        answer = packet(number, error, turn % 200, 8)
        yield 1, IN, answer if error or turn % 2 else answer[:-1] + b'\x55'


@pytest.mark.parametrize(('said', 'failed', 'found'), [
    *((played(parts), failed, found) for found, failed, *parts in yaml.safe_load(
        Path(__file__).with_name('foreign_programs.yaml').read_text())),
    (locks((3, 55, 1), (3, 9, 0, 1)), '', 'lock'),
    (locks((2, 3, 2), (3, 55, 1), (3, 9, 0, 1), (3, 55, 1)), '', 'lock'),
    (locks((2, 3, 2), (3, 55, 0), (3, 9, 0, 1), (3, 55, 1)), '', ''),
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
    (cut_off(1), RAISED, 'stray_bytes'), (cut_off(1), '', ''),
    (cut_off(0), RAISED, 'damaged_answers'),
    (goes((ACKED, COLLIDED), rounds=1, first=SEARCH[2:3]), RAISED, 'damaged_answers'),
    (goes((ACKED, COLLIDED), rounds=1, first=SEARCH[2:3]), '', ''),
    (goes((ASKED, b''), rounds=4), '', 'all_silent'), (goes((ASKED, b''), rounds=2), '', ''),
    (goes(write_2(1, 64, 1), SILENT_WRITE, rounds=9), '', 'no_answer'),
    (all_away(0), '', 'brown_out'), (all_away(2), '', 'dropout'),
    (paces(lambda turn: turn * 7919 % 97 if turn % 3 == 2 else 0), '', 'jitter'),
    (paces(lambda turn: 60 * (turn % 3 == 2)), '', ''),
    (by_chance(90), '', 'noise'), (by_chance(3), '', 'hardware_error noise'),
    (goes((ASKED, COLLIDED)), '', 'damaged_answers'), (goes((ASKED, b'')), '', 'no_answer'),
    (goes((ASKED, b'\0\xfe' + packet(1, 0, 0, 8))), '', ''),
    (goes(SEARCH[1], SEARCH[2], (packet(3, 1), COLLIDED), (packet(4, 1), b''), rounds=1), RAISED,
     'damaged_answers no_answer'),
    (goes(*SEARCH, (ASKED, COLLIDED), rounds=1), FAILED, 'damaged_answers'),
    (goes(*SEARCH, (packet(9, 3, 42, 0, 8), b''), rounds=1), FAILED, 'no_answer'),
    (goes(*SEARCH, rounds=1), FAILED, ''),
    (goes(ping_2(1), ping_2(2), SILENT_WRITE, rounds=1), FAILED, 'ping_only'),
    (goes(ping_2(1), read_2(2, 132, 4), SILENT_WRITE, rounds=1), FAILED, 'no_acks'),
    (goes(ping_2(1), ping_2(2), SILENT_WRITE, rounds=1), '', ''),
    (goes(write_2(1, 64, 1), SILENT_WRITE, SILENT_WRITE, read_2(1, 132, 4), rounds=1), FAILED,
     'no_answer'),
    (goes(write_2(1, 64, 1), SILENT_WRITE, SILENT_WRITE, read_2(1, 132, 4), rounds=1), '', ''),
    (goes(FAST, first=(write_2(2, 64, 1),)), '', 'fast_read_unsupported'),
    (goes(FAST), '', 'no_answer'),
    (goes((packet(1, 3, 16, 0, 2), packet(1, 0)), (ASKED, packet(1, 0, 0, 8))), '',
     'eeprom_wear'),
    (goes((packet(1, 3, 42, 0, 2), packet(1, 0)), (ASKED, packet(1, 0, 0, 8))), '', ''),
    (one_way(3, 4300), '', 'goal_limits'), (one_way(4, 4300), '', ''),
    (one_way(3, 2000), '', ''),
    (lost_acks(3), '', 'missed_answers'), (lost_acks(8), '', ''),
    (goes(BEYOND, rounds=1), RAISED, 'goal_limits'), (goes(BEYOND, rounds=1), '', ''),
    (goes(BEYOND, read_2(1, 132, 4), rounds=1), RAISED, ''),
    (goes(ping_2(1), REFUSED, rounds=1), FAILED, 'wrong_address'),
    (goes(read_2(1, 132, 4), UNREAD_2, first=BOTH), '', 'ping_only'),
    (goes(read_2(1, 132, 4), UNREAD_2, (encode(2, 1), b''), first=BOTH), '',
     'no_answer'),
    (goes(read_2(1, 132, 4), UNREAD_2, first=(*BOTH, read_2(2, 132, 4))), '', 'no_answer'),
    (twice(0.6), '', 'duplicate_id'), (twice(4), '', 'foreign_answers'),
    (passed_by(2, twice=True), '', 'duplicate_id'),
    (passed_by(1, 2, 3, twice=False), '', ''),
    (echoed(), '', 'echo'), (echoed(2), '', 'hardware_error'),
    (echoed(1), '', 'voltage'), (echoed(33), '', 'hardware_error'),
    (sync_reads(0), '', 'sync_read_unsupported'),
    (searches(packet(1, 0)), '', ''), (searches(b''), '', 'all_silent'),
    (written_first(packet(1, 3, 5, 7)), '', 'id_moved'),
    (written_first(packet(1, 3, 6, 4)), '', 'baud_moved'),
    (written_first(), '', 'no_answer'), (short(1), '', 'wrong_length'),
    (ahead(), '', ''), (ahead(damaged=1), '', 'damaged_answers'),
    (flushes(0.2, 2, 3), '', 'not_sent'), (flushes(0.2, 5, 5), '', ''),
    (flushes(4, 5, 0), '', 'no_answer'), (islice(flushes(0.2, 5, 0), 7), RAISED, 'not_sent'),
    (islice(flushes(4, 5, 0), 7), RAISED, 'no_answer'),
    (hurries(1.04, *CLIPPED), '', 'impatient_master unread_answers'), (hurries(1.04), '', ''),
    (hurries(2), '', ''),
    (gives_up(1, 3, 4, 0.3), '', 'late_answers'), (gives_up(1, 3, 4, 4), '', 'late_answers'),
    (gives_up(2, 20, 0.3, 4, 0.3), '', 'late_answers'), (gives_up(5, 20, 9), '', 'late_answers'),
    (gives_up(2, 20, 4, 4, 4), '', 'late_answers'), (gives_up(5, 20, 0.3, 4), '', ''),
    (breaks_off(silent=True), '', 'sync_read_stops'), (breaks_off(silent=False), '', ''),
    (limited(2), '', 'goal_limits'), (limited(1), '', ''),
    (waited_for(3, 0), FAILED, 'no_answer'), (waited_for(3, 0), '', ''),
    (waited_for(3, 3), FAILED, ''), (waited_for(1, 0), FAILED, 'no_answer'),
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
    assert [(one.rule, one.who) for one in said.wrong] == [('late_answers', '001')]
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
