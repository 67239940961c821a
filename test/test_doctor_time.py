# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""The doctor's rules about time and what they are made of: edges, words, what is remembered."""

from itertools import accumulate
from pathlib import Path
from random import Random

from doctor_case import asks
from doctor_case import blurred
from doctor_case import case
from doctor_case import cases_of
from doctor_case import COUNTERS
from doctor_case import device
from doctor_case import MS
from doctor_case import note
from doctor_case import NOW
from doctor_case import RULE
from doctor_case import S
from doctor_case import seen
from doctor_case import told
import pytest
import yaml

from msg_defs.dxl_instruction import Instruction as I
from msg_defs.dxl_packet import encode
from msg_defs.uart import heard_at
from rigs.tables import rows_of
from servobus.bus import evidence as ev
from servobus.bus import report as words
from servobus.bus.report import LineErrors
from servobus.bus.report import Wait
from servobus.doctor.case import History
from servobus.doctor.case import key_of
from servobus.doctor.case import Sample
from servobus.doctor.case import TwoClocks
from servobus.doctor.engine import Doctor
from servobus.doctor.facts import is_collision
from servobus.doctor.facts import ran_into_answers
from servobus.doctor.rhythm import is_independent
from servobus.doctor.rhythm import is_locked
from servobus.doctor.rhythm import PeriodicTimer
from servobus.doctor.rhythm import rhythms
from servobus.doctor.rule import about
from servobus.doctor.rule import Claim
from servobus.doctor.rule import Doubt
from servobus.doctor.rule import first_ids
from servobus.doctor.rule import longer_than
from servobus.doctor.rule import share
from servobus.doctor.rules.noise import likely_rate


def waits(count, us, ago_s=0.0, spoilt=False):
    return (Wait(NOW - int(ago_s * S), us, 1, spoilt),) * count


def damaged(count):
    return note(ev.DAMAGED_STATUS, ev.PacketHeader(0x55, 8), count)


def every(gaps_ms, number=1, code=I.READ):
    """Return an instruction that came at these distances, the last time just now."""
    stamps = [NOW]
    for gap in gaps_ms:
        stamps.insert(0, stamps[0] - int(gap * MS))
    return asks(code, number, stamps=stamps)


READ_OF_3 = encode(3, I.READ, b'\x84\0\4\0')
CUT_IN = bytes(len(READ_OF_3) - 6) + READ_OF_3[-6:]            # a question that ran into an answer


# --- what it cannot tell ---------------------------------------------------------------------

DOUBTS = [*cases_of('doctor_doubts.yaml')]


@pytest.mark.parametrize('row', DOUBTS, ids=[row[0] for row in DOUBTS])
def test_what_cannot_be_told_is_said(row):
    rule, parts, reason, _, too_little = row
    found = {name: part for name, part in parts.items() if name not in ('whom', 'step')}
    [doubt] = [one for one in told(rule, **found) if isinstance(one, Doubt)]
    assert (doubt.reason, doubt.device) == (reason, parts.get('whom'))
    assert doubt.step.startswith(step := parts.get('step', '')) and bool(doubt.step) == bool(step)
    for less in too_little:
        assert told(rule, **{**found, **less}) == [], less


# --- words -----------------------------------------------------------------------------------

STEPS = {1: '1 s', 5: '5 s', 10: '10 s', 30: '30 s', 60: '1 min', 300: '5 min', 600: '10 min',
         1800: '30 min', 3600: '60 min'}


def test_a_time_is_spelt_in_steps():
    assert {step: longer_than(step) for step in STEPS} \
        == {step: f'more than {text}' for step, text in STEPS.items()}
    assert [longer_than(step - 0.1) for step in STEPS] \
        == ['more than 1 s', *(longer_than(step) for step in list(STEPS)[:-1])]


@pytest.mark.parametrize(('spell', 'of', 'expected'), rows_of(
    Path(__file__).with_name('doctor_figures.tsv')))
def test_shares_and_ids_are_spelt_in_steps(spell, of, expected):
    figures = [yaml.safe_load(f'[{one}]' if spell == 'listed' and not at else one)
               for at, one in enumerate(of.split())]
    assert {'share': share, 'about': about, 'listed': first_ids}[spell](*figures) == expected


# --- rhythms and collisions ------------------------------------------------------------------


@pytest.mark.parametrize(('gaps', 'is_steady', 'is_even'), [
    ([20] * 20, True, True),
    ([20, 20, 20, 20, 40] * 4, True, False),           # some were lost
    ([20, 20, 20, 40, 50] * 4, True, False),           # four of five keep time
    ([20, 20, 24, 50, 31] * 4, False, False),
    ([20, 20, 20, 25] * 5, False, False), ([20, 20, 20, 24.9] * 5, False, True),
    ([20, 20, 20, 20, 20, 20, 20, 24, 24, 16] * 2, False, True),
])
def test_what_keeps_time(gaps, is_steady, is_even):
    [rhythm] = rhythms((every(gaps),), NOW, 1_000_000)
    assert (rhythm.is_steady, rhythm.is_even) == (is_steady, is_even)


def test_times_that_run_backwards_have_no_rhythm():
    assert not rhythms((every([20.0] * 20 + [-1.0]), every([-20.0] * 20)), NOW, 1_000_000)


def test_what_was_seen_for_a_short_time_is_taken_to_fit():
    one, two = rhythms((every([20.0] * 30), every([31.0] * 12, 2)), NOW, 1_000_000)
    assert not is_locked(two, one)
    one, two = rhythms((every([20.0] * 30), every([31.0] * 5 + [93.0] * 7, 2)), NOW, 1_000_000)
    assert is_locked(two, one)


def together(one_ms, other_ms):
    """Tell of two instructions that came at these times whether one knows of the other."""
    one, other = (rhythms((asks(I.READ, number, stamps=[
        NOW - S + int(at * MS) for at in times]),), NOW, 1_000_000)[0]
        for number, times in ((1, one_ms), (2, other_ms)))
    return is_independent(one, other)


def spread(count, places, apart_ms=40.0):
    """Return times at so many places of a period of 16 ms: a part of it each."""
    return [apart_ms * 16 / 20 * n - n % 5 / 1000 + n % places + 0.5 for n in range(count)]


def alternating(*but):
    """Return 21 times with one tick between each two, but for so many."""
    return [16.0 * n + n % 15 for n in range(21 + len(but)) if n not in but]


TICKS = [16.0 * n for n in range(60)]


@pytest.mark.parametrize(('one', 'other', 'is_told'), [
    (TICKS, spread(20, 8), True), (TICKS, spread(20, 7), False), (TICKS, spread(20, 1), False),
    (TICKS, spread(13, 6), True), (TICKS, spread(13, 5), False),
    (TICKS[:14], spread(20, 16)[:20], False),          # only seven of them are within the other
    (TICKS[:16], spread(20, 16)[:20], True),
    (TICKS, [16.0 * n + n % 16 + 0.5 for n in range(40)], False),       # they alternate
    (TICKS, alternating(5, 12), False), (TICKS, alternating(5, 12, 18), True),
])
def test_another_program_asks_anywhere_in_the_cycle(one, other, is_told):
    assert together(one, other) == is_told


def test_a_place_in_the_cycle_is_a_share_of_that_cycle():
    gaps = [gap for other in (10, 11, 12, 14, 16, 18, 21, 25, 32, 43) for gap in (16, other)] * 2
    begins = [float(sum(gaps[:n])) for n in range(40)]
    halves = [begins[n] + gaps[n] / 2 for n in range(0, 39, 2)]
    assert not together(begins, halves)


@pytest.mark.parametrize(('whole', 'odd', 'count'), [(9, 4, 1), (8, 5, 0)])
def test_a_repetition_is_told_where_four_of_five_periods_are_regular(whole, odd, count):
    [rhythm] = rhythms((every([20] * (whole - 1) + [1, 19, 20] + [30] * odd),), NOW, 1_000_000)
    assert len(rhythm.repeats) == count


@pytest.mark.parametrize(('before', 'count'), [(10, 1), (13, 0)])
def test_what_is_repeated_came_in_time_before(before, count):
    newest_first = [10] * 8 + [8.4, 1.6, before] + [10] * 12        # 8.4 alone is not in time
    [rhythm] = rhythms((every(newest_first),), NOW, 1_000_000)
    assert len(rhythm.repeats) == count


def test_the_usual_period_is_a_mean_of_eight_or_more():
    [rhythm] = rhythms((every([23.0] * 2 + [21.0] * 8 + [20.0] * 30),), NOW, 1_000_000)
    stamps = rhythm.cycle.stamps
    assert rhythm.turn(stamps[0]) == pytest.approx((30 * 20 + 8 * 21) / 38 * MS)
    assert rhythm.turn(stamps[30]) == 21.0 * MS        # 23 is not usual: it is off by 15 %
    assert rhythm.turn(stamps[30] + 1) == 0.0


def test_two_periods_are_compared_by_the_time_in_which_both_are_known():
    slow, fast = rhythms((every([40.0] * 15), every([20.0] * 30 + [20.9] * 12, 2)), NOW, 1_000_000)
    assert is_locked(slow, fast)


@pytest.mark.parametrize(('gaps', 'has_order'), [
    ([10, 12, 14, 16, 18, 20, 22, 26], False), ([10, 12, 14, 16, 18, 20, 20, 26], True)])
def test_jitter_has_many_different_periods(gaps, has_order):
    [rhythm] = rhythms((every(gaps * 2),), NOW, 1_000_000)
    assert (rhythm.jitter == 0) == has_order


@pytest.mark.parametrize(('headers', 'rate'), [(3, 1_000_000), (2, None)])
def test_a_rate_is_told_from_three_headers_on(headers, rate):
    assert likely_rate(heard_at(READ_OF_3, 2.0) * headers, 2_000_000) == rate


def test_only_what_is_repeated_and_goes_on_is_a_rhythm():
    assert len(rhythms((every([20] * 12),), NOW, 1_000_000)) == 1
    assert rhythms((every([20] * 11),), NOW, 1_000_000) == []
    assert rhythms((every([20] * 12),), NOW + 2 * S, 1_000_000) == []
    assert len(rhythms((every([20] * 12),), NOW + 2 * S - 1, 1_000_000)) == 1
    assert len(rhythms((every([20] * 12),) * 9, NOW, 1_000_000)) == 8


@pytest.mark.parametrize(('noise', 'count'), [
    (CUT_IN, 1),
    (CUT_IN * 2, 2), (CUT_IN[-6:] + CUT_IN, 1),
    (READ_OF_3, 0),                                    # it is whole: nothing was in its place
    (b'\xfc' + READ_OF_3[1:], 0),                      # two wrong bits are noise
    (b'\xf8' + READ_OF_3[1:], 1),
    (READ_OF_3[1:], 0),                                # its begin is not known
])
def test_the_end_of_a_question_behind_an_answer(noise, count):
    cycles = (asks(I.PING, 3), asks(I.READ), asks(I.READ, 3, at=None), asks(I.READ, 3))
    assert ran_into_answers(case(cycles=cycles, noise=noise, notes=damaged(1))) == count
    assert ran_into_answers(case(cycles=cycles, noise=noise)) == 0


ANDED = bytes(one & two for one, two in zip(
    READ_OF_3, b'\xff\xff\xfd\0\xff\xff\xff\xff\x0f\0\x0f\0\x2f\x17', strict=True))


@pytest.mark.parametrize(('noise', 'is_one'), [
    (ANDED * 3, True),
    ((b'\x3f\x00' + ANDED) * 3, True),
    (ANDED * 2, False),
    (ANDED[:-1] + b'\xff' + ANDED * 2, False),         # bits were added, too
    (READ_OF_3 * 3, False),
    (bytes(99), False),                                # anything is in nothing
])
def test_questions_that_lost_bits_and_gained_none_are_a_collision(noise, is_one):
    found = case(cycles=(asks(I.READ, 3),), noise=noise, protocol='Feetech', notes=damaged(3))
    assert is_collision(found) == is_one


FRONTS = {
    'Ping': (asks(I.PING, 3), ev.PacketHeader(I.PING, 2)),
    'Read': (asks(I.READ, 3), ev.PacketHeader(0, 7)),
    'Reg Write': (asks(I.REG_WRITE, 3, size=4), ev.PacketHeader(0, 9)),
    'Fast Sync Read': (asks(I.FAST_SYNC_READ, 1, 2, 3), ev.PacketHeader(I.FAST_SYNC_READ, 2)),
    'Sync Write': (asks(I.SYNC_WRITE, 1, 2, size=4), ev.PacketHeader(I.SYNC_WRITE, 16)),
}


@pytest.mark.parametrize('name', FRONTS)
def test_bits_that_are_lost_from_any_instruction_are_a_collision(name):
    cycle, front = FRONTS[name]

    def collides(front, count, others=0, protocol=words.PROTOCOL_2):
        return is_collision(case(cycles=(cycle,), protocol=protocol, notes=[
            *note(ev.DAMAGED_INSTRUCTION, front, count),
            *note(ev.DAMAGED_INSTRUCTION, ev.PacketHeader(0xFF, 0xFFFF), others)]))

    assert collides(front, 3)
    assert collides(front, 3, 7)
    assert not collides(front, 3, 8)
    assert not collides(front, 2)
    assert not collides(front, 3, protocol='Feetech')
    more_bits = ev.PacketHeader(front.instruction, front.length | 0x100)
    assert not collides(more_bits, 3)
    whole = {'Ping': 3, 'Read': 7, 'Reg Write': 9, 'Fast Sync Read': 10, 'Sync Write': 17}[name]
    assert not collides(ev.PacketHeader(cycle.instruction, whole), 9)     # a packet as it shall be


# --- two masters -----------------------------------------------------------------------------

CLASHES = note(ev.DAMAGED_INSTRUCTION, ev.PacketHeader(0, 2), 3)


def two_clocks(**parts):
    """Return what is said of one instruction that two loops repeat."""
    found = case(**parts)
    found.clocks = [TwoClocks(NOW, asks(I.READ, 3), (
        PeriodicTimer(31.0 * MS, ()), PeriodicTimer(20.0 * MS, ())))]
    return list(RULE['two_masters'].check(found))


def test_one_instruction_of_two_loops_is_two_programs_where_packets_collide():
    words = 'Read of 003 at 132 every 20 ms and every 31 ms: two programs, or '
    assert two_clocks() == [Doubt(words + 'one with two timers')]
    assert two_clocks(cycles=(asks(I.READ, 3),), protocol='Dynamixel 2.0', notes=CLASHES) == [
        Claim(words + 'two threads without a lock; let only one ask',
              {'damaged packets': 3})]


@pytest.mark.parametrize(('other_ms', 'blur_ms', 'is_told'), [
    (37.0, 1.0, True), (40.0, 1.0, False), (37.0, 6.6, True), (37.0, 6.7, False)])
def test_two_rhythms_that_do_not_fit_are_two_programs(other_ms, blur_ms, is_told):
    cycles = every([20.0] * 60), every([other_ms] * 32, 2)._replace(address=None)
    found = told('two_masters', metrics=blurred(blur_ms), rhythms=rhythms(cycles, NOW, 1_000_000))
    assert [one.message for one in found if isinstance(one, Claim)] == [
        'Read of 001 at 132 every 20 ms and Read of 002 every 37 ms: two programs, or two threads '
        'without a lock; let only one ask'] * is_told


@pytest.mark.parametrize(('hasty', 'missed', 'is_told'), [
    (waits(3, 499), 3, True), (waits(2, 499), 3, False), (waits(3, 500), 3, False),
    (waits(9, 499, spoilt=True), 9, False),
    (waits(3, 499), 2, False)])
def test_of_one_program_two_threads_ask_at_once_where_one_does_not_wait(hasty, missed, is_told):
    """One that takes a lock waits for its answer, or until that is spoilt: by a second servo."""
    cycles = every([20.0] * 60), every([37.0] * 32, 2)
    found = told('two_masters', devices=[device(window={'missed': missed})], waits=hasty,
                 has_sides=True, rhythms=rhythms(cycles, NOW, 1_000_000))
    assert bool(found) == is_told


UNSTEADY = [20, 20, 31, 20, 23, 43, 38, 20, 35, 26, 41, 29, 33, 37, 24, 22, 40, 28, 34, 30] * 2


@pytest.mark.parametrize(('gaps', 'parts', 'is_told'), [
    (UNSTEADY, {}, True), ([20.0] * 40, {}, False),
    (UNSTEADY, {'steady': set()}, False), (UNSTEADY, {'waits': waits(1, 500, 3.0)}, False),
    (UNSTEADY, {'waits': waits(1, 500, 3.001)}, True), (UNSTEADY, {'metrics': blurred(6.6)}, True),
    (UNSTEADY, {'metrics': blurred(6.7)}, False),
])
def test_a_cycle_that_was_regular_and_is_not(gaps, parts, is_told):
    cycle = every(gaps)
    found = told('jitter', **{'rhythms': rhythms((cycle,), NOW, 1_000_000),
                              'steady': {key_of(cycle)}, **parts})
    assert [dict(one.evidence) for one in found if isinstance(one, Claim)] == [
        {'spread': '0.67', 'cycle (ms)': '20.0 to 40.0, usually 30.0'}] * is_told


CHANCE = Random(1)
LATE = [25.0 if CHANCE.random() < 0.06 else 10.0 for _ in range(1400)]
FROM_0 = list(accumulate(LATE))
MADE_UP = [10 * n + (15 if n % 16 == 0 else 7 if n % 16 == 1 else 0) for n in range(1400)]


@pytest.mark.parametrize(('stamps_ms', 'others_ms', 'has_sides', 'is_told'), [
    (FROM_0, (), False, True), (MADE_UP, (), True, True), (MADE_UP, (), False, False),
    (accumulate([10.0] * 700 + [70.0] + [10.0] * 700), (), True, False),
    (accumulate(LATE[:250] + [10.0] * 1200), (), True, False),
    (accumulate(CHANCE.uniform(10, 11) for _ in range(1400)), (), True, False),
    (accumulate(20.0 if one > 10 else one for one in LATE), (), False, False),
    (FROM_0, [at - before for at, gap in zip(FROM_0, LATE, strict=True) if gap > 10
              for before in (23, 17, 11)], True, False),
    (FROM_0, [at - 23 for at, gap in zip(FROM_0, LATE, strict=True) if gap > 10], True, False),
    (sorted([*range(0, 14000, 10), *range(5, 14000, 170)]), (), True, False),
    ([max(at, at // 160 * 160 + 25) for at in range(0, 14000, 10)], (), False, False),
], ids=['late', 'made up for', 'or the listener', 'one pause', 'at the start', 'sleeps', 'lost',
        'health', 'unanswered', 'two loops', 'listener'])
def test_cycles_that_are_late(stamps_ms, others_ms, has_sides, is_told):
    doctor, found = Doctor(), set()
    asked = [[NOW + int(at * MS) for at in all_ms] for all_ms in (stamps_ms, others_ms)]
    for now in range(NOW, asked[0][-1], 750 * MS):
        cycles = [asks(I.SYNC_READ, *ids, stamps=[at for at in stamps if at <= now][-64:])
                  for ids, stamps in zip(((1, 2), (3,)), asked, strict=True)]
        found |= {one.rule for one in doctor.examine(case(
            cycles=[one for one in cycles if one.stamps], stamp=now, has_sides=has_sides,
            metrics=blurred(1.0)).report).findings}
    assert ('late_cycles' in found) == is_told


@pytest.mark.parametrize(('off_s', 'is_told'), [(1.1, True), (1.0, False), (0.1, False)])
def test_a_goal_is_without_torque_where_it_was_sent_after_the_torque_went_off(off_s, is_told):
    one = device(registers={'Present Position': 5})
    one = one._replace(observed=one.observed + seen(one, {'Goal Position': 120}, 'w', age_s=1.0)
                       + seen(one, {'Torque Enable': 0}, 'w', age_s=off_s))
    samples = [Sample(NOW - int(ago_s * S), goal, place, None, None) for ago_s, goal, place in (
        (1.05, 1000, 1000), (1, 100, 200), (0, 120, 206))]
    found = told('torque_off', devices=[one], samples={1: samples})
    assert [one.message[:18] for one in found] == ['goals are sent to '] * is_told


# --- what is remembered ----------------------------------------------------------------------

def test_the_count_of_so_long_ago_is_the_newest_that_is_old_enough():
    found = case(marks={10: {'bytes': 1}, 2: {'bytes': 2}, 1.9: {'bytes': 3}, 0: {'bytes': 4}})
    assert [found.mark(age).bytes for age in (60, 10, 2, 1.95, 0)] == [1, 1, 2, 2, 4]


def test_damage_has_gone_on_from_its_first_to_its_last():
    assert case().damage_s == 0.0
    assert case(notes=note(ev.CUT, ev.PacketHeader(2, 7), 5)).damage_s == pytest.approx(1.2)
    assert case(notes=note(ev.BAD_LENGTH, ev.Length(7), 2)).damage == 2


@pytest.mark.parametrize(('parts', 'gone'), yaml.safe_load(
    Path(__file__).with_name('gone_devices.yaml').read_text()))
def test_who_is_gone(parts, gone):
    assert case(device(7, **parts)).gone == [7] * gone


def asked_at(history, *pairs):
    """Return how long it was quiet, by reports at s with the last instruction at s."""
    reports = [case(asked=int(asked * S), stamp=int(now * S)).report for now, asked in pairs]
    return [round(history.make_case(report).quiet_s, 3) for report in reports]


def test_a_pause_is_quiet_where_the_master_does_not_often_pause_like_that():
    assert asked_at(History(), (100, 100), (100.625, 100), (100.626, 100)) == [0, 0, 0.626]
    assert asked_at(History(), (100, 0)) == [0]
    paused = History()
    assert asked_at(paused, (100, 100), (101, 100), (102, 102)) == [0, 1, 0]
    assert asked_at(paused, (104, 102), (104.1, 102)) == [0, 2.1]
    for minute, quiet_s in ((60, 0), (60.1, 1.5)):     # so long a usual one is remembered
        paused = History()
        assert asked_at(paused, (100, 100), (101, 100), (102, 101.9)) == [0, 1, 0]
        assert asked_at(paused, (102 + minute, 100.5 + minute)) == [quiet_s]


def test_an_incident_is_taken_once_and_forgotten_after_ten_seconds():
    history = History()
    one, two = note(ev.CUT, ev.PacketHeader(2, 7), 2)
    report = case().report
    assert history.make_case(report._replace(incidents=(one,))).count(ev.CUT) == 1
    assert history.make_case(report._replace(incidents=(one, two))).count(ev.CUT) == 2
    later = report._replace(incidents=(one, two))
    assert history.make_case(later._replace(stamp=one.stamp + 10 * S)).count(ev.CUT) == 2
    assert history.make_case(later._replace(stamp=one.stamp + 10 * S + 1)).count(ev.CUT) == 1
    assert history.make_case(later._replace(stamp=two.stamp + 10 * S + 1)).count(ev.CUT) == 0


@pytest.mark.parametrize(('between', 'count'), [
    ((), 1), ((NOW - 160 * MS,), 0), ((NOW - 159 * MS,), 0), ((NOW - 159 * MS + 1,), 1)])
def test_a_repetition_with_another_question_between_is_none(between, count):
    again = every([20] * 7 + [19, 1] + [20] * 14)      # 160 ms before the last, and 159
    found = History().make_case(case(cycles=(again, asks(I.PING, 2, stamps=between))).report)
    assert len(found.repeats) == count


def test_rhythms_are_looked_for_every_three_quarters_of_a_second():
    history = History()
    cycles = (every([20] * 20),)
    assert [len(history.make_case(case(stamp=NOW + int(at * S), cycles=some).report).rhythms)
            for at, some in ((0, ()), (0.749, cycles), (0.75, cycles), (1.499, ()), (1.5, ()))] \
        == [0, 0, 1, 1, 0]


def test_a_thousand_incidents_of_a_kind_are_kept():
    many = tuple(note(ev.CUT, ev.PacketHeader(2, 7), 1001, every_ms=1.0))
    found = History().make_case(case(incidents=many).report)
    assert [one.stamp for one in found.incidents(ev.CUT)] == [one.stamp for one in many[1:]]


def test_after_a_reset_the_history_begins_again():
    history = History()
    [one] = note(ev.CUT, ev.PacketHeader(2, 7), 1)
    counted = case(counters={'Bytes': 5}, incidents=(one,)).report
    assert history.make_case(counted).count(ev.CUT) == 1
    assert history.make_case(counted._replace(incidents=())).count(ev.CUT) == 1
    assert history.make_case(counted._replace(counters=COUNTERS, incidents=())).count(ev.CUT) == 0


def test_a_mark_counts_what_the_driver_and_the_devices_did():
    found = History().make_case(case(
        device(totals={'answers': 2}), device(2, totals={'answers': 3}),
        counters={'Bytes': 9, 'Packet Bytes': 8, 'Packets': 7, 'Instructions': 6},
        kinds={ev.GLITCH: 4, ev.ECHO: 5},
        line_errors=LineErrors(overrun=1, buf_overrun=2, frame=10, parity=40, breaks=20)).report)
    *counts, totals = found.mark(0)
    assert counts == [NOW, 9, 8, 7, 6, 5, 4, 5, 3, 30]
    assert [one.answers for one in totals.values()] == [2, 3]


def test_samples_are_those_of_the_last_ten_seconds():
    history = History()
    moving = device(registers={'Goal Position': 9, 'Present Position': 7,
                               'Present Input Voltage': 120, 'Realtime Tick': 1500})
    for age in (10, 0):
        found = history.make_case(case(moving, stamp=NOW - age * S).report)
    assert list(found.samples[1]) == [Sample(NOW - age * S, 9, 7, 1.5, 12.0) for age in (10, 0)]
    found = history.make_case(case(moving, stamp=NOW + 1).report)
    assert [one.stamp for one in found.samples[1]] == [NOW, NOW + 1]
    assert History().make_case(case(device(registers={'Goal Position': 9})).report).samples == {}
