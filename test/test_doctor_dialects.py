# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""The doctor against every fault of the simulated bus, with Feetech and Protocol 1.0."""

from functools import cache

import pytest

from benchmark.baseline import fault_cells
from benchmark.baseline import saved_of
from benchmark.confusion import examine
from benchmark.confusion import label
from benchmark.confusion import reports
from benchmark.confusion import Result
from benchmark.confusion import told
from benchmark.confusion import WITHIN_S
from benchmark.confusion_cases import Case
from benchmark.confusion_cases import DXL1
from benchmark.confusion_cases import DXL1_BULK
from benchmark.confusion_cases import DXL1_CASES
from benchmark.confusion_cases import FEETECH
from benchmark.confusion_cases import FEETECH_BEHIND
from benchmark.confusion_cases import FEETECH_CASES
from benchmark.confusion_cases import Key
from benchmark.confusion_cases import Scene
from dxl_monitor.doctor import feetech
from dxl_monitor.doctor import setting_up
from mecarover_fakes.faults import KINDS
from mecarover_fakes.traffic import FAMILY_1

ENOUGH = 25                        # faults of each dialect
LONG = 140                         # characters of a line that one reads at a glance
MS = 1_000_000


@cache
def result_of(case: Case) -> Result:
    return examine(case)


def case_name(case: Case) -> str:
    return ' '.join((case.scene.dialect, case.fault.replace(':{at}', ''), case.about)).rstrip()


@pytest.mark.parametrize('case', FEETECH_CASES + DXL1_CASES, ids=case_name)
def test_a_fault_is_named_and_nothing_else(case: Case) -> None:
    result = result_of(case)
    assert set(result.told) == set(case.told)
    assert 0 <= result.after_s <= WITHIN_S
    for finding in result.findings:
        assert 30 < len(finding.message) <= LONG, finding.message
        assert all(name and value for name, value in finding.evidence)


@pytest.mark.parametrize(('protocol', 'cases'), [('feetech', FEETECH_CASES), ('1', DXL1_CASES)])
def test_every_fault_is_among_the_cases(protocol: str, cases: tuple[Case, ...]) -> None:
    faults = {case.fault.partition(':')[0] for case in cases}
    assert faults == {name for name, kind in KINDS.items() if protocol in kind.protocols}
    assert len(faults) >= ENOUGH


def test_every_rule_of_the_dialects_is_among_the_cases() -> None:
    rules = {rule for case in FEETECH_CASES + DXL1_CASES for rule, _ in case.told}
    assert rules >= {rule.name for rule in feetech.RULES + setting_up.RULES}


@pytest.mark.parametrize(('family', 'cases'), [
    ('Feetech', FEETECH_CASES), ('Protocol 1.0', DXL1_CASES)])
def test_it_is_as_in_the_baseline(family: str, cases: tuple[Case, ...]) -> None:
    assert {label(case): fault_cells(case, result_of(case)) for case in cases} \
        == saved_of(family), 'run: python -m benchmark.baseline --write'


HEALTHY = [scene._replace(pattern=pattern, rate=20.0)
           for scene in (FEETECH, FEETECH_BEHIND, DXL1)
           for pattern in FAMILY_1['1' if scene is DXL1 else 'feetech'] if pattern != 'none']


GATHERED = [scene._replace(gather=16 * MS) for scene in (FEETECH, DXL1, DXL1_BULK)]


@pytest.mark.parametrize('scene', [*HEALTHY, *GATHERED],
                         ids=lambda scene: f'{scene.dialect} {scene.pattern}')
def test_good_traffic_is_no_finding(scene: Scene) -> None:
    assert {key for report in reports([], scene, 15.0) for key in told(report)} \
        == ({('scan', None)} if scene.pattern == 'broadcast' else set())       # advice, at OK


PAIRS: tuple[tuple[Scene, str, str, tuple[Key, ...]], ...] = (
    (FEETECH_BEHIND, 'silent:3', 'low_supply:5', (('no_answer', 3), ('wrong_supply', 5))),
    (FEETECH, 'layout:3', 'hot:5', (('layout', 3), ('too_hot', 5))),
    (FEETECH, 'latched:3', 'high_supply:5', (('hardware_error', 3), ('wrong_supply', 5))),
    (FEETECH, 'glitch', 'offset:5', (('stray_bytes', None), ('calibrated_twice', 5))),
    (DXL1, 'silent:3', 'latched:5', (('no_answer', 3), ('hardware_error', 5))),
    (DXL1, 'header:3', 'wrong_map:5', (('turnaround', 3), ('layout', 5))),
)


@pytest.mark.parametrize(('scene', 'one', 'other', 'expected'), PAIRS)
def test_two_faults_at_once_are_both_named(scene: Scene, one: str, other: str,
                                           expected: tuple[Key, ...]) -> None:
    faults = [f'{fault}:2' if ':' in fault else f'{fault}::2' for fault in (one, other)]
    *_, last = reports(faults, scene, 7.0)
    assert set(told(last)) == set(expected)
