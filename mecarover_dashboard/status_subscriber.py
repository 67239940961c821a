# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""The ROS side of mecarover_status: what it hears goes into a state, which is shown."""
from __future__ import annotations

from collections.abc import Callable
import signal
import time

from rclpy.clock import Clock
from rclpy.clock import ClockType

from mecarover_dashboard.state import OVERVIEW
from mecarover_dashboard.state import State
from mecarover_dashboard.state import TABLES
from mecarover_dashboard.topic_subscriber import TopicSubscriber

SHOW_S = 0.2


class StatusSubscriber(TopicSubscriber):
    """
    The node mecarover_status; made once, ended by `stop`. with_tables: for values of devices.

    `show(now_s)` is called several times a second; when it returns True, the node ends.
    """

    def __init__(self, state: State, show: Callable[[float], bool], with_tables: bool) -> None:
        super().__init__('mecarover_status', (TABLES, OVERVIEW) if with_tables else (OVERVIEW,),
                         self._store_message)
        self._state = state
        self._show = show
        state.namespace = self.namespace
        self.node.create_timer(SHOW_S, self._tick, clock=Clock(clock_type=ClockType.STEADY_TIME))

    def stop(self) -> None:
        """Nothing is open."""

    def _store_message(self, topic: str, message: bytes) -> None:
        self._state.store_message(topic, message, time.monotonic())

    def _tick(self) -> None:
        if self._show(time.monotonic()):
            signal.raise_signal(signal.SIGTERM)     # `run` ends at a signal
