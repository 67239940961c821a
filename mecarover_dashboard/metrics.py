# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""
What is known now as metrics for Prometheus, through prometheus_client.

Gauges for states and values, counters for what the nodes count since their start. Labels: robot
(the namespace), bus, id, model, joint. A device has about ten series and the state keeps at most
3000 rows, so that no name on a topic can fill a Prometheus. What is not reported any more has its
level (3, stale) and no values; nor has what a closed port or a device that does not answer said
last.
"""
from __future__ import annotations

from collections.abc import Callable
from collections.abc import Iterable
from collections.abc import Iterator
from collections.abc import Sequence
from functools import partial

from prometheus_client import CollectorRegistry
from prometheus_client.core import CounterMetricFamily
from prometheus_client.core import GaugeMetricFamily
from prometheus_client.core import Metric
from prometheus_client.exposition import choose_encoder

from mecarover_dashboard import rows
from mecarover_dashboard.robot_parts import level_of
from mecarover_dashboard.robot_parts import place_of
from mecarover_dashboard.rows import Row
from mecarover_dashboard.state import RowReport
from mecarover_dashboard.state import State
from msg_defs import status_keys as keys
from msg_defs.diagnostics import Level

MOST_FINDINGS = 1000            # series, of all robots
_LABEL = 100                    # characters
_DEVICE = ('robot', 'bus', 'id', 'model', 'joint')
_BUS = ('robot', 'bus')
_DEVICE_GAUGES: tuple[tuple[str, str, float, Callable[[RowReport], str]], ...] = (
    ('temperature_celsius', 'Temperature', 1.0, lambda one: one.values.temperature),
    ('voltage_volts', 'Input voltage', 1.0, lambda one: one.values.voltage),
    ('load_ratio', 'Load, of what the device can do', 0.01,
     lambda one: one.values.load if one.values.unit == '%' else ''),
    ('current_amperes', 'Current', 1.0,
     lambda one: one.values.load if one.values.unit == 'A' else ''),
    ('loss_ratio', 'Answers missed in the last 10 s, of those asked for', 0.01,
     lambda one: str(one.row['loss'])),
    ('reply_latency_seconds', 'Reply latency, median of 10 s', 0.001,
     lambda one: str(one.row['latency'])),
)


def exposition(state: State, accept: str) -> tuple[bytes, str]:
    """Return what a scrape gets, in the format that it accepts, and its content type."""
    registry = CollectorRegistry()
    registry.register(_Scrape(state))
    encode, content_type = choose_encoder(accept)
    return encode(registry), content_type


class _Scrape:
    """A collector over a State, for one scrape."""

    def __init__(self, state: State) -> None:
        self._state = state
        self._known = {one.place for one in state.parts() if one.is_known}

    def collect(self) -> Iterator[Metric]:
        yield _gauge('problem', 'Level of what is wrong with a bridge or a bus, its devices '
                     'included; no series without a problem', ('robot', 'part', 'problem'), (
                         ({'robot': one.robot, 'part': one.name, 'problem': problem}, one.level)
                         for one in self._state.parts() for problem in one.problems))
        for what, section, labels in (('device', 'devices', _DEVICE), ('bus', 'buses', _BUS),
                                      ('bridge', 'bridge', ('robot', 'part'))):
            yield _gauge(f'{what}_level', f'Level of a {what}: 0 ok, 1 warning, 2 error, 3 stale',
                         labels, ((one.row, level_of(one.row))
                                  for one in self._state.reports(section)))
        yield from self._devices()
        yield from self._buses()
        yield from self._bridges()
        yield from self._findings()
        yield _counter('dashboard_statuses_refused', 'Statuses that the dashboard had no room for',
                       (), [({}, self._state.refused)])
        yield _counter('dashboard_messages_malformed', 'Messages that could not be read',
                       (), [({}, self._state.malformed)])

    def _reports_of_now(self, section: str) -> list[RowReport]:
        """Return the devices or buses of which what is known is of now."""
        return [one for one in self._state.reports(section) if 'quiet_since' not in one.row
                and place_of(one.row) in self._known]

    def _devices(self) -> Iterator[Metric]:
        found = self._reports_of_now('devices')
        asked = [one for one in found if one.row['level'] != Level.STALE]
        yield _gauge('device_connected', 'Whether a device answers', _DEVICE, (
            (one.row, one.row['live']) for one in asked))
        for name, text, scale, read in _DEVICE_GAUGES:
            yield _gauge(f'device_{name}', text, _DEVICE, (
                (one.row, rows.finite(read(one))) for one in asked), scale)
        for name, text, key in (('answers', 'Answers heard since the start', keys.ANSWERS),
                                ('missed_answers', 'Answers missed', keys.MISSED_ANSWERS)):
            yield _counter(f'device_{name}', text, _DEVICE, (
                (one.row, rows.finite(self._state.fact(one.row_name, key))) for one in found))

    def _buses(self) -> Iterator[Metric]:
        found = [one.row for one in self._reports_of_now('buses')]
        for name, text, metric, scale in (
                ('load_ratio', 'Share of the time in which the wire is used', 'bus_load', 0.01),
                ('packets_per_second', 'Packets, over 10 s', 'packet_rate', 1.0),
                ('errors_per_second', 'Damaged packets, over 10 s', 'error_rate', 1.0)):
            yield _gauge(f'bus_{name}', text, _BUS, (
                (row, self._state.figure(row['node'], row['bus'], metric)) for row in found),
                scale)
        yield _counter('bus_packets', 'Packets since the start', _BUS, (
            (row, _value(row, 'Packets')) for row in found))

    def _bridges(self) -> Iterator[Metric]:
        for name, text, part, key in (
                ('frames', 'Frames sent to the MCU', 'link', 'Frames sent'),
                ('losses', 'How often the port was lost', 'link', 'Losses'),
                ('commands', 'Commands received', 'commands', keys.COMMANDS_RECEIVED),
                ('time_outs', 'Stops because no command came', 'commands', 'Time-outs')):
            yield _counter(f'bridge_{name}', text, ('robot',), (
                (one.row, _value(one.row, key)) for one in self._state.reports('bridge')
                if one.row['part'] == part and 'quiet_since' not in one.row))

    def _findings(self) -> Iterator[Metric]:
        found = [({'id': ''} | one.row | {'rule': rule, 'severity': severity}, 1.0)
                 for section in ('buses', 'devices') for one in self._reports_of_now(section)
                 for rule, _, severity in one.row['findings']]
        yield _gauge('finding', 'A finding of the doctor that holds now',
                     ('robot', 'bus', 'id', 'rule', 'severity'), found[:MOST_FINDINGS])
        yield _gauge('findings_left_out', f'Findings beyond {MOST_FINDINGS}, which have no series',
                     (), [({}, max(0, len(found) - MOST_FINDINGS))])


def _value(row: Row, key: str) -> float | None:
    return rows.finite(dict(row['values']).get(key, ''))


def _family(kind: type[GaugeMetricFamily | CounterMetricFamily], name: str, text: str,
            labels: Sequence[str], samples: Iterable[tuple[Row, float | None]],
            scale: float = 1.0) -> Metric:
    """Return the samples that are known; two devices of the same labels count once."""
    family = kind(f'mecarover_{name}', text, labels=labels)
    known = {tuple(str(row[label])[:_LABEL] for label in labels): value for row, value in samples}
    for values, value in known.items():
        if value is not None:
            family.add_metric(values, float(value) * scale)
    return family


_gauge, _counter = partial(_family, GaugeMetricFamily), partial(_family, CounterMetricFamily)
