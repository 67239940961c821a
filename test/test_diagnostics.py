# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""How reports are named and spelt."""

from math import inf
from math import nan
from pathlib import Path

import pytest
import yaml

from msg_defs.diagnostics import hardware_id
from msg_defs.diagnostics import headline_figure
from msg_defs.diagnostics import Level
from msg_defs.diagnostics import Metric
from msg_defs.diagnostics import metric_status
from msg_defs.diagnostics import number
from msg_defs.diagnostics import pairs
from msg_defs.diagnostics import Status
from msg_defs.diagnostics import status_name
from msg_defs.diagnostics import topic_names
from msg_defs.diagnostics import worst
from msg_defs.diagnostics import worst_first
from msg_defs.running_statistics import Series

ROWS = yaml.safe_load(
    Path(__file__).with_name('spelt_numbers.yaml').read_text(encoding='utf-8'))



@pytest.mark.parametrize(('value', 'text'), ROWS['spelt'])
def test_numbers_are_bare_and_short(value, text):
    assert number(value) == text


def test_what_is_no_value_is_left_out():
    values = {'a': 1.5, 'b': nan, 'c': None, 'd': inf, 'e': -inf, 'f': 0, 'g': False, 'h': ''}
    assert pairs(values) == [('a', '1.5'), ('f', '0'), ('g', 'false'), ('h', '')]


def test_worst_level_ranks_silence_between_warning_and_error():
    assert worst([]) is Level.OK
    assert worst([Level.OK, Level.WARN, Level.OK]) is Level.WARN
    assert worst([Level.WARN, Level.STALE]) is Level.STALE
    assert worst([Level.ERROR, Level.STALE, Level.OK]) is Level.ERROR


def test_the_worst_come_first_and_else_the_order_is_kept():
    levels = [Level.OK, Level.STALE, Level.WARN, Level.ERROR, Level.WARN]
    found = worst_first(Status(str(n), level, '', '', []) for n, level in enumerate(levels))
    assert [one.name for one in found] == ['3', '1', '2', '4', '0']


def test_status_names_leave_out_the_bus_of_a_single_bus():
    assert status_name('dxl_monitor', '', '011') == 'dxl_monitor: 011'
    assert status_name('dxl_monitor', 'arm', '011') == 'dxl_monitor: arm/011'


def test_names_and_hardware_ids_carry_the_namespace():
    assert status_name('rover1/dxl_monitor', 'arm', '011') == 'rover1/dxl_monitor: arm/011'
    assert hardware_id('dxl_monitor', '', '11') == '11'
    assert hardware_id('dxl_monitor', 'arm', '11') == 'arm/11'
    assert hardware_id('a/b/dxl_monitor', 'arm', '11') == 'a/b/arm/11'
    assert hardware_id('vel2d_bridge', '/dev/ttyAMA0') == '/dev/ttyAMA0'
    assert hardware_id('rover1/vel2d_bridge', '/dev/ttyAMA0') == 'rover1/dev/ttyAMA0'


def test_topic_names_are_legal_and_kept_apart():
    names = ['ttyUSB0', 'left arm', 'left-arm', 'left_arm', '1', 'ß', '__x', '/dev/ttyAMA0', '']
    parts = topic_names(names)
    assert parts['ttyUSB0'] == 'ttyUSB0'
    assert parts['left_arm'] == 'left_arm'          # a name that is legal stays as it is
    assert parts['left arm'] == 'left_arm_2'
    assert parts['left-arm'] == 'left_arm_3'
    assert parts['1'] == 'bus_1'
    assert parts['ß'] == 'bus'
    assert parts['__x'] == 'x'
    assert len(set(parts.values())) == len(names)


def series_of(values):
    series = Series()
    for value in values:
        series.add(value, 0)
    return series


def test_status_of_a_series():
    series = series_of([1.0, 2.0, 3.0, 4.0])
    metric = Metric('write', 'ms', series.summary(0), series.total())
    status = metric_status('rover1/vel2d_bridge', metric)
    assert (status.name, status.hardware_id) == ('rover1/vel2d_bridge: timing/write',
                                                 'rover1/vel2d_bridge')
    assert status.level is Level.OK
    assert status.message == 'p95 4 ms'
    values = dict(status.values)
    assert values['mean (ms)'] == '2.5'
    assert values['max (ms)'] == '4'
    assert values['count'] == '4'
    assert values['since start count'] == '4'
    assert list(values)[:8] == ['mean (ms)', 'deviation (ms)', 'min (ms)', 'max (ms)', 'p50 (ms)',
                                'p95 (ms)', 'p99 (ms)', 'count']


def test_headline_is_the_value_or_the_p95_of_the_window():
    assert headline_figure(Metric('frame_rate', 'Hz', value=20.0)) == 20.0
    assert headline_figure(Metric('write', 'ms', series_of([2.0]).summary(0))) == 2.0
    assert headline_figure(Metric('write', 'ms', None, series_of([2.0]).total())) is None
