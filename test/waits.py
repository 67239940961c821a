# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""
How long the processes of a test waited for a core, or because all of them were stopped.

A process beside pytest reads it from /proc/PID/task/TID/schedstat of pytest and its descendants,
and takes for a stop of everything the time that it missed itself.
"""
from collections import deque
from contextlib import suppress
import os
import select
import signal
import subprocess
import sys
import time

SAMPLE_S = 0.02
FAMILY_EVERY = 5                # samples; to walk the tree of processes costs most


def family(root):
    """Return the numbers of a process and its descendants."""
    found = [root]
    for pid in found:
        with suppress(OSError):
            for task in os.listdir(f'/proc/{pid}/task'):
                with open(f'/proc/{pid}/task/{task}/children') as file:
                    found += map(int, file.read().split())
    return found


def scheduled(path):
    """Return how long a task has run and has waited for a core, in ns; None where it is gone."""
    try:
        with open(path) as file:
            ran, waited, _ = file.read().split()
    except (OSError, ValueError):
        return None
    return int(ran), int(waited)


class Sampler:
    """Notes the waits of a process and its descendants, those that have left the family too."""

    def __init__(self, root):
        self._root = root
        self._pids = set()
        self._before = {}               # task: what it had waited
        self._waits = deque()           # (when, seconds)
        self._at = self._own = 0.0
        self._count = 0

    def begin(self):
        """Forget what was: waits count from now on."""
        self._at = self._count = 0
        self.sample()
        self._waits.clear()

    def sample(self):
        now, mine = time.monotonic(), sum(scheduled('/proc/self/schedstat') or (0, 0)) / 1e9
        if self._at:                    # what it neither ran nor waited nor slept, it was stopped
            stopped = now - self._at - (mine - self._own) - SAMPLE_S
            if stopped > SAMPLE_S:
                self._waits.append((now, stopped))
        self._at, self._own = now, mine
        if self._count % FAMILY_EVERY == 0:
            self._pids |= set(family(self._root)) - {os.getpid()}
        self._count += 1
        waited = sum(map(self._waited, list(self._pids)))
        if waited > 1e-3:
            self._waits.append((now, waited))

    def _waited(self, pid):
        """Return how long the tasks of a process have waited since the last sample, in s."""
        try:
            tasks = os.listdir(f'/proc/{pid}/task')
        except OSError:
            self._pids.discard(pid)
            return 0.0
        waited = 0
        for task in tasks:
            if figures := scheduled(f'/proc/{pid}/task/{task}/schedstat'):
                waited += figures[1] - self._before.get(task, 0)
                self._before[task] = figures[1]
        return waited / 1e9

    def longest(self, span):
        """Return the largest sum of waits within `span` seconds."""
        self.sample()
        longest, total, recent = 0.0, 0.0, deque()
        for when, waited in self._waits:
            recent.append((when, waited))
            total += waited
            while recent[0][0] < when - span:
                total -= recent.popleft()[1]
            longest = max(longest, total)
        return longest


def serve(root):
    """Sample from a line `begin` to a line with a span; the answer to that is the longest wait."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    sampler, runs = Sampler(root), False
    while os.getppid() == root:
        if select.select([0], [], [], SAMPLE_S if runs else 1.0)[0]:
            if not (line := sys.stdin.buffer.raw.readline().strip()):
                return
            if runs := line == b'begin':
                sampler.begin()
            print(0.0 if runs else sampler.longest(float(line)), flush=True)
        elif runs:
            sampler.sample()


class Machine:
    """What the processes of this pytest waited for, from `begin` on."""

    def __init__(self):
        self._sampler = None

    def begin(self):
        if self._sampler is None:
            self._sampler = subprocess.Popen(
                [sys.executable, '-S', '-E', __file__, str(os.getpid())], bufsize=0,
                stdin=subprocess.PIPE, stdout=subprocess.PIPE)
        self._ask(b'begin\n')

    def _ask(self, line):
        self._sampler.stdin.write(line)
        return float(self._sampler.stdout.readline())

    def longest(self, span):
        """Return how long the processes waited within `span` seconds, where that was longest."""
        return self._ask(b'%f\n' % span)

    def close(self):
        if self._sampler is not None:
            self._sampler.kill()        # what a test has forked may hold its input
            self._sampler.wait()
            self._sampler.stdin.close()
            self._sampler.stdout.close()


if __name__ == '__main__':
    serve(int(sys.argv[1]))
