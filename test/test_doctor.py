# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""The doctor by itself: how claims stand, fall and hide others; docs/doctor.md has each."""

from dataclasses import replace
from pathlib import Path
import re
from typing import get_args

import heard_bus
from heard_bus import MODELS
from heard_bus import PING
from heard_bus import READ
from heard_bus import REPLY
import pytest

from msg_defs.diagnostics import Level
from msg_defs.dxl_packet import encode
from msg_defs.dxl_packet import STATUS
from servobus.doctor import Doctor
from servobus.doctor import RULES
from servobus.doctor import rules
from servobus.doctor.case import OPTIONS
from servobus.doctor.case import PARAMETERS
from servobus.doctor.rule import Claim
from servobus.doctor.rule import Doubt
from servobus.doctor.rule import Rule
from servobus.doctor.symptom import ContentSymptom
from servobus.doctor.symptom import TrafficSymptom
from servobus.monitor import Monitor

DOCS = Path(__file__).parents[1] / 'docs'
TRACE = Path(__file__).parents[2] / 'shared' / 'data' / 'bus_trace_head.bin'
S = 1_000_000_000


class Bus(heard_bus.Bus):
    every_ms = 10.0


# --- how claims stand ------------------------------------------------------------------------

def plain_report(stamp):
    return Monitor('arm', MODELS).report(stamp)


def with_rules(monkeypatch, *some):
    monkeypatch.setattr(rules, 'RULES', some)
    monkeypatch.setattr(rules, 'BY_NAME', {one.name: one for one in some})
    monkeypatch.setattr(rules, 'RANKS', {one.name: n for n, one in enumerate(some)})
    return Doctor()


def saying(*claims, until=1 << 60):
    def check(case):
        if case.now < until:
            yield from claims
    return check


def rule(name, check, *effects, level=Level.WARN, holds=True):
    return Rule({name}, {*effects}, level=level, holds=holds, name=name, check=check)


def names(report):
    return [(one.rule, one.device) for one in report.findings]


def test_a_claim_outlives_its_evidence_a_little(monkeypatch):
    doctor = with_rules(monkeypatch, rule('bad', saying(Claim('words'), until=2 * S)))
    seen = [bool(doctor.examine(plain_report(at * S)).findings) for at in range(1, 8)]
    assert seen == [True, True, True, True, False, False, False]


def test_what_needs_to_last_is_told_after_a_while(monkeypatch):
    slow = replace(rule('bad', saying(Claim('words'))), onset_s=2.0)
    doctor = with_rules(monkeypatch, slow)
    assert [bool(doctor.examine(plain_report(at * S)).findings) for at in range(1, 5)] \
        == [False, False, True, True]


def test_a_state_ends_with_the_state(monkeypatch):
    doctor = with_rules(monkeypatch, rule('bad', saying(Claim('words'), until=2 * S),
                                          holds=False))
    assert doctor.examine(plain_report(S)).findings
    assert not doctor.examine(plain_report(2 * S)).findings


@pytest.mark.parametrize(('cause', 'consequence', 'hidden'), [
    (Claim('a'), Claim('b', device=5), True),
    (Claim('a', device=5), Claim('b', device=5), True),
    (Claim('a', device=5), Claim('b'), True),
    (Claim('a', device=5), Claim('b', device=6), False),
    (Claim('a', device=5, covers=(5, 6)), Claim('b', device=6), True),
])
def test_a_cause_hides_its_consequence(monkeypatch, cause, consequence, hidden):
    doctor = with_rules(monkeypatch, rule('effect', saying(consequence)),
                        rule('cause', saying(cause), 'effect'))
    expected = [('cause', cause.device)] + [('effect', consequence.device)] * (not hidden)
    assert sorted(names(doctor.examine(plain_report(S))), key=str) == sorted(expected, key=str)


@pytest.mark.parametrize(('cause', 'level', 'hidden'), [
    (Claim('a'), Level.WARN, True),
    (Claim('a'), Level.OK, False),
    (Claim('a', device=5), Level.WARN, True),
    (Claim('a', device=6), Level.WARN, False),
    (Claim('a', device=6, covers=(5,)), Level.WARN, True),
])
def test_what_is_found_leaves_no_doubt_of_what_follows_from_it(monkeypatch, cause, level, hidden):
    doctor = with_rules(monkeypatch, rule('effect', saying(Doubt('b', 5))),
                        rule('cause', saying(cause), 'effect', level=level))
    doubts = doctor.examine(plain_report(S)).doubts
    assert [one.rule for one in doubts] == ['effect'] * (not hidden)


def test_the_worst_comes_first_and_is_the_message(monkeypatch):
    doctor = with_rules(monkeypatch, rule('some', saying(Claim('a warning'))),
                        rule('worse', saying(Claim('an error')), level=Level.ERROR))
    report = doctor.examine(plain_report(S))
    assert names(report) == [('worse', None), ('some', None)]
    assert report.message == 'an error'


# --- rules that no fault of the simulated bus makes true ---------------------------------------


@pytest.mark.parametrize(('identity', 'names', 'message'), [
    (b'', PARAMETERS, 'connected; model not known, so registers have no names and some causes '
     'cannot be found; add ID:MODEL to `devices`, or let your program ping the servos'),
    (b'', OPTIONS, 'connected; model not known, so registers have no names and some causes '
     'cannot be found; add ID:MODEL to --devices, or let your program ping the servos'),
    (b'\x67\x12\x01', PARAMETERS,
     'connected; model 4711 has no model file: add one to `model_dirs`'),
])
def test_a_device_whose_registers_have_no_names_says_so(identity, names, message):
    bus = Bus()
    bus.monitor = Monitor('arm', MODELS, names=names)
    bus.hear(*(PING, encode(1, STATUS, identity, error=0)) * bool(identity), *[READ, REPLY] * 200)
    report = bus.report()
    [device] = report.devices
    assert (device.level, device.message) == (Level.OK, message)
    assert report.message == ('1 of 1 devices connected; not all models known: '
                              f'set {names.devices}')


# --- what a user sees --------------------------------------------------------------------------

def test_the_robot_trace():
    if not TRACE.is_file():
        pytest.skip('skipped: the robot trace is not here')
    data = TRACE.read_bytes()
    bus = Bus()
    bus.hear(*(data[at:at + 400] for at in range(0, len(data), 400)), every_ms=2.0)
    assert set(names(bus.report())) == {('no_answer', 101), ('turnaround', None), ('noise', None)}


def test_the_page_has_every_rule_and_no_other():
    page = (DOCS / 'doctor.md').read_text(encoding='utf-8')
    rows = re.findall(r'^\| `(\w+)` ([A-Z]+)[^|]* \| [^| ][^|]* \| [^| ][^|]* \|$', page, re.M)
    assert sorted(rows) == sorted((one.name, one.level.name) for one in RULES)


def test_every_rule_states_its_symptoms():
    assert len(rules.BY_NAME) == len(RULES)
    known = {*get_args(TrafficSymptom), *get_args(ContentSymptom)}
    assert [one.name for one in RULES
            if not one.symptoms or not one.symptoms | one.accounts_for <= known] == []


def test_every_symptom_but_a_proof_is_accounted_for_by_another_rule():
    """A rule that says which symptoms it has is hidden by all that account for them."""
    for symptom in (*get_args(TrafficSymptom), *get_args(ContentSymptom)):
        having = {one.name for one in RULES if symptom in one.symptoms}
        accounting = {one.name for one in RULES if symptom in one.accounts_for}
        assert having, symptom
        assert bool(accounting - having) is (symptom != 'proof'), symptom


def test_no_two_findings_hide_each_other():
    assert [(one.name, other.name) for one in RULES for other in RULES if one is not other
            and one.symptoms <= other.accounts_for and other.symptoms <= one.accounts_for] == []
