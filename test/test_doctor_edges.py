# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""
The thresholds of the doctor's rules, on both sides of the edge, and the words and figures told.

The cases are in doctor_edges.yaml, made by hand: what a bus must say to bring one about is in
test_doctor_evidence.py.
"""

from pathlib import Path

from doctor_case import asks
from doctor_case import cases_of
from doctor_case import claims
from doctor_case import device
from doctor_case import MODELS
from doctor_case import note
from doctor_case import NOW
from doctor_case import S
from doctor_case import speaks_from_its_edge_on
import pytest
import yaml

from msg_defs.diagnostics import Level
from msg_defs.dxl_instruction import Instruction as I
from rigs.tables import rows_of
from servobus.bus import evidence as ev
from servobus.bus.report import Counts
from servobus.bus.report import IdWrite
from servobus.doctor.bit_errors import TWO_SENDERS
from servobus.doctor.case import Case
from servobus.doctor.case import Sample
from servobus.doctor.facts import FACTORY
from servobus.model.control_table import Model

# --- what is just enough ---------------------------------------------------------------------

ENOUGH = [
    *cases_of('doctor_edges.yaml'),
    # and what differs in a figure only
    *(('voltage', {'level': level, 'devices': [device(registers={'Present Input Voltage': raw})]},
       f'its supply is near or {side} V from the factory: {remedy}',
       {'voltage (V)': f'{raw / 10:.1f}'}, [])
      for level, raw, side, remedy in (
          *((level, raw, 'below its limit of 6.0', 'charge the battery, check cable gauge and the '
             'load on the chain') for level, raw in (
              (Level.ERROR, 10), (Level.ERROR, 59), (Level.WARN, 60), (Level.WARN, 62))),
          *((level, raw, 'above its limit of 14.0', 'lower the supply voltage, or use a '
             'supply that takes the braking current') for level, raw in (
              (Level.WARN, 138), (Level.WARN, 140), (Level.ERROR, 141))))),
]


@pytest.mark.parametrize('row', ENOUGH, ids=[row[0] for row in ENOUGH])
def test_a_rule_speaks_from_its_edge_on(row):
    speaks_from_its_edge_on(*row)


@pytest.mark.parametrize(('number', 'firmware', 'is_told'), rows_of(
    Path(__file__).with_name('fast_reads.tsv')))
def test_the_firmware_from_which_on_fast_reads_are_known(number, firmware, is_told):
    number, firmware = (None if one == '-' else int(one) for one in (number, firmware))
    one = device(model_number=number, firmware=firmware, totals={'answers': 9})
    assert len(claims('fast_read_unsupported', cycles=(asks(I.FAST_SYNC_READ, 1),), devices=[one],
                      marks={10: {'totals': {1: Counts(answers=9)}}})) == (is_told == 'yes')


# Baud codes of Feetech, and what LeRobot takes them for (its tables, commit 7427f31).
LEROBOT_BAUDS = {4: None, 5: 57_600, 6: 38_400, 7: 19_200, 8: None}


@pytest.mark.parametrize('code', LEROBOT_BAUDS)
def test_the_baud_codes_that_lerobot_reads_differently(code):
    def told(model):
        return [one.message for one in claims(
            'baud_code', devices=[device(model=model)],
            notes=note(ev.BAUD_WRITTEN, ev.Written(code), 1))]

    found = told('STS3215')
    assert [f' {LEROBOT_BAUDS[code]} in LeRobot' in one for one in found] \
        == [True] * (LEROBOT_BAUDS[code] is not None)
    assert told('XL430-W250') == []


def test_a_servo_that_proves_to_be_of_another_model_has_no_baud_code(caplog):
    other = device()._replace(model=Model(None, 'unknown', protocol='feetech'))
    notes = note(ev.BAUD_WRITTEN, ev.Written(5), 1)
    assert claims('baud_code', devices=[other], notes=notes) == []
    assert caplog.messages == []


@pytest.mark.parametrize(('errors', 'registers', 'is_mode'), [
    ({(3, 11, 7): 1}, {}, True), ({}, {}, False), ({(3, 9, 7): 1}, {}, False),
    ({(3, 11, 6): 1}, {}, False), ({(3, 11, 7): 1}, {'Operating Mode': 4}, False)])
def test_goals_of_a_mode_that_was_refused_need_no_wider_limits(errors, registers, is_mode):
    [claim] = claims('goal_limits', devices=[device(errors=errors, registers=registers)],
                     notes=note(ev.REFUSED, ev.Refusal(3, 116, 6), 3))
    assert claim.message.endswith('those of another Operating Mode, of which the write was refused'
                                  if is_mode else 'set wider ones (as Max Position Limit)')


@pytest.mark.parametrize(('picture', 'asked', 'ids', 'says'), [
    (TWO_SENDERS, 5, (1,), 'its answers collide since 001 was given this ID'),
    (TWO_SENDERS, 5, (1, 2), 'a Write to all (ID 254) gave 001, 002 the ID 005'),
    (TWO_SENDERS, 6, (1,), None), ('interference', 5, (1,), None), (TWO_SENDERS, 5, (), None)])
def test_an_id_that_two_servos_were_given(monkeypatch, picture, asked, ids, says):
    monkeypatch.setattr(Case, 'damage_picture', lambda *_: {'looks like': picture})
    window = {'missed': 3, 'answers': asked - 3, 'spoilt': 3}
    found = claims('id_write', devices=[device(1), device(2), device(5, window=window)],
                   id_writes=(IdWrite(5, ids, NOW - 9 * S, -1),) if ids else ())
    assert [one.message.startswith(says) for one in found] == [True] * bool(says)


@pytest.mark.parametrize(('errors', 'found'), [({}, 1), ({(3, 11, 7): 1}, 0)])
def test_a_wheel_whose_mode_was_refused_is_in_another_one(errors, found):
    one = device(errors=errors, registers={'Present Velocity': 0}, written={'Goal Velocity': 99})
    assert len(claims('wheel_stopped', devices=[one])) == found


@pytest.mark.parametrize(('mode_s', 'is_told'), [(0.6, True), (0.5, False)])
def test_a_mode_that_was_written_after_the_goals_is_not_theirs(mode_s, is_told):
    one = device(registers={'Present Position': 5},
                 sent={'Goal Position': (120, 0.55), 'Operating Mode': (1, mode_s)})
    samples = [Sample(NOW - int(ago_s * S), goal, place, None, None) for ago_s, goal, place in (
        (1.05, 1000, 1000), (1, 100, 200), (0, 120, 206))]
    assert len(claims('operating_mode', devices=[one], samples={1: samples})) == is_told


@pytest.mark.parametrize('volts', [9, 63, 136])
def test_a_voltage_within_its_limits_is_none_to_tell(volts):
    assert claims('voltage', devices=[device(registers={'Present Input Voltage': volts})]) == []


@pytest.mark.parametrize(('volts', 'level'), [((62, 60, 138), Level.WARN),
                                              ((62, 59, 138), Level.ERROR)])
def test_three_that_are_near_a_limit_are_the_supply(volts, level):
    devices = [device(number, registers={'Present Input Voltage': raw})
               for number, raw in enumerate(volts, 1)]
    assert [one.device for one in claims('voltage', devices=devices[:2])] == [1, 2]
    found = claims('voltage', devices=devices)[-1]
    assert (found.device, found.level, found.evidence) == (
        None, level, (('devices', '001, 002, 003'),))
    assert found.message.startswith('3 devices near or beyond a voltage limit')


# Initial values of Temperature Limit (°C), Min and Max Voltage Limit (V), e-Manual.


@pytest.mark.parametrize(('model', 'limits'), yaml.safe_load(
    Path(__file__).with_name('factory_limits.yaml').read_text()).items())
def test_the_limits_from_the_factory(model, limits):
    number = model if isinstance(model, int) else MODELS.by_name(model).number
    assert FACTORY[number] == tuple(limits)
