# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""
What each published message costs: from plain values to the middleware, CPU time of all threads.

The figures are taken in one process with a subscriber to every topic in another. "kept" is the
message of a status list of which a tenth of the values has changed, "new" one built afresh.
"""

from collections.abc import Callable
from functools import partial
from itertools import cycle
import json
import sys
import time
from typing import Any

from diagnostic_msgs.msg import DiagnosticArray
import rclpy
from rclpy.node import Node
from rclpy.signals import SignalHandlerOptions
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64

from msg_defs import ros
from msg_defs.reports import Joint
from msg_defs.reports import Level
from msg_defs.reports import Metric
from msg_defs.reports import Status
from msg_defs.timing import Series
from rigs.harness import Child
from rigs.harness import cpu_us_per_call
from rigs.harness import Figure
from rigs.harness import interleaved
from rigs.harness import Options
from rigs.harness import ros_environment
from rigs.harness import say

SECTION = 'published messages: build and publish to one subscriber'
DEVICES = 20
FIELDS = 50
JOINTS = 20
METRICS = ('callback_to_write', 'write', 'command_period')
TOPICS = {'float': Float64, 'joints': JointState, 'diagnostics': DiagnosticArray}


def run(options: Options) -> list[Figure]:
    env = ros_environment()
    with Child('benchmark.messages', 'subscriber', env=env), \
            Child('benchmark.messages', 'publisher', env=env) as publisher:
        publisher.tell({'rounds': options.rounds, 'repeats': 20 if options.quick else 100})
        results = publisher.hear()
    return [Figure(SECTION, name, 'us CPU', values) for name, values in results.items()]


def device_statuses(number: int) -> list[Status]:
    """Return what a bus of 20 devices says; another number changes a tenth of the values."""
    return [Status(f'dxl_monitor: {device:03d}', Level.OK, 'connected', str(device), [
        (f'Field {field} (rad)', f'{number + field / 7:.6g}' if field % 10 == 0 else '1.5708')
        for field in range(FIELDS)]) for device in range(DEVICES)]


def timing_metrics() -> list[Metric]:
    """Return what the bridge says about its time."""
    series = Series()
    for i in range(1000):
        series.add(0.1 + i / 1000, i * 10_000_000)
    window, total = series.summary(10_000_000_000), series.total()
    return [Metric(name, 'ms', window, total) for name in METRICS]


def cases(node: Node, publishers: dict[str, Any]) -> dict[str, Callable[[], None]]:
    stamp = ros.to_time(time.time_ns())
    turn = cycle([device_statuses(0), device_statuses(1)])
    joints = [Joint(f'joint_{i}', 0.1 * i, 0.0, 0.5) for i in range(JOINTS)]
    metrics = timing_metrics()
    timing = ros.TimingPublisher(node, 'bench')
    kept = ros.DiagnosticArrays()

    def publish_statuses(arrays: ros.DiagnosticArrays) -> None:
        for message in arrays.build(next(turn), stamp):
            publishers['diagnostics'].publish(message)

    return {
        'Float64':
            lambda: publishers['float'].publish(Float64(data=1.5)),
        f'JointState of {JOINTS} joints':
            lambda: publishers['joints'].publish(ros.joint_state(joints, stamp)),
        f'DiagnosticArray of {DEVICES} x {FIELDS}, kept':
            lambda: publish_statuses(kept),
        f'DiagnosticArray of {DEVICES} x {FIELDS}, new':
            lambda: publish_statuses(ros.DiagnosticArrays()),
        f'timing topics of {len(METRICS)} metrics':
            lambda: timing.publish(metrics, time.time_ns()),
    }


def publish() -> None:
    """Be the publishing process: wait for the subscriber, then measure as told."""
    node = rclpy.create_node('bench_publisher')
    publishers = {topic: node.create_publisher(kind, f'bench/{topic}', ros.QUEUE_DEPTH)
                  for topic, kind in TOPICS.items()}
    calls = cases(node, publishers)
    for call in calls.values():
        call()                          # once before: the timing topics come with their first use
    order = json.loads(sys.stdin.readline())
    while not all(publisher.get_subscription_count() for publisher in publishers.values()):
        time.sleep(0.1)
    say(interleaved({
        name: partial(cpu_us_per_call, call, order['repeats']) for name, call in calls.items()
    }, order['rounds']))


def subscribe() -> None:
    """Be the subscribing process, which takes the messages as bytes."""
    node = rclpy.create_node('bench_subscriber')
    topics = {**TOPICS, 'timing': DiagnosticArray, **{f'timing/{m}_ms': Float64 for m in METRICS}}
    for topic, kind in topics.items():
        node.create_subscription(kind, f'bench/{topic}', lambda message: None, 10, raw=True)
    rclpy.spin(node)


if __name__ == '__main__':
    rclpy.init(signal_handler_options=SignalHandlerOptions.NO)      # SIGTERM just ends it
    {'publisher': publish, 'subscriber': subscribe}[sys.argv[1]]()
