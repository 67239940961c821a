# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""
The ROS side of the bridge: parameters, commands, services, reports.

Nothing here keeps the rover safe: time-outs, stops and the port live in link.py's thread, and a
callback, a graph scan or a publisher that blocks for seconds delays none of them.
"""
from __future__ import annotations

from collections import deque
from collections.abc import Sequence
import time
from typing import Any

from diagnostic_msgs.msg import DiagnosticArray
from rclpy.clock import Clock
from rclpy.clock import ClockType
from rclpy.logging import LoggingSeverity
from rclpy.node import Node
from rclpy.parameter import Parameter
from std_srvs.srv import SetBool
from std_srvs.srv import Trigger

from mecarover_serial.ros_node import declare
from mecarover_serial.ros_node import GraphCheck
from mecarover_serial.ros_node import warn_of_overrides
from msg_defs.crc import CRC_BY_INPUT
from msg_defs.crc import CRC_IS_FAST
from msg_defs.crc import SLOW_CRC_WARNING
from msg_defs.diagnostics import Level
from msg_defs.diagnostics import Status
from msg_defs.ros import DiagnosticArrays
from msg_defs.ros import full_name
from msg_defs.ros import QUEUE_DEPTH
from msg_defs.ros import TimingPublisher
from msg_defs.ros import to_time
from msg_defs.vel2d import encode
from msg_defs.vel2d import STOP
from msg_defs.vel2d import Vel2d
from servobus.port.inspection import Inspection
from servobus.port.port_error import PortError
from vel2d_bridge.bridge_settings import gate_settings
from vel2d_bridge.bridge_settings import PARAMETERS
from vel2d_bridge.bridge_settings import refuse_at_run_time
from vel2d_bridge.bridge_settings import refuse_at_start
from vel2d_bridge.bridge_settings import removed_limits
from vel2d_bridge.bridge_settings import warnings
from vel2d_bridge.bridge_status import Commands
from vel2d_bridge.bridge_status import commands_status
from vel2d_bridge.bridge_status import link_status
from vel2d_bridge.bridge_status import refusal
from vel2d_bridge.bridge_timing import Timing
from vel2d_bridge.cmd_vel_subscriber import CmdVelSubscriber
from vel2d_bridge.deadman import Deadman
from vel2d_bridge.deadman_server import NAME as DEADMAN_NAME
from vel2d_bridge.disabled_file import is_kept_off
from vel2d_bridge.disabled_file import keep
from vel2d_bridge.disabled_file import why_not_kept
from vel2d_bridge.gate import Counters
from vel2d_bridge.gate import Gate
from vel2d_bridge.gate import Outcome
from vel2d_bridge.gate import Stop
from vel2d_bridge.link import Link
from vel2d_bridge.link import NO_STOP
from vel2d_bridge.mcu_log import McuLog
from vel2d_bridge.pacer import Sent
from vel2d_bridge.port_log import PortLog

WATCH_S = 0.25              # between looks at the graph, logs and levels
REPORT_S = 1.0
THROTTLE_NS = 2_000_000_000     # between warnings of commands refused for the same reason
REFUSED_NS = 2_000_000_000      # a refused command is a complaint for so long
KEPT_FRAMES = 1000          # for the DEBUG log, between two looks
HOPELESS = ('not_a_port', 'baud', 'url')        # at the first opening: waiting will not help


class Bridge:
    """
    The node vel2d_bridge; made once, ended by `stop`.

    | attributes | who writes them |
    |---|---|
    | _values, _refused, _last_logged, _not_kept | callbacks of parameters, commands and services |
    | _known_complaints, _graph_complaints, _levels | _watch(), of the same thread |
    | _reported, _known_freezes | _watch(), too |
    | _sent, _port_log, _hopeless, _mcu | the port's thread; _watch() takes out |
    | all others | set once |
    """

    def __init__(self, deadman: Deadman) -> None:
        self.node = Node('vel2d_bridge')
        self._log = self.node.get_logger()
        self._values = declare(self.node, PARAMETERS, self._apply)
        refuse_at_start(self._values)
        self._port = self._values['port']
        self._timing = Timing()
        self._mcu = McuLog()
        self._sent: deque[Sent] = deque(maxlen=KEPT_FRAMES)
        self._port_log = PortLog()
        self._hopeless: PortError | None = None
        self._inspection = Inspection(self._port, [DEADMAN_NAME])
        self._known_complaints: set[str] = set()
        self._known_freezes = 0
        self._refused: tuple[Outcome | None, int] = None, 0
        self._last_logged: dict[Outcome, int] = {}     # ns, by reason
        self._levels: list[Level] = []
        self._not_kept = ''                         # why switching off would not outlast a restart
        self._reported = 0.0
        [self._other_crc_input] = {*CRC_BY_INPUT} - {self._values['crc_input']}
        self._link = self._make_link(deadman)
        if not self._link.gate.enabled:             # the file has said so: it is one switch
            self.node.set_parameters([Parameter('enabled', value=False)])
        self._subscriber = CmdVelSubscriber(
            self.node, self._values['message_type'], self._on_command, self._on_type)
        warn_of_overrides(self.node, [f'{self._subscriber.topic}.subscription'])
        self._graph_check = GraphCheck(self.node)
        self._graph_complaints: list[str] = []
        self.node.create_service(SetBool, '~/enable', self._enable)
        self.node.create_service(Trigger, '~/reset_statistics', self._reset_statistics)
        self._diagnostics = self.node.create_publisher(
            DiagnosticArray, '/diagnostics', QUEUE_DEPTH)
        self._arrays = DiagnosticArrays()
        self._timing_topics = TimingPublisher(
            self.node, 'vel2d', self._values['timing_topics'])
        steady = Clock(clock_type=ClockType.STEADY_TIME)    # use_sim_time must not stop it
        self.node.create_timer(WATCH_S, self._watch, clock=steady)
        if not CRC_IS_FAST:
            self._log.warning(SLOW_CRC_WARNING)
        self._warn(warnings(self._values))
        self._link.start()

    def stop(self) -> None:
        """Stop the rover, close the port, end the deadman."""
        has_stopped = self._link.close()
        self._log_changes()
        if not has_stopped:
            self._log.error(f'{self._port}: {NO_STOP} on; switch it off')

    def suspend(self) -> None:
        """Stop the rover; the process is about to be suspended."""
        self._link.suspend()

    def resume(self) -> None:
        """Begin again: what was published while we were suspended is not heard."""
        self._known_freezes = -1
        self._link.stop(Stop.FROZEN)

    def is_working(self) -> bool:
        """Tell whether the port's thread runs: without it no stop would be sent."""
        return self._link.is_working()

    def _make_link(self, deadman: Deadman) -> Link:
        values = self._values
        if not values['deadman']:
            deadman.leave()
        gate = Gate(gate_settings(values), baud=values['baud'], enabled=self._starts_enabled())
        return Link(
            values['port'], values['baud'], gate,
            crc=CRC_BY_INPUT[values['crc_input']], write_timeout_s=values['write_timeout'],
            deadman=deadman if values['deadman'] else None, on_sent=self._on_sent,
            on_received=self._mcu.feed, on_change=self._on_change)

    def _starts_enabled(self) -> bool:
        path = self._values['disabled_file']
        if problem := why_not_kept(path):
            self._log.warning(problem)
        if is_kept_off(path):
            self._log.warning(f'{path}: exists because commands were switched off when the last '
                              'bridge ended, so they are refused; call ~/enable with data: true')
            return False
        return bool(self._values['enabled'])

    def _apply(self, changes: dict[str, Any]) -> None:
        """Take parameters that changed at run time."""
        refuse_at_run_time(changes)
        before = dict(self._values)
        self._values |= changes
        if 'enabled' in changes:
            self._switch(changes['enabled'])
        self._link.apply(gate_settings(self._values), self._values['write_timeout'])
        known = warnings(before)
        self._warn([*removed_limits(before, self._values),
                    *(line for line in warnings(self._values) if line not in known)])

    def _switch(self, is_on: bool) -> None:
        """Take commands, or stop and refuse them; first the rover, then the disk."""
        self._link.enable(is_on)
        self._not_kept = keep(self._values['disabled_file'], is_on)
        if self._not_kept:
            self._log.error(self._not_kept)

    def _warn(self, lines: Sequence[str]) -> None:
        for line in lines:
            self._log.warning(line)

    # Commands

    def _on_command(self, twist: Any, waited: int, stamp_age: int | None) -> None:
        self._notice_freeze()
        now = time.monotonic_ns()
        velocity = Vel2d(twist.linear.x, twist.linear.y, twist.angular.z)
        verdict = self._link.offer_command(velocity, waited=waited, stamp_age=stamp_age)
        self._timing.add_command(now, stamp_age)       # only now: the frame is on its way
        if verdict is not Outcome.ACCEPTED:
            self._refused = verdict, now
            if now - self._last_logged.get(verdict, -THROTTLE_NS) >= THROTTLE_NS:
                self._last_logged[verdict] = now
                say = self._log.debug if verdict is Outcome.SHUTDOWN else self._log.warning
                say(refusal(
                    full_name(self.node), self._subscriber.topic, velocity, verdict,
                    self._graph_check.lacks_clock()))
        if twist.linear.z or twist.angular.x or twist.angular.y:
            self._log.warning(
                f'{self._subscriber.topic}: linear.z, angular.x and angular.y are ignored, as the '
                'rover moves in a plane; publish them as 0', once=True)

    def _notice_freeze(self) -> None:
        """Hear only what is published from now on, if this process was frozen."""
        freezes = self._link.freezes
        if freezes != self._known_freezes:
            self._known_freezes = freezes
            self._subscriber.renew()
            self._link.stop(Stop.FROZEN)        # the command at hand is an old one, too

    def _on_type(self, message_type: str) -> None:
        """Stop before another type is subscribed: its publisher is somebody else."""
        self._link.stop(Stop.TYPE_SWITCH)
        self._log.info(f'{self._subscriber.topic}: the message type is {message_type} now; the '
                       'bridge follows it')

    # The port's thread calls these

    def _on_sent(self, sent: Sent) -> None:
        self._timing.add_frame(sent)
        self._mcu.frames += 1
        self._mcu.drives += sent.velocity != STOP
        if self._log.get_effective_level() <= LoggingSeverity.DEBUG:
            self._sent.append(sent)

    def _on_change(self, problem: PortError | None) -> None:
        if problem is not None and problem.kind in HOPELESS and not self._link.state().openings:
            self._hopeless = problem
        else:
            self._port_log.add(problem)

    # Looking around and reporting

    def _watch(self) -> None:
        if self._hopeless is not None:
            raise self._hopeless
        self._notice_freeze()
        state = self._link.state()
        if state.is_open:
            self._inspection.inspect_if_due(state.openings, time.monotonic())
        self._subscriber.follow_graph()
        self._graph_complaints = self._graph_check.complaints()
        self._write_logs()
        self._report()

    def _log_changes(self) -> None:
        """
        Log what happened to the port: not in its thread, where stops would wait for that.

        The first line of a process takes rclpy 30 ms.
        """
        if left_out := self._port_log.left_out():
            self._log.warning(f'{self._port}: was opened or lost {left_out} more times than this '
                              'log shows, as the node was blocked; the next lines are the newest')
        for problem in self._port_log.take_changes():
            if problem is None:         # two lines: rclpy ties a severity to a place in the code
                until = 'a command comes' if self._link.gate.enabled else 'commands are enabled'
                self._log.info(f'{self._port}: open at {self._values["baud"]} baud; the '
                               f'bridge sends stop frames until {until}')
            else:
                self._log.error(str(problem))

    def _write_logs(self) -> None:
        self._log_changes()
        self._warn_of_new([*self._link_warnings(), *self._graph_complaints,
                           *self._subscriber.warnings])
        crc = CRC_BY_INPUT[self._values['crc_input']]
        while self._sent:
            velocity = self._sent.popleft().velocity
            checksum = int.from_bytes(encode(velocity, crc)[-4:], 'little')
            self._log.debug(f'sending [{velocity.x}, {velocity.y}, {velocity.omega}], '
                            f'crc: {checksum}')
        now = time.monotonic_ns()
        for line in self._mcu.take_lines(now):
            self._log.info(f'MCU: {line}')
        if garbage := self._mcu.garbage(now):
            self._log.warning(f'{self._port}: {garbage}')

    def _link_warnings(self) -> list[str]:
        """Return what disturbs the link: what the port shows, and what the MCU says."""
        return [*self._inspection.complaints, *(
            f'{self._port}: {line}'
            for line in self._mcu.complaints(time.monotonic_ns(), self._other_crc_input))]

    def _warn_of_new(self, complaints: Sequence[str]) -> None:
        """Warn of a complaint once, when it comes up."""
        self._warn([line for line in complaints if line not in self._known_complaints])
        self._known_complaints = set(complaints)

    def _report(self) -> None:
        """Publish both statuses once a second, and at once when a level changes."""
        statuses = self._statuses()
        levels = [status.level for status in statuses]
        now_s = time.monotonic()
        is_time = now_s - self._reported >= REPORT_S - WATCH_S / 2
        if not is_time and levels == self._levels:
            return
        now_ros = self.node.get_clock().now().nanoseconds
        for array in self._arrays.build(statuses, to_time(now_ros)):
            self._diagnostics.publish(array)
        if is_time:
            mine = statuses[0].hardware_id
            self._timing_topics.publish([
                one._replace(hardware_id=mine)
                for one in self._timing.metrics(time.monotonic_ns())], now_ros)
            self._reported = now_s
        self._levels = levels

    def _statuses(self) -> list[Status]:
        now = time.monotonic_ns()
        name, state, subscriber = full_name(self.node), self._link.state(), self._subscriber
        verdict, refused_at = self._refused
        commands = Commands(
            subscriber.topic, subscriber.subscribed, self._values['cmd_vel_timeout'],
            [*(f'{self._port}: {line}'
               for line in self._mcu.refused_drives(now, self._other_crc_input)),
             *self._graph_complaints, *subscriber.complaints],
            self._timing.series['command_period'].summary(now),
            subscriber.zero_stamps, verdict if now - refused_at < REFUSED_NS else None,
            self._graph_check.lacks_clock(), subscriber.absence)
        return [link_status(name, self._port, state, self._link_warnings(), self._mcu, now),
                commands_status(name, self._port, state, self._link.gate.counters, commands)]

    # Services

    def _enable(self, request: Any, response: Any) -> Any:
        # By way of the parameter, so that the two cannot disagree.
        self.node.set_parameters([Parameter('enabled', value=request.data)])
        moves = not request.data and self._link.state().owes_stop
        done = NO_STOP if moves else 'commands are accepted' if request.data else \
            'stopped; commands are refused until enabled'
        response.success = not (moves or self._not_kept)
        response.message = '; '.join(filter(None, (done, self._not_kept)))
        return response

    def _reset_statistics(self, request: Any, response: Any) -> Any:
        self._timing.reset()
        self._link.gate.counters = Counters()
        self._mcu.reset()
        self._subscriber.zero_stamps = 0
        response.success = True
        response.message = 'all counts and statistics restart at 0, except those of the port'
        return response
