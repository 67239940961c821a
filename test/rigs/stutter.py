# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""
A machine that stutters, for a command: what it runs must end as on a quiet machine.

    scripts/python -m rigs.stutter stop --seed 1 --rate 0.2 -- scripts/test
    scripts/python -m rigs.stutter load --seed 1 -- scripts/test

stop: all processes of the command are stopped together (SIGSTOP) for 20 to 500 ms, RATE times a
second at the mean, at random times; what a test has stopped itself stays so. load: three busy
loops and a writer to the disk run beside it. --times N: N runs, each with the next seed.
"""
import argparse
from contextlib import contextmanager
from contextlib import suppress
import os
from pathlib import Path
import random
import signal
import subprocess
import sys
import tempfile
import threading
import time

from rigs.harness import family
from rigs.harness import state

SHORTEST_S, LONGEST_S = 0.02, 0.5
BUSY_LOOPS = 3
WRITE_SIZE = 1 << 20
PR_SET_CHILD_SUBREAPER = 36


def adopt_orphans():
    """Become the parent of all that the command leaves, or it would leave its family."""
    import ctypes
    ctypes.CDLL(None).prctl(PR_SET_CHILD_SUBREAPER, 1, 0, 0, 0)


def stop_all(seconds):
    """Stop every descendant of this process that is not stopped yet, and let it go on."""
    stopped = []
    while new := [pid for pid in family(os.getpid())[1:]
                  if pid not in stopped and state(pid) != 'T']:     # some began meanwhile
        for pid in new:
            with suppress(ProcessLookupError):
                os.kill(pid, signal.SIGSTOP)
        stopped += new
    time.sleep(seconds)
    for pid in stopped:
        with suppress(ProcessLookupError):
            os.kill(pid, signal.SIGCONT)


@contextmanager
def stopping(seed, rate):
    """Stop the descendants of this process now and then; yields [count, seconds]."""
    chance, over, done = random.Random(seed), threading.Event(), [0, 0.0]

    def run():
        while not over.wait(chance.expovariate(rate)):
            seconds = chance.uniform(SHORTEST_S, LONGEST_S)
            stop_all(seconds)
            done[0] += 1
            done[1] += seconds

    thread = threading.Thread(target=run)
    thread.start()
    try:
        yield done
    finally:
        over.set()
        thread.join()


@contextmanager
def busy_loops(count):
    """Keep so many cores busy."""
    loops = [subprocess.Popen([sys.executable, '-c', 'while True: pass']) for _ in range(count)]
    try:
        yield
    finally:
        for one in loops:
            one.kill()
            one.wait()


@contextmanager
def loading(seed, _rate):
    """Keep cores and disk busy; yields [processes, 0]."""
    chance, over = random.Random(seed), threading.Event()

    def write():
        with tempfile.TemporaryFile(dir=Path.cwd()) as file:
            while not over.wait(chance.uniform(0.0, 0.2)):
                file.seek(chance.randrange(64) * WRITE_SIZE)
                file.write(chance.randbytes(WRITE_SIZE))
                os.fsync(file.fileno())

    writer = threading.Thread(target=write)
    writer.start()
    try:
        with busy_loops(BUSY_LOOPS):
            yield [BUSY_LOOPS, 0.0]
    finally:
        over.set()
        writer.join()


WAYS = {'stop': stopping, 'load': loading}


def main():
    """Run the command under a stutter; exit with the number of runs that failed."""
    parser = argparse.ArgumentParser(usage=__doc__)
    parser.add_argument('way', choices=WAYS)
    parser.add_argument('--seed', type=int, default=1)
    parser.add_argument('--rate', type=float, default=0.2, help='stops per second (default 0.2)')
    parser.add_argument('--times', type=int, default=1)
    parser.add_argument('command', nargs='+')
    options = parser.parse_args()
    adopt_orphans()
    red = 0
    for seed in range(options.seed, options.seed + options.times):
        begin = time.monotonic()
        with WAYS[options.way](seed, options.rate) as done:
            code = subprocess.run(options.command, check=False).returncode
        red += code != 0
        what = (f'{done[0]} stops, {done[1]:.1f} s in all, {options.rate:g} a second'
                if options.way == 'stop' else f'{done[0]} busy loops and a writer')
        print(f'stutter: seed {seed}: exit code {code} after {time.monotonic() - begin:.0f} s; '
              f'{what}', flush=True)
    return min(red, 125)


if __name__ == '__main__':
    raise SystemExit(main())
