# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""The status of a bus: which of its troubles sets the level, and which is told first."""
from dataclasses import fields
from pathlib import Path

import pytest
from tracked_bus import damaged
from tracked_bus import ping
from tracked_bus import pong
from tracked_bus import read
from tracked_bus import reply
from tracked_bus import words

from msg_defs import status_keys as keys
from msg_defs.diagnostics import Level
from servobus.bus.decoder import Settings
from servobus.bus.expected_devices import Expected
from servobus.bus.report import Counts
from servobus.bus.report import Error
from servobus.bus.report import Finding
from servobus.bus.table import Observed
from servobus.model.models import Models
from servobus.monitor import Monitor
from servobus.status import bus_status
from servobus.status import device_status
from servobus.status import PortState
from servobus.status import statuses_of
from servobus.status import timing_metrics

ROOT = Path(__file__).parents[1]
REPORT = Monitor('arm', Models()).report(0)
ONE_DEVICE = Monitor('', Models(), Settings(devices=(Expected(3, 'MX-64', ''),))).report(0)
FULL = 'capture stopped: bus.txt: No space left on device; make room and restart the node'


@pytest.mark.parametrize(('heard', 'problem', 'level', 'message'), [
    (Level.OK, '', Level.WARN, f'{FULL}; as heard'),
    (Level.WARN, '', Level.WARN, f'as heard; {FULL}'),
    (Level.STALE, '', Level.STALE, f'as heard; {FULL}'),
    (Level.ERROR, '', Level.ERROR, f'as heard; {FULL}'),
    (Level.OK, 'lost', Level.ERROR, f'lost; {FULL}'),
])
def test_what_is_to_be_done_beside_the_bus_is_a_warning(heard, problem, level, message):
    report = REPORT._replace(level=heard, message='as heard')
    port = PortState('port', problem, (), FULL)
    status = bus_status('dxl_monitor', 'arm', report, port, False)
    assert (status.level, status.message) == (level, message)


def test_every_counter_with_a_key_is_published_in_its_status():
    """A new counter takes two edits: its line in Counts and the place that counts."""
    shown = [one for one in fields(Counts) if one.metadata]
    totals = Counts(**{one.name: 100 + n for n, one in enumerate(shown)})
    blank = Monitor('arm', Models(), Settings(devices=(Expected(1),))).report(0)
    device = blank.devices[0]._replace(totals=totals, window=Counts(answers=3, missed=1))
    values = dict(device_status('dxl_monitor', '', device, (), False).values)
    assert [values[one.metadata['key']] for one in shown] == [
        str(100 + n) for n in range(len(shown))]
    assert values[keys.LOSS] == '25'


@pytest.mark.parametrize('key', [
    value for name, value in vars(keys).items() if name.isupper() and isinstance(value, str)])
def test_every_key_that_programs_read_is_documented(key):
    assert f'`{key}' in (ROOT / 'docs' / 'diagnostics.md').read_text()


def test_a_finding_carries_how_bad_it_is():
    found = (Finding('noise', Level.WARN, None, 'check the cable'),
             Finding('too_hot', Level.ERROR, 3, 'let it cool'))
    unknown = Finding('too_hot', Level.WARN, 1, 'never read')
    status = bus_status('dxl_monitor', '', REPORT._replace(findings=found, doubts=(unknown,)),
                        PortState('port', '', ()), False)
    assert {('severity.noise', 'warn'), ('cannot tell.too_hot', '001: never read')} <= {
        *status.values}
    [device] = ONE_DEVICE.devices
    assert device_status('dxl_monitor', '', device, found, False).values[-2:] \
        == [('finding.too_hot', 'let it cool'), ('severity.too_hot', 'error')]


def statuses(port, **device):
    """Return those of a bus with a device that has a temperature, of /diagnostics."""
    [one] = ONE_DEVICE.devices
    field = next(field for field in one.model.fields if field.name == 'Present Temperature')
    seen = (Observed(field, field.decode(bytes([61])), 0.5, 'r'),)
    report = ONE_DEVICE._replace(devices=(one._replace(observed=seen, **device),))
    return statuses_of('rover1/dxl_monitor', '', report, port, False)


def test_a_hardware_id_says_what_it_is_and_where():
    port = PortState('/dev/ttyUSB0', '', (), bus='ttyUSB0')
    bus, device = statuses(port)
    [*_, load, latency] = timing_metrics('rover1/dxl_monitor', ONE_DEVICE, port)
    assert bus.hardware_id == load.hardware_id == 'rover1/servo bus ttyUSB0'
    assert device.hardware_id == latency.hardware_id == 'rover1/servo bus ttyUSB0/ID 3'
    assert (load.bus, load.bus_name) == ('', 'ttyUSB0')


def test_the_short_form_shows_heat():
    _, device = statuses(PortState('port', '', ()))
    assert ('Present Temperature (°C)', '61') in device.values


def test_the_bus_begins_with_what_is_wrong():
    bus, _ = statuses(PortState('port', '', ()), level=Level.ERROR, message='no answer')
    assert bus.values[:3] == [('Port', 'port'), ('State', 'open'),
                              ('device 003', 'error: no answer')]
    bus, _ = statuses(PortState('port', 'lost', ()), level=Level.ERROR, message='no answer')
    assert [key for key, _ in bus.values if key.startswith(keys.DEVICE_PROBLEM)] == []


def test_behind_a_closed_port_devices_are_not_called_unasked():
    [device] = ONE_DEVICE.devices
    device = device._replace(level=Level.STALE, message='silent: not asked for 9 s')
    status = device_status('dxl_monitor', '', device, (), False, is_listening=False)
    assert (status.level, status.message) \
        == (Level.STALE, 'not listening: the port of its bus is closed')
    lost = device._replace(level=Level.ERROR, message='disconnected: 7 answers missed')
    assert device_status('dxl_monitor', '', lost, (), False, False).message == lost.message


def test_the_bus_tells_model_and_number_of_its_devices():
    listed = (Expected(1, 'MX-64'), *(Expected(number, 'MX-106') for number in range(3, 7)),
              Expected(7), Expected(8))
    report = Monitor('arm', Models(), Settings(devices=listed)).report(0)
    heard = list(report.devices)
    heard[-1] = heard[-1]._replace(model_name='unknown (4711)', model_number=4711)
    values = dict(bus_status('dxl_monitor', '', report._replace(devices=tuple(heard)),
                             PortState('port', '', ()), False).values)
    assert values['Models'] == (
        '001 MX-64 (311), 003-006 MX-106 (321), 007 unknown, 008 unknown (4711)')


def test_errors_can_be_dated():
    report = REPORT._replace(stamp=20_000_000_000, started=5_000_000_000,
                             errors=(Error(12_500_000_000, '003: no answer'),))
    values = dict(bus_status('dxl_monitor', '', report, PortState('port', '', ()), True).values)
    assert (values['Running for (s)'], values['error 00']) == ('15', '7.500 s: 003: no answer')


def test_error_00_is_the_newest():
    """That nothing answered is known only when the next question comes, after it was damaged."""
    monitor = Monitor('', Models(), Settings())
    monitor.feed(ping(1) + pong(1), 1_000_000_000)
    monitor.feed(read(1) + damaged(reply(1, words(7, 0))) + read(2) + reply(2, words(7, 0)),
                 1_500_600_000)
    report = monitor.report(2_000_000_000)
    status = bus_status('dxl_monitor', '', report, PortState('port', '', ()), True)
    errors = [value for key, value in status.values if key.startswith('error ')]
    assert [error.split(' s: ')[0] for error in errors] == ['0.501', '0.500'], errors
