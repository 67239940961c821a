# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""Each rule of pairing on its own: what an answer means, who is missed, what a table takes in."""


import pytest
from tracked_bus import Bus
from tracked_bus import BYTE_NS
from tracked_bus import GOAL
from tracked_bus import notes
from tracked_bus import ping
from tracked_bus import pong
from tracked_bus import POSITION
from tracked_bus import read
from tracked_bus import reply
from tracked_bus import SENSELESS
from tracked_bus import words
from tracked_bus import write

from msg_defs.dxl_instruction import Instruction as I
from msg_defs.dxl_packet import BROADCAST
from msg_defs.dxl_packet import encode
from servobus.bus import evidence as ev
from servobus.model.models import Models

GRIPPER = 4660                     # a model of the user


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
    bus.tracker.planner.updated_plans()
    assert bus.evidence.counts[ev.MALFORMED] == 2


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


# --- exactly what is noted ---

def test_a_miss_is_stamped_with_the_next_instruction_on_the_wire():
    bus = Bus()
    bus.hear(ping(1), pong(1), read(1), ping(1))
    began = bus.now - len(ping(1)) * BYTE_NS
    assert notes(bus)[-1] == (began, ev.MISSED, 1, (I.READ, POSITION))
    assert bus.evidence.waits[-1] == (began, (began - (bus.now - 1_000_000)) // 1000, 1, False,
                                      I.READ)


def test_a_repetition_is_noted_with_its_distance():
    bus = Bus()
    bus.hear(ping(1), pong(1), read(1), read(1))
    distance = (1_000_000 - len(read(1)) * BYTE_NS) // 1000
    assert notes(bus)[-1][1:] == (ev.REPEATED, 1, (I.READ, distance))
