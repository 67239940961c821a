# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""What the rules of the doctor conclude from, and what refutes them: one bus, few packets."""

from pathlib import Path
import struct

import pytest
from tracked_bus import GOAL
from tracked_bus import packets
from tracked_bus import read
from tracked_bus import reply
from tracked_bus import write
import yaml

from msg_defs.dxl1_packet import encode as encode_1
from msg_defs.dxl_instruction import Instruction as I
from msg_defs.dxl_packet import encode
from servobus.bus.decoder import Settings
from servobus.model.models import Models
from servobus.monitor import Monitor

MODELS = Models()
MS = 1_000_000
S = 1_000_000_000
HEARD = yaml.safe_load(Path(__file__).with_name('doctor_evidence.yaml').read_text(
    encoding='utf-8'))
MODEL = b'\x24\x04\x2e'          # an XL430-W250


def heard(chunks, every_ms=5.0, devices=3):
    """Return what is told of a bus on which devices have answered Pings, and then this is said."""
    monitor = Monitor('arm', MODELS, Settings())
    now = 100 * S
    pings = [one for number in range(1, devices + 1)
             for one in (encode(number, I.PING), reply(number, MODEL))]
    report = monitor.report(now)
    for chunk in [*pings, *chunks]:
        now += int(every_ms * MS)
        monitor.feed(chunk, now)
        if now - report.stamp >= S // 2:
            report = monitor.report(now)
    return monitor.report(now)


def names(report):
    return [(one.rule, one.device) for one in report.findings]


def chunks(entry):
    """Return what is said; a turn of the master has a read of each device."""
    times, _, turn = entry.partition(' x turn')
    if not turn and not entry.endswith(' x turn'):
        return packets(entry)
    silent, _, more = turn.removeprefix(' but').partition('; ')
    silent = [*map(int, silent.split())]
    return int(times) * ([one for number in (1, 2, 3) for one in (
        read(number), *[reply(number, bytes(4))] * (number not in silent))]
        + (packets(more) if more else []))


@pytest.mark.parametrize('name', HEARD)
def test_what_is_concluded(name):
    row = HEARD[name]
    report = heard([one for entry in row['heard'] for one in chunks(entry)],
                   row.get('every_ms', 5.0), row.get('devices', 3))
    found = [list(one) for one in names(report)]
    assert found == row['findings'] if 'findings' in row else found[0] == row['first']
    for finding in report.findings:
        assert finding.message.startswith(row.get('says', ''))
        assert {**dict(finding.evidence), **row.get('figures', {})} == dict(finding.evidence)


FEETECH = b'\x38\x02'          # a read


def mixed(of_2, of_1, what, turns=100):
    """Return turns of two loops on one bus, each over its devices."""
    return [*[one for number in of_2 for one in (read(number), reply(number, bytes(4)))],
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


def motion(count, *follow):
    """Return a loop that moves three goals; some devices follow."""
    said = []
    for step in range(count):
        place = struct.pack('<i', 10 * step)
        for number in (1, 2, 3):
            said += [write(number, GOAL, place), reply(number), read(number),
                     reply(number, place if number in follow else bytes(4))]
    return said


@pytest.mark.parametrize(('said', 'expected', 'words'), [
    (motion(90, 1, 3), [('torque_off', 2)], 'others do'),
    (motion(90, 1, 2, 3), [], ''),
    (motion(90), [], ''),                          # perhaps nothing shall move
    (motion(35, 1, 3), [], ''),                    # not for long enough
    (packets('read 2 64 1; reply 2 00') + motion(35), [('torque_off', 2)], 'its torque is off'),
    (packets('read 2 64 1; reply 2 01') + motion(35), [], ''),
])
def test_goals_that_move_and_a_position_that_stands(said, expected, words):
    report = heard(said)
    assert names(report) == expected
    assert all(words in one.message for one in report.findings)
