# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""
The monitor at full load for minutes: its memory stays flat, nothing is lost.

The two loads above 2 MBd take a fifth of the time.
"""

from benchmark.harness import Figure
from benchmark.harness import Options
from benchmark.monitored import through_node
from benchmark.monitored import through_reader
from benchmark.node_cost import ALL_TOPICS
from benchmark.node_cost import LOADS
from benchmark.traffic import BAUD

SECTION = 'dxl_monitor for minutes'
READER_S = 60.0
SETTLE_S = 30.0                 # until every window and cache is full


def run(options: Options) -> list[Figure]:
    figures = []
    for name, (traffic, _) in LOADS.items():
        seconds = 60 * options.load_minutes / (1 if traffic.baud == BAUD else 5)
        node = through_node(traffic, seconds, *ALL_TOPICS, settle_s=SETTLE_S)
        bare = through_reader(traffic, min(seconds, READER_S))
        rows = (('CPU', 100 * node.cpu, '% of a core', f'{100 * bare.cpu:.1f}'),
                ('bytes', node.sent, 'B', f'{bare.sent}'),
                ('overrun', node.overrun, 'B', f'{bare.overrun}'),
                ('longest gap between reads', node.longest_gap_ms, 'ms',
                 f'{bare.longest_gap_ms:.1f}'),
                ('resident memory', node.resident_mb, 'MB', f'{bare.resident_mb:.1f}'),
                ('growth of it', node.growth_mb, 'MB', f'{bare.growth_mb:.1f}'))
        figures += [Figure(SECTION, f'{name}: {what}', unit, [value],
                           f'bare reader for {min(seconds, READER_S):g} s: {beside}')
                    for what, value, unit, beside in rows]
    return figures
