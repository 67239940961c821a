# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""The driver of the soak: commands in spells; the rover must move, and must stop."""

from collections.abc import Callable
from collections.abc import Iterator
import threading
import time
from typing import Any

from geometry_msgs.msg import Twist
from rclpy.qos import QoSProfile
from rclpy.qos import ReliabilityPolicy

from mecarover_fakes.fake_mcu import FakeMcu
from rigs.soak_watch import BRIDGE
from rigs.soak_watch import Hearing
from rigs.soak_watch import Machine

SPEED = 0.3
DRIVE_S, REST_S = 2.0, 1.5
MOVE_S = 4.0                    # no freeze explains more
STOP_BOUND_S = 0.95             # as docs/reliability.md; and what a shared machine adds:
LATE_S = 0.5


class Driver:
    """Publishes commands in spells, and watches how the rover obeys."""

    def __init__(self, node: Any, mcu: FakeMcu, machine: Machine,
                 complain: Callable[[str, str], None]) -> None:
        self.is_hindered = False        # a fault may delay a drive or a stop beyond its bound
        self.last_fault = 'none'
        self.drives = self.stops = self.made_up = 0
        self.slowest_s = self.longest_s = 0.0
        self._late: list[tuple[int, int, str]] = []     # begin, end, words
        # A reliable publisher sends a lost command again, seconds later: a new one for the bridge.
        self._publisher = node.create_publisher(Twist, 'cmd_vel', QoSProfile(
            depth=1, reliability=ReliabilityPolicy.BEST_EFFORT))
        self._mcu = mcu
        self._machine = machine
        self._complain = complain
        self._done = threading.Event()
        self._thread = threading.Thread(target=self._run, name='driver')

    def start(self) -> None:
        self._thread.start()

    def stop(self) -> None:
        self._done.set()
        if self._thread.is_alive():
            self._thread.join()

    def is_heard(self) -> bool:
        """Return whether somebody takes the commands."""
        return bool(self._publisher.get_subscription_count())

    def late(self, hearing: Hearing) -> Iterator[str]:
        """Yield the drives that were late without a reason; some time after the last of them."""
        return (words for begin, end, words in self._late if not hearing.explained(begin, end))

    def _run(self) -> None:
        while not self._done.is_set():
            if self._drive():
                self._rest()

    def _drive(self) -> bool:
        """Send commands; the rover must move. Return whether it did."""
        message = Twist()
        message.linear.x = SPEED
        begin, begin_s, held_s = time.time_ns(), time.monotonic(), self._machine.held_s()
        moved_s = None
        was_hindered = False
        while moved_s is None or time.monotonic() - begin_s < DRIVE_S:
            self._publisher.publish(message)
            was_hindered |= self.is_hindered or self._done.is_set()
            self._look()
            if moved_s is None and not self._mcu.receiver.wheels.is_stop:
                moved_s = time.monotonic() - begin_s
            if self._machine.is_over(begin_s, DRIVE_S if was_hindered else MOVE_S, held_s):
                break
            time.sleep(0.02)
        if not was_hindered:
            self.drives += 1
            if moved_s is None:
                self._complain('drives without motion', f'{BRIDGE}: the rover did not move within '
                               f'{MOVE_S:g} s of commands; {self._mcu.totals()}')
            else:
                self._judge_drive(begin, moved_s, self._machine.patience_s(DRIVE_S, held_s))
        return moved_s is not None

    def _judge_drive(self, begin: int, moved_s: float, bound_s: float) -> None:
        self.slowest_s = max(self.slowest_s, moved_s)
        if moved_s > bound_s:
            self._late.append((begin, time.time_ns(),
                               f'{BRIDGE}: the rover moved {moved_s:.1f} s after the first '
                               f'command, {bound_s:.1f} s is right, and no freeze explains it; '
                               f'at {time.monotonic():.1f} s, behind {self.last_fault}'))

    def _rest(self) -> None:
        """Say nothing; the rover must stop, and stay so."""
        last_s, held_s = time.monotonic(), self._machine.held_s()
        stopped_s = None
        was_hindered = False
        while (now_s := time.monotonic()) < last_s + REST_S or (
                stopped_s is None
                and not self._machine.is_over(last_s, STOP_BOUND_S + LATE_S, held_s)):
            was_hindered |= self.is_hindered
            self._look()
            if not self._mcu.receiver.wheels.is_stop:
                stopped_s = None
            elif stopped_s is None:
                stopped_s = now_s
            time.sleep(0.01)
        if was_hindered:
            return
        self.stops += 1
        taken_s = (stopped_s or time.monotonic()) - last_s
        self.longest_s = max(self.longest_s, taken_s)
        bound_s = self._machine.patience_s(STOP_BOUND_S + LATE_S, held_s)
        if stopped_s is None or taken_s > bound_s:
            self._complain('stops too late', f'{BRIDGE}: no stop within {taken_s:.3f} s, '
                           f'{bound_s:.3f} s is right; {self._mcu.totals()}')

    def _look(self) -> None:
        arrivals = self._mcu.receiver.arrivals
        while arrivals:
            velocity = arrivals.popleft().velocity
            self.made_up += velocity is not None and tuple(velocity) not in (
                (SPEED, 0.0, 0.0), (0.0, 0.0, 0.0))
