# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""
Parsing here against parsing at an older commit, in many short pairs that take turns.

The rows of benchmark.parsing (Protocol 2.0) and of benchmark.parsing_1 (the 1.0 family).

Each of them runs in a process of its own that lives as long as the comparison, on the same bytes;
the older commit runs twice, so that its ratio to itself tells what the machine can resolve.
usage: scripts/python -m benchmark.against COMMIT [--only TEXT]
"""

import argparse
from contextlib import contextmanager
from contextlib import ExitStack
from functools import partial
import io
import json
from math import sqrt
import os
from pathlib import Path
import random
from statistics import median
import subprocess
import sys
import tarfile
from tempfile import TemporaryDirectory
from typing import NamedTuple

from benchmark.parsing import CHUNKS
from benchmark.parsing_1 import CLIENTS
from benchmark.traffic import KINDS
from benchmark.traffic import KINDS_1
from benchmark.traffic import packets
from benchmark.traffic import packets_1
from rigs.harness import machine
from rigs.harness import REPOSITORY
from servobus.errors import UsageError
from servobus.tools.cli import run_tool

SIZE = 150_000                     # bytes: a measurement takes 10 to 40 ms
PAIRS = 100
WANTED = 0.97                      # the lower 95 % bound of the ratio
OLD, AGAIN, NEW = 'old', 'old again', 'new'
# Runs in the folder of either commit, with what both have: benchmark.parsing, and for the 1.0
# family the settings that benchmark.parsing_1 measures with.
WORKER = """
import gc, json, pathlib, sys
here = pathlib.Path.cwd()
sys.path[:0] = [str(here), str(here / 'test')]      # older commits have benchmark/ in the first
from benchmark import parsing
assert pathlib.Path(parsing.__file__).parents[1] in (here, here / 'test'), parsing.__file__
models = parsing.Models()
chunks = {}
print('{}', flush=True)
for line in sys.stdin:
    file, size, protocol = case = tuple(json.loads(line))
    if case not in chunks:
        data = pathlib.Path(file).read_bytes()
        chunks[case] = [data[at:at + size] for at in range(0, len(data), size)]
    settings = ()
    if protocol:
        from benchmark import parsing_1
        settings = parsing_1.Settings(baud=parsing_1.BAUD_1, protocol=protocol),
    gc.collect()
    print(json.dumps(parsing.monitor_us(models, chunks[case], *settings)), flush=True)
"""


class Case(NamedTuple):
    """What is measured: these bytes in chunks of this size; protocol: '' for that of 2.0."""

    file: Path
    size: int
    protocol: str


class Worker:
    """A process that measures with the code of one commit."""

    def __init__(self, folder):
        self._process = subprocess.Popen(
            [sys.executable, '-c', WORKER], cwd=folder, text=True, stdin=subprocess.PIPE,
            stdout=subprocess.PIPE, env={**os.environ, 'PYTHONPATH': str(folder)})
        self._read_json()

    def us(self, case):
        """Return the CPU time per packet, in us."""
        print(json.dumps([str(case.file), *case[1:]]), file=self._process.stdin, flush=True)
        return float(self._read_json())

    def _read_json(self):
        for line in self._process.stdout:
            return json.loads(line)
        raise ChildProcessError('a measuring process ended early; its error stands above')

    def __enter__(self):
        return self

    def __exit__(self, *error):
        self._process.stdin.close()
        self._process.wait()


@contextmanager
def checked_out(commit):
    """Have the files of a commit in a folder for a while."""
    packed = subprocess.run(['git', 'archive', '--format=tar', commit], cwd=REPOSITORY,
                            capture_output=True, check=False)
    if packed.returncode:
        raise UsageError(f'{commit}: {packed.stderr.decode().strip()}; name a commit of this '
                         'repository (a shallow clone has only the newest: git fetch --unshallow)')
    with TemporaryDirectory() as folder:
        with tarfile.open(fileobj=io.BytesIO(packed.stdout)) as files:
            files.extractall(folder, filter='data')
        yield Path(folder)


def bound(ratios):
    """
    Return the lower 95 % bound of the median of these ratios.

    By rank alone (one-sided, normal approximation of the binomial): nothing is assumed about
    how a busy machine spreads them.
    """
    rank = int((len(ratios) - 1.645 * sqrt(len(ratios))) / 2)
    return sorted(ratios)[max(0, rank - 1)]


def compare(old, cases):
    """Measure, and yield a line of the table for each case."""
    taken = {
        name: {OLD: [], AGAIN: [], NEW: []} for name in cases}
    rng = random.Random(1)
    with ExitStack() as stack:
        workers = {name: stack.enter_context(Worker(folder))
                   for name, folder in ((OLD, old), (AGAIN, old), (NEW, REPOSITORY))}
        order = [(case, name) for case in cases for name in workers]
        for _ in range(PAIRS):
            rng.shuffle(order)
            order.sort(key=lambda one: one[0])      # a pair is measured within 0.1 s
            for case, name in order:
                taken[case][name].append(workers[name].us(cases[case]))
    for case, us in taken.items():
        new, again = ([one / other for one, other in zip(us[OLD], us[name], strict=True)]
                      for name in (NEW, AGAIN))
        yield (f'{case:30}{median(us[OLD]):8.2f}{median(us[NEW]):8.2f}'
               f'{median(new):9.3f}{bound(new):9.3f}{median(again):11.3f}{bound(again):9.3f}')


def main(arguments):
    options = _parser().parse_args(arguments)
    print(', '.join(f'{key}: {value}' for key, value in machine().items()))
    print(f'old: {options.commit}; {PAIRS} pairs; us of CPU per packet; bound: lower '
          f'95 % bound of the median ratio, wanted: {WANTED}')
    print(f'{"traffic, chunk":30}{"old":>8}{"new":>8}{"old/new":>9}{"bound":>9}'
          f'{"old/old":>11}{"bound":>9}', flush=True)
    with checked_out(options.commit) as old, TemporaryDirectory() as folder:
        for line in compare(old, _cases(Path(folder), options.only)):
            print(line, flush=True)


def _cases(folder, only):
    """Return the rows of parsing and parsing_1 with this text in their name; write the bytes."""
    make = {kind: partial(packets, kind) for kind in KINDS}
    make |= {f'{kind}, {told}': partial(packets_1, kind)
             for kind in KINDS_1 for told in (CLIENTS[kind][0], 'auto')}
    cases = {}
    for number, kind in enumerate(kind for kind in make if only in kind):
        file = folder / f'{number}.bin'
        file.write_bytes(b''.join(make[kind]())[:SIZE])
        _, _, protocol = kind.partition(', ')
        cases.update({f'{kind}, {size}': Case(file, size, protocol) for size in CHUNKS})
    return cases


def _parser():
    parser = argparse.ArgumentParser(prog='scripts/python -m benchmark.against', description=(
        'Compare the CPU time of parsing with that of an older commit (docs/benchmarks.md).'))
    parser.add_argument('commit', help='what git calls it, e.g. 7820283')
    parser.add_argument('--only', default='', metavar='TEXT', help='kinds with this in their name')
    return parser


if __name__ == '__main__':
    sys.exit(run_tool('against', main))
