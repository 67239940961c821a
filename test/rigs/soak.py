# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""
Both nodes for minutes, with faults: nothing ends, nothing grows, and after each fault all is well.

Bridge and monitor run as processes, each on a cable (cable.py) to its fake; commands come in
spells. A seeded fault strikes every few seconds. Without a fault the rover obeys, all devices
answer, and each byte is in one counter. LIMITS and LEAST say what a soak must come to (else exit
code 1); what went wrong is said in a line when it does.
"""

from collections import Counter
from contextlib import ExitStack
from functools import partial
import math
import os
from pathlib import Path
import random
import signal
import statistics
import sys
from tempfile import TemporaryDirectory
import threading
import time
from typing import NamedTuple

import rclpy
from rclpy.signals import SignalHandlerOptions

from rigs.cable import Cable
from rigs.harness import Child
from rigs.harness import family
from rigs.harness import Figure
from rigs.harness import own_mb
from rigs.harness import ros_environment
from rigs.running_mcu import RunningMcu
from rigs.soak_drive import Driver
from rigs.soak_watch import IDS
from rigs.soak_watch import Machine
from rigs.soak_watch import NODES
from rigs.soak_watch import Watch

SECTION = 'both nodes with faults'
SEED = 1
START_S = 60.0
FAULT_S = 2.5                   # after a fault: the back-off, and what it leads to
ANSWER_S = 10.0                 # until all must be heard again
END_S = 30.0                    # until all must be well again: the window of the levels is 10 s
MODULES = ('vel2d_bridge.main', 'dxl_monitor.start')
PROCESSES = 3, 2                # bridge, dead man and its server; monitor and reader
DEVICES = f'{IDS[0]}-{IDS[-1]}:MX-106'
LIMITS = {
    'growth of memory, bridge': 5.0, 'growth of memory, monitor': 8.0,
    'more descriptors, bridge': 0, 'more descriptors, monitor': 0,
    'more threads, bridge': 0, 'more threads, monitor': 0,
    'nodes ended': 0, 'processes missing': 0, 'silences': 0, 'bytes not accounted for': 0,
    'velocities made up': 0, 'drives without motion': 0, 'stops too late': 0,
    'statuses not well at the end': 0,
}
LEAST = {'quiet times': 1, 'bytes to the monitor': 1, 'drives': 1, 'stops': 1}


class Sample(NamedTuple):
    """A node at one moment, with its other processes."""

    memory_mb: float
    descriptors: int
    threads: int


def run(options):
    env = ros_environment()
    os.environ.update(env)
    rclpy.init(signal_handler_options=SignalHandlerOptions.NO)
    try:
        with ExitStack() as stack:
            return _Soak(stack, env).run(options.soak_minutes * 60)
    finally:
        rclpy.try_shutdown()


def problems(figures):
    """Return what exceeds LIMITS or does not come to LEAST."""
    found = []
    for one in figures:
        value = f'{one.name}: {one.median:g} {one.unit}'.rstrip()
        if one.name in LIMITS and not one.median <= LIMITS[one.name]:
            found.append(f'{value}, at most {LIMITS[one.name]:g} is right')
        if one.name in LEAST and not one.median >= LEAST[one.name]:
            found.append(f'{value}, less than {LEAST[one.name]:g} proves nothing')
    return found


class _Soak:
    """The processes, the fakes, and what happens to them."""

    def __init__(self, stack, env):
        folder = Path(stack.enter_context(TemporaryDirectory()))
        self._chance = random.Random(SEED)
        self._mcu = stack.enter_context(RunningMcu(str(folder / 'mcu')).running())
        fake_bus = stack.enter_context(Child(
            'mecarover_fakes.fake_bus', '--link', str(folder / 'bus'), '--devices', DEVICES,
            '--pattern', 'moving', env=env))
        fake_bus.read_line()
        self._cables = [
            stack.enter_context(Cable(str(folder / device), folder / f'{device}_cable', seed))
            for seed, device in enumerate(('mcu', 'bus'))]
        bridge, bus = self._cables
        parameters = (('port', bridge.path),), (
            ('ports', f"['{bus.path}']"), ('devices', f"['{DEVICES}']"), ('publish_rate', '4.0'))
        self._nodes = [
            stack.enter_context(Child(module, '--ros-args', *(
                word for key, value in given for word in ('-p', f'{key}:={value}')),
                env=env, quiet=True))
            for module, given in zip(MODULES, parameters, strict=True)]
        self._machine = Machine([node.pid for node in self._nodes])
        stack.callback(self._machine.stop)
        self._watch = Watch()
        stack.callback(self._watch.stop)
        self._driver = Driver(self._watch.node, self._mcu, self._machine, self._complain)
        stack.callback(self._driver.stop)
        self._wrong = Counter()
        self._lock = threading.Lock()
        self._faults = self._quiets = 0
        self._samples = []

    def run(self, seconds):
        if not self._wait_until(lambda: not self._watch.not_well(0), START_S):
            raise TimeoutError('soak: the nodes are not well from the start; run them alone: '
                               + '; '.join(self._ends() or self._watch.not_well(0)))
        self._wait_until(self._driver.is_heard, START_S)
        print('soak: all is well, faults from now on', file=sys.stderr, flush=True)
        begin_s = time.monotonic()
        self._driver.start()
        while time.monotonic() < begin_s + seconds and not self._ends():
            self._run_undisturbed()
            self._cause_fault()
        self._driver.stop()
        end = time.time_ns()
        if not self._wait_until(lambda: not self._watch.not_well(end), END_S):
            for line in self._watch.not_well(end):
                self._complain('statuses not well at the end', line)
        self._run_undisturbed()
        for line in self._ends():
            self._complain('nodes ended', line)
        return self._figures(time.monotonic() - begin_s)

    def _complain(self, kind, line):
        with self._lock:                # the driver complains, too
            self._wrong[kind] += 1
            print(f'soak: {line} ({kind}; at {time.monotonic():.1f} s; last fault: '
                  f'{self._driver.last_fault})', file=sys.stderr, flush=True)

    def _ends(self):
        return [f'{name}: ended with {node.end}'
                for name, node in zip(NODES, self._nodes, strict=True) if node.end]

    def _wait_until(self, condition, seconds):
        """Wait for a condition, but not for a node that has ended."""
        return self._machine.wait_until(lambda: bool(self._ends()) or condition(), seconds) \
            and condition()

    def _cause_fault(self):
        """Let one fault happen for up to a second, and wait until its traces are gone."""
        self._faults += 1
        at = self._chance.randrange(2)
        cable, node = self._cables[at], self._nodes[at]
        faults = {
            'drop': partial(cable.damage, drop=0.3), 'flip': partial(cable.damage, flip=0.3),
            'delay': partial(cable.damage, delay_s=0.1), 'stall': cable.stall,
            'flood': partial(cable.flood, 0.5), 'cut': cable.cut,
            'no name': cable.remove_name, 'freeze': partial(node.signal, signal.SIGSTOP)}
        self._driver.is_hindered = at == 0
        fault = self._chance.choice(list(faults))
        self._driver.last_fault = f'{fault} of {NODES[at]} at {time.monotonic():.1f} s'
        faults[fault]()
        time.sleep(self._chance.uniform(0.1, 1.0))
        node.signal(signal.SIGCONT)
        cable.calm()
        if fault == 'no name':
            cable.restore_name()
        cable.reopen()
        time.sleep(FAULT_S)
        self._driver.is_hindered = False

    def _run_undisturbed(self):
        """Let it run undisturbed until all is heard and all devices answer."""
        begin, watch = time.time_ns(), self._watch
        is_heard = self._wait_until(lambda: not watch.silent(begin), ANSWER_S)
        if self._ends():
            return
        for line in () if is_heard else watch.silent(begin):
            self._complain('silences', line)
        self._wait_until(lambda: all(len(family(node.pid)) == right for node, right
                                 in zip(self._nodes, PROCESSES, strict=True)), ANSWER_S)
        for name, node, right in zip(NODES, self._nodes, PROCESSES, strict=True):
            if not node.end and len(family(node.pid)) != right:
                self._complain('processes missing', f'{name}: {len(family(node.pid))} processes, '
                               f'{right} are right')
        self._sample()
        self._quiets += 1

    def _sample(self):
        """Measure the nodes, each with its other processes."""
        sample = []
        for node in self._nodes:
            pids = family(node.pid)
            try:
                sample.append(Sample(own_mb(pids), *(
                    sum(len(os.listdir(f'/proc/{pid}/{what}')) for pid in pids)
                    for what in ('fd', 'task'))))
            except OSError:             # one has just ended: `nodes ended`, `processes missing`
                return
        self._samples.append(sample)

    def _figures(self, seconds):
        """Return what was measured, what grew, and how often what went wrong."""
        driver = self._driver
        rows = {
            'faults': (self._faults, f'in {seconds:.0f} s'), 'quiet times': (self._quiets, ''),
            'bytes to the monitor': (self._cables[1].carried, 'B'),
            'drives': (driver.drives, ''), 'stops': (driver.stops, ''),
            'longest until a stop': (driver.longest_s, 's'),
            'bytes not accounted for': (self._watch.unaccounted, 'B'),
            'velocities made up': (driver.made_up, '')}
        for at, node in enumerate(('bridge', 'monitor')):
            for what, name, unit in (('growth of memory', 'memory_mb', 'MB'),
                                     ('more descriptors', 'descriptors', ''),
                                     ('more threads', 'threads', '')):
                rows[f'{what}, {node}'] = growth(
                    [getattr(one[at], name) for one in self._samples]), unit
        for name in LIMITS:
            rows.setdefault(name, (self._wrong[name], ''))
        return [Figure(SECTION, name, unit, [float(value)], _bound(name))
                for name, (value, unit) in rows.items()]


def growth(values):
    """Return how much more the last third has than the first; NaN, a problem, for nothing."""
    if not values:
        return math.nan
    third = max(1, len(values) // 3)
    return statistics.median(values[-third:]) - statistics.median(values[:third])


def _bound(name):
    if name in LIMITS:
        return f'at most {LIMITS[name]:g}'
    return f'at least {LEAST[name]:g}' if name in LEAST else ''
