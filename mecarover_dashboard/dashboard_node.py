# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""The ROS side of mecarover_status: it subscribes /diagnostics and shows what is known."""
from __future__ import annotations

from collections.abc import Callable
import signal
import time

from diagnostic_msgs.msg import DiagnosticArray
from rclpy.clock import Clock
from rclpy.clock import ClockType
from rclpy.node import Node
from rclpy.qos import QoSProfile

from mecarover_dashboard.state import OVERVIEW
from mecarover_dashboard.state import State

LOOK_S = 0.2


class StatusNode:
    """
    The node mecarover_status; made once, ended by `stop`.

    `look(now_s)` is called several times a second; when it returns True, the node ends.
    """

    def __init__(self, state: State, look: Callable[[float], bool]) -> None:
        self.node = Node('mecarover_status', start_parameter_services=False)
        state.namespace = self.node.get_namespace().strip('/')
        self._look = look
        self.node.create_subscription(
            DiagnosticArray, OVERVIEW,
            lambda message: state.take(OVERVIEW, message, time.monotonic()), QoSProfile(depth=100),
            raw=True)
        self.node.create_timer(LOOK_S, self._tick, clock=Clock(clock_type=ClockType.STEADY_TIME))

    def stop(self) -> None:
        """Nothing is open."""

    def suspend(self) -> None:
        """Nothing moves here."""

    def resume(self) -> None:
        """Go on: the next report brings all of it."""

    def _tick(self) -> None:
        if self._look(time.monotonic()):
            signal.raise_signal(signal.SIGTERM)     # `run` ends at a signal
