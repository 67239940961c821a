# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""
One run of traffic through a pty: into the real node dxl_monitor, or into a bare reader.

Every run has processes of its own: writer, node or reader, and this one, which only listens to
dxl/timing. What is said about the node is what the node says about itself on that topic.
"""

from contextlib import ExitStack
import os
from pathlib import Path
import time
from typing import NamedTuple

from diagnostic_msgs.msg import DiagnosticArray
import rclpy
from rclpy.signals import SignalHandlerOptions
from std_srvs.srv import Trigger

from benchmark.traffic import BAUD
from benchmark.traffic import ROBOT
from rigs.harness import Child
from rigs.harness import ros_environment
from rigs.harness import usage

NODE = 'dxl_monitor.start'
THREAD_NODE = 'benchmark.thread_node'        # the same, without its reader process
SETTLE_S = 1.0
QUEUE_DEPTH = 100                              # 253 devices come in 14 messages at once
START_S = 30.0
PREFIX = 'dxl_monitor: timing/'
Metrics = dict[str, dict[str, float]]         # by name and key, e.g. 'max (ms)'


class Traffic(NamedTuple):
    """What is on the bus."""

    kind: str
    gap_us: int = 0
    baud: int = BAUD
    devices: tuple[str, ...] = ROBOT
    trace: Path | None = None


class Run(NamedTuple):
    """What came out of a run; `metrics` since the reset."""

    overrun: int                        # bytes that came while its buffer was full
    cpu: float                          # share of a core, 0 to 1
    growth_mb: float                    # more resident memory at the end
    longest_gap_ms: float               # between two reads
    metrics: Metrics


def through_reader(traffic, seconds):
    """Measure what the bare reader makes of the traffic."""
    with ExitStack() as stack:
        writer, port = _start_writer(stack, traffic)
        reader = stack.enter_context(Child('benchmark.reader', port))
        reader.read_json()
        _begin_measuring(writer, seconds)
        reader.send_json('begin')
        before, result, after = usage(reader.pid), writer.read_json(), usage(reader.pid)
        reader.send_json('report')
        longest_gap_ms = reader.read_json()['longest_gap_ms']
        writer.send_json('done')
    return _run(result, before, after, longest_gap_ms, {})


def through_node(traffic, seconds, *parameters, module=NODE):
    """Measure what the node makes of the traffic; parameters as 'name:=value'."""
    env = ros_environment()
    os.environ.update(env)
    rclpy.init(signal_handler_options=SignalHandlerOptions.NO)
    try:
        with ExitStack() as stack:
            writer, port = _start_writer(stack, traffic)
            given = (f"ports:=['{port}']", f'bauds:=[{traffic.baud}]', *parameters)
            node = stack.enter_context(Child(
                module, '--ros-args', *(word for one in given for word in ('-p', one)), env=env))
            subscriber = _Subscriber()
            subscriber.wait_for_metrics(0, START_S)
            _begin_measuring(writer, seconds)
            subscriber.reset()
            before, result, after = usage(node.pid), writer.read_json(), usage(node.pid)
            metrics = subscriber.wait_for_metrics(time.time_ns())
            writer.send_json('done')
    finally:
        rclpy.try_shutdown()
    return _run(result, before, after, metrics['time_between_buffers']['since start max (ms)'],
                metrics)


def _start_writer(stack, traffic):
    """Return the process that is the bus, and its port."""
    writer = stack.enter_context(Child('benchmark.writer'))
    writer.send_json({**traffic._asdict(), 'trace': str(traffic.trace)})
    return writer, writer.read_json()['port']


def _begin_measuring(writer, seconds):
    """Have it write, and return when what it writes is measured."""
    writer.send_json({'settle': SETTLE_S, 'seconds': seconds})
    writer.read_json()


def _run(result, before, after, longest_gap_ms, metrics):
    return Run(result['overrun'] + result['unheard'],
               (after.cpu_s - before.cpu_s) / result['seconds'],
               after.resident_mb - before.resident_mb, longest_gap_ms, metrics)


class _Subscriber:
    """Hears dxl/timing."""

    def __init__(self):
        self._node = rclpy.create_node('bench_listener')
        self._node.create_subscription(DiagnosticArray, 'dxl/timing', self._hear, QUEUE_DEPTH)
        for topic in ('dxl/diagnostics', '/diagnostics'):       # somebody listens, unread
            self._node.create_subscription(
                DiagnosticArray, topic, lambda message: None, QUEUE_DEPTH, raw=True)
        self._service = self._node.create_client(Trigger, '/dxl_monitor/reset_statistics')
        self._stamp = 0         # the last message's: those in the queue may be old
        self._metrics = {}

    def _hear(self, array):
        self._stamp = array.header.stamp.sec * 1_000_000_000 + array.header.stamp.nanosec
        for status in array.status:
            self._metrics[status.name.removeprefix(PREFIX)] = {
                pair.key: float(pair.value) for pair in status.values
                if pair.key.startswith('since start ')}

    def wait_for_metrics(self, since, seconds=10.0):
        """Return what the node says after a moment (ns since the epoch)."""
        deadline = time.monotonic() + seconds
        while self._stamp <= since:
            if time.monotonic() > deadline:
                raise TimeoutError(f'dxl/timing: nothing heard for {seconds:g} s; '
                                   f'try python -m {NODE} alone')
            rclpy.spin_once(self._node, timeout_sec=0.1)
        return self._metrics

    def reset(self):
        """Let the statistics of the node start at 0."""
        done = self._service.call_async(Trigger.Request())
        rclpy.spin_until_future_complete(self._node, done, timeout_sec=10.0)
