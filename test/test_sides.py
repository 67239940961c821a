# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""Sides: what is certain once it is known who put which bytes on the wire."""

from hypothesis import given
from hypothesis import settings
from hypothesis import strategies as st
import pytest

from msg_defs.dxl_packet import encode
from msg_defs.dxl_packet import STATUS
from msg_defs.event import BAUD
from msg_defs.event import Change
from msg_defs.event import IN
from msg_defs.event import LATENCY_TIMER
from msg_defs.event import NOT_SENT
from msg_defs.event import OUT
from msg_defs.event import OVERRUN
from msg_defs.event import UNKNOWN
from servobus.bus.expected_devices import parse_all
from servobus.model.models import Models
from servobus.monitor import Monitor
from servobus.monitor import Settings

MODELS = Models()
RATE = 1_000_000
S = 1_000_000_000
MS = 1_000_000
FEW_EXAMPLES = settings(max_examples=60)
PING_1 = encode(1, 1)
PONG_1 = encode(1, STATUS, b'\x41\x01\x2d', error=0)
READ_1 = encode(1, 2, b'\x84\x00\x04\x00')
ANSWER_1 = encode(1, STATUS, b'\x00\x08\x00\x00', error=0)


def monitor(devices=('1:MX-106',), baud=RATE):
    return Monitor('bus', MODELS, Settings(baud=baud, devices=tuple(parse_all(list(devices)))))


@given(chunks=st.lists(st.tuples(st.sampled_from((OUT, IN, UNKNOWN)), st.one_of(
    st.binary(min_size=1, max_size=40), st.sampled_from((PING_1, PONG_1, READ_1, ANSWER_1))))),
    gap_ms=st.integers(0, 30))
@FEW_EXAMPLES
def test_every_byte_is_in_one_counter_of_its_side(chunks, gap_ms):
    bus = monitor()
    stamp = S
    for side, data in chunks:
        bus.feed(data, stamp, side)
        stamp += gap_ms * MS
    for side, framer in bus.decoder.framers.items():
        assert framer.bytes == sum(len(data) for one, data in chunks if one == side)
        assert framer.packet_bytes + framer.noise_bytes + framer.pending == framer.bytes
    bus.report(stamp + S)


def test_rate_is_learned_and_begins_a_new_wire():
    bus = monitor(baud=0)
    bus.feed(READ_1, S, OUT)
    bus.feed(ANSWER_1, S + 5 * MS, IN)
    report = bus.report(S + 6 * MS)
    assert report.baud == 0
    assert 'bus_load' not in {metric.name for metric in report.metrics}
    bus.feed(READ_1[:7], S + 7 * MS, OUT)
    bus.change(Change(BAUD, RATE), S + 8 * MS)
    bus.feed(READ_1, S + 9 * MS, OUT)
    bus.feed(ANSWER_1, S + 11 * MS, IN)
    report = bus.report(S + 12 * MS)
    assert report.baud == RATE
    assert (report.counters['Noise Bytes'], report.counters['Packets']) == (7, 4)
    assert report.devices[0].totals.missed == 0
    assert bus.decoder.registry.byte_ns == 10_000


def test_line_errors_and_latency_timer_come_from_the_source():
    bus = monitor()
    assert bus.report(S).line_errors is None
    bus.change(Change(OVERRUN, 2), S)
    bus.change(Change(OVERRUN, 1), S)
    bus.change(Change(LATENCY_TIMER, 16), S)
    assert bus.report(S).line_errors.overrun == 3
    assert bus.decoder.idle_ns == 32 * MS


def test_latency_is_from_the_end_of_the_instruction_to_the_begin_of_the_answer():
    bus = monitor()
    for number in range(20):
        at = S + number * 10 * MS
        bus.feed(READ_1, at, OUT)
        bus.feed(ANSWER_1, at + (len(READ_1) + len(ANSWER_1)) * 10_000 + MS // 4, IN)
    latency = bus.report(S + 300 * MS).devices[0].latency
    assert latency.resolved == 1.0
    assert latency.total.p50 == pytest.approx(0.25, abs=0.01)


def examined(*events, turns=15):
    """Return what the doctor names after three seconds of this, five times a second."""
    bus = monitor()
    for turn in range(turns):
        stamp = S + turn * 200 * MS
        for number, (one, data) in enumerate(events):
            if isinstance(data, bytes):
                bus.feed(data, stamp + number * MS, one)
            else:
                bus.change(Change(one, data), stamp + number * MS)
        report = bus.report(stamp + 100 * MS)
    return report.findings


def findings(*events):
    return {one.rule for one in examined(*events)}


def test_the_doctor_uses_the_sides():
    exchange = (OUT, READ_1), (IN, ANSWER_1)
    assert findings(*exchange) == set()
    assert findings((OUT, READ_1), (IN, READ_1 + ANSWER_1)) == {'echo'}
    assert findings(*exchange, (IN, PING_1), (IN, PONG_1)) == {'two_masters'}


def test_instructions_that_never_left_are_named():
    events = (OUT, READ_1), (NOT_SENT, 14), (OUT, PING_1), (IN, PONG_1)
    assert examined(*events, turns=2) == ()
    [found] = examined(*events)
    assert (found.rule, found.device) == ('not_sent', None)
    assert found.message.startswith('15 instructions never left the adapter: ')
    assert found.evidence == (('instructions', '15'), ('to', '001'))
