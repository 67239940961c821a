# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""What the doctor keeps from report to report: of a silent bus, of damage."""


from doctor_case import asks
from doctor_case import case
from doctor_case import device
from doctor_case import note
from doctor_case import NOW
from doctor_case import S
import pytest

from msg_defs.dxl_instruction import Instruction as I
from msg_defs.dxl_packet import encode
from msg_defs.dxl_packet import STATUS
from servobus.bus import evidence as ev
from servobus.bus import report as words
from servobus.doctor import Doctor
from servobus.doctor import RULES
from servobus.doctor.case import History

LOST = tuple(note(ev.SOURCE_LOST, ev.Count(3), 1))
MANY_LOST = '3 bytes or events were lost'


def silent(pause_s=1.0, last_byte_s=1.0, **parts):
    """Return a report of a bus on which the master asked so long ago."""
    return case(*parts.pop('devices', ()), **{
        'asked': NOW - int(pause_s * S), 'last_byte_s': last_byte_s, **parts}).report


def doubts(report):
    return [one.message.partition(':')[0] for one in report.doubts]


# --- a bus on which nothing happens any more ---------------------------------------------------

def test_what_was_not_heard_is_told_of_a_bus_that_was_silent_from_the_first_report_on():
    assert [one[:15] for one in doubts(Doctor().examine(silent(incidents=LOST)))] \
        == [MANY_LOST[:15]]
    assert doubts(Doctor().examine(silent())) == []


def test_the_doubts_of_a_bus_stand_while_it_is_silent():
    doctor = Doctor()
    unknown = device(9, '')
    first = doctor.examine(silent(0.0, devices=[unknown]))
    assert doubts(first) == ['009']
    later = doctor.examine(silent(0.0, devices=[unknown], stamp=NOW + S))
    assert doubts(later) == ['009']


@pytest.mark.parametrize(('last_byte_s', 'is_judged'), [(0.5, True), (0.51, False), (None, True)])
def test_a_bus_is_judged_while_there_are_bytes(last_byte_s, is_judged):
    wrong = device(moved_to='57600 Bd')
    found = Doctor().examine(silent(last_byte_s=last_byte_s, devices=[wrong]))
    assert [one.rule for one in found.findings] == ['baud_moved'] * is_judged


def test_the_states_end_with_the_state():
    assert {one.name for one in RULES if not one.holds} == {
        'baud_moved', 'id_moved', 'id_write', 'hardware_error', 'all_silent', 'broken_cable',
        'sync_read_stops', 'no_answer', 'master_stopped', 'scan', 'no_acks'}
    assert {one.name: one.onset_s for one in RULES if one.onset_s} == {
        'two_masters': 1.0, 'jitter': 3.0, 'damaged_answers': 1.0, 'wrong_supply': 3.0,
        'cycle_time': 1.0, 'no_acks': 1.0, 'wheel_stopped': 1.5}


def test_a_port_that_is_closed_hears_no_master_and_says_nothing_of_it():
    doctor, cycles = Doctor(), [asks(I.READ, 1, stamps=(NOW - 50 * S, NOW - 30 * S))]
    assert [[one.rule for one in doctor.examine(
                silent(30.0, 30.0, deaf=deaf, cycles=cycles)).findings]
            for deaf in (0, NOW, NOW - S, NOW - 2 * S)] == [
                ['master_stopped'], [], [], ['master_stopped']]


# --- what is remembered of damage --------------------------------------------------------------

WRONG = bytearray(encode(3, STATUS, bytes((0, 8, 0, 0)), error=0))
WRONG[5] ^= 4


def noisy(count, seconds=0.0, noise=bytes(WRONG)):
    return case(cycles=(asks(I.READ, 3),), protocol=words.PROTOCOL_2, noise=noise,
                counters={'Noise Bytes': count}, stamp=NOW + int(seconds * S)).report


def test_a_wreck_is_looked_at_once_and_forgotten_after_ten_seconds():
    history = History()
    size = len(WRONG)
    assert [len(history.make_case(noisy(count, seconds)).damaged_packets) for count, seconds in (
        (size, 0), (size, 1), (2 * size, 2), (2 * size + 1, 3), (2 * size + 1, 10),
        (2 * size + 1, 10.001), (2 * size + 1, 12), (2 * size + 1, 12.001))] \
        == [1, 1, 2, 2, 2, 1, 1, 0]
