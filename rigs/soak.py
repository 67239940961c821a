# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""
Both nodes for minutes, with faults: nothing grows, nothing is lost in quiet, all ends well.

Bridge and monitor run as processes, each on a cable (cable.py) to its fake; commands come in
spells. A seeded fault strikes every few seconds; between faults it is quiet, and what the nodes
say is held against what cable, bus and MCU know. soak_figures.py says what a soak must come to
(else exit code 1); what went wrong is told in a line when it does.
"""

from collections import Counter
from collections.abc import Callable
from contextlib import ExitStack
from functools import partial
import os
from pathlib import Path
import random
import signal
import sys
from tempfile import TemporaryDirectory
import threading
import time

import rclpy
from rclpy.signals import SignalHandlerOptions

from mecarover_fakes.fake_mcu import FakeMcu
from rigs.cable import Cable
from rigs.harness import Child
from rigs.harness import family
from rigs.harness import Figure
from rigs.harness import Options
from rigs.harness import own_mb
from rigs.harness import ros_environment
from rigs.soak_drive import Driver
from rigs.soak_figures import figures
from rigs.soak_figures import problems
from rigs.soak_figures import Sample
from rigs.soak_watch import Ears
from rigs.soak_watch import FREEZE_AFTER_S
from rigs.soak_watch import IDS
from rigs.soak_watch import Machine
from rigs.soak_watch import MODULES
from rigs.soak_watch import MONITOR
from rigs.soak_watch import NODES
from rigs.soak_watch import S
from rigs.soak_watch import TABLES

__all__ = ['problems', 'run']      # what benchmark/__main__.py calls
SEED = 1
START_S = 60.0
FAULT_S = 2.5                   # after a fault: the back-off, and what it leads to
QUIET_S = 2.0                   # undisturbed, beside what is asked of the monitor then
ANSWER_S = 10.0                 # until something must be heard again
VERDICT_S = 3.0                 # until the monitor has to say what is so
STEADY_S = 0.75                 # its count of bytes stands still: all that came is in it
END_S = 30.0                    # until all must be well again: the window of the levels is 10 s
PROCESSES = 3, 2                # bridge, dead man and its server; monitor and reader
DEVICES = f'{IDS[0]}-{IDS[-1]}:MX-106'


def run(options: Options) -> list[Figure]:
    env = ros_environment()
    os.environ.update(env)
    rclpy.init(signal_handler_options=SignalHandlerOptions.NO)
    try:
        with ExitStack() as stack:
            return _Soak(stack, env).run(options.soak_minutes * 60)
    finally:
        rclpy.try_shutdown()


class _Soak:
    """The processes, the fakes, and what happens to them."""

    def __init__(self, stack: ExitStack, env: dict[str, str]) -> None:
        folder = Path(stack.enter_context(TemporaryDirectory()))
        self._chance = random.Random(SEED)
        self._mcu = stack.enter_context(FakeMcu(str(folder / 'mcu')).running())
        self._bus = stack.enter_context(Child('rigs.soak_bus', str(folder / 'bus'), DEVICES))
        self._answers()                 # it is there
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
        self._ears = Ears()
        stack.callback(self._ears.stop)
        self._driver = Driver(self._ears.node, self._mcu, self._machine, self._complain)
        stack.callback(self._driver.stop)
        self._wrong: Counter[str] = Counter()
        self._lock = threading.Lock()
        self._faults = self._quiets = 0
        self._samples: list[tuple[Sample, ...]] = []

    def run(self, seconds: float) -> list[Figure]:
        if not self._waited(lambda: not self._ears.not_well(0), START_S):
            raise TimeoutError('soak: the nodes are not well from the start; run them alone: '
                               + '; '.join(self._ends() or self._ears.not_well(0)))
        self._waited(self._driver.is_heard, START_S)
        print('soak: all is well, faults from now on', file=sys.stderr, flush=True)
        held_s, begin_s = self._machine.held_s(), time.monotonic()
        self._driver.start()
        while time.monotonic() < begin_s + seconds and not self._ends():
            self._quiet()
            self._strike()
        self._driver.stop()
        self._see_end()
        self._quiet()
        for line in self._ends():
            self._complain('nodes ended', line)
        for line in self._driver.late(self._ears):
            self._complain('drives too late', line)
        return self._figures(time.monotonic() - begin_s, self._machine.held_s() - held_s)

    def _complain(self, kind: str, line: str) -> None:
        with self._lock:                # the driver complains, too
            self._wrong[kind] += 1
            print(f'soak: {line} ({kind}; at {time.monotonic():.1f} s; last fault: '
                  f'{self._driver.last_fault})', file=sys.stderr, flush=True)

    def _ends(self) -> list[str]:
        return [f'{name}: ended with {node.end}'
                for name, node in zip(NODES, self._nodes, strict=True) if node.end]

    def _waited(self, condition: Callable[[], bool], seconds: float) -> bool:
        """Wait for a condition, but not for a node that has ended."""
        return self._machine.waited(lambda: bool(self._ends()) or condition(), seconds) \
            and condition()

    def _see_end(self) -> None:
        """Give the nodes time to be well again."""
        begin, begin_s = time.time_ns(), time.monotonic()
        if not self._waited(lambda: not self._ears.not_well(begin), END_S):
            for line in self._ears.not_well(begin):
                self._complain('statuses not well at the end', line)
        time.sleep(max(0.0, 0.0 if self._ends() else begin_s + FREEZE_AFTER_S - time.monotonic()))

    # --- faults ------------------------------------------------------------------------------

    def _strike(self) -> None:
        """Let one fault happen for up to a second, and wait until its traces are gone."""
        self._faults += 1
        at = self._chance.randrange(2)
        cable, node = self._cables[at], self._nodes[at]
        faults: dict[str, Callable[[], object]] = {
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

    # --- quiet -------------------------------------------------------------------------------

    def _quiet(self) -> None:
        """Let it run undisturbed; what the nodes say must be what is so."""
        begin = time.time_ns()
        is_heard = self._waited(lambda: not self._ears.silent(begin), ANSWER_S)
        if self._ends():
            return
        if not is_heard:
            self._complain_of('silences', self._ears.silent(begin))
            return
        self._hear_verdict(begin, set())
        self._count_processes()
        self._compare_bytes()
        self._sample()
        self._quiets += 1

    def _count_processes(self) -> None:
        self._waited(lambda: all(len(family(node.pid)) == right for node, right
                                 in zip(self._nodes, PROCESSES, strict=True)), ANSWER_S)
        for name, node, right in zip(NODES, self._nodes, PROCESSES, strict=True):
            if not node.end and len(family(node.pid)) != right:
                self._complain('processes missing', f'{name}: {len(family(node.pid))} processes, '
                               f'{right} are right')

    def _complain_of(self, kind: str, lines: list[str]) -> None:
        for line in lines:
            self._complain(kind, line)

    def _compare_bytes(self) -> None:
        """Count what cable and monitor count while it is quiet, between two pauses of the bus."""
        cable = self._cables[1]
        begin_s, held_s = time.monotonic(), self._machine.held_s()
        lost, damaged = [one.lost for one in self._cables], self._damaged_frames()
        cable.stall()
        carried, its_count = cable.carried - cable.lost, self._steady_count()
        cable.calm()
        self._strike_dumb()
        cable.stall()
        carried = cable.carried - cable.lost - carried
        if not self._waited(lambda: self._ears.counted.count - its_count == carried, ANSWER_S):
            counted = self._ears.counted.count - its_count
            self._wrong['bytes counted wrong'] += abs(counted - carried) - 1
            self._complain('bytes counted wrong', f'{MONITOR}: counted {counted} B of '
                           f'{carried} B that the cable brought in quiet')
        cable.calm()
        if damaged != self._damaged_frames():
            self._complain('frames damaged in quiet', f'{NODES[0]}: {self._mcu.totals()}')
        lost_now = sum(one.lost for one in self._cables) - sum(lost)
        rate = carried / (time.monotonic() - begin_s)
        excess = lost_now - rate * max(0.0, self._machine.held_s() - held_s)
        if excess > 0:                  # more than what could not be taken
            self._wrong['bytes lost in quiet'] += lost_now - 1
            self._complain('bytes lost in quiet', f'{lost_now} B were not taken in quiet')

    def _steady_count(self) -> int:
        """Return what the monitor has counted when nothing comes any more."""
        begin, held_s = time.time_ns(), self._machine.held_s()

        def is_steady() -> bool:
            count = self._ears.counted
            steady_s = (count.until - max(count.since, begin)) / S
            return steady_s >= self._machine.patience_s(STEADY_S, held_s)

        if not self._waited(is_steady, ANSWER_S):
            self._complain_of('silences', self._ears.silent(begin, TABLES))
            self._complain('bytes counted wrong', f'{MONITOR}: tells no steady count while the '
                           'cable brings nothing')
        return self._ears.counted.count

    def _strike_dumb(self) -> None:
        """Have a device say nothing for a moment: the monitor must notice both, and only that."""
        self._hear_verdict(time.time_ns(), set())       # what a pause has led to is over
        begin, dumb, before = time.time_ns(), self._chance.choice(IDS), self._answers()
        self._answers(dumb)
        self._hear_verdict(time.time_ns(), {dumb})
        self._answers()
        self._hear_verdict(time.time_ns(), set())
        time.sleep(QUIET_S)
        after = self._answers()
        for number, state in sorted({(number, state) for stamp, number, state
                                     in list(self._ears.denied) if stamp > begin}):
            if number != dumb and after[number] > before[number]:
                self._complain('false verdicts', f'{MONITOR}: called {number:03} {state}, which '
                               'answered')

    def _hear_verdict(self, since: int, dumb: set[int]) -> None:
        ears = self._ears
        if not self._waited(lambda: not ears.silent(since, TABLES) and not ears.wrong(since, dumb),
                            VERDICT_S):
            self._complain_of('silences', ears.silent(since, TABLES))
            self._complain_of('false verdicts', ears.wrong(since, dumb))

    def _answers(self, *dumb: int) -> dict[int, int]:
        """Have these devices say nothing; return how often each has answered."""
        self._bus.tell(dumb)
        return {int(number): count for number, count in self._bus.hear().items()}

    def _damaged_frames(self) -> int:
        totals = self._mcu.totals()
        return totals['insufficient'] + totals['crc_err']

    def _sample(self) -> None:
        """Measure the nodes, each with the processes beside it."""
        sample = []
        for node in self._nodes:
            pids = family(node.pid)
            try:
                sample.append(Sample(own_mb(pids), *(
                    sum(len(os.listdir(f'/proc/{pid}/{what}')) for pid in pids)
                    for what in ('fd', 'task'))))
            except OSError:             # one has just ended: `nodes ended`, `processes missing`
                return
        self._samples.append(tuple(sample))

    # --- what came of it ---------------------------------------------------------------------

    def _figures(self, seconds: float, held_s: float) -> list[Figure]:
        driver = self._driver
        return figures({
            'faults': (self._faults, f'in {seconds:.0f} s'), 'quiet times': (self._quiets, ''),
            'held by the machine': (held_s, 's'),
            'bytes to the monitor': (self._cables[1].carried, 'B'),
            'drives': (driver.drives, ''), 'longest until a drive': (driver.slowest_s, 's'),
            'stops': (driver.stops, ''), 'longest until a stop': (driver.longest_s, 's'),
            'bytes not accounted for': (self._ears.unaccounted, 'B'),
            'velocities made up': (driver.made_up, '')}, self._samples, self._wrong)
