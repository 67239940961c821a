# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""
The monitor at full load for minutes: its memory stays flat, nothing is lost.

The two loads above 2 MBd take a fifth of the time, two of such buses in one node all of it. Bare
readers have the same traffic for as long: a pause of the machine meets them as often.
"""

from benchmark.monitored import several_through_node
from benchmark.monitored import several_through_readers
from benchmark.monitored import through_node
from benchmark.monitored import through_reader
from benchmark.node_cost import ALL_TOPICS
from benchmark.node_cost import LOADS
from benchmark.traffic import BAUD
from rigs.harness import Figure

SECTION = 'dxl_monitor for minutes'
TWO = 'two buses of 450 kB/s'
TWO_BUSES = (LOADS['450 kB/s, 20 devices'][0],) * 2
SETTLE_S = 30.0                 # until every window and cache is full


def run(options):
    figures = []
    for name, (traffic, _) in LOADS.items():
        seconds = 60 * options.load_minutes / (1 if traffic.baud == BAUD else 5)
        node = through_node(traffic, seconds, *ALL_TOPICS, settle_s=SETTLE_S)
        bare = through_reader(traffic, seconds)
        figures += [*_node_figures(name, node, bare), *_bus_figures(name, node, bare)]
    seconds = 60 * options.load_minutes
    nodes = several_through_node(TWO_BUSES, seconds, *ALL_TOPICS, settle_s=SETTLE_S)
    bares = several_through_readers(TWO_BUSES, seconds)
    both = bares[0]._replace(cpu=sum(one.cpu for one in bares),
                             resident_mb=sum(one.resident_mb for one in bares))
    figures += _node_figures(f'{TWO} in one node', nodes[0], both)
    for number, (node, bare) in enumerate(zip(nodes, bares, strict=True), start=1):
        figures += _bus_figures(f'{TWO}, bus {number}', node, bare)
    return figures


def _bus_figures(name, node, bare):
    return [_figure(name, 'bytes', node.sent, 'B', bare, f'{bare.sent}'),
            _figure(name, 'overrun', node.overrun, 'B', bare, f'{bare.overrun}, wanted: 0'),
            _figure(name, 'longest gap between reads', node.longest_gap_ms, 'ms', bare,
                    f'{bare.longest_gap_ms:.1f}')]


def _node_figures(name, node, bare):
    return [_figure(name, 'CPU', 100 * node.cpu, '% of a core', bare, f'{100 * bare.cpu:.1f}'),
            _figure(name, 'resident memory', node.resident_mb, 'MB', bare,
                    f'{bare.resident_mb:.1f}'),
            _figure(name, 'growth of it', node.growth_mb, 'MB', bare, f'{bare.growth_mb:.1f}')]


def _figure(name, what, value, unit, bare, beside):
    return Figure(SECTION, f'{name}: {what}', unit, [value],
                  f'bare reader for {bare.seconds:.0f} s: {beside}')
