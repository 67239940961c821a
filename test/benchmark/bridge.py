# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""
From a Twist published in one process to its frame at a pty in another, through the real node.

Beside it the floor: the least that a rclpy node can do, a callback that encodes and writes. Both
get the same commands, turn by turn, at several rates, steady and with jitter. The Twist carries
the time of its publishing in linear.x (float64 and unlimited, so the frame carries it too), on the
clock that all processes share.
"""

from contextlib import ExitStack
import json
import os
import random
import select
import sys
import time

from geometry_msgs.msg import Twist
import rclpy
from rclpy.signals import SignalHandlerOptions

from msg_defs.vel2d import decode
from msg_defs.vel2d import encode
from msg_defs.vel2d import FRAME_SIZE
from msg_defs.vel2d import Vel2d
from rigs.harness import Child
from rigs.harness import Figure
from rigs.harness import quantile
from rigs.harness import ros_environment
from servobus.port.pty import Pty

SECTION = 'bridge: Twist published to frame received'
RATES_HZ = (10, 20, 25, 29, 30, 33, 50, 100)    # commands to each node
MAX_RATE_HZ = 30                # the bridge's default
JITTERS_MS = (0, 2)
PLANS = [(rate, jitter) for rate in RATES_HZ for jitter in JITTERS_MS]
SHARE = 0.25                    # a plan gets this share of the seconds of an experiment
TOPICS = {'bridge': 'cmd_vel', 'floor': 'bench_cmd_vel'}
DISCOVERY_S = 30.0


def run(options):
    env = ros_environment()
    with ExitStack() as stack:
        ptys = {name: stack.enter_context(Pty()) for name in TOPICS}
        stack.enter_context(Child('vel2d_bridge.main', '--ros-args', '-p',
                                  f'port:={ptys["bridge"].path}', env=env, quiet=True))
        stack.enter_context(Child('benchmark.bridge', 'floor', ptys['floor'].path, env=env))
        publisher = stack.enter_context(Child('benchmark.bridge', 'publisher', env=env))
        receiver = Receiver({name: pty.master for name, pty in ptys.items()})
        receiver.wait_for_all(DISCOVERY_S)
        receiver.read_latencies(1.0)    # the first ones are slow
        rounds = [{} for _ in range(options.rounds)]
        for one in rounds:
            for plan in PLANS:
                publisher.send_json(plan)
                receiver.read_latencies(0.3)        # what the plan before it left
                one[plan] = receiver.read_latencies(SHARE * options.seconds)
    return _figures(rounds)


class Receiver:
    """Reads the frames of several ptys and notes how long each new command took."""

    def __init__(self, masters):
        self._names = {master: name for name, master in masters.items()}
        self._poll = select.poll()
        for master in self._names:
            self._poll.register(master, select.POLLIN)
        self._buffers = dict.fromkeys(self._names, b'')
        self._last = dict.fromkeys(self._names, 0.0)

    def wait_for_all(self, seconds):
        """Wait until a command has come through every node."""
        deadline = time.monotonic() + seconds
        while not all(self._last.values()):
            if time.monotonic() > deadline:
                silent = [name for fd, name in self._names.items() if not self._last[fd]]
                raise TimeoutError(f'{silent[0]}: no command came through in {seconds:g} s')
            self.read_latencies(0.2)

    def read_latencies(self, seconds):
        """Return the latencies in ms, by node, of the commands that came in this time."""
        latencies = {name: [] for name in self._names.values()}
        deadline = time.monotonic() + seconds
        while (left := deadline - time.monotonic()) > 0:
            for master, _ in self._poll.poll(left * 1000):
                now = time.monotonic()
                self._buffers[master] += os.read(master, 4096)
                latencies[self._names[master]] += self._new_commands(master, now)
        return latencies

    def _new_commands(self, master, now):
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


def _figures(rounds):
    figures = []
    for plan in PLANS:
        rate, jitter = plan
        section = f'{SECTION}, {rate} Hz' + (f', {jitter} ms jitter' if jitter else '')
        taken = [one[plan] for one in rounds]
        figures += [Figure(section, f'{name}, p50', 'ms', [quantile(one[name], 0.5)
                                                           for one in taken]) for name in TOPICS]
        is_steady = rate <= MAX_RATE_HZ         # else newer commands replace older ones
        figures += [
            Figure(section, 'bridge / floor, p50', '', [
                quantile(one['bridge'], 0.5) / quantile(one['floor'], 0.5) for one in taken],
                'wanted: at most 1.25' if is_steady else 'commands are replaced'),
            Figure(section, 'bridge - floor, p95', 'ms', [
                quantile(one['bridge'], 0.95) - quantile(one['floor'], 0.95) for one in taken],
                'wanted: at most 3' if is_steady else '')]
    return figures


def publish():
    """Be the publishing process: commands to each node in turn, by the plan heard last."""
    node = rclpy.create_node('bench_publisher')
    publishers = [node.create_publisher(Twist, topic, 1) for topic in TOPICS.values()]
    chance = random.Random(1)
    twist = Twist()
    rate, jitter_ms = PLANS[0]
    due = time.monotonic()
    while True:
        if select.select([sys.stdin], [], [], 0)[0]:
            rate, jitter_ms = json.loads(sys.stdin.readline())
            due = time.monotonic()
        for publisher in publishers:
            due += 1 / rate / len(publishers)
            late = chance.uniform(0, jitter_ms / 1000)
            time.sleep(max(0.0, due + late - time.monotonic()))
            twist.linear.x = time.monotonic()
            publisher.publish(twist)


def floor(port):
    """Be the floor: what has to happen and nothing else."""
    fd = os.open(port, os.O_WRONLY | os.O_NOCTTY)

    def write(message):
        os.write(fd, encode(Vel2d(message.linear.x, message.linear.y, message.angular.z)))

    node = rclpy.create_node('bench_floor')
    node.create_subscription(Twist, TOPICS['floor'], write, 1)
    rclpy.spin(node)


if __name__ == '__main__':
    rclpy.init(signal_handler_options=SignalHandlerOptions.NO)      # SIGTERM just ends it
    {'publisher': publish, 'floor': floor}[sys.argv[1]](*sys.argv[2:])
