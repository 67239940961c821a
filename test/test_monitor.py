# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""A bus over time: states, levels and words, rates, idle lines; against the simulated truth."""

from itertools import pairwise
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

from dxl_monitor import doctor
from dxl_monitor.bus.decoder import BusDecoder
from dxl_monitor.bus.decoder import Settings
from dxl_monitor.bus.expected import Expected
from dxl_monitor.bus.tracker import Tracker
from dxl_monitor.monitor import Monitor
from mecarover_serial import internal_fault
from msg_defs import dxl1_packet
from msg_defs.dxl_instruction import Instruction as I
from msg_defs.dxl_packet import BROADCAST
from msg_defs.dxl_packet import encode
from msg_defs.dxl_packet import STATUS
from msg_defs.event import IN
from msg_defs.event import OUT
from msg_defs.event import UNKNOWN
from msg_defs.reports import Level

POSITIONS = encode(BROADCAST, I.SYNC_READ, struct.pack('<HH', 132, 4) + b'\x01\x02\x03')


def damaged(packet):
    return packet[:-1] + bytes([packet[-1] ^ 1])


def verdict(device):
    return device.state, device.level, device.message


def test_nothing_heard_yet():
    report = Bus().report()
    assert (report.level, report.message, report.devices) == (Level.STALE, 'nothing heard yet', ())
    assert report.counters['Bytes'] == 0


def test_connected():
    bus = Bus()
    bus.hear(PING, PONG, READ, REPLY)
    device = bus.device()
    assert verdict(device) == ('connected', Level.OK, 'connected')
    assert (device.name, device.model_name, device.firmware) == ('001', 'MX-64', 41)
    assert bus.report().message == '1 of 1 devices connected'


def test_asked_and_never_heard():
    bus = Bus()
    bus.hear(READ, READ)
    assert verdict(bus.device()) == ('asked', Level.WARN, 'asked, but never heard')


def test_silent_is_stale_and_keeps_its_values():
    bus = Bus()
    bus.hear(PING, PONG, READ, REPLY)
    bus.wait(8)
    device = bus.device()
    assert (device.state, device.level) == ('silent', Level.STALE)
    assert device.last_heard_s == pytest.approx(8.0)
    assert any(one.field.name == 'Present Position' for one in device.observed)


def test_waiting_behind_a_silent_one():
    bus = Bus()
    for number in (1, 2, 3):
        bus.hear(encode(number, I.PING), encode(number, STATUS, b'\x37\x01\x29', error=0))
    bus.hear(*[POSITIONS] * 8)
    assert bus.device(1).state == 'disconnected'
    for number in (2, 3):
        assert verdict(bus.device(number)) == (
            'waiting', Level.WARN, 'asked but not served: 001 before it does not answer')
    bus.hear(POSITIONS, *[encode(n, STATUS, bytes(4), error=0) for n in (1, 2, 3)])
    assert [bus.device(n).state for n in (1, 2, 3)] == ['connected'] * 3


def test_a_device_that_waited_is_silent_when_the_master_stops():
    bus = Bus()
    for number in (1, 2, 3):
        bus.hear(encode(number, I.PING), encode(number, STATUS, b'\x37\x01\x29', error=0))
    bus.hear(POSITIONS, encode(1, STATUS, bytes(4), error=0))       # and then no more, ever
    bus.wait(2)
    assert [bus.device(n).state for n in (2, 3)] == ['connected', 'waiting']
    bus.wait(8)
    assert [bus.device(n).state for n in (1, 2, 3)] == ['silent'] * 3


def test_loss_is_that_of_the_last_ten_seconds():
    bus = Bus()
    bus.hear(PING, PONG)
    bus.hear(*[READ, REPLY] * 20, READ, READ, REPLY)
    device = bus.device()
    assert (device.level, device.message) == (Level.WARN, '1 of 23 answers missed')
    bus.hear(*[READ, REPLY] * 60, every_ms=100)
    assert bus.device().level is Level.OK
    assert bus.device().totals.missed == 1


def test_moved_to_a_rate_that_its_model_does_not_name():
    bus = Bus()
    bus.hear(PING, PONG, encode(1, I.WRITE, b'\x08\0\x63'), encode(1, STATUS, error=0), PING)
    assert 'was set to an unknown baud rate (code 99)' in bus.device().message


def test_damage_is_told_by_device_and_by_bus():
    bus = Bus()
    bus.hear(PING, PONG)
    for _ in range(20):
        bus.hear(READ, damaged(REPLY), READ, REPLY)
    bus.wait(0.5)
    report = bus.report()
    assert report.devices[0].window.damaged == 20
    assert report.level is Level.WARN
    assert report.counters['CRC Errors'] == 20
    assert report.errors[-1].text == '001: no answer to Read at Present Position'
    assert '001: status with a wrong CRC' in {error.text for error in report.errors}


def test_what_cannot_wait_for_a_report():
    bus = Bus()
    bus.hear(PING, PONG, *[READ] * 4, every_ms=300)
    assert bus.monitor.alarms() == 0
    bus.hear(READ, READ, READ)
    lost = bus.monitor.alarms()
    assert lost == 1
    bus.hear(READ, REPLY)
    assert bus.monitor.alarms() == lost + 1
    bus.hear(READ, encode(1, STATUS, bytes(4), error=0x80), READ, REPLY)
    assert bus.monitor.alarms() == lost + 2


def test_errors_name_the_register_once_the_model_is_known():
    bus = Bus()
    bus.hear(READ, READ)
    assert bus.report().errors[-1].text == '001: no answer to Read at 132'
    bus.hear(PING, PONG, encode(1, I.WRITE, b'\x74\x00' + bytes(4)), encode(1, STATUS, error=7))
    assert bus.device().model_name == 'MX-64'
    assert [error.text for error in bus.report().errors] == [
        '001: no answer to Read at Present Position',
        '001: Write at Goal Position refused: Access']


def test_one_packet_of_protocol_1_is_counted_once():
    bus = Bus()
    packet = b'\xff\xff\x01\x04\x02\x24\x02\xd2'
    bus.hear(READ, packet[:3], packet[3:], *[b'\x00'] * 10, every_ms=1000)
    assert bus.report().kinds['protocol 1.0'] == 1
    bus.hear(packet * 3, *[b'\x00'] * 10, every_ms=1000)
    assert bus.report().kinds['protocol 1.0'] == 4


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


def test_cycles_tell_what_the_master_repeats():
    bus = Bus()
    bus.hear(*[READ, REPLY] * 10, PING, every_ms=5)
    cycle = bus.report().cycles[0]
    assert (cycle.instruction, cycle.ids, cycle.address, cycle.asked) == (I.READ, (1,), 132, 10)
    assert {after - before for before, after in pairwise(cycle.stamps)} == {10 * MS}
    assert bus.device().totals.reads == 10


def test_reset_statistics_keeps_what_is_known():
    bus = Bus()
    bus.hear(PING, PONG, *[READ, REPLY] * 5)
    bus.monitor.reset_statistics(bus.now)
    report = bus.report()
    assert report.counters['Packets'] == 0
    assert report.devices[0].totals.answers == 0
    assert report.devices[0].model_name == 'MX-64'
    assert report.devices[0].state == 'connected'
    bus.hear(READ, REPLY)
    assert bus.report().counters['Packets'] == 2


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


def test_a_bus_names_its_lost_devices():
    bus = Bus(Expected(1, 'MX-64', 'knee'), *(Expected(number) for number in range(2, 9)))
    bus.hear(encode(200, STATUS, error=0))
    report = bus.report()
    assert report.level is Level.WARN
    assert report.message.endswith('; lost: 001 knee, 002, 003, 004, 005 and 3 more')


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
    (Tracker, 'track'), (BusDecoder, 'hear'), (BusDecoder, 'pause')])
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

    monkeypatch.setattr(doctor, 'RULES', tuple(
        rule._replace(check=wrong, each=False) if rule.name == 'duplicate_id' else rule
        for rule in doctor.RULES))
    bus = Bus()
    for _ in range(30):
        bus.hear(READ, every_ms=100)
        bus.report()
    assert [one.rule for one in bus.report().findings] == ['no_answer']
    assert [record.exc_info[0] for record in caplog.records] == [IndexError]
