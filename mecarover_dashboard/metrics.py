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
from functools import partial

from prometheus_client import CollectorRegistry
from prometheus_client.core import CounterMetricFamily
from prometheus_client.core import GaugeMetricFamily
from prometheus_client.core import Metric
from prometheus_client.exposition import choose_encoder

from mecarover_dashboard import rows
from mecarover_dashboard.robot_parts import level_of
from mecarover_dashboard.rows import Row
from mecarover_dashboard.state import RowReport
from mecarover_dashboard.state import State
from msg_defs import status_keys as keys
from msg_defs.reports import Level

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
        self._known = {(one.node, one.bus) for one in state.parts() if one.is_known}

    def collect(self) -> Iterator[Metric]:
        yield _gauge('problem', 'Level of what is wrong with a bridge or a bus, its devices '
                     'included; no series without a problem', ('robot', 'part', 'problem'), (
                         ((one.robot[:_LABEL], one.name[:_LABEL], problem), float(one.level))
                         for one in self._state.parts() for problem in one.problems))
        yield from self._devices()
        yield from self._buses()
        yield from self._bridges()
        yield from self._findings()
        yield _counter('dashboard_statuses_refused', 'Statuses that the dashboard had no room for',
                       (), [((), self._state.refused)])
        yield _counter('dashboard_messages_malformed', 'Messages that could not be read',
                       (), [((), self._state.malformed)])

    def _is_known(self, row: Row) -> bool:
        """Tell whether what a row says is of now."""
        return 'quiet_since' not in row and (row['node'], row['bus']) in self._known

    def _devices(self) -> Iterator[Metric]:
        found = [(_labels(one.row, _DEVICE), one) for one in self._state.reports('devices')]
        fresh = [(labels, one) for labels, one in found if self._is_known(one.row)]
        asked = [(labels, one) for labels, one in fresh if one.row['level'] != Level.STALE]
        yield _gauge('device_level', 'Level of a device: 0 ok, 1 warning, 2 error, 3 stale',
                     _DEVICE, ((labels, float(level_of(one.row))) for labels, one in found))
        yield _gauge('device_connected', 'Whether a device answers', _DEVICE, (
            (labels, float(one.row['live'])) for labels, one in asked))
        for name, text, scale, read in _DEVICE_GAUGES:
            yield _gauge(f'device_{name}', text, _DEVICE, (
                (labels, _scaled(rows.finite(read(one)), scale)) for labels, one in asked))
        for name, text, key in (('answers', 'Answers heard since the start', keys.ANSWERS),
                                ('missed_answers', 'Answers missed', keys.MISSED_ANSWERS)):
            yield _counter(f'device_{name}', text, _DEVICE, (
                (labels, rows.finite(self._state.fact(one.row_name, key)))
                for labels, one in fresh))

    def _buses(self) -> Iterator[Metric]:
        found = [(_labels(one.row, _BUS), one.row) for one in self._state.reports('buses')]
        yield _gauge('bus_level', 'Level of a bus: 0 ok, 1 warning, 2 error, 3 stale', _BUS,
                     ((labels, float(level_of(row))) for labels, row in found))
        fresh = [(labels, row) for labels, row in found if self._is_known(row)]
        for name, text, metric, scale in (
                ('load_ratio', 'Share of the time in which the wire is used', 'bus_load', 0.01),
                ('packets_per_second', 'Packets, over 10 s', 'packet_rate', 1.0),
                ('errors_per_second', 'Damaged packets, over 10 s', 'error_rate', 1.0)):
            yield _gauge(f'bus_{name}', text, _BUS, (
                (labels, _scaled(self._state.figure(row['node'], row['bus'], metric), scale))
                for labels, row in fresh))
        yield _counter('bus_packets', 'Packets since the start', _BUS, (
            (labels, _value(row, 'Packets')) for labels, row in fresh))

    def _bridges(self) -> Iterator[Metric]:
        found = [(one.row['robot'][:_LABEL], one.row) for one in self._state.reports('bridge')]
        yield _gauge('bridge_level', 'Level of a bridge: 0 ok, 1 warning, 2 error, 3 stale',
                     ('robot', 'part'),
                     (((robot, row['part'][:_LABEL]), float(level_of(row)))
                      for robot, row in found))
        for name, text, part, key in (
                ('frames', 'Frames sent to the MCU', 'link', 'Frames sent'),
                ('losses', 'How often the port was lost', 'link', 'Losses'),
                ('commands', 'Commands received', 'commands', keys.COMMANDS_RECEIVED),
                ('time_outs', 'Stops because no command came', 'commands', 'Time-outs')):
            yield _counter(f'bridge_{name}', text, ('robot',), (
                ((robot,), _value(row, key)) for robot, row in found
                if row['part'] == part and 'quiet_since' not in row))

    def _findings(self) -> Iterator[Metric]:
        found = [((*_labels(one.row, ('robot', 'bus')), str(one.row.get('id', '')),
                   rule[:_LABEL], severity), 1.0)
                 for kind in ('buses', 'devices') for one in self._state.reports(kind)
                 if self._is_known(one.row) for rule, _, severity in one.row['findings']]
        yield _gauge('finding', 'A finding of the doctor that holds now',
                     ('robot', 'bus', 'id', 'rule', 'severity'), found[:MOST_FINDINGS])
        yield _gauge('findings_left_out', f'Findings beyond {MOST_FINDINGS}, which have no series',
                     (), [((), float(max(0, len(found) - MOST_FINDINGS)))])


def _labels(row: Row, names: tuple[str, ...]) -> tuple[str, ...]:
    return tuple(str(row[name])[:_LABEL] for name in names)


def _value(row: Row, key: str) -> float | None:
    return rows.finite(dict(row['values']).get(key, ''))


def _scaled(value: float | None, scale: float) -> float | None:
    return None if value is None else value * scale


_Samples = Iterable[tuple[tuple[str, ...], float | None]]


def _family(kind: type[GaugeMetricFamily | CounterMetricFamily], name: str, text: str,
            labels: tuple[str, ...], samples: _Samples) -> Metric:
    """Return the samples that are known; two devices of the same labels count once."""
    family = kind(f'mecarover_{name}', text, labels=labels)
    for values, value in dict(samples).items():
        if value is not None:
            family.add_metric(values, value)
    return family


_gauge, _counter = partial(_family, GaugeMetricFamily), partial(_family, CounterMetricFamily)
