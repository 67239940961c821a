# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""The parts of the benchmark suite that could be wrong without anybody noticing."""

import json
import os
from shutil import which
from tempfile import TemporaryDirectory

import pytest

from benchmark import tap
from benchmark.against import bound
from rigs.harness import as_json
from rigs.harness import Figure
from rigs.harness import Options
from rigs.harness import quantile

pytestmark = pytest.mark.realtime(bears=0.05)

FIGURES = [
    Figure('one', 'mean', 'us', [3.0, 1.0, 2.0], 'wanted: less'),
    Figure('two', 'p50', 'ms', [0.5]),
]


def test_the_masters_beside_each_other_are_tapped_heard_and_neither():
    figures = tap.run(Options(asked_rounds=2))         # it raises where nothing was heard
    assert len(figures) == (14 if which('strace') else 10)
    assert all(value > 0 for figure in figures if not figure.beside for value in figure.values)


@pytest.mark.ros
def test_the_node_beside_which_the_reader_process_is_measured_reads_in_a_thread():
    from benchmark.thread_node import in_thread

    with in_thread as listener_on, TemporaryDirectory() as folder:
        listener = listener_on(f'{folder}/port', 57600, print, print)
        assert listener._in_thread


def test_quantile_is_of_nearest_rank():
    assert [quantile([4, 1, 3, 2], share) for share in (0.0, 0.5, 0.75, 1.0)] == [1, 2, 3, 4]


def test_bound_of_a_median_is_a_low_rank():
    ratios = [value / 100 for value in range(100)]
    assert bound(ratios) == 0.40           # the 41st of 100, by the binomial
    assert bound([0.9]) == 0.9


def test_results_name_no_folder_and_nobody():
    text = as_json(FIGURES, 'scripts/bench')
    assert os.getcwd() not in text
    assert os.uname().nodename not in json.loads(text)['machine'].values()
    assert json.loads(text)['figures'][0]['values'] == [3.0, 1.0, 2.0]
