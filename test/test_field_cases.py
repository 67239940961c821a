# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""The cases that people had: each is played or says why not, and one of them is told."""

import re

import pytest

from benchmark.field_cases import PAGE
from benchmark.field_cases import results
from dxl_monitor.doctor import RULES
from rigs.bus.field import NOT_PLAYED
from rigs.bus.field import PLAYED


def test_every_case_of_the_page_is_one_of_the_scenes():
    text = PAGE.read_text()
    rows = re.findall(r'^\| (T\d\d [^|]*) \|', text, re.M)
    assert rows == [scene.name for scene in PLAYED]
    assert [case for case, _ in NOT_PLAYED if f'| {case} |' not in text] == []


def test_what_is_expected_are_rules():
    known = {rule.name for rule in RULES}
    assert {rule for scene in PLAYED for rule, _ in scene.expected} - known == set()


@pytest.mark.parametrize(('case', 'cause'), [
    ('T10', 'all_silent'), ('T44', 'two_masters'), ('T58', 'impatient_master')])
def test_a_case_is_told_as_its_thread_found(case, cause):
    [found] = results([case])
    assert (found.verdict, found.told) == ('right', ((cause, None),))
