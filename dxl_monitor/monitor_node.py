# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""
The ROS side of the monitor: parameters, one listener and one monitor per bus, what is published.

The listeners' threads take bytes in; what is published is made from reports, a few statuses
at a time, so that 253 devices neither fill a message nor hold up the executor.
"""
from __future__ import annotations

from collections import deque
import time
from typing import Any

from diagnostic_msgs.msg import DiagnosticArray
from rclpy.clock import Clock
from rclpy.clock import ClockType
from rclpy.node import Node
from rclpy.qos import qos_profile_sensor_data
from std_srvs.srv import Trigger

from dxl_monitor.bus_log import BusLog
from dxl_monitor.monitor_settings import make_recorders
from dxl_monitor.monitor_settings import PARAMETERS
from dxl_monitor.timers import Timers
from mecarover_serial.resident_memory import resident_memory
from mecarover_serial.ros_node import declare
from mecarover_serial.ros_node import GraphCheck
from mecarover_serial.ros_node import overridable_publisher
from mecarover_serial.ros_node import Stoppable
from mecarover_serial.ros_node import warn_of_overrides
from msg_defs.crc import CRC_IS_FAST
from msg_defs.crc import SLOW_CRC_WARNING
from msg_defs.diagnostics import Status
from msg_defs.diagnostics import topic_names
from msg_defs.diagnostics import worst_first
from msg_defs.ros import DiagnosticArrays
from msg_defs.ros import full_name
from msg_defs.ros import joint_state
from msg_defs.ros import QUEUE_DEPTH
from msg_defs.ros import slice_statuses
from msg_defs.ros import TimingPublisher
from msg_defs.ros import to_ros_time
from msg_defs.ros import to_time
from servobus.bus.report import BusReport
from servobus.monitor import Monitor
from servobus.monitored_bus import MonitoredBus
from servobus.settings import buses
from servobus.settings import load_models
from servobus.sources.listener import STARTING
from servobus.status import PortState
from servobus.status import statuses_of
from servobus.status import timing_metrics

OVERVIEW_PERIOD_S = 1.0             # /diagnostics and dxl/timing
TIMERS_CHECK_S = 1.0                # whether the timers are well
ALARM_CHECK_S = 0.1                 # whether something cannot wait for the next report
REPORTS_APART_NS = 200_000_000      # ... and at least so long after the one before
RETRY_NS = 50_000_000               # until a report that had to wait is tried again


Reported = tuple[MonitoredBus, BusReport, PortState]


class JointStates:
    """dxl/joint_states of one bus."""

    def __init__(self, node: Node, monitor: Monitor, topic: str) -> None:
        from sensor_msgs.msg import JointState  # here, as in msg_defs/ros.py
        self._monitor = monitor
        self._since = 0
        self._publisher = overridable_publisher(node, JointState, topic, qos_profile_sensor_data)

    def publish(self, now: int, now_ros: int) -> None:
        """Publish what was read since the last time, if anything was."""
        joints, stamp = self._monitor.joints(self._since)
        if joints:
            self._since = stamp
            self._publisher.publish(joint_state(joints, to_ros_time(stamp, now, now_ros)))


class MonitorNode(Stoppable):
    """
    The node dxl_monitor; made once, ended by `stop`.

    | attributes | who writes them |
    |---|---|
    | _waiting, _timer.period_s | _tick(): the thread of the timers |
    | _alarms, _reported, _known_complaints | _make_reports() in that thread |
    | _levels, _overview_s, _port_words | _publish_reports() in that thread |
    | _is_stopped | stop() |
    | all others | set once |
    """

    def __init__(self) -> None:
        self.node = Node('dxl_monitor')
        self._log = self.node.get_logger()
        values = declare(self.node, PARAMETERS, lambda changes: None)
        if not CRC_IS_FAST:
            self._log.warning(SLOW_CRC_WARNING)
        models = load_models(values['model_dirs'])
        found = buses(values, models)
        self._recorders = make_recorders(values)
        self._buses = [MonitoredBus(bus, models, self._recorders, values['joint_state_rate'])
                           for bus in found]
        self._graph_check = GraphCheck(self.node)
        self._known_complaints: set[str] = set()
        self._port_words: dict[str, str] = {}
        self._bus_logs = [BusLog(one.bus.label) for one in self._buses]
        self._levels: list[int] = []
        self._alarms = 0                # so many were there in the last report
        self._reported = 0              # when that was, monotonic ns
        self._overview_s = 0.0
        self._waiting: deque[list[Status]] = deque()    # slices of the report, not yet published
        self._period_s = 1.0 / values['publish_rate']
        self._overview, self._tables = (
            self.node.create_publisher(DiagnosticArray, topic, QUEUE_DEPTH)
            for topic in ('/diagnostics', 'dxl/diagnostics'))
        self._overview_arrays = DiagnosticArrays()
        self._table_arrays = DiagnosticArrays()
        self._timing = TimingPublisher(
            self.node, 'dxl', values['timing_topics'],
            [one.bus.name for one in self._buses])
        self.node.create_service(Trigger, '~/reset_statistics', self._reset_statistics)
        self.node.create_service(Trigger, '~/save_recording', self._save_recording)
        self._timers = Timers()
        self._timer = self._timers.add(1e-9 * RETRY_NS, self._tick)
        self._joint_states = self._start_joint_states(values['joint_state_rate'])
        self._timers.add(ALARM_CHECK_S, self._report_alarms)
        self.node.create_timer(TIMERS_CHECK_S, self._timers.check,
                               clock=Clock(clock_type=ClockType.STEADY_TIME))
        self._is_stopped = False
        self._recorders.start()
        for one in self._buses:
            one.listener.start()
        self._started = time.monotonic_ns()
        self._timers.start()

    def stop(self) -> None:
        """Close the ports, then the capture."""
        if not self._is_stopped:
            self._is_stopped = True
            self._timers.stop()
            for one in self._buses:
                one.listener.stop()
            self._recorders.stop()
            self._log_recorders()

    def is_working(self) -> bool:
        """Tell whether reports are made and every port is listened to, or waited for."""
        return self._timers.is_alive() and all(one.listener.is_alive() for one in self._buses)

    def _start_joint_states(self, rate: float) -> list[JointStates]:
        """Return the publishers of joint states, none at rate 0; a timer works them."""
        if not rate:
            return []
        self._timers.add(1.0 / rate, self._publish_joints)
        parts = topic_names([one.bus.label for one in self._buses if one.bus.label])
        topics = ['/'.join(filter(None, ('dxl/joint_states', parts.get(one.bus.label))))
                  for one in self._buses]
        found = [JointStates(self.node, one.monitor, topic)
                 for one, topic in zip(self._buses, topics, strict=True)]
        warn_of_overrides(self.node, [f'{self.node.resolve_topic_name(topic)}.publisher'
                                      for topic in topics])
        return found

    def _publish_joints(self) -> None:
        now, now_ros = time.monotonic_ns(), self.node.get_clock().now().nanoseconds
        for one in self._joint_states:
            one.publish(now, now_ros)

    def _tick(self) -> None:
        """Publish a slice of the report; make a new report when there is none left."""
        if self._is_stopped:            # closed ports are as they should be now
            return
        reports: list[Reported] = []
        if not self._waiting:
            now = time.monotonic_ns()
            if self._is_early(now) or self._is_late(now):
                self._timer.period_s = 1e-9 * RETRY_NS
                return
            reports = self._make_reports(now)
            self._waiting.extend(slice_statuses(self._statuses(reports, True)))
            self._timer.period_s = self._period_s / max(1, len(self._waiting))
        if self._waiting:
            self._tables.publish(self._table_arrays.array(self._waiting.popleft(), self._stamp()))
        if reports:
            self._publish_reports(reports)
            self._log_recorders()

    def _is_early(self, now: int) -> bool:
        """
        Return whether the first report must wait: for a subscriber, and until ports were tried.

        After a period it waits no more.
        """
        return not self._reported and now - self._started < 1e9 * self._period_s and (
            not self._tables.get_subscription_count()
            or any(one.listener.state.kind == STARTING for one in self._buses))

    def _is_late(self, now: int) -> bool:
        late = [one.is_late(now) for one in self._buses]     # each: it notes since when
        return any(late)

    def _report_alarms(self) -> None:
        """Tell at once what cannot wait: a device was lost, came back or has an alert."""
        now = time.monotonic_ns()
        if (self._count_alarms() != self._alarms and now - self._reported > REPORTS_APART_NS
                and not self._is_stopped and not self._is_late(now)):
            self._publish_reports(self._make_reports(now))

    def _count_alarms(self) -> int:
        return sum(one.monitor.alarms() for one in self._buses)

    def _make_reports(self, now: int) -> list[Reported]:
        self._alarms, self._reported = self._count_alarms(), now
        complaints = self._graph_check.complaints()
        for line in set(complaints) - self._known_complaints:
            self._log.warning(line)
        self._known_complaints = set(complaints)
        reports = [(one, one.report(now)) for one in self._buses]
        if self._recorders.flight is not None:
            for one, report in reports:
                self._recorders.flight.record_report(one.bus.name, report)
            self._log_recorders()
        return [(one, report, one.port_state(complaints)) for one, report in reports]

    def _publish_reports(self, reports: list[Reported]) -> None:
        """
        Publish the overview when it is time or a level changed, and timing when it is time.

        Logging comes last: the first line of a process takes rclpy 30 ms.
        """
        levels = [level for _, report, port in reports for level in (
            bool(port.problem), bool(port.warning), report.level,
            *(device.level for device in report.devices))]
        now_s = time.monotonic()
        is_time = now_s - self._overview_s >= OVERVIEW_PERIOD_S - self._period_s / 2
        if is_time or levels != self._levels:
            self._levels = levels
            for array in self._overview_arrays.build(
                    self._statuses(reports, False), self._stamp()):
                self._overview.publish(array)
        if is_time:
            self._overview_s = now_s
            self._publish_timing(reports)
        for log, (one, report, port) in zip(self._bus_logs, reports, strict=True):
            self._log_port(one.listener.state.text, port)
            if not port.problem:
                for line in log.lines(report):
                    self._log.warning(line)

    def _statuses(self, reports: list[Reported], whole: bool) -> list[Status]:
        """Return the buses, then the devices, both the worst first: a reader sees the top."""
        node = full_name(self.node)
        groups = [statuses_of(node, one.bus.label, report, port, whole)
                  for one, report, port in reports]
        return [*worst_first(bus for bus, *_ in groups),
                *worst_first(device for _, *devices in groups for device in devices)]

    def _stamp(self) -> Any:
        return to_time(self.node.get_clock().now().nanoseconds)

    def _publish_timing(self, reports: list[Reported]) -> None:
        metrics = [resident_memory()]
        for _, report, port in reports:
            metrics += timing_metrics(full_name(self.node), report, port)
        self._timing.publish(metrics, self.node.get_clock().now().nanoseconds)

    def _log_port(self, words: str, port: PortState) -> None:
        """Log what happens to a port, once per change."""
        if self._port_words.get(port.port) != words:
            self._port_words[port.port] = words
            self._log_text(words, bool(port.problem))

    def _log_recorders(self) -> None:
        """Log what becomes of the recordings, once per change."""
        for words, is_problem in self._recorders.news():
            self._log_text(words, is_problem)

    def _log_text(self, words: str, is_problem: bool) -> None:
        if is_problem:                  # two lines: rclpy ties a severity to a place in the code
            self._log.error(words)
        else:
            self._log.info(words)

    def _save_recording(self, request: Any, response: Any) -> Any:
        response.success, response.message = self._recorders.save()
        return response

    def _reset_statistics(self, request: Any, response: Any) -> Any:
        for one in self._buses:
            one.monitor.reset_statistics(time.monotonic_ns())
        response.success = True
        response.message = 'all counts and statistics restart at 0, except those of the port'
        return response
