# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""
What the doctor costs: its CPU time beside that of all else the monitor does, at a full bus.

200 kB/s (2 MBd) of a walking robot, in chunks of 2 ms, a report every 0.5 s of bus time, all from
memory. The monitor as a process does more than that: it reads, builds messages and publishes.
"""

from functools import partial
import time

from benchmark.confusion import chunks
from mecarover_fakes.fake_bus import make_devices
from mecarover_fakes.faults import parse
from mecarover_fakes.line import Line
from mecarover_fakes.master import Master
from mecarover_fakes.traffic import PATTERNS
from rigs.harness import Figure
from rigs.harness import interleaved
from servobus.bus.decoder import Settings
from servobus.doctor import Doctor
from servobus.model.models import Models
from servobus.monitor import Monitor

S = 1_000_000_000
BAUD = 2_000_000
ROBOT = ('1-20:MX-106', '100:Rhoban DXL Board')
SECONDS, QUICK_SECONDS = 20, 5
CASES = {
    'a healthy bus': (), 'a bus full of noise': ('noise::0',)}
_CORE_MS = 1000.0                  # ms of CPU time in a second


def run(options):
    """Measure on a healthy bus and on one that gives the doctor a lot to look at."""
    models = Models()
    seconds = QUICK_SECONDS if options.quick else SECONDS
    results = interleaved({
        name: partial(_costs, models, faults, seconds) for name, faults in CASES.items()},
        options.rounds)
    figures = []
    for name, rounds in results.items():
        doctor = [mine for mine, _ in rounds]
        shares = [100 * mine / (mine + others) for mine, others in rounds]
        figures += [
            Figure(f'doctor: {name}', 'CPU of the doctor', 'ms/s', doctor,
                   f'{100 * sorted(doctor)[len(doctor) // 2] / _CORE_MS:.2f} % of a core'),
            Figure(f'doctor: {name}', 'share of the monitor from memory', '%', shares)]
    return figures


def _costs(models, faults, seconds):
    """Return ms of CPU per second of bus time: of the doctor, and of all else."""
    traffic = list(chunks(_master(models, faults), seconds * S, S // 500))
    monitor = Monitor('bus', models, Settings(baud=BAUD))
    clock = Stopwatch(monitor)
    start = time.process_time_ns()
    report_at = S // 2
    for chunk, stamp, side in traffic:
        while stamp > report_at:
            monitor.report(report_at)
            report_at += S // 2
        monitor.feed(chunk, stamp, side)
    spent = time.process_time_ns() - start
    return clock.spent / 1e6 / seconds, (spent - clock.spent) / 1e6 / seconds


def _master(models, faults):
    line = Line(make_devices(list(ROBOT), models, BAUD), BAUD)
    return Master(line, PATTERNS['moving'], rate=0, gap=0,
                  faults=[parse(fault) for fault in faults])


class Stopwatch(Doctor):
    """A doctor that keeps its own time; takes the place of a monitor's."""

    def __init__(self, monitor):
        super().__init__()
        self.spent = 0             # ns
        monitor.doctor = self

    def examine(self, report):
        """Do as any doctor does."""
        start = time.process_time_ns()
        result = super().examine(report)
        self.spent += time.process_time_ns() - start
        return result
