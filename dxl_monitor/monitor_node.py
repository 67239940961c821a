# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""
The ROS side of the monitor: parameters, one listener and one monitor per bus, what is published.

Bytes are taken in by the taps' threads; what is published is made from reports, a few statuses
at a time, so that 253 devices neither fill a message nor hold up the executor.
"""
from __future__ import annotations

from collections import deque
from collections.abc import Sequence
from functools import cached_property
import time
from typing import Any

from diagnostic_msgs.msg import DiagnosticArray
from rclpy.clock import Clock
from rclpy.clock import ClockType
from rclpy.node import Node
from rclpy.qos import qos_profile_sensor_data
from std_srvs.srv import Trigger

from dxl_monitor.bus.report import BusReport
from dxl_monitor.model.models import Models
from dxl_monitor.monitor import Monitor
from dxl_monitor.monitor_settings import Bus
from dxl_monitor.monitor_settings import buses
from dxl_monitor.monitor_settings import load_models
from dxl_monitor.monitor_settings import make_recorders
from dxl_monitor.monitor_settings import PARAMETERS
from dxl_monitor.monitor_status import bus_status
from dxl_monitor.monitor_status import device_metrics
from dxl_monitor.monitor_status import device_status
from dxl_monitor.monitor_status import PortState
from dxl_monitor.port.driver import adapter
from dxl_monitor.port.listener import STARTING
from dxl_monitor.port.listener import TAKE_EVERY_S
from dxl_monitor.port.listeners import listener_on
from dxl_monitor.port.reader import NAME as READER_NAME
from dxl_monitor.port.source_name import is_live
from dxl_monitor.record.capture import Wire
from dxl_monitor.record.recorders import Recorders
from dxl_monitor.timers import Timers
from mecarover_serial.inspection import Inspection
from mecarover_serial.process import resident_memory_mb
from mecarover_serial.ros_node import declare
from mecarover_serial.ros_node import overridable_publisher
from mecarover_serial.ros_node import Surroundings
from msg_defs.crc import CRC_IS_FAST
from msg_defs.crc import SLOW_CRC_WARNING
from msg_defs.event import Change
from msg_defs.event import UNKNOWN
from msg_defs.reports import Metric
from msg_defs.reports import Status
from msg_defs.reports import topic_names
from msg_defs.ros import DiagnosticArrays
from msg_defs.ros import full_name
from msg_defs.ros import joint_state
from msg_defs.ros import QUEUE_DEPTH
from msg_defs.ros import slices
from msg_defs.ros import TimingPublisher
from msg_defs.ros import to_ros_time
from msg_defs.ros import to_time

OVERVIEW_S = 1.0            # /diagnostics and dxl/timing
CHECK_S = 1.0               # whether the timers are well
LOOK_S = 0.1                # whether something cannot wait for the next report
APART_NS = 200_000_000      # ... and at least so long after the one before
BEHIND_NS = 1_000_000_000   # after a freeze; else a listener is 0.3 s late at most
AGAIN_NS = 50_000_000       # until it is looked again whether that is over; at the start too
PATIENCE_NS = 2_500_000_000     # longer is not a freeze: its reader hangs; a dashboard waits 4 s


class MonitoredBus:
    """One bus: its listener and its monitor, and the recorders of all buses."""

    def __init__(self, bus: Bus, models: Models, recorders: Recorders,
                 joint_state_rate: float) -> None:
        self.bus = bus
        self.monitor = Monitor(bus.label, models, bus.settings, idle_is_told=True)
        self._behind_since = 0
        self._known_adapter: tuple[int, list[tuple[str, str]]] = (0, [])
        self._recorders = recorders
        self._inspection = None if is_live(bus.port) else Inspection(bus.port, [READER_NAME])
        self.listener = listener_on(
            bus.port, bus.settings.baud,
            self._record_and_feed if recorders else self.monitor.feed,
            self.monitor.flush_if_idle, on_change=self._change,
            on_pieces=None if recorders else self.monitor.feed_pieces,
            take_every_s=min(TAKE_EVERY_S, 0.5 / (joint_state_rate or 1.0)))

    @cached_property
    def _wire(self) -> Wire:
        """What a capture says about the bus; known once there are bytes."""
        return Wire(self.bus.name, self.bus.settings.baud, self.listener.latency_timer_ms or 0,
                    self.bus.port)

    def _record_and_feed(self, chunk: bytes, stamp: int, side: str = UNKNOWN) -> None:
        self._recorders.take(self._wire, chunk, stamp, side)
        self.monitor.feed(chunk, stamp, side)

    def _change(self, change: Change, stamp: int) -> None:
        self._recorders.change(self._wire, change, stamp)
        self.monitor.change(change, stamp)

    def is_late(self, now: int) -> bool:
        """Return whether a report must wait, because what came is still to be read."""
        if not self.listener.state.is_open or now - self.listener.listened < BEHIND_NS:
            self._behind_since = 0
            return False
        self._behind_since = self._behind_since or now
        return now - self._behind_since < PATIENCE_NS

    def report(self, now: int) -> BusReport:
        """Return what is known; what the adapter delays is not silence."""
        self.monitor.expect_delay(self.listener.latency_timer_ms or 0)
        return self.monitor.report(now, self.listener.counters.line_errors,
                                   self.listener.state.is_open and not self._behind_since)

    def port_state(self, warnings: Sequence[str] = ()) -> PortState:
        """Return what the driver and the thread know about the port; `warnings` are the node's."""
        counters, state = self.listener.counters, self.listener.state
        values = [
            ('Bytes read', str(counters.bytes)),
            ('Reads', str(counters.reads)),
            ('Openings', str(counters.openings)),
            ('Largest gap between reads (ms)', f'{1e3 * counters.largest_gap_s:.1f}'),
            ('Low latency mode', str(self.listener.low_latency).lower()),
        ]
        if state.is_open:
            values.append(('Read by', 'a process of its own' if self.listener.reader_pid
                           else 'a thread of the node'))
            values += self._adapter(counters.openings)
        if self.listener.latency_timer_ms is not None:
            values.append(('Latency timer (ms)', str(self.listener.latency_timer_ms)))
        values += self._recorders.values()
        if counters.line_errors is not None:
            values += [(f'Driver: {name}', str(count))
                       for name, count in counters.line_errors._asdict().items()]
        warning = self._recorders.problem or '; '.join(
            [*self.listener.problems(), *self._complaints()])
        if state.is_open and self._behind_since:
            warning = (f'{self.bus.port}: its reader is not responding, so the data is stale; '
                       'plug the adapter in again, or restart the node')
        return PortState(self.bus.port, '' if state.is_open else state.text, tuple(values),
                         '; '.join(filter(None, [*warnings, warning])))

    def _complaints(self) -> list[str]:
        """Return what disturbs the port while it is open: a login, a console."""
        if self._inspection is None or not self.listener.state.is_open:
            return []
        self._inspection.look(self.listener.counters.openings, time.monotonic())
        return self._inspection.complaints

    def _adapter(self, openings: int) -> list[tuple[str, str]]:
        """Return what the adapter says of itself; another one may be there after each opening."""
        if self._known_adapter[0] != openings:
            self._known_adapter = openings, adapter(self.bus.port)
        return self._known_adapter[1]


Heard = tuple[MonitoredBus, BusReport, PortState]


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


class MonitorNode:
    """
    The node dxl_monitor; made once, ended by `stop`.

    | attributes | who writes them |
    |---|---|
    | _waiting, _alarms, _reported, _said | _tick(), _look(): the thread of the timers |
    | _levels, _overview_s, _port_words | _tell() in that thread |
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
        self._surroundings = Surroundings(self.node)
        self._said: set[str] = set()
        self._port_words: dict[str, str] = {}
        self._levels: list[int] = []
        self._alarms = 0                # so many were there in the last report
        self._reported = 0              # when that was, monotonic ns
        self._overview_s = 0.0
        self._waiting: deque[list[Status]] = deque()    # slices of the report, not yet published
        self._period_s = 1.0 / values['publish_rate']
        self._overview = self._publisher('/diagnostics')
        self._tables = self._publisher('dxl/diagnostics')
        self._overview_arrays = DiagnosticArrays()
        self._table_arrays = DiagnosticArrays()
        self._timing = TimingPublisher(
            self.node, 'dxl', values['timing_topics'],
            [one.bus.label for one in self._buses])
        self.node.create_service(Trigger, '~/reset_statistics', self._reset_statistics)
        self.node.create_service(Trigger, '~/save_recording', self._save_recording)
        self._timers = Timers()
        self._timer = self._timers.add(1e-9 * AGAIN_NS, self._tick)
        self._joint_states = self._start_joint_states(values['joint_state_rate'])
        self._timers.add(LOOK_S, self._look)
        self.node.create_timer(CHECK_S, self._timers.check,
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
            self._tell_recorders()

    def suspend(self) -> None:
        """Nothing moves here."""

    def resume(self) -> None:
        """Do nothing: what was not heard is missing, and counted as such."""

    def _publisher(self, topic: str) -> Any:
        return self.node.create_publisher(DiagnosticArray, topic, QUEUE_DEPTH)

    def _start_joint_states(self, rate: float) -> list[JointStates]:
        """Return the publishers of joint states, none at rate 0; a timer works them."""
        if not rate:
            return []
        self._timers.add(1.0 / rate, self._publish_joints)
        parts = topic_names([one.bus.label for one in self._buses if one.bus.label])
        return [JointStates(self.node, one.monitor, '/'.join(filter(None, (
            'dxl/joint_states', parts.get(one.bus.label))))) for one in self._buses]

    def _publish_joints(self) -> None:
        now, now_ros = time.monotonic_ns(), self.node.get_clock().now().nanoseconds
        for one in self._joint_states:
            one.publish(now, now_ros)

    def _tick(self) -> None:
        """Publish a slice of the report; make a new report when there is none left."""
        if self._is_stopped:            # closed ports are as they should be now
            return
        heard: list[Heard] = []
        if not self._waiting:
            now = time.monotonic_ns()
            if self._is_early(now) or self._is_late(now):
                self._timer.period_s = 1e-9 * AGAIN_NS
                return
            heard = self._hear(now)
            self._waiting.extend(slices(self._statuses(heard, True)))
            self._timer.period_s = self._period_s / max(1, len(self._waiting))
        if self._waiting:
            self._tables.publish(self._table_arrays.array(self._waiting.popleft(), self._stamp()))
        if heard:
            self._tell(heard)
            self._tell_recorders()

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

    def _look(self) -> None:
        """Tell at once what cannot wait: a device was lost, came back or has an alert."""
        now = time.monotonic_ns()
        if (self._count_alarms() != self._alarms and now - self._reported > APART_NS
                and not self._is_stopped and not self._is_late(now)):
            self._tell(self._hear(now))

    def _count_alarms(self) -> int:
        return sum(one.monitor.alarms() for one in self._buses)

    def _hear(self, now: int) -> list[Heard]:
        self._alarms, self._reported = self._count_alarms(), now
        around = self._surroundings.complaints()
        for line in set(around) - self._said:
            self._log.warning(line)
        self._said = set(around)
        reports = [(one, one.report(now)) for one in self._buses]
        if self._recorders.flight is not None:
            for one, report in reports:
                self._recorders.flight.look(one.bus.name, report)
            self._tell_recorders()
        return [(one, report, one.port_state(around)) for one, report in reports]

    def _tell(self, heard: list[Heard]) -> None:
        """
        Publish the overview when it is time or a level changed, and timing when it is time.

        Logging comes last: the first line of a process takes rclpy 30 ms.
        """
        levels = [level for _, report, port in heard for level in (
            bool(port.problem), bool(port.warning), report.level,
            *(device.level for device in report.devices))]
        now_s = time.monotonic()
        is_time = now_s - self._overview_s >= OVERVIEW_S - self._period_s / 2
        if is_time or levels != self._levels:
            self._levels = levels
            self._publish(self._overview, self._overview_arrays, self._statuses(heard, False))
        if is_time:
            self._overview_s = now_s
            self._publish_timing([report for _, report, _ in heard])
        for one, _, port in heard:
            self._tell_port(one.listener.state.text, port)

    def _statuses(self, heard: list[Heard], whole: bool) -> list[Status]:
        node = full_name(self.node)
        statuses = []
        for one, report, port in heard:
            label = one.bus.label
            statuses.append(bus_status(node, label, report, port, whole))
            statuses += [device_status(node, label, device, report.findings, whole,
                                       not port.problem)
                         for device in report.devices]
        return statuses

    def _publish(self, publisher: Any, arrays: DiagnosticArrays, statuses: list[Status]) -> None:
        for array in arrays.build(statuses, self._stamp()):
            publisher.publish(array)

    def _stamp(self) -> Any:
        return to_time(self.node.get_clock().now().nanoseconds)

    def _publish_timing(self, reports: list[BusReport]) -> None:
        metrics = [Metric('resident_memory', 'MB', value=resident_memory_mb())]
        for report in reports:
            metrics += report.metrics
            metrics += device_metrics(report)
        self._timing.publish(metrics, self.node.get_clock().now().nanoseconds)

    def _tell_port(self, words: str, port: PortState) -> None:
        """Log what happens to a port, once per change."""
        if self._port_words.get(port.port) != words:
            self._port_words[port.port] = words
            if port.problem:            # two lines: rclpy ties a severity to a place in the code
                self._log.error(words)
            else:
                self._log.info(words)

    def _tell_recorders(self) -> None:
        """Log what becomes of the recordings, once per change."""
        for words, is_problem in self._recorders.news():
            if is_problem:              # two lines, as above
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
