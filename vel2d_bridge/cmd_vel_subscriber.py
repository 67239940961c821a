# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""
The subscription of cmd_vel: it follows the type and the reliability of its publishers.

One process cannot subscribe two types on one name, so the old subscription is destroyed and
another is made. graph.py decides what the graph means; the owner decides about a command.
"""
from __future__ import annotations

from collections.abc import Callable
from contextlib import suppress
import time
from typing import Any

from geometry_msgs.msg import Twist
from geometry_msgs.msg import TwistStamped
from rclpy.event_handler import SubscriptionEventCallbacks
from rclpy.node import Node
from rclpy.qos import qos_check_compatible
from rclpy.qos import QoSCompatibility
from rclpy.qos import QoSPolicyKind
from rclpy.qos import QoSProfile
from rclpy.qos import ReliabilityPolicy
from rclpy.qos_overriding_options import QoSOverridingOptions

from mecarover_serial.namesakes import node_name
from mecarover_serial.ros_node import first_line
from mecarover_serial.ros_node import given_parameters
from servobus.errors import ParameterError
from vel2d_bridge.bridge_settings import TWIST
from vel2d_bridge.bridge_settings import TWIST_STAMPED
from vel2d_bridge.graph import Absence
from vel2d_bridge.graph import Choice
from vel2d_bridge.graph import choose
from vel2d_bridge.graph import complaints
from vel2d_bridge.graph import Publisher
from vel2d_bridge.wall_clock import WallClock

SERVICES = ('enable', 'reset_statistics')       # by which a bridge is known
TYPES = {TWIST: Twist, TWIST_STAMPED: TwistStamped}


class CmdVelSubscriber:
    """
    Hears cmd_vel.

    `on_command(twist, waited, stamp_age)`: ns in the middleware, ns since the stamp (None: the
    type has none, or it is zero). `on_type(message_type)` comes before a switch. `complaints` are
    all current ones, `warnings` those for the log.
    """

    def __init__(self, node: Node, setting: str,
                 on_command: Callable[[Any, int, int | None], object],
                 on_type: Callable[[str], object]) -> None:
        self.topic = node.resolve_topic_name('cmd_vel')
        self.choice = choose(setting, Choice(TWIST, True), [])
        self.complaints: list[str] = []
        self.absence = ''           # 'no node publishes', '' while one does
        self.zero_stamps = 0
        self._node = node
        self._setting = setting
        self._on_command = on_command
        self._on_type = on_type
        self._absence = Absence(time.monotonic_ns())
        self._wall = WallClock()
        self._overrides = _overridden(node, self.topic)
        self._subscription = self._subscribe()

    @property
    def subscribed(self) -> Choice:
        """The choice as it is in force: the reliability may be overridden."""
        ours = self._subscription.qos_profile.reliability
        return self.choice._replace(reliable=ours == ReliabilityPolicy.RELIABLE)

    def follow_graph(self) -> None:
        """Look at the graph and follow it; to be called several times a second."""
        self._wall.observe(*_clocks())
        ours = self._subscription.qos_profile
        publishers = [
            Publisher(node_name(one.node_namespace, one.node_name), one.topic_type,
                      one.qos_profile.reliability != ReliabilityPolicy.BEST_EFFORT,
                      _conflict(one.qos_profile, ours))
            for one in self._node.get_publishers_info_by_topic(self.topic)]
        choice = choose(self._setting, self.choice, publishers)
        if choice == self.choice:
            self._judge(publishers)
        else:                           # the next look finds which publishers conflict with it
            self._follow(choice)

    def _judge(self, publishers: list[Publisher]) -> None:
        now = time.monotonic_ns()
        if self._absence.observe(bool(publishers), now):
            self._node.get_logger().info(f'{self.topic}: its last publisher has ended')
        self.complaints = complaints(self.choice, publishers, self.topic, self._other_bridges())
        self.absence = Absence.words(self.topic) if self._absence.is_long(now) else ''

    @property
    def warnings(self) -> list[str]:
        """What the log gets: of a missing publisher only until there was one."""
        is_news = self.absence and not self._absence.had_one
        return [*self.complaints, *([self.absence] if is_news else [])]

    def _other_bridges(self) -> list[str]:
        """Return the nodes that hear our topic and have the services of a bridge."""
        ours = self._node.get_fully_qualified_name()
        nodes = {(one.node_namespace, one.node_name)
                 for one in self._node.get_subscriptions_info_by_topic(self.topic)}
        return sorted(node_name(*one) for one in nodes
                      if node_name(*one) != ours and self._is_bridge(*one))

    def _is_bridge(self, namespace: str, name: str) -> bool:
        with suppress(RuntimeError):        # rclpy's: it is leaving, or its name is not known yet
            services = self._node.get_service_names_and_types_by_node(name, namespace)
            return {f'{node_name(namespace, name)}/{service}' for service in SERVICES} <= {
                service for service, _ in services}
        return False

    def renew(self) -> None:
        """
        Subscribe again: what was published until now is no longer heard.

        After a freeze it waits in the sockets, or is sent again by a reliable publisher, up to
        seconds later, and it looks like a new command.
        """
        self._node.destroy_subscription(self._subscription)
        self._subscription = self._subscribe()

    def _follow(self, choice: Choice) -> None:
        if choice.message_type != self.choice.message_type:
            self._on_type(choice.message_type)
        self.choice = choice
        self.renew()

    def _subscribe(self) -> Any:
        reliability = ReliabilityPolicy.RELIABLE if self.choice.reliable \
            else ReliabilityPolicy.BEST_EFFORT
        callback = {TWIST: self._on_twist, TWIST_STAMPED: self._on_twist_stamped}
        try:
            return self._node.create_subscription(
                TYPES[self.choice.message_type], 'cmd_vel', callback[self.choice.message_type],
                QoSProfile(depth=1, reliability=reliability),
                # Our complaints name who does not fit; rclpy's own words do not.
                event_callbacks=SubscriptionEventCallbacks(use_default_callbacks=False),
                qos_overriding_options=QoSOverridingOptions(self._overrides))
        except RuntimeError as error:   # rclpy's, and its private RCLError
            raise ParameterError(
                f'qos_overrides.{self.topic}.subscription: {first_line(error)}; '
                'set e.g. reliability to best_effort, depth to 1') from error

    def _on_twist(self, message: Any, info: Any) -> None:
        self._on_command(message, self._waited(info), None)

    def _on_twist_stamped(self, message: Any, info: Any) -> None:
        stamp = message.header.stamp.sec * 1_000_000_000 + message.header.stamp.nanosec
        age = self._node.get_clock().now().nanoseconds - stamp if stamp else None
        self.zero_stamps += not stamp
        self._on_command(message.twist, self._waited(info), age)

    def _waited(self, info: Any) -> int:
        return self._wall.waited(info['received_timestamp'], *_clocks())


def _clocks() -> tuple[int, int]:
    """Return the system clock, and one that is not stepped and goes on during a suspend (ns)."""
    return time.time_ns(), time.clock_gettime_ns(time.CLOCK_BOOTTIME)


def _overridden(node: Node, topic: str) -> list[QoSPolicyKind]:
    """Return only the policies that are given: a declared default could follow no publisher."""
    names = given_parameters(node)
    return [policy for policy in QoSPolicyKind
            if f'qos_overrides.{topic}.subscription.{policy.name.lower()}' in names]


def _conflict(theirs: Any, ours: Any) -> str:
    verdict, reason = qos_check_compatible(theirs, ours)
    return reason.rstrip('; ') if verdict == QoSCompatibility.ERROR else ''
