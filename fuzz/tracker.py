# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""Tracker and Monitor: any traffic, with pauses, to a report and what is published of it."""

import json

from dxl_monitor.models import Models
from dxl_monitor.monitor import Monitor
from dxl_monitor.planner import SLOTS_KEPT
from dxl_monitor.status import bus_status
from dxl_monitor.status import device_metrics
from dxl_monitor.status import device_status
from dxl_monitor.status import PortState
from dxl_monitor.table import SIZE_LIMIT
from fuzz.framer import pieces
from fuzz.script import Script
from fuzz.script import traffic

MODELS = Models()
PAUSES_NS = (0, 0, 0, 1_000, 1_000_000, 30_000_000, 1_500_000_000, 12_000_000_000)
LIMITS = {'errors': 50, 'incidents': 1000, 'waits': 256, 'cycles': 32, 'noise': 256}
PORT = PortState('port', '', ())


def check(data):
    """
    Check one bus over one stretch of traffic.

    Never raises, in a report and its statuses neither; bytes are packet, noise or pending; all
    that is kept is bounded; what came at one stamp gives the same in any split.
    """
    script = Script(data)
    seed = script.word()
    bursts = [(piece, script.pick(PAUSES_NS)) for piece in filter(None, traffic(script))]
    whole = run((([piece], pause) for piece, pause in bursts))
    assert run(((list(pieces(piece, seed)), pause) for piece, pause in bursts)) == whole


def run(bursts):
    """Feed bursts of chunks, each at one stamp; return what does not hang on the chunks."""
    monitor = Monitor('bus', MODELS)
    now = 1_000_000_000
    total = 0
    for chunks, pause in bursts:
        for chunk in chunks:
            total += len(chunk)
            monitor.feed(chunk, now)
        if pause >= 1_000_000_000:
            bounded(monitor.report(now), total)
        now += pause
    now += 4_000_000_000               # not 5: a device is silent after so long, to the ns
    report = monitor.report(now)
    bounded(report, total)
    assert report.counters['Pending Bytes'] == 0
    published(report)
    roster, planner = monitor._roster, monitor._tracker._planner
    assert sum(1 + len(plan.slots) for plan in planner.known.values()) <= SLOTS_KEPT + 255
    assert all(len(one.table._settle().data) <= SIZE_LIMIT for one in roster.devices.values())
    return report.counters, report.kinds, [
        (device.id, device.model_name, device.state, dict(device.counters),
         [(address, found) for address, found in roster.devices[device.id].table.known()])
        for device in report.devices]


def bounded(report, total):
    counters = report.counters
    assert counters['Bytes'] == total == (
        counters['Packet Bytes'] + counters['Noise Bytes'] + counters['Pending Bytes'])
    assert all(len(getattr(report, name)) <= limit for name, limit in LIMITS.items())
    assert len(report.devices) <= 253


def published(report):
    """Hold that statuses are text throughout, and that `observed` is JSON."""
    statuses = [bus_status('dxl_monitor', '', report, PORT, True)]
    statuses += [device_status('dxl_monitor', '', device, report.findings, True)
                 for device in report.devices]
    assert len({status.name for status in statuses}) == len(statuses)
    for status in statuses:
        for key, value in status.values:
            assert isinstance(key, str) and isinstance(value, str)
            (key + value).encode()
        observed = dict(status.values).get('observed')
        if observed is not None:
            assert all(age_s >= 0 and source in 'rw'
                       for age_s, source in json.loads(observed).values())
    device_metrics(report)
