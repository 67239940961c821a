# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""
From the start of a process to what it is there for, beside a minimal rclpy node in turn.

The bridge: its first frame (a stop) at the other end of a pty. The monitor: its first
dxl/diagnostics in another process, discovery included, at the default publish_rate. What is
imported is compiled beforehand, as an installation has it.
"""

from contextlib import contextmanager
from functools import partial
import os
import select
import time

from diagnostic_msgs.msg import DiagnosticArray
import rclpy
from rclpy.signals import SignalHandlerOptions

from benchmark.minimal_node import TOPIC
from rigs.harness import Child
from rigs.harness import Figure
from rigs.harness import interleaved
from rigs.harness import ros_environment
from servobus.port.pty import Pty

SECTION = 'from the start of a process'
LIMIT_S = 30.0
WANTED = 'wanted: at most 0.3'
BRIDGE, MONITOR, MINIMAL = 'vel2d_bridge.main', 'dxl_monitor.start', 'benchmark.minimal_node'


def run(options):
    env = ros_environment()
    env.pop('PYTHONDONTWRITEBYTECODE', None)
    os.environ.update(env)
    rclpy.init(signal_handler_options=SignalHandlerOptions.NO)
    try:
        listener = rclpy.create_node('bench_listener')
        to_frame = partial(_to_frame, env)
        to_message = partial(_to_message, env, listener)
        cases = {
            'bridge, first frame': partial(to_frame, BRIDGE, '--ros-args', '-p', 'port:={port}'),
            'minimal node, first frame': partial(to_frame, MINIMAL, '{port}'),
            'monitor, first dxl/diagnostics': partial(
                to_message, 'dxl/diagnostics', MONITOR, '--ros-args', '-p', 'ports:={port}'),
            'minimal node, first message': partial(to_message, TOPIC, MINIMAL, '{port}'),
        }
        for case in cases.values():         # what it imports is compiled then
            case()
        taken = interleaved(cases, options.rounds)
    finally:
        rclpy.try_shutdown()
    figures = [Figure(SECTION, name, 's', values) for name, values in taken.items()]
    bridge, least_frame, monitor, least_message = taken.values()
    for name, ours, least in (('bridge', bridge, least_frame),
                              ('monitor', monitor, least_message)):
        more = [one - other for one, other in zip(ours, least, strict=True)]
        figures.append(Figure(SECTION, f'{name} - minimal node', 's', more, WANTED))
    return figures


@contextmanager
def _started(env, module, arguments):
    """Start a module on a pty; give the time of that and the pty."""
    with Pty() as pty:
        begin = time.monotonic()
        with Child(module, *(one.format(port=pty.path) for one in arguments), env=env, quiet=True):
            yield begin, pty


def _to_frame(env, module, *arguments):
    """Return the seconds until the first byte is at the other end."""
    with _started(env, module, arguments) as (begin, pty):
        if not select.select([pty.master], [], [], LIMIT_S)[0]:
            raise TimeoutError(f'{module}: no frame in {LIMIT_S:g} s; run it alone to see why')
        return time.monotonic() - begin


def _to_message(env, listener, topic, module, *arguments):
    """Return the seconds until the first message on a topic is here."""
    came = []
    subscription = listener.create_subscription(
        DiagnosticArray, topic, lambda message: came.append(time.monotonic()), 10)
    with _started(env, module, arguments) as (begin, _):
        while not came:
            rclpy.spin_once(listener, timeout_sec=0.1)
            if time.monotonic() - begin > LIMIT_S:
                raise TimeoutError(f'{module}: nothing on {topic} in {LIMIT_S:g} s; '
                                   'run it alone to see why')
    listener.destroy_subscription(subscription)
    return came[0] - begin
