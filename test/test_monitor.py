# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""A bus over time: states, levels and words, rates, idle lines; against the simulated truth."""

from dataclasses import replace
from pathlib import Path
import struct

from heard_bus import Bus
from heard_bus import MODELS
from heard_bus import MS
from heard_bus import PING
from heard_bus import PONG
from heard_bus import READ
from heard_bus import REPLY
from heard_bus import SECOND
import pytest
from tracked_bus import packets
import yaml

from msg_defs import dxl1_packet
from msg_defs.diagnostics import Level
from msg_defs.dxl_instruction import Instruction as I
from msg_defs.dxl_packet import encode
from msg_defs.dxl_packet import STATUS
from msg_defs.event import Change
from msg_defs.event import IN
from msg_defs.event import OUT
from msg_defs.event import UNKNOWN
from servobus import internal_fault
from servobus.bus.decoder import BusDecoder
from servobus.bus.decoder import Settings
from servobus.bus.expected_devices import parse_all
from servobus.bus.tracker import Tracker
from servobus.doctor import rules
from servobus.monitor import Monitor

HEARD = yaml.safe_load(Path(__file__).with_name('monitor.yaml').read_text(encoding='utf-8'))


LISTED = {'errors': 'text', 'findings': 'rule', 'incidents': 'kind', 'doubts': 'message'}


def hear(bus, entry):
    what, *words = entry.split()
    if what == 'wait':
        bus.wait(float(words[0]))
    elif what == 'every':
        bus.every_ms = float(words[0])
    elif what == 'reset':
        bus.monitor.reset_statistics(bus.now)
    elif what == 'change':
        bus.wait(bus.every_ms / 1000)
        bus.monitor.change(Change(words[0], int(words[1])), bus.now)
    elif what in (IN, OUT):
        bus.wait(bus.every_ms / 1000)
        bus.monitor.feed(*packets(' '.join(words)), bus.now, what)
    else:
        bus.hear(*packets(entry))


def known(bus, key):
    what, _, number = key.rpartition(' ')
    report = bus.report()
    if number.isdigit():
        device = bus.device(int(number))
        found = getattr(device if hasattr(device, what) else device.totals, what)
    elif key == 'alarms':
        return bus.monitor.alarms()
    else:
        found = getattr(report, key) if hasattr(report, key) else {
            **dict.fromkeys([key], 0), **report.counters, **report.kinds}[key]
    if isinstance(found, Level):
        return found.name
    if isinstance(found, tuple):
        return [getattr(one, LISTED[key]) if key in LISTED else one.field.name for one in found]
    return found


@pytest.mark.parametrize('name', HEARD)
def test_what_is_heard_and_reported(name):
    bus = Bus()
    for step in HEARD[name]:
        if isinstance(step, list):
            for entry in step:
                hear(bus, entry)
        elif 'listed' in step:
            bus = Bus(*parse_all(step['listed']), baud=step.get('baud', 2_000_000))
        else:
            assert {key: known(bus, key) for key in step} == step


@pytest.mark.parametrize('cut', range(1, len(REPLY)))
def test_a_pause_in_delivery_costs_no_answer(cut):
    bus = Bus()
    bus.hear(PING, PONG, READ, REPLY[:cut])
    bus.now += bus.monitor.decoder.idle_ns + 1
    bus.monitor.flush_if_idle(bus.now)                 # a reader that sees an idle line
    bus.hear(REPLY[cut:] + READ, every_ms=40)
    bus.hear(REPLY)
    counters = bus.report().counters
    assert (counters['Packets'], counters['Noise Bytes'], counters['Truncated Packets']) == (
        6, 0, 0)
    assert (bus.device().totals.answers, bus.device().totals.missed) == (3, 0)


class Tapped(Bus):
    """A bus with a tap that says when nothing came; it can be stopped, and then bytes wait."""

    def __init__(self, **limits):
        super().__init__(**limits)
        self.monitor = Monitor('arm', MODELS, Settings(
            silent_after=limits.get('silent_after', 5.0)), idle_is_told=True)

    def listen(self, seconds):
        end = self.now + int(seconds * SECOND)
        while self.now < end:
            self.now = min(end, self.now + SECOND // 4)
            self.monitor.flush_if_idle(self.now)


def test_what_waited_while_we_were_stopped_is_not_cut_in_two():
    bus = Tapped()
    bus.hear(PING, PONG, READ[:9])
    bus.wait(10)                               # stopped; a report may be the first to run again
    assert bus.report().counters['Pending Bytes'] == 9
    bus.hear(READ[9:] + REPLY)
    counters = bus.report().counters
    assert (counters['Packets'], counters['Noise Bytes'], counters['Truncated Packets']) == (
        4, 0, 0)
    assert bus.device().totals.missed == 0


def test_an_answer_that_waited_while_we_were_stopped_is_not_missed():
    bus = Tapped()
    bus.hear(PING, PONG, READ)
    bus.wait(10)
    assert bus.device().totals.missed == 0
    bus.hear(REPLY)
    assert (bus.device().totals.answers, bus.device().totals.missed) == (2, 0)


def test_time_that_we_did_not_listen_is_no_silence():
    bus = Tapped()
    ping_2, pong_2 = encode(2, I.PING), encode(2, STATUS, b'\x37\x01\x29', error=0)
    bus.hear(PING, PONG, ping_2, pong_2)
    bus.wait(60)
    assert [one.state for one in bus.report().devices] == ['connected'] * 2
    bus.hear(PING, PONG)                       # device 2 was not among what waited
    assert [one.state for one in bus.report().devices] == ['connected'] * 2
    bus.listen(4.5)
    assert [one.state for one in bus.report().devices] == ['connected'] * 2
    bus.listen(1)
    assert [one.state for one in bus.report().devices] == ['silent'] * 2
    assert bus.device().last_heard_s == pytest.approx(5.5)


def test_while_nobody_listens_and_nobody_was_stopped_devices_are_silent():
    """The port is lost, or what reads it hangs: then what is known is old."""
    bus = Tapped()
    bus.hear(PING, PONG)
    bus.wait(6)
    assert bus.monitor.report(bus.now, is_listening=False).devices[0].state == 'silent'


def test_the_idle_time_is_that_of_the_design():
    assert BusDecoder(MODELS, Settings(baud=2_000_000)).idle_ns == 20 * MS
    assert BusDecoder(MODELS, Settings(latency_timer_ms=16)).idle_ns == 32 * MS
    assert BusDecoder(MODELS, Settings(baud=9_600)).idle_ns == 20 * 10 * SECOND // 9_600


def test_rates_and_load():
    bus = Bus(baud=1_000_000)
    chunk = READ + REPLY
    for _ in range(3_000):
        bus.hear(chunk)
    report = bus.report()
    values = {metric.name: metric for metric in report.metrics}
    assert report.rates['bytes'] == pytest.approx(1000 * len(chunk), rel=0.01)
    assert values['packet_rate'].value == pytest.approx(2000, rel=0.01)
    assert values['bus_load'].value == pytest.approx(len(chunk), rel=0.01)
    between = values['time_between_buffers'].window
    assert between.p50 == pytest.approx(1.0, rel=0.03)


def test_no_counter_is_below_zero_after_a_reset():
    bus = Bus()
    bus.hear(PING, PONG, PONG, READ, REPLY, *[encode(7, STATUS, error=0)] * 3, encode(1, 0x8B),
             b'\x01\x02', READ[:9])
    before = bus.report()
    assert before.counters['Unasked Answers'] == 4
    bus.hear(READ[9:] + READ[:9])
    bus.monitor.reset_statistics(bus.now)
    report = bus.report()
    assert {name: count for name, count in report.counters.items() if count} == {
        'Bytes': 9, 'Pending Bytes': 9}
    assert [(one.totals.reads, one.totals.writes) for one in report.devices] == [(0, 0), (0, 0)]
    bus.hear(READ[9:])
    report = bus.report()
    assert {name: count for name, count in report.counters.items() if count} == {
        'Bytes': len(READ), 'Packet Bytes': len(READ), 'Packets': 1, 'Instructions': 1}
    assert report.devices[0].totals.reads == 1
    assert not report.kinds.get('unasked answer')


def test_after_a_reset_the_doctor_does_not_count_back():
    bus = Bus()
    bus.hear(PING, PONG)
    bus.report()
    bus.monitor.reset_statistics(bus.now)
    bus.hear(*[READ, REPLY] * 5)
    bus.report()
    marks = bus.monitor.doctor._history._marks
    assert [mark.packets for mark in marks] == [10]


def test_a_report_is_not_touched_by_what_comes_later():
    bus = Bus()
    bus.hear(PING, PONG, READ, REPLY)
    report = bus.report()
    before = repr(report)
    bus.hear(READ, encode(1, STATUS, b'\x01\x02\x03\x04', error=0), READ, READ)
    assert repr(report) == before


# --- what once raised ---------------------------------------------------------------------------

LONG = encode(1, I.READ, struct.pack('<HH', 0, 252)), encode(1, STATUS, bytes(252), error=0)
SERVO = 8 * [(dxl1_packet.encode(1, I.PING), OUT), (dxl1_packet.encode(1, 0), IN)]


@pytest.mark.parametrize(('said', 'protocol'), [
    pytest.param(20 * [(LONG[0], ''), (LONG[1], '')] + [(b'\0' + LONG[0], ''), (LONG[1], '')] * 20,
                 'auto', id='noise where 252 bytes are read again and again'),
    pytest.param([(b'\xff\xff\1\2\x93\x69', '')] * 3, '1', id='Bulk Write of Protocol 1.0'),
    pytest.param([*SERVO, (dxl1_packet.encode(1, STATUS), OUT)], 'auto', id='0x55 as instruction'),
    pytest.param([*SERVO, (dxl1_packet.encode(1, I.READ, b'\1\1'), OUT),
                  (dxl1_packet.encode(1, STATUS), OUT)], 'auto', id='0x55 behind a Read'),
    pytest.param([*SERVO, (dxl1_packet.encode(1, I.READ, b'\1'), OUT),
                  (dxl1_packet.encode(1, 0, b'\1\2'), IN)], 'auto', id='Read without a size'),
])
def test_nothing_on_the_wire_raises(said, protocol):
    bus = Bus(protocol=protocol)
    for data, side in said:
        bus.now += 20 * MS
        bus.monitor.feed(data, bus.now, side or UNKNOWN)
        bus.report()
    bus.wait(2)
    counters = bus.report().counters
    assert counters['Bytes'] == sum(len(data) for data, _ in said)
    assert counters['Bytes'] == counters['Packet Bytes'] + counters['Noise Bytes']


def test_a_stamp_may_be_any():
    monitor = Monitor('arm', MODELS)
    for stamp in (1 << 62, 1 << 63, 1 << 80):
        monitor.feed(LONG[0] + LONG[1], stamp)
        [device] = monitor.report(stamp).devices
        assert device.totals.answers > 0


@pytest.fixture
def survives(monkeypatch):
    """Let the program survive a mistake of ours, as it does but in tests."""
    monkeypatch.setattr(internal_fault.LOG, 'handlers', [])
    monkeypatch.setattr(internal_fault, '_logged', set())


@pytest.mark.parametrize(('where', 'name'), [
    (Tracker, 'process_frames'), (BusDecoder, 'process_chunk'), (BusDecoder, 'process_pause')])
def test_a_mistake_of_ours_costs_no_byte_and_is_logged_once(survives, caplog, monkeypatch, where,
                                                           name):
    bus, calls, right = Bus(), [], getattr(where, name)

    def wrong(*arguments):
        calls.append(1)
        if 3 < len(calls) < 7:
            raise KeyError(name)
        return right(*arguments)

    monkeypatch.setattr(where, name, wrong)
    for _ in range(12):
        bus.hear(READ, every_ms=1500)
        bus.hear(REPLY)
    counters = bus.report().counters
    assert counters['Bytes'] == 12 * len(READ + REPLY)
    assert counters['Bytes'] == counters['Packet Bytes'] + counters['Noise Bytes']
    assert counters['Packets'] > 16
    assert [record.exc_info[0] for record in caplog.records] == [KeyError]


def test_a_rule_that_fails_is_left_out_and_logged_once(survives, caplog, monkeypatch):
    def wrong(case):
        raise IndexError('of this rule')
        yield

    monkeypatch.setattr(rules, 'RULES', tuple(
        replace(rule, check=wrong, each_device=False) if rule.name == 'duplicate_id' else rule
        for rule in rules.RULES))
    bus = Bus()
    for _ in range(30):
        bus.hear(READ, every_ms=100)
        bus.report()
    assert [one.rule for one in bus.report().findings] == ['no_answer']
    assert [record.exc_info[0] for record in caplog.records] == [IndexError]


def test_what_was_before_a_gap_is_not_of_the_last_10_s():
    bus = Bus()
    for _ in range(5):
        bus.hear(READ, READ, READ, READ)
        bus.wait(1)
    bus.wait(60)
    for _ in range(20):
        bus.hear(READ, REPLY)
    bus.wait(2)
    bus.hear(READ, REPLY)
    report = bus.report()
    assert bus.device().window.missed == 0
    assert report.rates['packets'] == pytest.approx(20, rel=0.01)
