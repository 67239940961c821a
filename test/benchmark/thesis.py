# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""
The six experiments of the thesis, through a pty into the real node.

*time per buffer*: from a read to the end of its processing. *time between buffers*: from one read
to the next. Processing rate: bits received per sum of all times per buffer. The buffers of the
thesis hold 4096 bytes; what a pty hands over at a time is less.
"""

import sys
from typing import NamedTuple

from benchmark.monitored import through_node
from benchmark.monitored import Traffic
from benchmark.traffic import TRACE
from rigs.harness import Figure

SECTION = 'the six experiments of the thesis'


class Row(NamedTuple):
    """A line of the table: medians in ms, the processing rate in bit/s."""

    per_buffer: float
    between: float
    rate: float


# From the thesis, its chapter on the debug interface: 216 MHz Cortex-M7
THESIS = {
    ('trace', 0): Row(8.8, 4.0, 3_788_589), ('trace', 100): Row(7.7, 4.0, 4_306_544),
    ('read/write', 0): Row(11.2, 4.0, 2_916_174), ('read/write', 100): Row(10.9, 4.0, 2_999_109),
    ('ping', 0): Row(52.7, 4.0, 644_432), ('ping', 100): Row(57.9, 4.0, 565_894),
}


def run(options):
    if options.trace is None:
        print(f'{SECTION}: the two with the trace are left out; give the raw bytes of a bus: '
              '--trace FILE', file=sys.stderr)
    figures = []
    for kind, gap_us in THESIS:
        if kind == TRACE and options.trace is None:
            continue
        traffic = Traffic(kind, gap_us, trace=options.trace)
        node = through_node(traffic, options.seconds)
        name = f'{kind}, {gap_us} us' if gap_us else f'{kind}, no delay'
        figures += _figures(name, row_of(node), THESIS[kind, gap_us], node.overrun)
    return figures


def row_of(node):
    """Return the figures of a run as the thesis gives them."""
    per_buffer, between, size = (node.metrics[name] for name in (
        'time_per_buffer', 'time_between_buffers', 'bytes_per_buffer'))
    return Row(per_buffer['since start p50 (ms)'], between['since start p50 (ms)'],
               8000 * size['since start mean (B)'] / per_buffer['since start mean (ms)'])


def _figures(name, row, thesis, overrun):
    def figure(what, value, unit, beside=''):
        return Figure(SECTION, f'{name}: {what}', unit, [value], beside)

    return [
        figure('per buffer, median', row.per_buffer, 'ms', f'thesis {thesis.per_buffer}'),
        figure('between buffers, median', row.between, 'ms', f'thesis {thesis.between}'),
        figure('processing rate', row.rate, 'bit/s', f'thesis {thesis.rate}'),
        figure('processing rate / thesis', row.rate / thesis.rate, '', 'wanted: at least 8'),
        figure('overrun', overrun, 'B'),
    ]
