# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""
The ROS side of the page and of mecarover_status: subscriptions; messages are passed on as bytes.

A node hears the robots of its namespace: the topics of this namespace and of those below it,
which are looked for in the graph. At the root these are the robots of the whole domain.
"""
from __future__ import annotations

from collections.abc import Sequence
from functools import partial
from typing import Protocol

from diagnostic_msgs.msg import DiagnosticArray
from rclpy.clock import Clock
from rclpy.clock import ClockType
from rclpy.node import Node
from rclpy.qos import HistoryPolicy
from rclpy.qos import QoSProfile
from rclpy.qos import ReliabilityPolicy

from mecarover_dashboard.state import OVERVIEW
from mecarover_dashboard.state import TOPICS
from mecarover_serial.ros_node import Stoppable

_QOS = QoSProfile(history=HistoryPolicy.KEEP_LAST, depth=100,
                  reliability=ReliabilityPolicy.RELIABLE)
_GRAPH_S = 2.0
_MOST_TOPICS = 200              # all robots together
_TYPE = 'diagnostic_msgs/msg/DiagnosticArray'


class Sink(Protocol):
    """What takes messages: a web server, or what is like it."""

    def start(self, namespace: str) -> None: ...

    def take(self, topic: str, message: bytes) -> None: ...

    def publishers(self, counts: dict[str, int]) -> None: ...

    def stop(self) -> None: ...


class Subscriber(Stoppable):
    """A node that hears some of TOPICS; made once, ended by `stop`."""

    def __init__(self, server: Sink, name: str = 'dxl_dashboard',
                 topics: Sequence[str] = TOPICS) -> None:
        self.node = Node(name, start_parameter_services=topics is TOPICS)
        self._server = server
        self._topics = topics
        self._kinds: dict[str, str] = {}        # kinds of the topics that are heard, by name
        for kind in topics:
            self._subscribe(self.node.resolve_topic_name(kind), kind)
        self.node.create_timer(_GRAPH_S, self._look,
                               clock=Clock(clock_type=ClockType.STEADY_TIME))
        server.start(self.node.get_namespace().strip('/'))

    def stop(self) -> None:
        """Stop serving."""
        self._server.stop()

    def _subscribe(self, topic: str, kind: str) -> None:
        self._kinds[topic] = kind
        self.node.create_subscription(
            DiagnosticArray, topic, partial(self._server.take, kind), _QOS, raw=True)

    def _look(self) -> None:
        """Hear robots that have come, and count who publishes."""
        below = self.node.get_namespace().rstrip('/') + '/'
        for topic, types in self.node.get_topic_names_and_types():
            kind = next((one for one in self._topics
                         if one != OVERVIEW and topic.endswith(f'/{one}')), None)
            if kind and topic.startswith(below) and topic not in self._kinds \
                    and _TYPE in types and len(self._kinds) < _MOST_TOPICS:
                self._subscribe(topic, kind)
        counts = dict.fromkeys(self._topics, 0)
        for topic, kind in self._kinds.items():
            counts[kind] += self.node.count_publishers(topic)
        self._server.publishers(counts)
