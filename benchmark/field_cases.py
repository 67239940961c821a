# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""
What the doctor says of cases that people had: `python -m benchmark.field_cases [WORD ...]`.

WORDs choose cases by a part of their names; --write makes docs/field_cases.md of all.
"""

from __future__ import annotations

from collections.abc import Iterator
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path
import sys

from dxl_monitor.bus.report import BusReport
from dxl_monitor.tools.doctor.course import Course
from dxl_monitor.tools.doctor.examination import TRAFFIC_S
from rigs.bus.field import NOT_PLAYED
from rigs.bus.field import PLAYED
from rigs.bus.score import BOOT
from rigs.bus.score import compare
from rigs.bus.score import reports
from rigs.bus.score import Result
from rigs.bus.score import SEED
from rigs.bus.score import table
from rigs.bus.score import verdict_of
from rigs.bus.score import words

PAGE = Path(__file__).resolve().parents[1] / 'docs' / 'field_cases.md'
HEAD = """# Cases that people had

Made by `python -m benchmark.field_cases --write`. Each case is from a public issue thread; its
program and its fault are played by the generator in `rigs/bus`, in simulated time, for 20 s.
What is expected is what the thread found. It was written down before the rules were changed for
it. Each case is played in its own protocol: 2.0, 1.0 or that of Feetech.

*told* is what stands on the screen of `dxl_doctor`, the first finding first, after the
{seconds:.0f} s of traffic for which it listens, counted from the first byte that the fault
altered. *right*: the first is the expected one. *wrong*: at any time of the 20 s something was
said at WARN or ERROR that is not true of this bus. *vague*: something true, but not the cause.
*silent*: nothing. *after* is when the expected one was first in a report, counted from that byte.

{first}Second run, each in its own protocol: 26 of 31 are told rightly, 2 vaguely, 1 not at all, 2
with a false word. There the second servos of T01 and T03 soon stood exactly where the first ones
did, so that both said the same and nothing was wrong to hear; now they tremble apart, as two
joints do, and their reads fail as those of the threads did. For T01 `factory_id` counts too: it is
what the thread found, and that rule is newer than the case. T06 and T58 were added.

Now: {now}

"""
FIRST = """\
First run, when all were played in the form of Protocol 2.0: 25 of 30 faults are told rightly, 2
vaguely, 1 not at all, 2 with a false word; 1 of 1 healthy runs without an accusation. Median time
to the right name: 0.5 s.

"""
THREADS = """
| case | thread |
|---|---|
| T01, T04, T08, T14 | huggingface/lerobot #526, #1603, #560, #2387 |
| T03, T11, T23, T52 | ROBOTIS-GIT/DynamixelSDK #11, #106, #282, #518 |
| T06 | fanhao375/microduck-replica PR #28 |
| T07 | KurtE/Phantom_Phoenix #3 |
| T10, T40 | ROBOTIS-GIT/dynamixel-workbench #71, #370 |
| T13, T19, T20 | pollen-robotics/reachy_mini #1163, #1402, #589 |
| T22 | ROBOTIS-GIT/turtlebot3 #338 |
| T25 | humancomputerlab/lelamp_runtime #9 |
| T26 | open-edge-platform/physical-ai-studio #955 |
| T28 | Interbotix/interbotix_ros_manipulators #252 |
| T29 | start-jsk/jsk_apc #1960 |
| T34 | ROBOTIS-GIT/DynamixelSDK PR #116 |
| T35 | ROBOTIS-GIT/dynamixel_hardware_interface #79 |
| T37, T49 | poppy-project/pypot #92, #309 |
| T38, T43, T44 | hello-robot/stretch_body #44, PR #218, PR #181 |
| T41, T53, T56, T59 | huggingface/lerobot PR #1349, #532, PR #1889, #1296 |
| T50 | apirrone/Open_Duck_Mini #49 |
| T58 | strands-labs/robots #3398 |
| T61 | notes of users of OpenMANIPULATOR-X |

## Not played, or not to be told

| case | why, and what would tell it |
|---|---|
"""


def results(chosen: list[str]) -> list[Result]:
    """Play the cases with one of these words in their name, or all."""
    numbers = [number for number, scene in enumerate(PLAYED)
               if not chosen or any(word in scene.name for word in chosen)]
    with ProcessPoolExecutor() as pool:
        return list(pool.map(_judge, numbers))


def _judge(number: int) -> Result:
    """Play a case; what counts is the screen of dxl_doctor, 10 s after the fault showed."""
    scene = PLAYED[number]
    rig = scene.rig(SEED)
    course = Course()

    def heard() -> Iterator[tuple[BusReport, float | None]]:
        for report, since in reports(scene, rig):
            if since is None or since <= TRAFFIC_S:
                course.take(report)
            yield report, since
    result = compare(scene, rig, heard(), BOOT)
    told = tuple((one.finding.rule, one.finding.device) for one in course.told())
    return result._replace(told=told, verdict=verdict_of(scene, told, bool(result.false)))


def render(found: list[Result]) -> str:
    """Return the page."""
    rows = ''.join(f'| {case} | {why} |\n' for case, why in NOT_PLAYED)
    head = HEAD.format(seconds=TRAFFIC_S, first=FIRST, now=words(found))
    return head + table(found) + THREADS + rows


def main() -> int:
    """Print the table, or write the page."""
    chosen = [word for word in sys.argv[1:] if word != '--write']
    found = results(chosen)
    if '--write' in sys.argv[1:] and not chosen:
        PAGE.write_text(render(found), encoding='utf-8')
    print(table(found) + '\n' + words(found))
    return 0


if __name__ == '__main__':
    sys.exit(main())
