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
from benchmark.traffic import KINDS
from benchmark.traffic import packets
from benchmark.traffic import ROBOT
from benchmark.traffic import trace_packets
from mecarover_fakes.line import wire_ns
from msg_defs.dxl_instruction import Instruction as I
from msg_defs.dxl_packet import BROADCAST
from msg_defs.dxl_packet import Framer
from msg_defs.frame import IS_STATUS
from rigs.harness import as_json
from rigs.harness import Child
from rigs.harness import Figure
from rigs.harness import interleaved
from rigs.harness import Options
from rigs.harness import quantile
from rigs.harness import table
from rigs.harness import usage

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


def test_a_figure_is_the_median_with_its_spread():
    assert FIGURES[0].median == 2.0
    line = next(line for line in table(FIGURES).splitlines() if 'mean' in line)
    assert line.split() == ['mean', '2', 'us', '(1', 'to', '3)', 'wanted:', 'less']


def test_cases_take_turns():
    calls = []
    results = interleaved({name: lambda name=name: calls.append(name) or len(calls)
                           for name in 'abc'}, rounds=4)
    assert [sorted(calls[at:at + 3]) for at in range(0, 12, 3)] == [list('abc')] * 4
    assert {name: len(values) for name, values in results.items()} == dict.fromkeys('abc', 4)


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


@pytest.mark.parametrize('kind', KINDS)
def test_traffic_is_whole_packets_of_a_busy_bus(kind):
    pieces = packets(kind, 2000)
    framer = Framer()
    framer.frames(b''.join(pieces))
    assert len(pieces) == framer.packets == 2000
    assert framer.noise_bytes == 0
    assert packets(kind, 2000) == pieces


def test_experiment_2_reads_each_device_in_three_ways_and_writes_what_can_be_written():
    kinds = {number: set() for number in range(1, 21)}
    for frame in Framer().frames(b''.join(packets('read/write', 2000))):
        kind, number, code, params = frame[2:6]
        if kind != IS_STATUS:
            by_list = 4 if code in (I.SYNC_READ, I.SYNC_WRITE) else 0
            kinds[number if number != BROADCAST else params[by_list]].add(code)
    reads = {I.PING, I.READ, I.SYNC_READ, I.BULK_READ}
    everything = reads | {I.WRITE, I.SYNC_WRITE, I.BULK_WRITE}
    assert kinds == {number: reads if 13 <= number <= 16 else everything for number in kinds}


def test_a_moving_robot_hardly_repeats_itself():
    assert len(set(packets('moving robot', 2000)[500:])) > 1000


def test_a_trace_is_cut_without_loss(tmp_path):
    recorded = bytes(700) + b''.join(packets('ping', 10)) + b'\xff\xff'
    file = tmp_path / 'trace.bin'
    file.write_bytes(recorded)
    pieces = trace_packets(file)
    assert b''.join(pieces) == recorded
    assert max(map(len, pieces)) <= 256
    assert len(pieces) == 3 + 10


@pytest.mark.parametrize('gap_us', [0, 100])
def test_writer_keeps_its_schedule_and_counts_what_nobody_takes(gap_us):
    with Child('benchmark.writer') as writer:
        writer.send_json({'kind': 'ping', 'trace': '', 'devices': ROBOT, 'baud': 2_000_000,
                     'gap_us': gap_us})
        port = writer.read_json()['port']
        with Child('benchmark.reader', port) as reader:
            reader.read_json()
            writer.send_json({'settle': 0.1, 'seconds': 0.5})
            assert writer.read_json() == {'measuring': True}
            assert usage(writer.pid).resident_mb > 1
            result = writer.read_json()
    assert result['sent'] == result['taken'] + result['overrun'] + result['unheard']
    assert 0 < result['sent'] * wire_ns(1, 2_000_000) <= 1.1e9 * result['seconds']
    assert result['gap_us'][0] >= gap_us
