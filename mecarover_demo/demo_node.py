# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""The demo's own node: publishes cmd_vel as a teleop would, and hears the diagnostics."""
from __future__ import annotations

import time
from typing import Any

from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import Twist
import rclpy
from rclpy.executors import SingleThreadedExecutor
from rclpy.signals import SignalHandlerOptions

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
        self.statuses: dict[str, Any] = {}      # the newest DiagnosticStatus by name
        for topic in ('/diagnostics', 'dxl/diagnostics'):
            self._node.create_subscription(DiagnosticArray, topic, self._hear, 50)

    def _hear(self, message: Any) -> None:
        # dxl/diagnostics has the whole table under the same names: the richer one stays.
        for status in message.status:
            known = self.statuses.get(status.name)
            if known is None or len(status.values) >= len(known.values) \
                    or status.level != known.level:
                self.statuses[status.name] = status

    def is_heard(self) -> bool:
        """
        Tell whether the bridge has had a command of ours since `forget`.

        Matched subscriptions do not tell: those of a killed process stay until its lease ends.
        """
        status = self.statuses.get('vel2d_bridge: commands')
        return status is not None and any(
            pair.key == COMMANDS_RECEIVED and int(pair.value) > 0 for pair in status.values)

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
        self.statuses.pop('vel2d_bridge: commands', None)

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
