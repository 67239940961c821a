# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""
One run of traffic through ptys: into the real node dxl_monitor, or into bare readers.

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

    seconds: float
    sent: int
    overrun: int                        # bytes that nobody took
    cpu: float                          # share of a core, 0 to 1
    resident_mb: float
    growth_mb: float                    # more resident memory at the end
    longest_gap_ms: float               # between two reads
    metrics: Metrics


def through_reader(traffic, seconds):
    """Measure what the bare reader makes of the traffic."""
    return several_through_readers([traffic], seconds)[0]


def several_through_readers(buses, seconds):
    """Measure bare readers, one for each bus, all at the same time."""
    with ExitStack() as stack:
        writers, ports = _writers(stack, buses)
        readers = [stack.enter_context(Child('benchmark.reader', port)) for port in ports]
        for reader in readers:
            reader.hear()
        _begin(writers, seconds, SETTLE_S)
        for reader in readers:
            reader.tell('begin')
        before = [usage(reader.pid) for reader in readers]
        results = [writer.hear() for writer in writers]
        after = [usage(reader.pid) for reader in readers]
        for reader in readers:
            reader.tell('report')
        longest = [reader.hear()['longest_gap_ms'] for reader in readers]
        for writer in writers:
            writer.tell('done')
    return [_run(*one, {}) for one in zip(results, before, after, longest, strict=True)]


def through_node(traffic, seconds, *parameters, module=NODE, settle_s=SETTLE_S):
    """Measure what the node makes of the traffic; parameters as 'name:=value'."""
    return several_through_node([traffic], seconds, *parameters, module=module,
                                settle_s=settle_s)[0]


def several_through_node(buses, seconds, *parameters, module=NODE, settle_s=SETTLE_S):
    """Measure one node that hears all buses: a run for each; CPU and memory are the node's."""
    env = ros_environment()
    os.environ.update(env)
    rclpy.init(signal_handler_options=SignalHandlerOptions.NO)
    try:
        with ExitStack() as stack:
            writers, ports = _writers(stack, buses)
            names = [f'bus{number}' for number in range(len(buses))]
            given = (f'ports:={ports}', f'bauds:={[one.baud for one in buses]}',
                     f'names:={names}', *parameters)
            node = stack.enter_context(Child(
                module, '--ros-args', *(word for one in given for word in ('-p', one)), env=env))
            subscriber = _Subscriber()
            subscriber.wait_for_metrics(0, START_S)
            _begin(writers, seconds, settle_s)
            subscriber.reset()
            before = usage(node.pid)
            results = [writer.hear() for writer in writers]
            after = usage(node.pid)
            metrics = subscriber.wait_for_metrics(time.time_ns())
            for writer in writers:
                writer.tell('done')
    finally:
        rclpy.try_shutdown()
    found = [metrics] if len(buses) == 1 else [_of_bus(name, metrics) for name in names]
    return [_run(result, before, after, one['time_between_buffers']['since start max (ms)'], one)
            for result, one in zip(results, found, strict=True)]


def _of_bus(name, metrics):
    return {key.removeprefix(f'{name}/'): values for key, values in metrics.items()
            if key.startswith(f'{name}/')}


def _writers(stack, buses):
    """Return a writer for each bus, and their ports."""
    writers = [stack.enter_context(Child('benchmark.writer')) for _ in buses]
    for writer, traffic in zip(writers, buses, strict=True):
        writer.tell({**traffic._asdict(), 'trace': str(traffic.trace)})
    return writers, [writer.hear()['port'] for writer in writers]


def _begin(writers, seconds, settle_s):
    """Have them write, and return when what they write is measured."""
    for writer in writers:
        writer.tell({'settle': settle_s, 'seconds': seconds})
    for writer in writers:
        writer.hear()


def _run(result, before, after, longest_gap_ms, metrics):
    seconds = result['seconds']
    return Run(seconds, result['sent'], result['overrun'] + result['unheard'],
               (after.cpu_s - before.cpu_s) / seconds, after.resident_mb,
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
