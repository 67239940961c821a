# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""
What benchmarks and rigs share: interleaved rounds, figures with their spread, child processes.

A machine that others use too is fast at one moment and slow at the next. So cases that are to be
compared take turns, and a figure is the median of its rounds beside the smallest and the largest.
"""

from collections.abc import Sequence
from contextlib import suppress
import json
from math import ceil
import os
from pathlib import Path
import platform
import random
from statistics import median
import subprocess
import sys
from typing import NamedTuple

from mecarover_fakes.domain_lock import BENCHMARKS

REPOSITORY = Path(__file__).resolve().parents[2]
_TICKS = os.sysconf('SC_CLK_TCK')


class Options(NamedTuple):
    """What the command line asks for."""

    quick: bool = False
    trace: Path | None = None           # a recorded robot trace, raw bytes
    seconds: float = 10.0               # per experiment through a pty
    soak_minutes: float = 5.0
    asked_rounds: int | None = None     # else what is usual

    @property
    def rounds(self):
        return self.asked_rounds or (3 if self.quick else 9)


class Figure(NamedTuple):
    """One result: a value per round; `beside` is what it is to be compared with, in words."""

    section: str
    name: str
    unit: str
    values: Sequence[float]
    beside: str = ''

    @property
    def median(self):
        return median(self.values)


def interleaved(cases, rounds, seed=1):
    """Run every case once per round, in a new order each time; return the results by case."""
    rng = random.Random(seed)
    results = {name: [] for name in cases}
    order = list(cases)
    for _ in range(rounds):
        rng.shuffle(order)
        for name in order:
            results[name].append(cases[name]())
    return results


def quantile(values, share):
    """Return the value of nearest rank."""
    return sorted(values)[max(1, ceil(share * len(values))) - 1]


def table(figures):
    """Lay figures out for a terminal, one section after the other."""
    rows = [(figure.name, f'{figure.median:.4g}', figure.unit,
             f'({min(figure.values):.4g} to {max(figure.values):.4g})', figure.beside)
            for figure in figures]
    widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
    lines = []
    section = ''
    for figure, row in zip(figures, rows, strict=True):
        if figure.section != section:
            section = figure.section
            lines.append(f'\n{section}')
        name, value, unit, spread, beside = (
            cell.rjust(width) if i == 1 else cell.ljust(width)
            for i, (cell, width) in enumerate(zip(row, widths, strict=True)))
        lines.append(f'  {name}  {value} {unit}  {spread}  {beside}'.rstrip())
    return '\n'.join(lines)


def as_json(figures, command):
    return json.dumps({
        'command': command,
        'machine': machine(),
        'figures': [{
            'section': figure.section, 'name': figure.name, 'unit': figure.unit,
            'median': figure.median, 'minimum': min(figure.values),
            'maximum': max(figure.values), 'values': list(figure.values),
            'beside': figure.beside} for figure in figures],
    }, indent=1)


def machine():
    """Describe the machine without naming it or its owner."""
    return {
        'cpu': _cpu_name(),
        'cores': str(len(os.sched_getaffinity(0))),
        'memory': f'{os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES") / 1e9:.1f} GB',
        'kernel': platform.release(),
        'python': f'{platform.python_implementation()} {platform.python_version()}',
        'load at the start': f'{os.getloadavg()[0]:.2f}',
    }


def _cpu_name():
    text = Path('/proc/cpuinfo').read_text()
    for key in ('model name', 'Model'):         # x86-64, Raspberry Pi
        for line in text.splitlines():
            if line.startswith(key):
                return line.partition(':')[2].strip()
    return platform.machine()


class Usage(NamedTuple):
    """What a process and its children have taken so far."""

    cpu_s: float
    resident_mb: float                  # what they share counts for each

    def __add__(self, other):
        return Usage(*(mine + its for mine, its in zip(self, other, strict=True)))


def usage(pid):
    """Return what a process and its living children have taken so far."""
    fields = Path(f'/proc/{pid}/stat').read_text().rpartition(')')[2].split()
    own = Usage((int(fields[11]) + int(fields[12])) / _TICKS,
                _status(Path(f'/proc/{pid}/status'), 'VmRSS') / 1024)
    return sum(map(usage, children(pid)), own)


def children(pid):
    """Return the children of all threads of a process, none of one that has ended."""
    found = []
    with suppress(FileNotFoundError):
        for task in Path(f'/proc/{pid}/task').iterdir():
            with suppress(OSError):                # a thread that ends while we look
                found += map(int, (task / 'children').read_text().split())
    return found


def family(pid):
    """Return a process and its descendants, without zombies, which have a folder too."""
    return [pid] * is_alive(pid) + [one for child in children(pid) for one in family(child)]


def own_mb(pids):
    """Return the memory that processes have filled; of a file's, the kernel takes pages back."""
    return sum(_status(Path(f'/proc/{pid}/status'), key)
               for pid in pids for key in ('RssAnon', 'VmSwap')) / 1024


def state(pid):
    """Return the state of a process as ps shows it, as T for stopped; '' if it is gone."""
    try:
        return Path(f'/proc/{pid}/stat').read_text().rpartition(')')[2].split()[0]
    except (OSError, IndexError):
        return ''


def is_alive(pid):
    """Tell whether a process runs; one that only waits for its parent to look is over."""
    return state(pid) not in ('', 'Z', 'X')


def _status(path, key):
    for line in path.read_text().splitlines():
        if line.startswith(f'{key}:'):
            return int(line.split()[1])
    return 0


def ros_environment():
    """Return an environment in which the nodes of this run meet no others."""
    return {**os.environ, 'ROS_AUTOMATIC_DISCOVERY_RANGE': 'LOCALHOST',
            'ROS_DOMAIN_ID': str(random.SystemRandom().choice(BENCHMARKS)),
            'PYTHONPATH': os.pathsep.join(
                filter(None, (str(REPOSITORY), os.environ.get('PYTHONPATH'))))}


class Child:
    """
    A Python module in a process of its own; it talks in lines of JSON.

    Leaving the context ends it: SIGTERM, and SIGKILL after 5 s.
    """

    def __init__(self, module, *arguments, env=None, quiet=False):
        self._module = module
        self._process = subprocess.Popen(
            [sys.executable, '-u', '-m', module, *arguments], cwd=REPOSITORY,
            env=dict(os.environ if env is None else env), text=True, stdin=subprocess.PIPE,
            stdout=subprocess.PIPE, stderr=subprocess.DEVNULL if quiet else None,
            start_new_session=True)         # Ctrl-C is for this process, which ends its children
        self.pid = self._process.pid

    def read_json(self):
        """Return the next line of JSON that the child says, decoded."""
        while not (line := self.read_line()).startswith(('{', '[')):
            pass
        return json.loads(line)

    def read_line(self):
        """Return the next line that the child says."""
        if line := self._process.stdout.readline():
            return line
        raise ChildProcessError(f'python -m {self._module}: ended early; run it alone to see why')

    def send_json(self, thing):
        self._process.stdin.write(json.dumps(thing) + '\n')
        self._process.stdin.flush()

    def signal(self, number):
        """Send a signal; one that has ended gets none."""
        self._process.send_signal(number)

    @property
    def end(self):
        """How it ended: 'signal 9', 'exit code 0'; '' while it runs."""
        code = self._process.poll()
        if code is None:
            return ''
        return f'signal {-code}' if code < 0 else f'exit code {code}'

    def __enter__(self):
        return self

    def __exit__(self, kind, error, trace):
        self._process.terminate()
        try:
            self._process.wait(5.0)
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.wait()
        for stream in (self._process.stdin, self._process.stdout):
            if stream is not None:
                stream.close()


def print_json(thing):
    """Say one thing to the process that started this one (see Child.read_json)."""
    print(json.dumps(thing), flush=True)
