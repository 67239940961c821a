# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""
The six experiments of the thesis, through a pty into the real node.

*time per buffer*: from a read to the end of its processing. *time between buffers*: from one read
to the next. Effective rate: bits received per duration; processing rate: bits received per sum of
all times per buffer. The thesis' buffers hold 4096 bytes; what a pty hands over at a time is less,
so the time per buffer stands there as measured and scaled to 4096 bytes.
"""

import sys
from typing import NamedTuple

from benchmark.monitored import through_node
from benchmark.monitored import through_reader
from benchmark.monitored import Traffic
from benchmark.traffic import TRACE
from rigs.harness import Figure

SECTION = 'the six experiments of the thesis'
BUFFER = 4096
SHARES = ('max', 'median', 'mean', 'min')
KEYS = {'max': 'max', 'median': 'p50', 'mean': 'mean', 'min': 'min'}


class Row(NamedTuple):
    """A line of the table: ms in the order of SHARES, rates in bit/s."""

    per_buffer: tuple[float, ...]
    between: tuple[float, ...]
    effective: float
    processing: float


# From the thesis, its chapter on the debug interface: 216 MHz Cortex-M7
THESIS = {
    ('trace', 0): Row((10.1, 8.8, 8.6, 0.9), (15.0, 4.0, 6.7, 3.8), 1_600_717, 3_788_589),
    ('trace', 100): Row((9.4, 7.7, 7.6, 0.9), (13.1, 4.0, 4.3, 3.7), 313_481, 4_306_544),
    ('read/write', 0): Row((11.9, 11.2, 11.2, 10.6), (17.0, 4.0, 8.6, 3.7), 1_600_717, 2_916_174),
    ('read/write', 100): Row((11.7, 10.9, 10.9, 10.3), (16.1, 4.0, 4.5, 3.7), 314_027, 2_999_109),
    ('ping', 0): Row((54.2, 52.7, 50.8, 37.0), (59.1, 4.0, 22.6, 3.7), 534_118, 644_432),
    ('ping', 100): Row((58.7, 57.9, 57.9, 57.0), (64.0, 4.0, 8.9, 3.7), 314_027, 565_894),
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
        node = through_node(traffic, options.seconds, settle_s=options.settle_s)
        reader = through_reader(traffic, options.seconds, settle_s=options.settle_s)
        figures += _figures(_name(kind, gap_us), row_of(node), THESIS[kind, gap_us], node, reader)
    return figures


def row_of(node):
    """Return the figures of a run as the thesis gives them."""
    per_buffer, between, size = (node.metrics[name] for name in (
        'time_per_buffer', 'time_between_buffers', 'bytes_per_buffer'))
    return Row(
        tuple(per_buffer[f'since start {KEYS[share]} (ms)'] for share in SHARES),
        tuple(between[f'since start {KEYS[share]} (ms)'] for share in SHARES),
        8 * node.taken / node.seconds,
        8000 * size['since start mean (B)'] / per_buffer['since start mean (ms)'])


def _name(kind, gap_us):
    return f'{kind}, {gap_us} us' if gap_us else f'{kind}, no delay'


def _figures(name, row, thesis, node, reader):
    scale = BUFFER / node.metrics['bytes_per_buffer']['since start mean (B)']

    def figure(what, value, unit, beside=''):
        return Figure(SECTION, f'{name}: {what}', unit, [value], beside)

    return [
        *(figure(f'per buffer {share}', value, 'ms', f'thesis {known}')
          for share, value, known in zip(SHARES, row.per_buffer, thesis.per_buffer, strict=True)),
        figure('per 4096 bytes mean', row.per_buffer[2] * scale, 'ms',
               f'thesis {thesis.per_buffer[2]}'),
        *(figure(f'between buffers {share}', value, 'ms', f'thesis {known}')
          for share, value, known in zip(SHARES, row.between, thesis.between, strict=True)),
        figure('effective rate', row.effective, 'bit/s', f'thesis {thesis.effective}'),
        figure('processing rate', row.processing, 'bit/s', f'thesis {thesis.processing}'),
        Figure(SECTION, f'{name}: processing rate / thesis', '',
               [row.processing / thesis.processing], 'wanted: at least 8'),
        figure('overrun', node.overrun, 'B', f'bare reader {reader.overrun}'),
        figure('longest gap between reads', node.longest_gap_ms, 'ms',
               f'bare reader {reader.longest_gap_ms:.3g}'),
        figure('gap made by the writer p50', node.gap_us[0], 'us', f'p99 {node.gap_us[1]:.4g}'),
        figure('CPU', 100 * node.cpu, '% of a core', f'bare reader {100 * reader.cpu:.1f}'),
    ]
