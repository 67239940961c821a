# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""A packet and a report cost no more than they did, counted without a clock (benchmark.calls)."""
import sys

import pytest

from benchmark import calls
from dxl_monitor.bus.tracker import Tracker
from dxl_monitor.doctor import Doctor

pytestmark = pytest.mark.skipif(sys.version_info[:2] != calls.PYTHON, reason=calls.ONE_PYTHON)

PING = f'ping, chunks of {calls.CHUNKS[0]}'
BUS = next(iter(calls.BUSES))


@pytest.mark.more
@pytest.mark.parametrize('measure', [calls.of_packets, calls.of_reports])
def test_nothing_costs_more_than_its_limit(measure):
    figures, limits = measure(), calls.limits()
    assert figures.keys() <= limits.keys()
    assert {name: (cost, limits[name]) for name, cost in figures.items()
            if cost > limits[name]} == {}


def cost_of_a_ping(count):
    stream = calls.STREAMS['ping']
    return calls.cost_of(calls.chunks_of(stream, calls.CHUNKS[0], False), stream.baud, count)


@pytest.mark.parametrize(('rule', 'count', 'what'), [
    (lambda frame: len(frame) > 7, calls.calls_of, 'calls a packet'),
    (lambda frame: frame[0] + frame[1] > frame[2], calls.bytecodes_of, 'bytecodes a packet'),
])
def test_a_rule_that_costs_more_on_each_packet_is_over_the_limit(monkeypatch, rule, count, what):
    limit, track = calls.limits()[PING, what], Tracker.track
    assert cost_of_a_ping(count) <= limit
    monkeypatch.setattr(Tracker, 'track', lambda self, frames, *rest: track(
        self, [frame for frame in frames if not rule(frame)] or frames, *rest))
    assert cost_of_a_ping(count) > limit


def test_a_rule_that_looks_at_each_device_is_over_the_limit_of_a_report(monkeypatch):
    limit, examine = calls.limits()[BUS, 'calls a report'], Doctor.examine
    assert calls.calls_of_a_report(calls.BUSES[BUS]) <= limit
    monkeypatch.setattr(Doctor, 'examine', lambda self, report: examine(
        self, report._replace(devices=tuple(device._replace() for device in report.devices))))
    assert calls.calls_of_a_report(calls.BUSES[BUS]) > limit
