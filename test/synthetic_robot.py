# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""
A robot that consists of what it publishes: device, bus, bridge and timing statuses, as bytes.

The statuses are made by the same functions as those of the nodes, but for those of the bridge:
test_synthetic_robot.py compares these. `serialise` turns them into what a subscription gets, so
that the dashboard can be tested without ROS.
"""
import math
from pathlib import Path

import yaml

from fuzz.dashboard import cdr
from msg_defs.diagnostics import Level
from msg_defs.diagnostics import Metric
from msg_defs.diagnostics import metric_status
from msg_defs.diagnostics import Status
from msg_defs.running_statistics import Summary
from servobus.bus import report as words
from servobus.bus.decoder import Settings
from servobus.bus.expected_devices import Expected
from servobus.bus.report import Counts
from servobus.bus.report import Error
from servobus.bus.report import Finding
from servobus.bus.report import ReplyLatency
from servobus.bus.table import Observed
from servobus.model.models import Models
from servobus.monitor import Monitor
from servobus.status import PortState
from servobus.status import statuses_of
from servobus.status import timing_metrics

NODE = 'dxl_monitor'
BRIDGE_PORT = '/dev/ttyAMA0'
BRIDGE = yaml.safe_load(Path(__file__).with_name('bridge_status.yaml').read_text())['published']
NO_COMMANDS = '/cmd_vel: no node publishes it; start teleop_twist_keyboard or your planner'
JOINTS = ('left_hip_yaw', 'right_hip_yaw', 'left_hip_roll', 'right_hip_roll', 'left_hip_pitch',
          'right_hip_pitch', 'left_knee', 'right_knee', 'left_ankle_pitch', 'right_ankle_pitch',
          'left_ankle_roll', 'right_ankle_roll', 'left_shoulder_pitch', 'right_shoulder_pitch',
          'left_shoulder_roll', 'right_shoulder_roll', 'left_elbow', 'right_elbow', 'neck_yaw',
          'neck_pitch')
HUMANOID = (*((i + 1, 'MX-106' if i < 10 else 'MX-64', joint) for i, joint in enumerate(JOINTS)),
            (100, 'Rhoban DXL Board', ''), (101, 'BitFoot', 'left_foot'),
            (102, 'BitFoot', 'right_foot'), (103, 'Bit-Bots IMU', 'imu'))
MANY = tuple((i, ('MX-106', 'MX-64', 'XL430-W250')[i % 3], '') for i in range(253))


def serialise(statuses, order='<'):
    """Return the CDR of a DiagnosticArray with these statuses."""
    return cdr([(one.level, one.name, one.message, one.hardware_id,
                 [pair[:2] for pair in one.values]) for one in statuses], order)


def summary(mean, spread):
    return Summary(100, mean, spread / 3, max(0.0, mean - spread), mean + 2 * spread,
                   mean, mean + spread, mean + 1.7 * spread)


class SyntheticRobot:
    """Buses of (id, model, joint) by name; `lost`, `warned` and so on hold device IDs."""

    def __init__(self, buses=None, namespace=''):
        self._prefix = f'{namespace}/' if namespace else ''
        self._node = f'{self._prefix}{NODE}'
        self._bridge = f'{self._prefix}vel2d_bridge'
        self.buses = {'': HUMANOID} if buses is None else buses
        self.lost, self.warned, self.silent, self.faulty = set(), set(), set(), set()
        self.waiting = set()                   # in a Sync Read, after 007
        self.stumbles = set()                  # these miss an answer and go on
        self.port_problem = self.bridge_problem = ''
        self.findings = ()
        self.velocity = (0.32, 0.11, 0.6)
        self.absence = ''                      # no node publishes cmd_vel
        self.started_s = 0.0                   # when its monitor was started
        self._made, self._made_s = [], None
        models = Models()
        self._blank = {bus: Monitor(bus, models, Settings(
            devices=tuple(Expected(*device) for device in devices))).report(0)
            for bus, devices in self.buses.items()}

    def tables(self, time_s):
        """Return what goes to dxl/diagnostics."""
        return self._statuses(time_s, True)

    def overview(self, time_s):
        """Return what goes to /diagnostics, the bridge included."""
        return [*self._statuses(time_s, False), *self.bridge(time_s)]

    def _statuses(self, time_s, whole):
        statuses = []
        for bus, report in self._reports(time_s):
            statuses += statuses_of(self._node, bus, report, self._port(bus), whole)
        return statuses

    def _port(self, bus):
        return PortState(f'/dev/tty{bus or "USB0"}', self.port_problem,
                         (('Latency timer (ms)', '1'), ('Openings', '1')), bus=bus or 'ttyUSB0')

    def _reports(self, time_s):
        """Return (bus, report) of all buses; the last ones are kept."""
        if self._made_s != time_s:
            self._made, self._made_s = list(self._make(time_s)), time_s
        return self._made

    def _make(self, time_s):
        for bus, blank in self._blank.items():
            reports = tuple(self._device(time_s, device) for device in blank.devices)
            lost = [one for one in reports if one.state == words.DISCONNECTED]
            errors = tuple(
                Error(int((time_s - 20 + i) * 1e9),
                      f'{one.id:03}: no answer to Read at Present Position')
                for i, one in enumerate([*lost * 3, *(
                    one for one in reports if one.id in self.stumbles)]))
            yield bus, blank._replace(
                stamp=int(time_s * 1e9), started=1 + int(self.started_s * 1e9),
                devices=reports, errors=errors,
                level=Level.WARN if lost else Level.OK, findings=self.findings,
                message=f'{len(reports) - len(lost)} of {len(reports)} devices connected',
                counters=blank.counters | {
                    'Bytes': int(time_s * 84000), 'Packets': int(time_s * 3900)},
                rates={'bytes': 84000.0, 'packets': 3900.0, 'errors': 0.4 * len(lost)})

    def _device(self, time_s, blank):
        number, model = blank.id, blank.model
        state, level, message = words.CONNECTED, Level.OK, 'connected'
        missed = 0
        if number in self.lost:
            state, level, missed = words.DISCONNECTED, Level.ERROR, 7
            message = 'disconnected: 7 answers missed'
        elif number in self.faulty:
            level, message = Level.ERROR, 'hardware error: overheating'
        elif number in self.waiting:
            state, level = words.WAITING, Level.WARN
            message = 'asked but not served: 007 before it does not answer'
        elif number in self.silent:
            state, level, message = words.SILENT, Level.STALE, 'silent: not asked for 9 s'
        elif number in self.warned:
            level, message = Level.WARN, '12 of 310 answers missed'
        missed_s = 12 if number in self.warned else 7 if number in self.lost else 0
        answers_s = 0 if number in self.lost else 298
        latency = 0.11 + 0.01 * math.sin(time_s + number)
        return blank._replace(
            firmware=44, state=state, level=level, message=message,
            totals=Counts(answers=int(time_s * 100), missed=3 * missed, writes=int(time_s * 50)),
            window=Counts(answers=answers_s, missed=missed_s), missed_in_a_row=missed,
            observed=tuple(self._observe(model, number, time_s)), unobserved=9,
            latency=ReplyLatency(summary(latency, 0.02), summary(latency, 0.05), 0.94))

    def _observe(self, model, number, time_s):
        for field in model.fields[:60]:
            raw = bytes(field.size)
            age_s, source = 12.0 + time_s % 3600, 'r'
            if field.name.startswith('Present Position'):
                raw = self._position(field.size, number, time_s)
                age_s = 0.01
            elif field.name.startswith('Goal Position'):
                raw = self._position(field.size, number, time_s + 0.15)
                age_s, source = 0.01, 'w'
            elif field.name == 'Present Temperature':
                raw, age_s = bytes([41 + number % 7]), 0.6
            elif field.name == 'Present Input Voltage':
                raw, age_s = (152 + int(3 * math.sin(time_s))).to_bytes(field.size, 'little'), 0.6
            elif field.name == 'ID':
                raw = bytes([number])
            yield Observed(field, field.decode(raw), age_s, source)

    def _position(self, size, number, time_s):
        step = int(2048 + 500 * math.sin(1.7 * time_s + number))
        return step.to_bytes(size, 'little', signed=True)

    def timing(self, time_s):
        """Return what goes to dxl/timing."""
        wave = math.sin(time_s / 9)
        metrics = [Metric('resident_memory', 'MB', value=61.2)]
        for bus, report in self._reports(time_s):
            window = {'time_per_buffer': ('ms', 0.42 + 0.03 * wave, 0.2),
                      'time_between_buffers': ('ms', 4.1, 0.8), 'bytes_per_buffer': ('B', 344, 80)}
            single = {'byte_rate': ('B/s', 84000 + 900 * wave),
                      'packet_rate': ('Hz', 3900 + 40 * wave),
                      'error_rate': ('Hz', 0.4 * len(self.lost)),
                      'bus_load': ('%', 42 + 5 * wave)}
            mine = (*(Metric(name, unit, summary(mean, spread), summary(mean, 3 * spread), bus=bus)
                      for name, (unit, mean, spread) in window.items()),
                    *(Metric(name, unit, value=float(value), bus=bus)
                      for name, (unit, value) in single.items()))
            metrics += timing_metrics(
                self._node, report._replace(metrics=mine), self._port(bus))
        return [metric_status(self._node, metric) for metric in metrics]

    def bridge(self, time_s):
        """Return what vel2d_bridge puts on /diagnostics."""
        speeds = [f'{speed:g}' for speed in self.velocity]
        doing = 'driving' if any(self.velocity) else 'stopped'
        commands = str(int(10 * time_s))
        return [
            self._of_bridge('link', self.bridge_problem or 'open', [
                'closed' if self.bridge_problem else 'open', str(int(20 * time_s)), *speeds]),
            self._of_bridge('commands', '; '.join(filter(None, (doing, self.absence))), [
                doing, commands, commands])]

    def _of_bridge(self, part, message, filled_in):
        rest = iter(filled_in)
        return Status(
            f'{self._bridge}: {part}',
            Level.ERROR if message == self.bridge_problem else Level.OK, message, BRIDGE_PORT,
            [(key, value or next(rest)) for key, value in BRIDGE[part].items()])

    def bridge_timing(self, time_s):
        """Return what goes to vel2d/timing."""
        wave = 0.04 * math.sin(time_s / 5)
        return [metric_status(self._bridge, metric) for metric in (
            Metric('callback_to_write', 'ms', summary(0.31 + wave, 0.12), summary(0.31, 0.9)),
            Metric('write', 'ms', summary(0.09, 0.02), summary(0.09, 0.3)),
            Metric('command_period', 'ms', summary(100.2, 3.0), summary(100, 9)),
            Metric('stamp_age', 'ms'),
            Metric('frame_rate', 'Hz', value=20.0 + wave),
            Metric('resident_memory', 'MB', value=48.3))]

    def tell(self, state, time_s, at_s=None):
        """Let a state take the reports of one second; at_s: when they come, if it is another."""
        for topic, message in self.messages(time_s):
            state.store_message(topic, message, time_s if at_s is None else at_s)

    def messages(self, time_s, all_topics=True):
        """Return (topic, bytes) of one second's reports, at most 20 statuses in each."""
        self._made_s = None
        published = [('dxl/diagnostics', self.tables(time_s))]
        if all_topics:
            published += [('/diagnostics', self.overview(time_s)),
                          ('dxl/timing', self.timing(time_s)),
                          ('vel2d/timing', self.bridge_timing(time_s))]
        return [(topic, serialise(statuses[at:at + 20]))
                for topic, statuses in published for at in range(0, len(statuses), 20)]


FINDINGS = (
    Finding('missing_termination', Level.WARN, None,
            'Noise after every answer: put 120 ohm across D+ and D- at both ends of the bus'),
    Finding('return_delay', Level.WARN, 12,
            'Return Delay Time is 250 (500 us): set 0, each read then takes half as long'),
)
