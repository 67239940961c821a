# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""The demo's verdicts, without its processes; scripts/demo itself is run by hand and in CI."""

import pytest

from mecarover_fakes.demo.scenes import judge_missed


@pytest.mark.parametrize('missed, overrun, passed, text', [
    ({6: 0, 7: 9}, 0, True, '9 counted, 10 simulated'),
    ({6: 1, 7: 9}, 0, False, '006: 1 counted, 0 simulated'),
    ({6: 1, 7: 9}, 40, True, 'unknown: the busy computer lost 40 bytes'),
    ({6: 0, 7: 9, 55: 3}, 0, False, '055: 3 counted, 0 simulated'),
])
def test_missed_answers_are_those_of_the_fakes_books(missed, overrun, passed, text):
    truth = {'devices': {'6': {'missed': 0}, '7': {'missed': 10}},
             'totals': {'bus': {'overrun': overrun}}}
    verdict = judge_missed(missed, truth)
    assert (verdict.passed, verdict.text) == (passed, text)
