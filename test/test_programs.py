# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""What is said of random programs with a mistake is at least as right as it was."""
from harness import later
import pytest

from fuzz.programs.play import kept_scores
from fuzz.programs.play import kinds
from fuzz.programs.play import play
from fuzz.programs.play import SEEDS
from fuzz.programs.play import WORST_LAST

CASES = [(*of, seed) for of in kinds() for seed in SEEDS]


@pytest.mark.parametrize(('kind', 'family', 'seed'), later(CASES, CASES[::3 * len(SEEDS) + 2]))
def test_a_program_with_a_mistake(kind, family, seed):
    before = kept_scores()[kind, family][seed - SEEDS[0]]
    now = play(kind, family, seed)
    assert WORST_LAST.index(now.score) <= WORST_LAST.index(before), now
