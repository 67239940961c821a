# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""
Both nodes for minutes, with faults: nothing grows, nothing is lost in quiet, all ends well.

Bridge and monitor run as processes, each on a cable (cable.py) to its fake; commands come in
spells. A seeded fault strikes every few seconds; between faults and at the end it is quiet, and
only what is lost in quiet counts. LIMITS says what a soak must not exceed (exit code 1).
"""

from collections.abc import Callable
from contextlib import ExitStack
from functools import partial
import os
from pathlib import Path
import random
import signal
import statistics
import sys
from tempfile import TemporaryDirectory
import threading
import time
from typing import Any

from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import Twist
import rclpy
from rclpy.qos import QoSProfile
from rclpy.qos import ReliabilityPolicy
from rclpy.signals import SignalHandlerOptions

from benchmark.cable import Cable
from benchmark.harness import Child
from benchmark.harness import Figure
from benchmark.harness import Options
from benchmark.harness import ros_environment
from benchmark.harness import usage
from vel2d_bridge.fake_mcu import FakeMcu

SECTION = 'both nodes with faults'
SEED = 1
START_S = 60.0
QUIET_S = 4.0                   # between faults: a drive and a rest
END_S = 30.0                    # until all must be well again: the window of the levels is 10 s
SPEED = 0.3
DRIVE_S, REST_S = 2.0, 1.5
STOP_BOUND_S = 0.95             # as docs/reliability.md; and what a shared machine adds:
LATE_S = 0.5
HELD_S = 0.25                   # when it held us for so long, the moment says nothing
NODES = ('vel2d_bridge', 'dxl_monitor')
DEVICES = '1-8:MX-106'
LIMITS = {
    'growth of memory, bridge': 5.0, 'growth of memory, monitor': 8.0,
    'more descriptors, bridge': 0, 'more descriptors, monitor': 0,
    'more threads, bridge': 0, 'more threads, monitor': 0,
    'bytes not accounted for': 0, 'bytes lost in quiet': 0, 'velocities made up': 0,
    'stops too late': 0, 'statuses not well at the end': 0, 'nodes ended': 0,
}


def run(options: Options) -> list[Figure]:
    env = ros_environment()
    os.environ.update(env)
    rclpy.init(signal_handler_options=SignalHandlerOptions.NO)
    try:
        with ExitStack() as stack:
            return _Soak(stack, env).run(options.soak_minutes * 60)
    finally:
        rclpy.try_shutdown()


def problems(figures: list[Figure]) -> list[str]:
    """Return what exceeds LIMITS."""
    return [f'{one.name}: {one.median:g} {one.unit}, at most {LIMITS[one.name]:g} is right'
            for one in figures if one.name in LIMITS and not one.median <= LIMITS[one.name]]


class _Soak:
    """The processes, the fakes, and what happens to them."""

    def __init__(self, stack: ExitStack, env: dict[str, str]) -> None:
        folder = Path(stack.enter_context(TemporaryDirectory()))
        self._chance = random.Random(SEED)
        self._mcu = stack.enter_context(FakeMcu(str(folder / 'mcu')).running())
        stack.enter_context(Child('dxl_monitor.fake_bus', '--link', str(folder / 'bus'),
                                  '--devices', DEVICES, '--rate', '100', quiet=True))
        _wait((folder / 'bus').exists)
        self._cables = [
            stack.enter_context(Cable(str(folder / device), folder / f'{device}_cable', seed))
            for seed, device in enumerate(('mcu', 'bus'))]
        bridge, bus = self._cables
        parameters = (('port', bridge.path),), (
            ('ports', f"['{bus.path}']"), ('devices', f"['{DEVICES}']"), ('publish_rate', '4.0'))
        self._nodes = [
            stack.enter_context(Child(f'{name}.main', '--ros-args', *(
                word for key, value in given for word in ('-p', f'{key}:={value}')),
                env=env, quiet=True))
            for name, given in zip(NODES, parameters, strict=True)]
        self._ears = _Ears()
        stack.callback(self._ears.stop)
        self._driver = _Driver(self._ears.node, self._mcu)
        stack.callback(self._driver.stop)
        self._faults = 0
        self._samples: list[tuple[tuple[float, int, int], ...]] = []
        self._lost_in_quiet = 0

    def run(self, seconds: float) -> list[Figure]:
        _wait(self._is_well, START_S)
        self._driver.start()
        end = time.monotonic() + seconds
        while time.monotonic() < end:
            self._quiet(QUIET_S)
            self._strike()
        self._driver.stop()
        not_well = [] if _waited(self._is_well, END_S) else self._ears.not_well()
        for line in not_well:
            print(f'soak: not well: {line}', file=sys.stderr)
        self._quiet(QUIET_S)
        return self._figures(seconds, len(not_well))

    # --- faults ------------------------------------------------------------------------------

    def _strike(self) -> None:
        """Let one fault happen for up to a second, and wait until its traces are gone."""
        self._faults += 1
        at = self._chance.randrange(2)
        cable, node = self._cables[at], self._nodes[at]
        faults: list[Callable[[], object]] = [
            partial(cable.damage, drop=0.3), partial(cable.damage, flip=0.3),
            partial(cable.damage, delay_s=0.1), cable.stall, partial(cable.flood, 0.5), cable.cut,
            cable.remove_name, partial(os.kill, node.pid, signal.SIGSTOP)]
        self._driver.is_hindered = at == 0
        fault = self._chance.choice(faults)
        self._driver.last_fault = f'{fault} on {NODES[at]} at {time.monotonic():.1f} s'
        fault()
        time.sleep(self._chance.uniform(0.1, 1.0))
        os.kill(node.pid, signal.SIGCONT)
        cable.calm()
        if fault == cable.remove_name:
            cable.restore_name()
        cable.reopen()
        time.sleep(2.5)                 # the back-off, and what it leads to
        self._driver.is_hindered = False

    def _quiet(self, seconds: float) -> None:
        """Let it run undisturbed; take a sample, count what nobody takes."""
        before = [cable.lost for cable in self._cables]
        time.sleep(seconds)
        self._lost_in_quiet += sum(
            cable.lost - lost for cable, lost in zip(self._cables, before, strict=True))
        self._samples.append(tuple(
            (usage(node.pid).resident_mb, _count(node.pid, 'fd'), _count(node.pid, 'task'))
            for node in self._nodes if Path(f'/proc/{node.pid}/fd').exists()))

    def _is_well(self) -> bool:
        return not self._ears.not_well()

    # --- what came of it ---------------------------------------------------------------------

    def _figures(self, seconds: float, not_well: int) -> list[Figure]:
        whole = [one for one in self._samples if len(one) == len(NODES)]
        third = max(1, len(whole) // 3)
        figures = {
            'faults': (self._faults, f'in {seconds:.0f} s'), 'stops': (self._driver.stops, ''),
            'bytes to the monitor': (self._cables[1].carried, 'B'),
            'nodes ended': (sum(len(one) < len(NODES) for one in self._samples), ''),
            'bytes not accounted for': (self._ears.unaccounted, 'B'),
            'bytes lost in quiet': (self._lost_in_quiet, 'B'),
            'velocities made up': (self._driver.made_up, ''),
            'stops too late': (self._driver.late, ''),
            'longest until a stop': (self._driver.longest_s, 's'),
            'statuses not well at the end': (not_well, '')}
        for at, node in enumerate(('bridge', 'monitor')):
            first, last = whole[:third], whole[-third:]
            for kind, (what, unit) in enumerate((
                    ('growth of memory', 'MB'), ('more descriptors', ''), ('more threads', ''))):
                grown = statistics.median(one[at][kind] for one in last) - statistics.median(
                    one[at][kind] for one in first)
                figures[f'{what}, {node}'] = (grown, unit)
            figures[f'memory at the end, {node}'] = (whole[-1][at][0], 'MB')
        return [Figure(SECTION, name, unit, [float(value)],
                       f'at most {LIMITS[name]:g}' if name in LIMITS else '')
                for name, (value, unit) in figures.items()]


class _Ears:
    """Hears the statuses of both nodes, in a thread of its own."""

    def __init__(self) -> None:
        self.node = rclpy.create_node('bench_soak')
        self.unaccounted = 0            # most of all reports
        self._complaints: dict[str, str] = {}       # by status, '' where it is OK
        for topic in ('/diagnostics', 'dxl/diagnostics'):
            self.node.create_subscription(DiagnosticArray, topic, self._hear, 100)
        self._is_stopping = False
        self._thread = threading.Thread(target=self._spin, name='ears')
        self._thread.start()

    def stop(self) -> None:
        self._is_stopping = True
        self._thread.join()

    def not_well(self) -> list[str]:
        """Return the statuses that are not OK and what they say; silent nodes likewise."""
        heard = dict(self._complaints)
        silent = [f'{node}: says nothing' for node in NODES
                  if not any(name.startswith(node) for name in heard)]
        return silent + [f'{name}: {text}' for name, text in heard.items() if text]

    def _spin(self) -> None:
        while not self._is_stopping:
            rclpy.spin_once(self.node, timeout_sec=0.1)

    def _hear(self, array: DiagnosticArray) -> None:
        for status in array.status:
            self._complaints[status.name] = status.message if status.level[0] else ''
            values = {pair.key: pair.value for pair in status.values}
            if 'Noise Bytes' in values:
                parts = (int(values[f'{kind} Bytes']) for kind in ('Packet', 'Noise', 'Pending'))
                self.unaccounted = max(self.unaccounted, abs(int(values['Bytes']) - sum(parts)))


class _Driver:
    """Publishes commands in spells, and watches how the rover obeys."""

    def __init__(self, node: Any, mcu: FakeMcu) -> None:
        self.is_hindered = False        # a fault may delay a stop beyond the bound
        self.last_fault = 'none'
        self.stops = self.late = self.made_up = 0
        self.longest_s = 0.0
        # A reliable publisher sends a lost command again, seconds later: a new one for the bridge.
        self._publisher = node.create_publisher(Twist, 'cmd_vel', QoSProfile(
            depth=1, reliability=ReliabilityPolicy.BEST_EFFORT))
        self._mcu = mcu
        self._done = threading.Event()
        self._thread = threading.Thread(target=self._run, name='driver')

    def start(self) -> None:
        self._thread.start()

    def stop(self) -> None:
        self._done.set()
        if self._thread.is_alive():
            self._thread.join()

    def _run(self) -> None:
        message = Twist()
        message.linear.x = SPEED
        while not self._done.is_set():
            was_hindered = False
            end = time.monotonic() + DRIVE_S
            while time.monotonic() < end:
                self._publisher.publish(message)
                was_hindered |= self.is_hindered
                self._look()
                time.sleep(0.02)
            self._rest(time.monotonic(), was_hindered)

    def _rest(self, last_s: float, was_hindered: bool) -> None:
        """Say nothing; the rover must stop."""
        stopped_s = None
        looked_s = last_s
        while (now_s := time.monotonic()) < last_s + REST_S:
            self._look()
            was_hindered |= self.is_hindered or now_s - looked_s > HELD_S
            looked_s = now_s
            wheels = self._mcu.receiver.wheels
            if stopped_s is None and wheels.is_stop:
                stopped_s = time.monotonic()
            time.sleep(0.01)
        if not was_hindered:
            self.stops += 1
            taken_s = (stopped_s or time.monotonic()) - last_s
            self.longest_s = max(self.longest_s, taken_s)
            if taken_s > STOP_BOUND_S + LATE_S:
                self.late += 1
                print(f'soak: no stop within {taken_s:.3f} s at {time.monotonic():.1f} s; '
                      f'last fault: {self.last_fault}; {self._mcu.totals()}', file=sys.stderr)

    def _look(self) -> None:
        arrivals = self._mcu.receiver.arrivals
        while arrivals:
            velocity = arrivals.popleft().velocity
            self.made_up += velocity is not None and tuple(velocity) not in (
                (SPEED, 0.0, 0.0), (0.0, 0.0, 0.0))


def _count(pid: int, what: str) -> int:
    return len(os.listdir(f'/proc/{pid}/{what}'))


def _waited(condition: Callable[[], bool], seconds: float) -> bool:
    deadline = time.monotonic() + seconds
    while not condition() and time.monotonic() < deadline:
        time.sleep(0.05)
    return condition()


def _wait(condition: Callable[[], bool], seconds: float = START_S) -> None:
    if not _waited(condition, seconds):
        raise TimeoutError(f'soak: the nodes are not well after {seconds:g} s; run them alone')
