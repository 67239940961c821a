# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""The ROS side of the dashboard: four subscriptions whose messages go on as they are, as bytes."""
from __future__ import annotations

from functools import partial

from diagnostic_msgs.msg import DiagnosticArray
from rclpy.clock import Clock
from rclpy.clock import ClockType
from rclpy.node import Node
from rclpy.qos import HistoryPolicy
from rclpy.qos import QoSProfile
from rclpy.qos import ReliabilityPolicy

from dxl_monitor.dashboard.server import Server
from dxl_monitor.dashboard.state import TOPICS

_QOS = QoSProfile(history=HistoryPolicy.KEEP_LAST, depth=100,
                  reliability=ReliabilityPolicy.RELIABLE)
_GRAPH_S = 2.0


class Subscriber:
    """The node dxl_dashboard; made once, ended by `stop`."""

    def __init__(self, server: Server) -> None:
        self.node = Node('dxl_dashboard')
        self._server = server
        for topic in TOPICS:
            self.node.create_subscription(
                DiagnosticArray, topic, partial(server.take, topic), _QOS, raw=True)
        self.node.create_timer(_GRAPH_S, self._count_publishers,
                               clock=Clock(clock_type=ClockType.STEADY_TIME))
        server.start()

    def stop(self) -> None:
        """Stop serving."""
        self._server.stop()

    def suspend(self) -> None:
        """Nothing moves here."""

    def resume(self) -> None:
        """Clients reconnect by themselves."""

    def _count_publishers(self) -> None:
        self._server.publishers({topic: self.node.count_publishers(topic) for topic in TOPICS})
