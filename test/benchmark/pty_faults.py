# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""
The faults of fake_bus as a user meets them: two programs and a pty, in real time.

    scripts/python -m benchmark.pty_faults                      all, and healthy patterns
    scripts/python -m benchmark.pty_faults two_masters healthy  some
    scripts/python -m benchmark.pty_faults --busy 2 noise       beside two busy loops

fake_bus has devices and pattern as in benchmark/confusion_cases.tsv, dxl_doctor listens for 10 s.
What it must say is in that file. Exits with the number of rows that are not right.
"""

import argparse
from concurrent.futures import ThreadPoolExecutor
import json
from pathlib import Path
import signal
import subprocess
import sys
import tempfile
import time
from typing import NamedTuple

from benchmark.confusion import label
from benchmark.confusion_cases import Case
from benchmark.confusion_cases import CASES
from benchmark.confusion_cases import DXL1
from benchmark.confusion_cases import DXL1_CASES
from benchmark.confusion_cases import FAST
from benchmark.confusion_cases import FEETECH
from benchmark.confusion_cases import FEETECH_CASES
from benchmark.confusion_cases import Scene
from mecarover_fakes.traffic import FAMILY_1
from mecarover_fakes.traffic import PATTERNS
from rigs.bus.score import spell
from rigs.harness import REPOSITORY
from rigs.stutter import busy_loops

ONSET_S = 5                        # after the start of fake_bus: dxl_doctor listens, at load too
SECONDS = 10
AT_A_TIME = 2
LINK_S = 20.0                      # until fake_bus has its link
END_S = 60.0
RATE = 100.0                       # cycles a second, as fake_bus has by default
HEALTHY = 'healthy'
SLOW = {'read_write': 4.0, 'mixed': 10.0, 'bulk': 20.0, 'registered': 20.0}    # they take long


class Answer(NamedTuple):
    """What dxl_doctor said: rules with their devices, the first one first."""

    warned: tuple[tuple[str, int | None], ...]
    others: tuple[tuple[str, int | None], ...]     # at OK
    messages: tuple[str, ...]


def healthy_cases():
    """Return a case without a fault for each pattern of each dialect."""
    spoken = ((Scene(), PATTERNS), (FEETECH, FAMILY_1['feetech']), (DXL1, FAMILY_1['1']))
    return [Case(HEALTHY, (), (FAST if pattern == 'fast' else scene)._replace(
        pattern=pattern, rate=SLOW.get(pattern, RATE)), f'{scene.dialect} {pattern}')
        for scene, patterns in spoken for pattern in patterns if pattern != 'none']


def start_module(module, *arguments, **options):
    return subprocess.Popen([sys.executable, '-m', module, *map(str, arguments)], text=True,
                            cwd=REPOSITORY, stdout=subprocess.PIPE, **options)


def play(case):
    """Play a case on a pty; return the answer of dxl_doctor."""
    scene = case.scene
    rate = RATE if scene.rate == Scene().rate else scene.rate      # as usual, or what a row needs
    with tempfile.TemporaryDirectory() as folder:
        link = Path(folder) / 'bus'
        fault = [] if case.fault == HEALTHY else ['--fault', case.fault.format(at=ONSET_S)]
        bus = start_module('mecarover_fakes.fake_bus', '--link', link, '-b', scene.baud,
                           '--dialect', scene.dialect, '--devices', *scene.devices,
                           '--pattern', scene.pattern, '--rate', rate, *fault,
                           '--behind-silent', 'wait' if scene.waits_in_line else 'answer')
        try:
            deadline = time.monotonic() + LINK_S
            while not link.exists():
                if bus.poll() is not None or time.monotonic() > deadline:
                    raise ChildProcessError(f'fake_bus {" ".join(fault)}: has no link')
                time.sleep(0.01)
            doctor = start_module('servobus.tools.dxl_doctor', link, '-b', scene.baud, '--seconds',
                                  SECONDS, '--json', *(word for one in scene.devices
                                                       for word in ('--devices', one)))
            try:
                said, _ = doctor.communicate(timeout=END_S)
            finally:
                doctor.kill()
                doctor.wait()
        finally:
            bus.terminate()
            bus.communicate()
    if not said:
        raise ChildProcessError(f'dxl_doctor: exit code {doctor.returncode}, run it alone')
    return answer_of(json.loads(said))


def answer_of(said):
    """Sort what dxl_doctor said; the time-out that a silent device costs is advice only."""
    found = [one for bus in said['buses'] for one in bus['findings']
             if one['rule'] != 'cycle_time' or one['device'] is None]
    found.sort(key=lambda one: one['first_s'])
    warned = [one for one in found if one['level'] != 'OK']
    return Answer(tuple((one['rule'], one['device']) for one in warned),
                  tuple((one['rule'], one['device']) for one in found if one not in warned),
                  tuple(f"{one['first_s']:.1f} to {one['last_s']:.1f} s: {one['message']} "
                        f"{one['evidence']}" for one in warned))


def verdict(case, answer):
    """Return 'right', 'other word' or 'silent'."""
    if {*answer.warned} - {*case.told}:
        return 'other word'
    return 'right' if {*case.told} <= {*answer.warned, *answer.others} else 'silent'


def main():
    """Play the cases and print a line for each."""
    parser = argparse.ArgumentParser(usage=__doc__)
    parser.add_argument('faults', nargs='*', metavar='FAULT')
    parser.add_argument('--busy', type=int, default=0, metavar='N', help='busy loops beside it')
    options = parser.parse_args()
    signal.signal(signal.SIGTERM, signal.default_int_handler)      # ends its processes too
    cases = [case for case in (*CASES, *FEETECH_CASES, *DXL1_CASES, *healthy_cases())
             if case.fault.partition(':')[0] in (options.faults or [case.fault.partition(':')[0]])]
    wrong = 0
    with busy_loops(options.busy), ThreadPoolExecutor(AT_A_TIME) as pool:
        for case, answer in zip(cases, pool.map(play, cases), strict=True):
            judged = verdict(case, answer)
            wrong += judged != 'right'
            print(f'{case.scene.dialect:8}{label(case):35} {judged:11}expected: '
                  f'{spell(case.told) or "-"}; said: {spell(answer.warned) or "-"}'
                  + (f' (OK: {spell(answer.others)})' if answer.others else ''), flush=True)
            if judged != 'right' and answer.messages:
                print(*(f'        {message}' for message in answer.messages), sep='\n', flush=True)
    return min(wrong, 125)


if __name__ == '__main__':
    raise SystemExit(main())
