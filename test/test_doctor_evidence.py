# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""What the rules of the doctor conclude from, and what refutes them: one bus, few packets."""

import struct

import pytest

from dxl_monitor.bus.decoder import Settings
from dxl_monitor.model.models import Models
from dxl_monitor.monitor import Monitor
from msg_defs.dxl1_packet import encode as encode_1
from msg_defs.dxl_instruction import Instruction as I
from msg_defs.dxl_packet import BROADCAST
from msg_defs.dxl_packet import encode
from msg_defs.dxl_packet import STATUS
from msg_defs.reports import Level

MODELS = Models()
MS = 1_000_000
S = 1_000_000_000
ACCESS = 7
TORQUE, VOLTAGE = 64, 144
GOAL, POSITION, MODEL = 116, 132, b'\x24\x04\x2e'          # an XL430-W250


def read(number, at=POSITION, size=4):
    return encode(number, I.READ, struct.pack('<HH', at, size))


def write(number, at, data):
    return encode(number, I.WRITE, struct.pack('<H', at) + data)


def says(number, data=b'', error=0):
    return encode(number, STATUS, data, error=error)


def heard(chunks, every_ms=5.0, devices=3):
    """Return what is told of a bus on which devices have answered Pings, and then this is said."""
    monitor = Monitor('arm', MODELS, Settings())
    now = 100 * S
    pings = [one for number in range(1, devices + 1)
             for one in (encode(number, I.PING), says(number, MODEL))]
    report = monitor.report(now)
    for chunk in [*pings, *chunks]:
        now += int(every_ms * MS)
        monitor.feed(chunk, now)
        if now - report.stamp >= S // 2:
            report = monitor.report(now)
    return monitor.report(now)


def names(report):
    return [(one.rule, one.device) for one in report.findings]


def around(*between, devices=3):
    """Return a turn of a loop over the devices, and something more."""
    return [one for number in range(1, devices + 1)
            for one in (read(number), says(number, bytes(4)))] + list(between)


# --- one cause of all, and those of each -----------------------------------------------------

def volts(*numbers):
    """Return reads of Present Input Voltage, 5.9 V."""
    return [one for number in numbers
            for one in (read(number, VOLTAGE, 2), says(number, b'\x3b\0'))]


def test_a_supply_that_is_low_for_all_is_told_of_the_bus_alone():
    assert names(heard(volts(1, 2, 3) * 4)) == [('voltage', None)]


# --- two at once -----------------------------------------------------------------------------

CLASH = b'\x40\x01\x08\x02\x00\x80\x04'        # what two answers at once leave: no header


def test_one_that_always_answers_once_more_behind_damage_is_two():
    turn = around(read(2), says(2, bytes(4)), CLASH, says(2, bytes(4)))
    assert names(heard(turn * 30))[0] == ('duplicate_id', 2)




def test_a_master_that_does_not_wait_is_no_dead_device():
    torn = says(3, bytes(4))[:9] + b'\x55\x55' + says(3, bytes(4))[11:]
    turn = around(read(1) + read(2) + read(1) + read(3), torn)
    assert names(heard(turn * 40)) == [('impatient_master', None)]


# --- what refutes ----------------------------------------------------------------------------

def test_who_answers_nothing_at_all_is_not_said_to_acknowledge_nothing():
    goal = write(2, GOAL, bytes(4))
    silent = around() * 10 + [read(2), goal, read(1), says(1, bytes(4))] * 120
    assert names(heard(silent)) == [('no_answer', 2)]
    only_writes = around() * 10 + around(goal) * 30
    assert ('no_acks', 2) in names(heard(only_writes))


def test_the_address_that_is_refused_most_is_told():
    refused = [read(1, 611), says(1, b'', ACCESS)]
    once = [read(1, 562), says(1, b'', ACCESS)]
    [finding] = heard((once + refused * 3) * 3).findings
    assert finding.message.startswith('address 611 refused 9 times')
    assert heard(once * 2).findings == ()


def test_a_ping_to_all_is_a_scan_and_too_many_are_told():
    ping = encode(BROADCAST, I.PING)
    answers = [says(number, MODEL) for number in (1, 2, 3)]
    assert heard([ping, *answers] * 14).findings == ()
    [finding] = heard([ping, *answers] * 15).findings
    assert (finding.rule, finding.level) == ('scan', Level.OK)
    assert 'collide' not in finding.message


DYNAMIXEL_1, FEETECH = b'\x24\x02', b'\x38\x02'          # reads of each


def mixed(of_2, of_1, what, turns=100):
    """Return turns of two loops on one bus, each over its devices."""
    return [*[one for number in of_2 for one in (read(number), says(number, bytes(4)))],
            *[one for number in of_1
              for one in (encode_1(number, I.READ, what), encode_1(number, 0, b'\0\2'))]] * turns


def test_questions_of_2_0_that_none_answers_do_not_make_a_bus_of_two_protocols():
    """A program that looks for servos asks in both protocols, once."""
    scan = [encode(number, I.PING) for number in range(10)]
    report = heard(scan + mixed((), (1, 2, 3), FEETECH, 400), devices=0)
    assert 'protocol_1' not in dict(names(report))


def test_two_protocols_are_told_no_longer_than_both_answer():
    gone = mixed((9,), (1, 2, 3), FEETECH) + mixed((), (1, 2, 3), FEETECH, 700)
    assert 'protocol_1' not in dict(names(heard(gone, devices=0)))


# --- what is refused -------------------------------------------------------------------------


def test_what_needs_the_model_is_not_said_without_it():
    assert names(heard([read(9, 611), says(9, b'', ACCESS)] * 3, devices=0)) == [('refused', 9)]


# --- away and back ---------------------------------------------------------------------------

def turns(count, *silent):
    """Return turns of a loop over three devices, some of which say nothing."""
    return [one for number in (1, 2, 3) for one in (read(number), says(number, bytes(4)))
            if number not in silent or one == read(number)] * count


def tells(number, at, *data):
    return [read(number, at, len(data)), says(number, bytes(data))]


def absence(before, after, *silent):
    """Return what is told of devices that were silent and are back for more than two seconds."""
    return names(heard([*turns(20), *before, *turns(30), *turns(10, *silent), *turns(2), *after,
                        *turns(90)]))


LOW, FULL = (0x46, 0), (0x78, 0)               # 7 V, 12 V


@pytest.mark.parametrize(('before', 'after', 'silent', 'expected'), [
    (tells(2, VOLTAGE, *LOW), tells(2, VOLTAGE, *FULL), (2, 3), [('brown_out', None)]),
    (tells(2, VOLTAGE, *FULL), tells(2, VOLTAGE, *FULL), (2, 3), [('dropout', 2), ('dropout', 3)]),
    (tells(2, TORQUE, 1), tells(2, TORQUE, 0), (2, 3), [('brown_out', None)]),
    (tells(2, VOLTAGE, *LOW), tells(2, VOLTAGE, *FULL), (2,), [('dropout', 2)]),
])
def test_a_supply_that_broke_down_shows_in_several(before, after, silent, expected):
    assert absence(before, after, *silent) == expected


@pytest.mark.parametrize(('third', 'expected'), [(0, ('brown_out', None)), (1, ('rebooted', 2))])
def test_one_that_waited_behind_another_may_have_restarted_too(third, expected):
    ask = encode(BROADCAST, I.SYNC_READ, struct.pack('<HH', POSITION, 4) + b'\x01\x02\x03')
    all_ = [ask, *(says(number, bytes(4)) for number in (1, 2, 3))]
    before = [one for number in (2, 3) for one in tells(number, TORQUE, 1)]
    after = [*tells(2, TORQUE, 0), *tells(3, TORQUE, third)]
    report = heard([*before, *all_ * 60, *[ask, says(1, bytes(4))] * 30, *all_ * 2, *after,
                    *all_ * 120])
    assert names(report)[:1] == [expected]


def motion(count, *follow):
    """Return a loop that moves three goals; some devices follow."""
    said = []
    for step in range(count):
        place = struct.pack('<i', 10 * step)
        for number in (1, 2, 3):
            said += [write(number, GOAL, place), says(number), read(number),
                     says(number, place if number in follow else bytes(4))]
    return said


@pytest.mark.parametrize(('said', 'expected', 'words'), [
    (motion(90, 1, 3), [('torque_off', 2)], 'others follow'),
    (motion(90, 1, 2, 3), [], ''),
    (motion(90), [], ''),                          # perhaps nothing shall move
    (motion(35, 1, 3), [], ''),                    # not for long enough
    (tells(2, TORQUE, 0) + motion(35), [('torque_off', 2)], 'its torque is off'),
    (tells(2, TORQUE, 1) + motion(35), [], ''),
])
def test_goals_that_move_and_a_position_that_stands(said, expected, words):
    report = heard(said)
    assert names(report) == expected
    assert all(words in one.message for one in report.findings)


def test_of_several_absences_the_longest_is_told():
    away = [*turns(20), *turns(10, 2), *turns(20), *turns(20, 2), *turns(20), *turns(12, 2)]
    [finding] = heard([*away, *turns(90)]).findings
    assert (finding.rule, dict(finding.evidence)) == (
        'dropout', {'absences': '3', 'longest (ms)': '530'})


# --- how much it takes -----------------------------------------------------------------------


@pytest.mark.parametrize(('value', 'expected'), [
    (b'\xff', [('watchdog', 2)]), (b'\xfe', []), (b'\x32', []), (b'\0', [])])
def test_a_watchdog_that_tripped_reads_minus_1(value, expected):
    assert names(heard([read(2, 98, 1), says(2, value)])) == expected


RENAMES = [write(2, TORQUE, b'\0'), says(2), write(2, 7, b'\x05')]


@pytest.mark.parametrize(('acknowledges', 'asked', 'expected'), [
    (5, read(2), [('id_moved', 2)]),
    (2, encode(2, I.PING), []),                    # a search
    (2, read(5) + says(5, bytes(4)), []),          # the new ID is used
])
def test_an_id_that_was_written_and_is_still_asked(acknowledges, asked, expected):
    said = [*RENAMES, says(acknowledges), *around(asked, devices=1) * 4]
    assert names(heard(said, 40.0)) == expected
