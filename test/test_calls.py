# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""A packet and a report cost no more than they did, counted without a clock (benchmark.calls)."""
from pathlib import Path
import subprocess
import sys

import pytest

from benchmark import calls
from servobus.bus.tracker import Tracker
from servobus.doctor import Doctor

pytestmark = pytest.mark.skipif(sys.version_info[:2] != calls.PYTHON, reason=calls.ONE_PYTHON)

ROOT = Path(__file__).parents[1]
PING = f'ping, chunks of {calls.CHUNKS[0]}'
BUS = next(iter(calls.BUSES))


def test_nothing_costs_more_than_its_limit():
    """In a process of its own: what other tests left in caches would be counted, too."""
    done = subprocess.run([sys.executable, '-m', 'benchmark.calls'], cwd=ROOT, text=True,
                          capture_output=True)
    over = [line for line in done.stdout.splitlines() if line.endswith('OVER')]
    assert (done.returncode, over) == (0, []), done.stderr


def cost_of_a_ping(count):
    stream = calls.STREAMS['ping']
    return calls.cost_of(calls.chunks_of(stream, calls.CHUNKS[0], False), stream.baud, count)


@pytest.mark.parametrize(('rule', 'count', 'what'), [
    (lambda frame: len(frame) > 7, calls.calls_of, 'calls a packet'),
    (lambda frame: frame[0] + frame[1] > frame[2], calls.bytecodes_of, 'bytecodes a packet'),
])
def test_a_rule_that_costs_more_on_each_packet_is_over_the_limit(monkeypatch, rule, count, what):
    limit, track = calls.limits()[PING, what], Tracker.process_frames
    assert cost_of_a_ping(count) <= limit
    monkeypatch.setattr(Tracker, 'process_frames', lambda self, frames, *rest: track(
        self, [frame for frame in frames if not rule(frame)] or frames, *rest))
    assert cost_of_a_ping(count) > limit


def test_a_rule_that_looks_at_each_device_is_over_the_limit_of_a_report(monkeypatch):
    limit, examine = calls.limits()[BUS, 'calls a report'], Doctor.examine
    assert calls.calls_of_a_report(calls.BUSES[BUS]) <= limit
    monkeypatch.setattr(Doctor, 'examine', lambda self, report: examine(
        self, report._replace(devices=tuple(device._replace() for device in report.devices))))
    assert calls.calls_of_a_report(calls.BUSES[BUS]) > limit
