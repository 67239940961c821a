# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""
What the monitor costs as a process: CPU, and what it loses at full bus load.

All topics are on. The bare reader has the same traffic in the same run, turn by turn: what it
loses too is the machine's doing, not the node's. So has the node with a thread that reads instead
of a process: what the process is for.
"""

from functools import partial
from statistics import median

from benchmark.monitored import THREAD_NODE
from benchmark.monitored import through_node
from benchmark.monitored import through_reader
from benchmark.monitored import Traffic
from benchmark.traffic import FULL_BUS
from rigs.harness import Figure
from rigs.harness import interleaved

SECTION = 'dxl_monitor as a process'
ALL_TOPICS = ('joint_state_rate:=10.0',)
ROUNDS = 7
FAST_BAUD = 4_500_000
LOADS = {
    '200 kB/s, 20 devices': (Traffic('moving robot'), 'wanted: under 10'),
    '450 kB/s, 20 devices': (Traffic('moving robot', baud=FAST_BAUD), 'wanted: under 20'),
    '450 kB/s, 253 devices': (
        Traffic('moving robot', baud=FAST_BAUD, devices=FULL_BUS), 'reported only'),
}


def run(options):
    figures = []
    for name, (traffic, wanted) in LOADS.items():
        cases = {
            'node': partial(through_node, traffic, options.seconds, *ALL_TOPICS),
            'thread': partial(through_node, traffic, options.seconds, *ALL_TOPICS,
                              module=THREAD_NODE),
            'reader': partial(through_reader, traffic, options.seconds)}
        runs = interleaved(cases, options.asked_rounds or (1 if options.quick else ROUNDS))
        figures += _figures(name, wanted, runs)
    return figures


def _figures(name, wanted, runs):
    def figure(what, unit, of, beside=''):
        values = {case: [of(one) for one in taken] for case, taken in runs.items()}
        others = (f'bare reader {median(values["reader"]):.3g}, '
                  f'reading in a thread {median(values["thread"]):.3g}')
        return Figure(SECTION, f'{name}: {what}', unit, values['node'],
                      others + (f', {beside}' if beside else ''))

    gaps = [thread.longest_gap_ms / node.longest_gap_ms
            for thread, node in zip(runs['thread'], runs['node'], strict=True)]
    times = [node.cpu / reader.cpu
             for node, reader in zip(runs['node'], runs['reader'], strict=True)]
    return [
        Figure(SECTION, f'{name}: CPU, all processes / bare reader', '', times,
               'wanted: at most 3'),
        figure('CPU', '% of a core', lambda one: 100 * one.cpu, wanted),
        figure('growth of memory', 'MB', lambda one: one.growth_mb),
        figure('overrun', 'B', lambda one: one.overrun),
        figure('longest gap between reads', 'ms', lambda one: one.longest_gap_ms),
        Figure(SECTION, f'{name}: longest gap, thread / process', '', gaps, 'wanted: at least 2'),
    ]
