# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""The cases that people had: each is played or says why not; and what the baseline has of all."""

from pathlib import Path

import pytest

from benchmark import baseline
from rigs.bus.scenes import NOT_PLAYED
from rigs.bus.scenes import PLAYED
from servobus.doctor import RULES

PAGE = Path(__file__).parents[1] / 'docs' / 'doctor_results.md'


def test_every_case_is_in_the_baseline_and_no_other():
    assert [*baseline.saved()] == [
        (family, case) for family, cases in baseline.FAMILIES.items() for case in cases]
    played = {scene.name.split()[0] for scene in PLAYED}
    assert not played & {one for cases in NOT_PLAYED for one in cases.split(', ')}


def test_the_page_has_the_scores_of_the_baseline():
    page = PAGE.read_text(encoding='utf-8')
    assert [line for line in baseline.scores(baseline.saved()) if line not in page] == []


def test_what_is_expected_are_rules():
    known = {rule.name for rule in RULES}
    assert {rule for scene in PLAYED for rule, _ in scene.expected} - known == set()


@pytest.mark.parametrize(('case', 'cause'), [
    ('T10', 'all_silent'), ('T44', 'two_masters'), ('T58', 'impatient_master')])
def test_a_case_is_told_as_its_thread_found(case, cause):
    [scene] = [one for one in PLAYED if one.name.startswith(case)]
    cells = baseline.field_cells(scene)
    assert cells == baseline.saved_of('field cases')[scene.name]
    assert (cells[1], cells[3]) == (f'{cause} bus', 'right')


@pytest.mark.parametrize('name', baseline.TEXTS)
def test_texts_are_as_in_the_baseline(name):
    """The meaning of each register, and of each error text that --explain knows."""
    assert baseline.TEXTS[name]() == (baseline.FOLDER / name).read_text(encoding='utf-8'), \
        'run: scripts/python -m benchmark.baseline --write'
