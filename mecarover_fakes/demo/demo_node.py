# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""The demo's own node: publishes cmd_vel as a teleop would, and hears the diagnostics."""
from __future__ import annotations

from functools import partial
import time

from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import Twist
import rclpy
from rclpy.executors import SingleThreadedExecutor
from rclpy.signals import SignalHandlerOptions

from mecarover_dashboard.state import OVERVIEW
from mecarover_dashboard.state import State
from mecarover_dashboard.state import TABLES
from msg_defs.status_keys import COMMANDS_RECEIVED
from msg_defs.vel2d import Vel2d

DISCOVERY_S = 2.0       # so long may it take to hear of a node that is there


class Operator:
    """Hands on the stick, eyes on the topics."""

    def __init__(self) -> None:
        rclpy.init(signal_handler_options=SignalHandlerOptions.NO)
        self._node = rclpy.create_node('demo_operator')
        self._executor = SingleThreadedExecutor()
        self._executor.add_node(self._node)
        self._cmd_vel = self._node.create_publisher(Twist, 'cmd_vel', 1)
        self.state = State()
        self._forgotten_s = 0.0
        for topic in (OVERVIEW, TABLES):
            self._node.create_subscription(
                DiagnosticArray, topic, partial(self._store_message, topic), 50, raw=True)

    def _store_message(self, topic: str, message: bytes) -> None:
        self.state.store_message(topic, message, time.monotonic())

    def is_heard(self) -> bool:
        """
        Tell whether the bridge has had a command of ours since `forget`.

        Matched subscriptions do not tell: those of a killed process stay until its lease ends.
        """
        return any(key == COMMANDS_RECEIVED and int(value) > 0
                   for report in self.state.reports('bridge')
                   if report.arrived > self._forgotten_s
                   for key, value in report.row['values'])

    def is_in_company(self) -> bool:
        """Tell whether another node is in this domain, before anything was started."""
        deadline = time.monotonic() + DISCOVERY_S
        while time.monotonic() < deadline:
            if len(self._node.get_node_names()) > 1:
                return True
            self.spin(0.1)
        return False

    def forget(self) -> None:
        """Forget what the bridge reported: it was killed, the next report is of another one."""
        self._forgotten_s = time.monotonic()

    def command(self, velocity: Vel2d) -> None:
        """Publish one Twist."""
        message = Twist()
        message.linear.x, message.linear.y, message.angular.z = velocity
        self._cmd_vel.publish(message)

    def spin(self, seconds: float) -> None:
        """Take what has come, waiting at most so long."""
        self._executor.spin_once(timeout_sec=seconds)

    def close(self) -> None:
        """Leave the graph."""
        self._executor.shutdown()
        self._node.destroy_node()
        rclpy.try_shutdown()
