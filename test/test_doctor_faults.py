# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""The doctor against every fault of the simulated bus: named, and nothing else; two at a time."""

from collections.abc import Callable
from functools import cache

import pytest
import test_doctor_edges
import test_doctor_time

from benchmark.baseline import fault_cells
from benchmark.baseline import saved_of
from benchmark.confusion import examine
from benchmark.confusion import label
from benchmark.confusion import reports
from benchmark.confusion import Result
from benchmark.confusion import SIDED
from benchmark.confusion import told
from benchmark.confusion import WITHIN_S
from benchmark.confusion_cases import ANSWERS_BEHIND
from benchmark.confusion_cases import Case
from benchmark.confusion_cases import CASES
from benchmark.confusion_cases import DXL1_CASES
from benchmark.confusion_cases import FAST
from benchmark.confusion_cases import FAST_ROBOT
from benchmark.confusion_cases import FEETECH_CASES
from benchmark.confusion_cases import Key
from benchmark.confusion_cases import Scene
from dxl_monitor.doctor import RULES
from mecarover_fakes.faults import KINDS
from mecarover_fakes.traffic import PATTERNS

AT = '2'                           # s, when the faults begin
LONG = 140                         # characters of a line that one reads at a glance
MS = 1_000_000


@cache
def result_of(case: Case) -> Result:
    return examine(case)


@cache
def sided_result_of(case: Case) -> Result:
    return examine(case, has_sides=True)


def case_name(case: Case) -> str:
    return case.fault.replace(':{at}', '') + (f' {case.about}' if case.about else '')


@pytest.mark.parametrize('case', CASES, ids=case_name)
def test_a_fault_is_named_and_nothing_else(case: Case) -> None:
    result = result_of(case)
    assert set(result.told) == set(case.told)
    assert 0 <= result.after_s <= WITHIN_S


@pytest.mark.parametrize('case', SIDED, ids=case_name)
def test_with_the_sides_known_it_is_told_as_well(case: Case) -> None:
    result = sided_result_of(case)
    assert set(result.told) == set(case.told)
    assert 0 <= result.after_s <= WITHIN_S


def test_every_fault_is_among_the_cases() -> None:
    assert {case.fault.partition(':')[0] for case in CASES} \
        == {name for name, kind in KINDS.items() if '2' in kind.protocols}


def test_every_rule_has_a_fault_or_a_case_made_by_hand() -> None:
    played = {rule for case in (*CASES, *FEETECH_CASES, *DXL1_CASES) for rule, _ in case.told}
    by_hand = {rule for rule, *_ in (*test_doctor_edges.ENOUGH, *test_doctor_time.ENOUGH,
                                     *test_doctor_time.DOUBTS)}
    assert {rule.name for rule in RULES} - played - by_hand == set()


@pytest.mark.parametrize(('family', 'cases', 'result'), [
    ('Protocol 2.0', CASES, result_of), ('Protocol 2.0, sides known', SIDED, sided_result_of)])
def test_it_is_as_in_the_baseline(
        family: str, cases: tuple[Case, ...], result: Callable[[Case], Result]) -> None:
    assert {label(case): fault_cells(case, result(case)) for case in cases} == saved_of(family), \
        'run: python -m benchmark.baseline --write'


SLOW = {'read_write': 4.0, 'mixed': 10.0, 'bulk': 20.0, 'registered': 20.0}


def advice(pattern: str) -> set[Key]:
    """Return what is said of good traffic, at OK: only of one broadcast Ping after the other."""
    return {('scan', None)} if pattern == 'broadcast' else set()


@pytest.mark.parametrize('pattern', [name for name in PATTERNS if name != 'none'])
def test_a_minute_of_good_traffic_is_no_finding(pattern: str) -> None:
    scene = Scene(pattern, rate=SLOW.get(pattern, 30.0))
    if pattern == 'fast':
        scene = scene._replace(devices=FAST_ROBOT)
    assert {key for report in reports([], scene, 60.0) for key in told(report)} == advice(pattern)


@pytest.mark.parametrize('gather', [2 * MS, 16 * MS], ids=['2 ms', '16 ms'])
@pytest.mark.parametrize('pattern', ['moving', 'sync', 'read_write', 'mixed', 'ping', 'idle'])
def test_an_adapter_that_gathers_bytes_makes_no_finding(pattern: str, gather: int) -> None:
    scene = Scene(pattern, rate=SLOW.get(pattern, 50.0), gather=gather)
    assert {key for report in reports([], scene, 15.0) for key in told(report)} == set()


# What needs no times finer than an adapter of 2 ms tells is found through it too.
BLURRED = ('silent:3', 'duplicate:3', 'baud:3', 'latched:3', 'reboot:3', 'echo', 'wrong_map:3',
           'no_ack:3', 'noise', 'hot:3', 'protocol1', 'header', 'latency')


@pytest.mark.parametrize('name', BLURRED)
def test_found_through_an_adapter_that_gathers_bytes(name: str) -> None:
    case = next(one for one in CASES if one.fault.replace(':{at}', '').rstrip(':') == name)
    assert set(examine(case._replace(scene=case.scene._replace(gather=2 * MS))).told) \
        == set(case.told)


PAIRS: tuple[tuple[str, str, tuple[Key, ...]], ...] = (
    ('silent:3', 'latched:5', (('no_answer', 3), ('hardware_error', 5))),
    ('silent:3', 'hot:6', (('no_answer', 3), ('too_hot', 6))),
    ('silent:3', 'silent:6', (('no_answer', 3), ('no_answer', 6))),
    ('silent:3', 'wrong_map:5', (('no_answer', 3), ('wrong_address', 5))),
    ('silent:3', 'glitch', (('no_answer', 3), ('stray_bytes', None))),
    ('duplicate:3', 'latched:5', (('duplicate_id', 3), ('hardware_error', 5))),
    ('duplicate:3', 'low_voltage:6', (('duplicate_id', 3), ('voltage', 6))),
    ('baud:3', 'eeprom:5', (('baud_moved', 3), ('eeprom_locked', 5))),
    ('baud:3', 'hot:5', (('baud_moved', 3), ('too_hot', 5))),
    ('reboot:3', 'latched:5', (('rebooted', 3), ('hardware_error', 5))),
    ('header:3', 'wrong_map:5', (('turnaround', 3), ('wrong_address', 5))),
    ('noise', 'latched:5', (('noise', None), ('hardware_error', 5))),
    ('noise', 'protocol1', (('noise', None), ('protocol_1', None))),
    ('two_masters', 'hot:5', (('two_masters', None), ('too_hot', 5))),
    ('latency', 'latched:3', (('latency_timer', None), ('hardware_error', 3))),
    ('overload', 'low_voltage:3', (('bus_too_slow', None), ('voltage', 3))),
    # The loop was not seen to keep time before both began, so of that nothing is said.
    ('jitter', 'eeprom_wear:3', (('eeprom_wear', 3),)),
    ('unstuffed', 'no_ack:3', (('unstuffed', None), ('no_acks', 3))),
    ('glitch', 'wrong_map:3', (('stray_bytes', None), ('wrong_address', 3))),
    ('echo', 'hot:3', (('echo', None), ('too_hot', 3))),
    ('late:3', 'latched:6', (('late_answers', 3), ('hardware_error', 6))),
    ('foreign:3', 'hot:5', (('foreign_answers', 3), ('too_hot', 5))),
)


def begun(fault: str) -> str:
    return f'{fault}:{AT}' if ':' in fault else f'{fault}::{AT}'


@pytest.mark.parametrize(('one', 'other', 'expected'), PAIRS)
def test_two_faults_at_once_are_both_named(one: str, other: str,
                                           expected: tuple[Key, ...]) -> None:
    *_, last = reports([begun(one), begun(other)], ANSWERS_BEHIND, 7.0)
    assert set(told(last)) == set(expected)


@pytest.mark.parametrize('case', CASES, ids=case_name)
def test_sentences_are_short_and_figures_are_spelt(case: Case) -> None:
    for finding in result_of(case).findings:
        assert 30 < len(finding.message) <= LONG, finding.message
        assert '\n' not in finding.message
        assert all(name and value for name, value in finding.evidence)


def test_a_fault_that_is_over_is_forgotten() -> None:
    *_, last = reports(['noise::1:2', 'wrong_map:3:1:2'], Scene(rate=20.0), 17.0)
    assert last.findings == ()


def test_a_dead_device_at_the_end_of_the_chain_is_no_broken_cable() -> None:
    *_, last = reports(['silent:100:2'], Scene(), 7.0)
    assert told(last) == (('no_answer', 100),)


def test_no_fast_reads_at_all() -> None:
    *_, last = reports(['old_firmware::2'], FAST, 7.0)
    assert {rule for rule, _ in told(last)} == {'fast_read_unsupported'}
