# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""
Bytes of any source through the whole program, with its time.

usage: scripts/python -m fuzz.whole --seconds N

A case goes through the node (listener, monitor, doctor, recorder, its timers, all that it
publishes), through the dashboard that hears the node, and, as a file, through two of the tools;
all in this process. An exception is a fault, but for the one line that a user gets, and so are a
byte that is not in exactly one counter and an output that is not what it promises to be. Each
fault is told once, made small, with the command that shows it again; the exit code is 1 then.
"""

import argparse
from contextlib import suppress
import gc
import logging
from pathlib import Path
import random
import sys
import tempfile
import time
import traceback

from fuzz.whole.node import OPEN
from fuzz.whole.node import through_node
from fuzz.whole.tools import RUNS
from fuzz.whole.tools import through_tools
from fuzz.whole.traffic import case_of

ROOT = Path(__file__).parents[3]
TRIES = 60                         # to make a case smaller
CASES_AT_ONCE = 100                # between two collections of garbage: a fifth faster


def run_case(case, seed):
    """Run a case; what it raises is a fault."""
    try:
        with tempfile.TemporaryDirectory(prefix='whole_') as folder:
            capture = through_node(case, Path(folder))
            through_tools(case, capture, Path(folder), random.Random(seed))
    finally:
        for listener in OPEN[:]:
            listener.stop()


class Raise(logging.Handler):
    """Lets no exception be passed over that the program tells of and survives."""

    def emit(self, record):
        if record.exc_info and record.exc_info[1]:
            raise record.exc_info[1]


def fault_of(case, seed):
    """Return where a case fails and the exception, ('', None) if it does not."""
    try:
        run_case(case, seed)
    except Exception as error:
        ours = [one for one in traceback.extract_tb(error.__traceback__)
                if one.filename.startswith(str(ROOT))]
        inner = [one for one in ours if '/fuzz/' not in one.filename] or ours
        if isinstance(error, AssertionError):
            inner = ours
        return f'{type(error).__name__} {Path(inner[-1].filename).relative_to(ROOT)} ' \
               f'{inner[-1].lineno}', error
    return '', None


def shrink_case(case, seed, where):
    """Return what is left of a case when chunks without a part in its fault are taken out."""
    heard, size, tries = list(case.heard), max(1, len(case.heard) // 2), TRIES
    while size and tries:
        at = 0
        while at < len(heard) and tries:
            tries -= 1
            less = heard[:at] + heard[at + size:]
            if fault_of(case._replace(heard=tuple(less)), seed)[0] == where:
                heard = less
            else:
                at += size
        size //= 2
    return case._replace(heard=tuple(heard))


def main():
    options = _parser().parse_args()
    logging.getLogger('mecarover_serial').addHandler(Raise())
    found, count, seed = set(), 0, options.seed * 1_000_000
    if options.case is not None:
        where, error = fault_of(case_of(options.case), options.case)
        print(''.join(traceback.format_exception(error)) if error else f'{where or "no fault"}')
        return int(bool(where))
    gc.freeze()
    gc.disable()
    with suppress(KeyboardInterrupt):
        while time.process_time() < options.seconds and count < options.cases:
            count, seed = count + 1, seed + 1
            case = case_of(seed)
            where, error = fault_of(case, seed)
            if where and where not in found:
                found.add(where)
                print(f'{time.process_time():.0f} s, case {count}: {where}: {str(error)[:200]}; '
                      f'again: scripts/python -m fuzz.whole --case {seed}', flush=True)
                if options.small:
                    print(*shrink_case(case, seed, where).heard, sep='\n', flush=True)
            if not count % CASES_AT_ONCE:
                gc.collect()
    spent = time.process_time()
    print(f'{count} cases in {spent:.0f} s, {count / spent:.1f} a second, '
          f'from seed {options.seed}: {len(found)} faults; runs of tools:',
          ', '.join(f'{count} {name}' for name, count in sorted(RUNS.items())))
    return int(bool(found))


def _parser():
    parser = argparse.ArgumentParser(prog='scripts/python -m fuzz.whole', description=(
        'Feed bytes of any source through node, dashboard and tools in one process.'))
    add = parser.add_argument
    add('--seconds', type=float, default=60, help='how long, CPU time (default %(default)g)')
    add('--cases', type=float, default=float('inf'), metavar='N', help='how many at most')
    add('--seed', type=int, default=1, help='where to begin (default %(default)s)')
    add('--case', type=int, metavar='N', help='this case only, and show what breaks')
    add('--small', action='store_true', help='take out of a case what has no part in its fault')
    return parser


if __name__ == '__main__':
    sys.exit(main())
