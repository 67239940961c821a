# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""
What a tap adds to a call of pyserial: without it, with it, with a reader, and through strace.

These are processes that live all the time and take turns, a few ms each, in a new order each
round. What they read is there before, so that no other end is measured.
"""

from __future__ import annotations

from contextlib import ExitStack
from contextlib import suppress
from functools import partial
import os
import shutil
import sys
import tempfile
from unittest.mock import patch

from benchmark.tap_master import PACKET
from rigs.harness import Child
from rigs.harness import Figure
from rigs.harness import interleaved
from servobus.port.pty import Pty
from servobus.tools.start_program import environment

CALLS = 200                        # in a turn, each kind: less than a pty has room for
ROUNDS = 50
PLAIN, ALONE, HEARD, TRACED = (
    'without a tap', 'tapped, no listener', 'tapped and heard', 'through strace')
WANTED = 'wanted: at most 10 at the median'


def run(options):
    """Time the calls; a figure has the median of each turn."""
    rounds = options.asked_rounds or (5 if options.quick else ROUNDS)
    with tempfile.TemporaryDirectory() as folder, patch.dict(
            os.environ, XDG_RUNTIME_DIR=folder), ExitStack() as stack:
        listener = stack.enter_context(Child('benchmark.heard', 'tap:heard', '0'))
        listener.read_json()
        cases = {name: partial(_turn, *_master(stack, env)) for name, env in (
            (PLAIN, None), (ALONE, environment('alone')), (HEARD, environment('heard')))}
        if shutil.which('strace'):
            cases[TRACED] = partial(_turn, *_master(
                stack, None, 'servobus.tools.tap', 'traced', '--by', 'strace', '--',
                sys.executable, '-m'))
        for turn in cases.values():            # the first calls are slower
            turn()
        turns = interleaved(cases, rounds)
        listener.send_json('report')
        said = listener.read_json()['bytes']
    if said != 2 * CALLS * len(PACKET) * (rounds + 1):
        raise OSError(f'the listener heard {said} bytes; so this measures nothing')
    return [figure for call in ('write', 'read') for figure in _figures(call, turns)]


def _master(stack, env, *under):
    pty = stack.enter_context(Pty())
    master = stack.enter_context(Child(*under, 'benchmark.tap_master', pty.path, env=env))
    master.read_json()
    return master, pty


def _turn(master, pty):
    """Have a master write and read; return the median times (us) of both."""
    os.write(pty.master, PACKET * CALLS)
    master.send_json(CALLS)
    times = master.read_json()
    with suppress(BlockingIOError):
        while os.read(pty.master, 65_536):
            pass
    return times


def _figures(call, turns):
    section = f'tap: one {call} of {len(PACKET)} bytes through pyserial'
    times = {name: [one[call] for one in ones] for name, ones in turns.items()}
    return [Figure(section, name, 'us', values) for name, values in times.items()] + [
        Figure(section, f'{name}: added', 'us',
               [tapped - plain for tapped, plain in zip(times[name], times[PLAIN], strict=True)],
               '' if name == TRACED else WANTED) for name in times if name != PLAIN]
