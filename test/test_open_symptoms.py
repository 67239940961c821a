# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""What no rule accounts for at the end of a run: not sure, the step that decides, code 3."""

from doctor_case import case
from doctor_case import device
from doctor_case import note
from doctor_case import NOW
import pytest

from msg_defs.diagnostics import Level
from servobus.bus import evidence as ev
from servobus.bus import report as words
from servobus.bus.report import Finding
from servobus.bus.report import Wait
from servobus.doctor.finding_log import BusSummary
from servobus.doctor.finding_log import LoggedFinding
from servobus.doctor.open_symptoms import open_symptoms
from servobus.tools.doctor.answer_screen import screen
from servobus.tools.doctor.verdict import as_json
from servobus.tools.doctor.verdict import ERROR
from servobus.tools.doctor.verdict import make_verdict
from servobus.tools.doctor.verdict import Trouble
from servobus.tools.doctor.verdict import WARNING
from servobus.tools.doctor.verdict import WELL

HEARD = {'Bytes': 10_000, 'Packets': 1000}


def used(missed, answers=97, number=1, **other):
    return device(number, totals={'answers': answers, 'missed': missed, 'reads': 50}, **other)


def never_heard(number, level=Level.WARN):
    return device(number, state=words.ASKED, level=level, last_heard_s=None,
                  message='asked, but never heard')


def heard(*devices, counters=(), **parts):
    return case(*devices, counters=HEARD | dict(counters), **parts).report


def kinds(**counts):
    return {getattr(ev, name): count for name, count in counts.items()}


LATE = note(ev.LATE, ev.Lateness(3000), 3)
# A bus, who is meant, what is said of it, and how the step begins.
OPEN = [
    (heard(used(3)), 1, '3 of 100 answers missed: a loose plug, or a second program',
     'stop all other programs (`fuser -v PORT`)'),
    (heard(used(3), has_sides=True, waits=(Wait(NOW, 4000, 1, False),)), 1,
     '3 of 100 answers missed: a time-out of 4 ms that is too short, or a loose plug',
     'raise the time-out to 50 ms'),
    (heard(used(3), has_sides=True, waits=(Wait(NOW, 40_000, 1, False),)), 1,
     '3 of 100 answers missed: a loose plug, or a servo that is busy or restarts',
     'swap its cable with another servo'),
    (heard(used(0), never_heard(2)), 2,
     'asked, but never heard: no power, a bad cable, or another ID or baud rate',
     'unplug all but 002 and ping it'),
    (heard(never_heard(1), never_heard(2), has_sides=True), None,
     'none of 2 devices answers: no power, or another baud rate, protocol or IDs',
     'measure the supply at the plug of the first servo'),
    (heard(never_heard(1), never_heard(2)), None,
     'none of 2 devices answers: no power, another baud rate, or only the master is heard here',
     'listen with `dxl_doctor run -- COMMAND`'),
    (heard(counters={'Packets': 0, 'Bytes': 63}), None,
     '63 bytes, but no packet: too few to know Protocol 1.0 or Feetech by, or no servo bus',
     'add --protocol 1 or --protocol feetech'),
    (heard(counters={'Packets': 0, 'Bytes': 64}), None,
     '64 bytes, but no packet: another baud rate, D+ and D- swapped, or no servo bus',
     'listen with `dxl_doctor run -- COMMAND`'),
    (heard(kinds=kinds(UNKNOWN_INSTRUCTION=3)), None,
     '3 instructions of an unknown kind, no answer: an instruction that these servos do not have, '
     'or no power', 'ping one servo'),
    (heard(used(0), kinds=kinds(DAMAGED_STATUS=3, CUT=2)), None,
     '5 packets damaged: interference, or a second program', 'stop all other programs'),
    (heard(used(0), kinds=kinds(DAMAGED_STATUS=5), has_sides=True), None,
     '5 packets damaged: interference, or two devices with one ID',
     'read one servo after the other with its motor off'),
    (heard(used(0), counters={'Noise Bytes': 500}), None,
     '500 of 10000 bytes are no packet: packets that are wrong, text, or another baud rate now '
     'and then', 'look at them: `dxl_dump PORT`'),
    (heard(used(0), level=Level.WARN, message='2 damaged packets per second'), None,
     '2 damaged packets per second', 'listen for longer'),
]
SOUND = [
    heard(used(0)), heard(used(2)), heard(used(3, 1000)),       # as few are lost on a sound bus
    heard(used(3), incidents=tuple(LATE)),                      # they came, a little late
    heard(used(3), incidents=tuple(note(ev.REBOOTED, ev.NoDetail(), 1))),      # it was told to
    heard(used(3), tried=frozenset(range(4))),                  # it tries one rate after the other
    heard(used(0), never_heard(2, Level.STALE)),                # an ID of a search
    heard(used(3, 0)),                                          # that too: nothing was ever there
    heard(used(0), kinds=kinds(DAMAGED_STATUS=4)),
    heard(used(0), kinds=kinds(DAMAGED_STATUS=5), counters={'Packets': 6000}),
    heard(used(0), kinds=kinds(UNKNOWN_INSTRUCTION=90)),        # a vendor's own, and all is read
    heard(used(0), counters={'Noise Bytes': 499}),
    heard(counters={'Bytes': 0, 'Packets': 0}),
    heard(used(0), device(2, state=words.WAITING, level=Level.WARN, waiting_behind=1)),
]


@pytest.mark.parametrize(('report', 'whom', 'says', 'step'), OPEN, ids=[row[2] for row in OPEN])
def test_what_no_rule_accounts_for_has_its_causes_and_a_step(report, whom, says, step):
    [found] = open_symptoms(report, ())
    assert (found.device, found.message) == (whom, says)
    assert found.step.startswith(step)
    verdict = make_verdict('bus.txt', [BusSummary('', report, ())], 10, True)
    assert (verdict.code, verdict.wrong, len(verdict.not_sure)) == (WARNING, [], 1)


@pytest.mark.parametrize('report', SOUND)
def test_a_sound_bus_is_not_doubted(report):
    assert open_symptoms(report, ()) == []
    verdict = make_verdict('bus.txt', [BusSummary('', report, ())], 10, True)
    assert (verdict.code, verdict.not_sure) == (WELL, [])
    assert 'Nothing wrong that listening can find' in screen(verdict)


@pytest.mark.parametrize(('rule', 'level', 'whom', 'covers', 'is_open'), [
    ('dropout', Level.WARN, 1, (), False), ('dropout', Level.WARN, 2, (), True),
    ('late_answers', Level.WARN, 2, (1,), False), ('noise', Level.WARN, None, (), False),
    ('stray_bytes', Level.OK, None, (), True), ('too_hot', Level.ERROR, 2, (), False)])
def test_what_a_finding_accounts_for_is_not_open(rule, level, whom, covers, is_open):
    found = Finding(rule, level, whom, 'words', covers=covers)
    assert bool(open_symptoms(heard(used(3), used(0, number=2)), [found])) is is_open


# --- in the answer -----------------------------------------------------------------------------

OVERLAP = Finding('noise', Level.OK, None, 'packets overlap: two programs, or one is hasty',
                  step='stop all other programs (`fuser -v PORT`) and listen again: then wait '
                  'for each answer before the next question is sent, and look once more')
UNKNOWN = Finding('too_hot', Level.OK, 1, 'Temperature Limit never read')


def verdict_of(report, *findings, source='/dev/ttyUSB3'):
    logged = tuple(LoggedFinding(one, 0.0, 1.0, True) for one in findings)
    return make_verdict(source, [BusSummary('', report, logged)], 10, True)


def test_a_doubt_with_a_step_is_not_sure_and_one_without_is_information():
    report = heard(used(0), doubts=(OVERLAP, UNKNOWN))
    verdict = verdict_of(report)
    [point] = verdict.not_sure
    assert (verdict.code, point.who, point.rule) == (WARNING, 'the bus', 'noise')
    assert '(`fuser -v /dev/ttyUSB3`)' in point.step
    assert verdict.unknown == ['too hot, 001, XL430-W250: Temperature Limit never read']
    assert as_json(verdict, [], 10)['not_sure'] == [point]
    assert verdict_of(report._replace(doubts=(UNKNOWN,))).code == WELL


def test_where_something_fails_for_sure_the_doubts_follow_from_it():
    dead = Finding('no_answer', Level.ERROR, 2, 'no answer')
    verdict = verdict_of(heard(used(3), doubts=(OVERLAP,)), dead)
    assert (verdict.code, verdict.not_sure, len(verdict.unknown)) == (ERROR, [], 1)


def test_what_a_warning_accounts_for_is_no_doubt_any_more():
    foreign = Finding('foreign_answers', Level.WARN, 3, 'another master')
    verdict = verdict_of(heard(used(0), doubts=(OVERLAP, UNKNOWN)), foreign)
    assert (verdict.code, verdict.not_sure, len(verdict.unknown)) == (WARNING, [], 1)
    assert 'packets overlap' not in verdict.unknown[0]


@pytest.mark.parametrize(('findings', 'is_open', 'text'), [
    ((), True, 'KeyError: 3'),
    ((Finding('stray_bytes', Level.OK, None, 'advice'),), True, 'KeyError: 3'),
    ((Finding('dropout', Level.WARN, 1, 'no answers'),), False, 'KeyError: 3'),
    ((), False, "ValueError: Some motors have the same min and max values: ['gripper']")])
def test_an_error_of_a_servo_library_that_nothing_accounts_for_has_a_step(findings, is_open,
                                                                          text):
    error = Trouble(Level.WARN, 'the program', '', f'it ended with {text}', '')
    logged = tuple(LoggedFinding(one, 0.0, 1.0, True) for one in findings)
    verdict = make_verdict('x', [BusSummary('', heard(used(0)), logged)], 10, True, ended=error)
    assert [one.who for one in verdict.not_sure] == ['the program'] * is_open
    assert error in verdict.wrong and verdict.code == WARNING


@pytest.mark.parametrize('width', [40, 80])
@pytest.mark.parametrize('warnings', range(5))
def test_the_next_step_is_never_cut(width, warnings):
    some = [Finding('dropout', Level.WARN, number, f'{"words " * 40}{number}', (('a', 'b'),))
            for number in range(2, 2 + warnings)]
    lines = screen(verdict_of(heard(*[used(0, number=number) for number in range(1, 7)],
                                    doubts=(OVERLAP, UNKNOWN)), *some), width=width)
    text = ' '.join(' '.join(lines).split())
    assert 'Not sure:' in lines and ('Wrong:' in lines) == bool(warnings)
    assert f'Try: {OVERLAP.step.replace("PORT", "/dev/ttyUSB3")}' in text
    assert len(lines) < 24 and max(map(len, lines)) <= width


def test_advice_comes_after_what_is_not_sure():
    advice = Finding('stray_bytes', Level.OK, None, 'add bias resistors')
    lines = screen(verdict_of(heard(used(0), doubts=(OVERLAP,)), advice))
    assert lines.index('Not sure:') < lines.index('Advice, no error:')
    assert not any('Nothing wrong' in line for line in lines)
