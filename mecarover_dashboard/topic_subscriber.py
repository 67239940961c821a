# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""
The ROS side of the page and of mecarover_status: subscriptions; messages are passed on as bytes.

A node hears the robots of its namespace: the topics of this namespace and of those below it,
which are looked for in the graph. At the root these are the robots of the whole domain.
"""
from __future__ import annotations

from collections.abc import Callable
from collections.abc import Sequence
from functools import partial
from typing import TYPE_CHECKING

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

if TYPE_CHECKING:
    from mecarover_dashboard.web_server import Server

_QOS = QoSProfile(history=HistoryPolicy.KEEP_LAST, depth=100,
                  reliability=ReliabilityPolicy.RELIABLE)
_GRAPH_S = 2.0
_MOST_TOPICS = 200              # all robots together
_TYPE = 'diagnostic_msgs/msg/DiagnosticArray'


class TopicSubscriber(Stoppable):
    """
    A node that hears some of TOPICS; made once, ended by `stop`.

    `store(kind, message)` gets each message, serialised; `count(publishers)` how many nodes
    publish each kind, every few seconds.
    """

    def __init__(self, name: str, topics: Sequence[str], store: Callable[[str, bytes], None],
                 count: Callable[[dict[str, int]], None] = lambda publishers: None) -> None:
        self.node = Node(name, start_parameter_services=topics is TOPICS)
        self._topics = topics
        self._store = store
        self._count = count
        self._kinds: dict[str, str] = {}        # kinds of the topics that are heard, by name
        for kind in topics:
            self._subscribe(self.node.resolve_topic_name(kind), kind)
        self.node.create_timer(_GRAPH_S, self._find_topics,
                               clock=Clock(clock_type=ClockType.STEADY_TIME))

    @property
    def namespace(self) -> str:
        """The robots below it are heard; '' for all."""
        return str(self.node.get_namespace().strip('/'))

    def _subscribe(self, topic: str, kind: str) -> None:
        self._kinds[topic] = kind
        self.node.create_subscription(
            DiagnosticArray, topic, partial(self._store, kind), _QOS, raw=True)

    def _find_topics(self) -> None:
        """Hear robots that have come, and count who publishes."""
        below = self.node.get_namespace().rstrip('/') + '/'
        for topic, types in self.node.get_topic_names_and_types():
            kind = next((one for one in self._topics
                         if one != OVERVIEW and topic.endswith(f'/{one}')), None)
            if kind and topic.startswith(below) and topic not in self._kinds \
                    and _TYPE in types and len(self._kinds) < _MOST_TOPICS:
                self._subscribe(topic, kind)
        publishers = dict.fromkeys(self._topics, 0)
        for topic, kind in self._kinds.items():
            publishers[kind] += self.node.count_publishers(topic)
        self._count(publishers)


class PageSubscriber(TopicSubscriber):
    """The node dxl_dashboard: what it hears is served."""

    def __init__(self, server: Server) -> None:
        super().__init__('dxl_dashboard', TOPICS, server.queue_message, server.store_publishers)
        self._server = server
        server.start(self.namespace)

    def stop(self) -> None:
        """Stop serving."""
        self._server.stop()
