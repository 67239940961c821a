# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""The driver of the soak: commands in spells; the rover must move, and must stop."""

import threading
import time

from geometry_msgs.msg import Twist
from rclpy.qos import QoSProfile
from rclpy.qos import ReliabilityPolicy

from rigs.soak_watch import BRIDGE

SPEED = 0.3
DRIVE_S, REST_S = 2.0, 1.5
MOVE_S = 4.0                    # no freeze explains more
STOP_BOUND_S = 0.95             # as docs/reliability.md; and what a shared machine adds:
LATE_S = 0.5


class Driver:
    """Publishes commands in spells, and watches how the rover obeys."""

    def __init__(self, node, mcu, machine, complain):
        self.is_hindered = False        # a fault may delay a drive or a stop beyond its bound
        self.last_fault = 'none'
        self.drives = self.stops = self.made_up = 0
        self.longest_s = 0.0
        # A reliable publisher sends a lost command again, seconds later: a new one for the bridge.
        self._publisher = node.create_publisher(Twist, 'cmd_vel', QoSProfile(
            depth=1, reliability=ReliabilityPolicy.BEST_EFFORT))
        self._mcu = mcu
        self._machine = machine
        self._complain = complain
        self._done = threading.Event()
        self._thread = threading.Thread(target=self._run, name='driver')

    def start(self):
        self._thread.start()

    def stop(self):
        self._done.set()
        if self._thread.is_alive():
            self._thread.join()

    def is_heard(self):
        """Return whether somebody takes the commands."""
        return bool(self._publisher.get_subscription_count())

    def _run(self):
        while not self._done.is_set():
            if self._drive():
                self._rest()

    def _drive(self):
        """Send commands; the rover must move. Return whether it did."""
        message = Twist()
        message.linear.x = SPEED
        begin_s, held_s = time.monotonic(), self._machine.held_s()
        has_moved = was_hindered = False
        while not has_moved or time.monotonic() - begin_s < DRIVE_S:
            self._publisher.publish(message)
            was_hindered |= self.is_hindered or self._done.is_set()
            self._check_velocities()
            has_moved |= not self._mcu.receiver.wheels.is_stop
            if self._machine.is_over(begin_s, DRIVE_S if was_hindered else MOVE_S, held_s):
                break
            time.sleep(0.02)
        if not was_hindered:
            self.drives += 1
            if not has_moved:
                self._complain('drives without motion', f'{BRIDGE}: the rover did not move within '
                               f'{MOVE_S:g} s of commands; {self._mcu.totals()}')
        return has_moved

    def _rest(self):
        """Say nothing; the rover must stop, and stay so."""
        last_s, held_s = time.monotonic(), self._machine.held_s()
        stopped_s = None
        was_hindered = False
        while (now_s := time.monotonic()) < last_s + REST_S or (
                stopped_s is None
                and not self._machine.is_over(last_s, STOP_BOUND_S + LATE_S, held_s)):
            was_hindered |= self.is_hindered
            self._check_velocities()
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
        if stopped_s is None or self._machine.is_over(
                time.monotonic() - taken_s, STOP_BOUND_S + LATE_S, held_s):
            self._complain('stops too late', f'{BRIDGE}: no stop within {taken_s:.3f} s; '
                           f'{self._mcu.totals()}')

    def _check_velocities(self):
        arrivals = self._mcu.receiver.arrivals
        while arrivals:
            velocity = arrivals.popleft().velocity
            self.made_up += velocity is not None and tuple(velocity) not in (
                (SPEED, 0.0, 0.0), (0.0, 0.0, 0.0))
