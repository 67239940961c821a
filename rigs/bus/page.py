# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""The page about the scenes: docs/doctor_scenes.md."""

from __future__ import annotations

from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor
import os

from rigs.bus.broken import SCENES as BROKEN
from rigs.bus.healthy import SCENES as HEALTHY
from rigs.bus.score import judge
from rigs.bus.score import Result
from rigs.bus.score import table
from rigs.bus.score import words

SCENES = (*BROKEN, *HEALTHY)
HEAD = """# Traffic that the doctor was not made with

Made by `python -m benchmark.confusion --write` with the generator in `rigs/bus`, in simulated
time. It shares nothing with `fake_bus`: its own packets, servos, collisions and books, and
programs that send and wait as public ones do (DynamixelSDK examples, dynamixel_hardware_interface,
a bitbots robot, LeRobot, a Wizard-like scan, a first program). Each run lasts 20 s; adapters that
gather bytes and pauses in delivery are among them. What is expected was written down before the
rules were changed.

*right*: the first finding at the end is the expected one. *wrong*: at any time there was a WARN or
ERROR that is not true of this bus, and on a healthy bus also a level or a missed answer that its
books do not have. *vague*: something true, but not the cause. *silent*: nothing.
The time counts from the first byte that the fault altered or removed.

First run, before the rules were changed: {first}

Now: {now}

"""
FIRST = """48 of 92 faults were told rightly, 3 vaguely, 17 not at all, 24 with a false
word; 17 of 28 healthy runs were without an accusation. After that run the item-by-item program was
made to switch the torque on, as it must for a restart to show."""


def results(names: Sequence[str] = ()) -> list[Result]:
    """Run all scenes, or those with one of these words in their name; on all processors."""
    chosen = [number for number, scene in enumerate(SCENES)
              if not names or any(name in scene.name for name in names)]
    with ProcessPoolExecutor(os.cpu_count()) as pool:
        return list(pool.map(_judge, chosen))


def _judge(number: int) -> Result:
    return judge(SCENES[number])


def render(found: Sequence[Result]) -> str:
    """Return the page."""
    return HEAD.format(first=FIRST, now=words(found)) + table(found)
