# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""The rule about what takes most of a cycle, where somebody can do something about it."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator

from dxl_monitor.doctor.case import Case
from dxl_monitor.doctor.rhythm import EVEN
from dxl_monitor.doctor.rule import Claim
from dxl_monitor.doctor.rule import Claims
from msg_defs.dxl_instruction import Instruction

MOST = 0.5                         # share of the cycle
SEVERAL = 3                        # Reads that one Sync Read replaces
SLOW_MS = 0.4                      # reply latency: Return Delay Time from the factory is 0.5 ms


def cycle_time(case: Case) -> Claims:
    """Name what takes most of each cycle; not the pause of a program that a clock paces."""
    times = case.report.cycle
    if times is None or times.unknown:
        return
    most = MOST * times.cycle
    if times.asleep > most:
        yield Claim(f'{times.asleep:.0f} of {times.cycle:.0f} ms of each cycle the program does '
                    'not look for answers that are there: let it read at once, with a time-out, '
                    'not sleep before it reads')
    elif times.program > most:
        if case.rhythms and min(one.spread for one in case.rhythms) > EVEN:
            yield Claim('most of each cycle is the program itself, between an answer and '
                        'the next instruction: do less there, or in another thread')
    elif times.waiting and times.waiting[0][1] > most and times.waiting[0][0] in case.gone:
        yield Claim('most of each cycle is a time-out for its answer: leave '
                    'it out, or shorten the time-out', device=times.waiting[0][0])
    elif times.wire + times.device > most:
        yield from (Claim(todo) for todo in _faster(case))


def _faster(case: Case) -> Iterator[str]:
    alike = Counter((one.address, one.length) for one in case.report.cycles
                    if one.instruction == Instruction.READ and 2 * one.missed < one.asked)
    reads = max(alike.values(), default=0)
    slow = max((one.latency.window.p50 for one in case.report.devices if one.latency.window),
               default=0.0)
    if reads >= SEVERAL and '1.0' not in case.report.protocol:     # it has no Sync Read
        yield (f'{reads} servos are read one by one, which is most of each cycle: use one Sync '
               'Read for all')
    elif slow > SLOW_MS:
        yield ('most of each cycle is waiting for answers that do come: set the latency timer of '
               'the adapter to 1 ms and Return Delay Time to 0')
