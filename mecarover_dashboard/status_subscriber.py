# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""The ROS side of mecarover_status: what it hears goes into a state, which is shown."""
from __future__ import annotations

from collections.abc import Callable
import signal
import time

from rclpy.clock import Clock
from rclpy.clock import ClockType

from mecarover_dashboard.state import Message
from mecarover_dashboard.state import OVERVIEW
from mecarover_dashboard.state import State
from mecarover_dashboard.state import TABLES
from mecarover_dashboard.topic_subscriber import Subscriber

LOOK_S = 0.2


class StatusSink:
    """Puts messages into a state at once."""

    def __init__(self, state: State) -> None:
        self._state = state

    def start(self, namespace: str) -> None:
        self._state.namespace = namespace

    def take(self, topic: str, message: Message) -> None:
        self._state.take(topic, message, time.monotonic())

    def publishers(self, counts: dict[str, int]) -> None:
        """Nothing is said about publishers."""

    def stop(self) -> None:
        """Nothing is open."""


class StatusSubscriber(Subscriber):
    """
    The node mecarover_status; made once, ended by `stop`. with_tables: for values of devices.

    `look(now_s)` is called several times a second; when it returns True, the node ends.
    """

    def __init__(self, state: State, look: Callable[[float], bool], with_tables: bool) -> None:
        super().__init__(StatusSink(state), 'mecarover_status',
                         (TABLES, OVERVIEW) if with_tables else (OVERVIEW,))
        self._show = look
        self.node.create_timer(LOOK_S, self._tick, clock=Clock(clock_type=ClockType.STEADY_TIME))

    def _tick(self) -> None:
        if self._show(time.monotonic()):
            signal.raise_signal(signal.SIGTERM)     # `run` ends at a signal
