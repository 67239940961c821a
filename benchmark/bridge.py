# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""
From a Twist published in one process to its frame at a pty in another, through the real node.

Beside it the floor: the least that a rclpy node can do, a callback that encodes and writes. Both
get the same commands, turn by turn. The Twist carries the time of its publishing in linear.x
(float64 and unlimited, so the frame carries it too), on the clock that all processes share.
"""

from contextlib import ExitStack
import os
import select
import sys
import time

from geometry_msgs.msg import Twist
import rclpy
from rclpy.signals import SignalHandlerOptions

from benchmark.harness import Child
from benchmark.harness import Figure
from benchmark.harness import Options
from benchmark.harness import quantile
from benchmark.harness import ros_environment
from benchmark.harness import Usage
from benchmark.harness import usage
from mecarover_serial.pty import Pty
from msg_defs.vel2d import decode
from msg_defs.vel2d import encode
from msg_defs.vel2d import FRAME_SIZE
from msg_defs.vel2d import Vel2d

SECTION = 'bridge: Twist published to frame received'
PERIOD_S = 0.04                 # of the commands to each node: below the bridge's max_rate
TOPICS = {'bridge': 'cmd_vel', 'floor': 'bench_cmd_vel'}
DISCOVERY_S = 30.0


def run(options: Options) -> list[Figure]:
    env = ros_environment()
    with ExitStack() as stack:
        ptys = {name: stack.enter_context(Pty()) for name in TOPICS}
        nodes = {
            'bridge': stack.enter_context(Child('vel2d_bridge.main', '--ros-args', '-p', (
                f'port:={ptys["bridge"].path}'), env=env, quiet=True)),
            'floor': stack.enter_context(
                Child('benchmark.bridge', 'floor', ptys['floor'].path, env=env)),
        }
        stack.enter_context(Child('benchmark.bridge', 'publisher', env=env))
        receiver = Receiver({name: pty.master for name, pty in ptys.items()})
        receiver.wait_for_all(DISCOVERY_S)
        receiver.take(1.0)      # the first ones are slow
        before = {name: usage(node.pid) for name, node in nodes.items()}
        rounds = [receiver.take(options.seconds) for _ in range(options.rounds)]
        after = {name: usage(node.pid) for name, node in nodes.items()}
    return _figures(rounds) + _cpu_figures(rounds, before, after)


class Receiver:
    """Reads the frames of several ptys and notes how long each new command took."""

    def __init__(self, masters: dict[str, int]) -> None:
        self._names = {master: name for name, master in masters.items()}
        self._poll = select.poll()
        for master in self._names:
            self._poll.register(master, select.POLLIN)
        self._buffers = dict.fromkeys(self._names, b'')
        self._last = dict.fromkeys(self._names, 0.0)

    def wait_for_all(self, seconds: float) -> None:
        """Wait until a command has come through every node."""
        deadline = time.monotonic() + seconds
        while not all(self._last.values()):
            if time.monotonic() > deadline:
                silent = [name for fd, name in self._names.items() if not self._last[fd]]
                raise TimeoutError(f'{silent[0]}: no command came through in {seconds:g} s')
            self.take(0.2)

    def take(self, seconds: float) -> dict[str, list[float]]:
        """Return the latencies in ms, by node, of the commands that came in this time."""
        latencies: dict[str, list[float]] = {name: [] for name in self._names.values()}
        deadline = time.monotonic() + seconds
        while (left := deadline - time.monotonic()) > 0:
            for master, _ in self._poll.poll(left * 1000):
                now = time.monotonic()
                self._buffers[master] += os.read(master, 4096)
                latencies[self._names[master]] += self._new_commands(master, now)
        return latencies

    def _new_commands(self, master: int, now: float) -> list[float]:
        """Pass over stops and what is only sent again."""
        new = []
        while len(self._buffers[master]) >= FRAME_SIZE:
            frame = self._buffers[master][:FRAME_SIZE]
            self._buffers[master] = self._buffers[master][FRAME_SIZE:]
            velocity = decode(frame)
            if velocity is not None and velocity.x > self._last[master]:
                self._last[master] = velocity.x
                new.append((now - velocity.x) * 1000)
        return new


def _figures(rounds: list[dict[str, list[float]]]) -> list[Figure]:
    points = {f'Twist to frame, {name}': _points([ms for one in rounds for ms in one[name]])
              for name in TOPICS}
    figures = [
        Figure(SECTION, f'{name}, p{share * 100:g}', 'ms',
               [quantile(one[name], share) for one in rounds])
        for share in (0.5, 0.95, 0.99) for name in TOPICS]
    ratios = [quantile(one['bridge'], 0.5) / quantile(one['floor'], 0.5) for one in rounds]
    figures.append(Figure(SECTION, 'bridge / floor, p50', '', ratios, 'wanted: at most 1.25',
                          points))
    return figures


def _points(latencies: list[float]) -> dict[str, float]:
    return {'min': min(latencies), 'median': quantile(latencies, 0.5),
            'p99': quantile(latencies, 0.99), 'max': max(latencies)}


def _cpu_figures(rounds: list[dict[str, list[float]]], before: dict[str, Usage],
                 after: dict[str, Usage]) -> list[Figure]:
    """Return the CPU time per command: of all that the process does, resends and reports too."""
    return [Figure(SECTION, f'{name}, CPU', 'ms/command', [
        1000 * (after[name].cpu_s - before[name].cpu_s) / sum(len(one[name]) for one in rounds)])
        for name in TOPICS]


def publish() -> None:
    """Be the publishing process: one command to each node in turn."""
    node = rclpy.create_node('bench_publisher')
    publishers = [node.create_publisher(Twist, topic, 1) for topic in TOPICS.values()]
    twist = Twist()
    due = time.monotonic()
    while True:
        for publisher in publishers:
            due += PERIOD_S / len(publishers)
            time.sleep(max(0.0, due - time.monotonic()))
            twist.linear.x = time.monotonic()
            publisher.publish(twist)


def floor(port: str) -> None:
    """Be the floor: what has to happen and nothing else."""
    fd = os.open(port, os.O_WRONLY | os.O_NOCTTY)

    def write(message: Twist) -> None:
        os.write(fd, encode(Vel2d(message.linear.x, message.linear.y, message.angular.z)))

    node = rclpy.create_node('bench_floor')
    node.create_subscription(Twist, TOPICS['floor'], write, 1)
    rclpy.spin(node)


if __name__ == '__main__':
    rclpy.init(signal_handler_options=SignalHandlerOptions.NO)      # SIGTERM just ends it
    {'publisher': publish, 'floor': floor}[sys.argv[1]](*sys.argv[2:])
