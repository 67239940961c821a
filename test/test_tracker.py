# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""Each rule of pairing on its own: what an answer means, who is missed, what a table takes in."""

from pathlib import Path

import pytest
from tracked_bus import Bus
from tracked_bus import BYTE_NS
from tracked_bus import damaged
from tracked_bus import fast_read
from tracked_bus import fast_reply
from tracked_bus import FILLED
from tracked_bus import GOAL
from tracked_bus import MX_106
from tracked_bus import notes
from tracked_bus import ping
from tracked_bus import pong
from tracked_bus import POSITION
from tracked_bus import read
from tracked_bus import reply
from tracked_bus import SENSELESS
from tracked_bus import words
from tracked_bus import write

from dxl_monitor.bus import evidence as ev
from dxl_monitor.bus.expected import Expected
from dxl_monitor.model.models import Models
from msg_defs.dxl_instruction import Instruction as I
from msg_defs.dxl_packet import BROADCAST
from msg_defs.dxl_packet import encode

TRACE = Path(__file__).parents[2] / 'shared' / 'data' / 'bus_trace_head.bin'
GRIPPER = 4660                     # a model of the user


# --- answers ---


@pytest.mark.parametrize('data', [b'', b'\x01', b'\x01\x02\x03', bytes(5), bytes(900)])
def test_an_answer_of_another_size_is_life_only(data):
    bus = Bus()
    bus.hear(read(1), reply(1, data), ping(2))
    assert bus.known(1, POSITION) is None
    assert bus.counts(1).answers == 1
    assert bus.counts(1).missed == 0


@pytest.mark.parametrize(('asked', 'unasked'), [
    (encode(1, 0x8B, b'\x01\x02'), 0), (encode(BROADCAST, 0x8B, b'\x01'), 0),
    (encode(1, I.READ, b'\x01'), 0), (encode(2, 0x8B, b'\x01\x02'), 1), (read(2), 1),
])
def test_who_answers_what_nobody_here_understands_is_not_unasked(asked, unasked):
    bus = Bus()
    bus.hear(asked, reply(1, b'aaaa'))
    assert bus.evidence.counts[ev.UNASKED] == unasked
    assert bus.device(1).heard == bus.now
    assert not bus.registry.devices[1].table._settle().data


def test_what_is_not_understood_is_noted_once_and_counted_each_time():
    bus = Bus()
    bus.hear(*[encode(1, 0x8B), encode(1, I.READ), encode(253, I.PING)] * 5)
    bus.tracker.planner.plans()
    kinds = [ev.UNKNOWN_INSTRUCTION, ev.MALFORMED, ev.BAD_ID]
    assert bus.kinds() == kinds
    assert [bus.evidence.counts[kind] for kind in kinds] == [5, 5, 5]


def test_a_late_answer_is_not_taken_for_the_next_one():
    bus = Bus()
    bus.hear(read(1), ping(2), reply(1, b'aaaa'))
    assert bus.known(1, POSITION) is None
    assert bus.counts(1).missed == 1
    assert bus.device(1).missed_in_a_row == 0
    assert ev.LATE in bus.kinds()


def test_a_late_acknowledgement_is_one():
    bus = Bus()
    goal = write(1, GOAL, bytes(4))
    bus.hear(goal, read(2), reply(2, bytes(4)))
    assert (bus.device(1).acks, bus.device(1).acks_missing) == (None, 1)
    bus.hear(goal, read(2), reply(1))
    assert bus.kinds() == ['late answer']
    assert (bus.device(1).acks, bus.device(1).acks_missing) == (True, 0)


@pytest.mark.parametrize(('noise', 'kinds', 'garbled'), [
    (18, ['missed'], 1),                       # as long as the answer, and a glitch
    (19, ['noise too long', 'missed'], 0),
])
def test_noise_that_is_longer_than_the_answer_is_not_that(noise, kinds, garbled):
    bus = Bus()
    bus.hear(read(1), b'\x5a' * noise, read(2))
    assert (bus.kinds(), bus.counts(1).garbled, bus.counts(1).spoilt) == (kinds, garbled, 1)


# --- after damage ---


@pytest.mark.parametrize('lost', [
    damaged(read(1, 144)), read(1, 144)[:-4], read(1, 144)[4:], b'\x01' * 9,
])
def test_after_damage_an_answer_is_life_only(lost):
    bus = Bus()
    bus.hear(read(1, POSITION), lost + reply(1, b'aaaa'), ping(2))
    bus.idle()
    assert bus.known(1, POSITION) is None
    assert bus.counts(1).answers == 1
    assert bus.counts(1).missed == 0


@pytest.mark.parametrize(('error', 'known'), [(0, b'aaaa'), (4, None), (0x80, b'aaaa')])
def test_after_damage_a_refusal_still_leaves_a_write_undone(error, known):
    bus = Bus()
    bus.hear(write(1, POSITION, b'aaaa'), b'\x01' * 9 + reply(1, b'', error), ping(2))
    assert bus.known(1, POSITION) == known


# --- write acknowledgements ---


@pytest.fixture
def gripper_bus(tmp_path):
    """Return a bus with a user's model file that has Status Return Level at 30."""
    (tmp_path / 'gripper.yaml').write_text(f"""model_numbers: {{{GRIPPER}: Gripper}}
fields:
  - {{at: 0, name: Model Number, type: u16, access: r, memory: eeprom}}
  - {{at: 30, name: Status Return Level, type: u8, access: rw, memory: eeprom}}
  - {{at: 132, name: Present Position, type: i32, access: r, memory: ram}}
""")
    return Bus(models=Models([tmp_path]))


def is_asked_in_vain(bus):
    """Ask device 1 seven times without an answer; return how many of them count as missed."""
    before = bus.counts(1).missed
    bus.hear(*[read(1)] * 7, ping(2))
    return bus.counts(1).missed - before


def test_where_the_return_level_stands_is_what_the_model_says(gripper_bus):
    bus = gripper_bus
    bus.hear(ping(1), pong(1, GRIPPER), read(1, 30, 1), reply(1, b'\0'))
    assert is_asked_in_vain(bus) == 0
    bus.hear(write(1, 30, b'\x01'), ping(2))
    assert is_asked_in_vain(bus) == 7


def test_a_return_level_seen_before_the_model_was_known_counts(gripper_bus):
    bus = gripper_bus
    bus.hear(read(1, 30, 1), reply(1, b'\0'))
    assert bus.device(1).return_level is None
    bus.hear(ping(1), pong(1, GRIPPER))
    assert is_asked_in_vain(bus) == 0


@pytest.mark.parametrize('ask', [
    lambda level: (read(1, 30, 1), reply(1, bytes([level]))),
    lambda level: (encode(BROADCAST, I.SYNC_WRITE, words(30, 1) + bytes([1, level])),)])
def test_what_was_said_before_is_understood_afresh_with_the_model(gripper_bus, ask):
    bus = gripper_bus
    bus.hear(*ask(2), *ask(2), ping(1), pong(1, GRIPPER))
    assert bus.device(1).return_level == 2
    bus.hear(*ask(0))
    assert bus.device(1).return_level == 0


def test_another_model_has_another_return_level(gripper_bus):
    bus = gripper_bus
    bus.hear(ping(1), pong(1, GRIPPER), read(1, 30, 1), reply(1, b'\0'), ping(1), pong(1))
    assert bus.device(1).return_level is None
    assert is_asked_in_vain(bus) == 7
    bus.hear(read(1, 30, 1), reply(1, b'\0'))          # no level of an MX-64
    assert bus.device(1).return_level is None


def test_a_device_that_stops_to_acknowledge_but_answers_reads_is_there():
    bus = Bus()
    bus.hear(write(1, GOAL, b'aaaa'), reply(1))
    for _ in range(10):
        bus.hear(write(1, GOAL, b'bbbb'), read(1), reply(1, b'cccc'))
    assert bus.counts(1).missed < 3
    assert bus.device(1).acks is False
    assert ev.ACKS_STOPPED in bus.kinds()
    assert bus.known(1, GOAL) == b'bbbb'


# --- what instructions do ---


@pytest.mark.parametrize('senseless', [
    SENSELESS, encode(BROADCAST, I.SYNC_WRITE, words(GOAL, 4) + b'\x01aaaa\x02bbb'),
    encode(BROADCAST, I.BULK_WRITE, b'\x01' + words(GOAL, 9) + b'aaaa'),
    encode(BROADCAST, I.BULK_WRITE, b'\x01' + words(GOAL, 0) + b'aaaa'),
    encode(1, I.WRITE, words(GOAL)), encode(1, I.WRITE, b'\x74'), encode(1, I.WRITE),
    encode(1, I.SYNC_WRITE, words(GOAL, 4) + b'\x01aaaa'),
], ids=repr)
def test_a_write_that_makes_no_sense_hides_none_behind_it(senseless):
    bus = Bus()
    for data in (b'cccc', b'dddd'):
        bus.hear(senseless
                 + encode(BROADCAST, I.SYNC_WRITE, words(GOAL, 4) + b'\x01' + data + b'\x02bbbb')
                 + encode(BROADCAST, I.BULK_WRITE, b'\x03' + words(GOAL, 4) + data)
                 + write(4, GOAL, data) + reply(4))
        assert [bus.known(n, GOAL) for n in (1, 2, 3, 4)] == [data, b'bbbb', data, data]
    bus.tracker.planner.plans()
    assert bus.evidence.counts[ev.MALFORMED] == 2


def test_a_bulk_write_that_makes_no_sense_behind_one_that_does_is_noted():
    bus = Bus()
    whole = b'\x01' + words(GOAL, 4) + b'aaaa'
    for last in (b'\x02' + words(GOAL, 4) + b'bbbb', b'\x02' + words(GOAL, 5) + b'dddd'):
        bus.hear(encode(BROADCAST, I.BULK_WRITE, whole + last))
    assert notes(bus) == [(bus.now, ev.MALFORMED, BROADCAST, (I.BULK_WRITE, len(whole + last)))]
    assert (bus.known(1, GOAL), bus.known(2, GOAL)) == (b'aaaa', b'bbbb')


@pytest.mark.parametrize('how', [
    (write(1, 7, b'\x09'), reply(1)),
    (encode(BROADCAST, I.SYNC_WRITE, words(7, 1) + b'\x01\x09'),),
    (encode(BROADCAST, I.BULK_WRITE, b'\x01' + words(7, 1) + b'\x09'),),
    (encode(1, I.REG_WRITE, words(7) + b'\x09'), reply(1), encode(1, I.ACTION), reply(1)),
])
def test_a_written_id_is_followed(how):
    bus = Bus()
    bus.hear(*FILLED)
    bus.hear(*how, read(9), reply(9, b'qqqq'))
    assert list(bus.registry.devices) == [9]
    assert bus.known(9, POSITION) == b'qqqq'
    assert bus.known(9, GOAL) == b'gggg'
    assert bus.device(9).model.name == 'MX-64'


@pytest.mark.parametrize('how', [I.WRITE, I.REG_WRITE])
def test_an_id_written_to_everybody_leaves_everybody_who_he_is(how):
    bus = Bus(Expected(1, 'MX-64', 'left_knee'), Expected(2, 'MX-106', 'right_knee'))
    bus.hear(ping(1), pong(1), ping(2), pong(2, MX_106), ping(3), pong(3),
             encode(BROADCAST, how, words(7) + b'\x09'), encode(BROADCAST, I.ACTION), ping(1))
    assert [(n, bus.device(n).joint, bus.device(n).model.name) for n in bus.registry.devices] == [
        (1, 'left_knee', 'MX-64'), (2, 'right_knee', 'MX-106'), (3, '', 'MX-64')]


def test_who_gets_the_id_of_one_that_is_listed_is_that_one():
    bus = Bus(Expected(2, 'MX-106', 'right_knee'))
    bus.hear(ping(1), pong(1, MX_106), write(1, 7, b'\x02'), reply(1))
    assert set(bus.registry.devices) == {2}
    device = bus.device(2)
    assert (device.joint, device.expected, device.counts.answers) == ('right_knee', True, 2)


# --- models ---


@pytest.mark.parametrize(('length', 'data'), [
    (2, words(MX_106)), (8, words(MX_106) + b'\0\0\0\0\x29\x01')])
def test_a_read_of_the_model_number_names_the_model(length, data):
    bus = Bus()
    bus.hear(read(1), reply(1, b'pppp'), read(1, 0, length), reply(1, data))
    assert bus.device(1).model.name == 'MX-106'
    assert bus.device(1).firmware == (0x29 if length == 8 else None)
    assert bus.known(1, POSITION) == b'pppp'


# --- latency ---


def test_latency_is_that_of_the_wire():
    bus = Bus()
    bus.hear(read(1))
    bus.hear(reply(1, b'aaaa'), gap_ns=500_000 + 15 * BYTE_NS)
    total = bus.device(1).latency.total()
    assert total.mean == pytest.approx(0.5)
    assert (bus.device(1).asked_first, bus.device(1).latency_resolved) == (1, 1)


@pytest.mark.parametrize(('together', 'is_told'), [(4, True), (5, False)])
def test_a_latency_that_few_answers_tell_is_not_told(together, is_told):
    bus = Bus()
    bus.hear(read(1), reply(1, b'aaaa'), *[read(1) + reply(1, b'aaaa')] * together)
    window, total, resolved = bus.device(1).latency_report(bus.now)
    assert resolved == 1 / (1 + together)
    assert (window is not None, total is not None) == (is_told, is_told)


# --- any bytes ---


@pytest.mark.parametrize('packet', [
    encode(1, 0x8B, b'\x01\x02'), encode(253, I.READ, words(0, 2)), encode(255, I.PING),
    encode(1, I.READ, b''), encode(1, I.WRITE, b'\x01'), encode(BROADCAST, I.SYNC_READ, b''),
    encode(BROADCAST, I.SYNC_WRITE, words(1, 0) + b'\x01'), encode(1, I.CLEAR),
    encode(1, I.STATUS + 1),
    encode(BROADCAST, I.FAST_BULK_READ, b'\xff' + words(0, 4)),
    encode(BROADCAST, I.FACTORY_RESET, b'\xff'), encode(BROADCAST, I.BULK_WRITE, b'\x01\x02'),
])
def test_odd_instructions_are_counted_and_nothing_else(packet):
    bus = Bus()
    bus.hear(*FILLED)
    bus.hear(packet, reply(1, b'zzzz'), read(1), reply(1, b'qqqq'))
    assert bus.known(1, POSITION) == b'qqqq'
    assert set(bus.registry.devices) == {1}


def test_the_robot_trace_in_any_chunks():
    if not TRACE.is_file():
        pytest.skip('skipped: the robot trace is not here')
    data = TRACE.read_bytes()
    results = []
    for size in (len(data), 4096, 64):
        bus = Bus()
        bus.hear(*(data[at:at + size] for at in range(0, len(data), size)))
        results.append({n: (bus.device(n).model.name, bus.counts(n).answers, bus.counts(n).missed,
                            bus.counts(n).not_served, bus.counts(n).damaged)
                        for n in sorted(bus.registry.devices)})
    assert results[0] == results[1] == results[2]
    found = results[0]
    assert set(found) == {*range(1, 21), 101}
    names = [found[n][0] for n in range(1, 21)]
    assert (names.count('MX-64'), names.count('MX-106'), names.count('unknown')) == (8, 9, 3)
    assert found[1] == ('MX-64', 399, 10, 0, 4)
    assert found[20] == ('MX-64', 310, 17, 81, 12)    # 3 behind a damaged answer
    assert found[101] == ('unknown', 0, 335, 0, 0)
    assert sum(row[1] for row in found.values()) == 7524
    assert sum(row[2] for row in found.values()) == 683


# --- exactly what is noted ---

def test_a_miss_is_stamped_with_the_next_instruction_on_the_wire():
    bus = Bus()
    bus.hear(ping(1), pong(1), read(1), ping(1))
    began = bus.now - len(ping(1)) * BYTE_NS
    assert notes(bus)[-1] == (began, ev.MISSED, 1, (I.READ, POSITION))
    assert bus.evidence.waits[-1] == (began, (began - (bus.now - 1_000_000)) // 1000, 1, False)


def test_a_repetition_is_noted_with_its_distance():
    bus = Bus()
    bus.hear(ping(1), pong(1), read(1), read(1))
    distance = (1_000_000 - len(read(1)) * BYTE_NS) // 1000
    assert notes(bus)[-1][1:] == (ev.REPEATED, 1, (I.READ, distance))


def test_what_an_answer_is_worth_is_noted_exactly():
    bus = Bus()
    bus.hear(ping(1), pong(1), read(1), reply(1, b'12'))
    assert notes(bus)[-1][1:] == (ev.WRONG_SIZE, 1, (2, 4))
    bus.hear(read(1), reply(1, b'1234'), reply(1, b'1234'))
    assert notes(bus)[-1][1:] == (ev.SECOND_ANSWER, 1, (I.READ,))
    bus.hear(reply(7, b'1234', error=3))
    assert notes(bus)[-1][1:] == (ev.UNASKED, 7, ())
    bus.hear(read(1), ping(2), reply(1, b'1234'))
    assert [kind for _, kind, _, _ in notes(bus)][-2:] == [ev.MISSED, ev.LATE]


def test_a_cut_fast_reply_and_a_glitch_are_noted_exactly():
    bus = Bus()
    bus.hear(fast_read(1, 2, 3), fast_reply({1: b'1234', 2: b'5678', 3: b'9abc'})[:20])
    bus.idle()
    assert (ev.FAST_CUT, 2, (1, 3)) in [one[1:] for one in notes(bus)]
    bus.hear(read(1), b'\x00' + reply(1, b'1234'))
    assert bus.evidence.counts[ev.GLITCH] == 1


@pytest.mark.parametrize(('asked', 'answer', 'spoilt'), [
    (read(1), b'', 0), (read(1), damaged(reply(1, b'1234')), 1),
    (fast_read(1), b'', 0), (fast_read(1), damaged(fast_reply({1: b'1234'})), 1),
])
def test_damage_and_then_silence_is_an_answer_spoilt_not_a_device_silent(asked, answer, spoilt):
    """The doctor tells a bad cable from an absent device by it."""
    bus = Bus()
    bus.hear(ping(1), pong(1), asked, answer)
    bus.idle()
    bus.tracker.settle(bus.now + 10**9)
    assert (bus.counts(1).missed, bus.counts(1).spoilt) == (1, spoilt)
