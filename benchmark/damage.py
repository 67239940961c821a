# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""
What damage looks like bit by bit, on lines that are simulated at bit level.

    python -m benchmark.damage [SEED ...]     seeds of your own, to the terminal
    python -m benchmark.damage --write        the seeds of the page, to docs/damage.md

Each run is one kind of bad line, with its figures drawn from the seed, under one program; what the
doctor adds as "looks like" at the end is counted. The equipment (rigs/bus/uart.py) shares nothing
with what it judges.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor
from itertools import product
from pathlib import Path
import sys

from dxl_monitor.bus.conversation import Settings
from dxl_monitor.bus.report import BusReport
from dxl_monitor.doctor import bits
from dxl_monitor.model.models import Models
from dxl_monitor.monitor import Monitor
from rigs.bus import wrecked
from rigs.bus.ear import FULL_SPEED
from rigs.bus.wire import S
from rigs.bus.wrecked import Kind
from rigs.bus.wrecked import KINDS
from rigs.bus.wrecked import PROGRAMS
from rigs.bus.wrecked import scene_of

PAGE = Path(__file__).resolve().parents[1] / 'docs' / 'damage.md'
KNOWN = (1, 2, 3)                  # seeds that were looked at while this was written
BLIND = (2301, 2302, 2303, 2304)   # and seeds that were not
SECONDS = 9
BOOT = 1000 * S
COLUMNS = (wrecked.CLOCK, wrecked.LEVEL, wrecked.INTERFERENCE, wrecked.PWM, wrecked.SPEAKERS,
           wrecked.TURN, wrecked.STRAY, wrecked.NOTHING)
_LOOKS = {bits.CLOCK: wrecked.CLOCK, bits.LEVEL: wrecked.LEVEL, bits.PWM: wrecked.PWM,
          bits.INTERFERENCE: wrecked.INTERFERENCE, bits.SPEAKERS: wrecked.SPEAKERS}
_RULES = {'turnaround': wrecked.TURN, 'stray_bytes': wrecked.STRAY}
_MODELS = Models()

HEAD = """# What damage looks like, bit by bit

Made by `python -m benchmark.damage --write`. Where packets are damaged, the doctor looks at which
bits turned over, and adds to its evidence what that looks like. It never makes a finding of it.

| looks like | because |
|---|---|
| a clock that is off | the last bit of bytes is wrong: receiver and talker drift apart in a byte |
| a level or an edge | ones read as zeros each time, or zeros as ones: pull-up, ground, cable |
| interference | a bit here and there, up and down |
| the PWM of a motor | the wrong bits of a packet are multiples of one distance apart |
| two that talk at once | header, ID and length are whole each time, data and checksum are not |

A damaged packet is compared with what was due: the master repeats itself, so header, ID, length
and code are known. In the rest a single wrong bit is found by the checksum. With fewer than
{enough} recognised packets, or a mixed picture, nothing is said.

The lines are simulated at bit level (`rigs/bus/uart.py`): level, edges, noise, pulses and clock of
the talker, and a receiver that takes the majority of three samples of a bit. Rows are what it was,
columns what was told; the figures of each run are drawn from its seed, {programs} programs, two
rates. Turn-round and stray bytes are told by the findings of these names. A clock that is too fast
breaks the frame of the bytes as well, and is not recognised; two answers that overlap by some bits
look like a slow edge or a period, so nothing is said where it is always the same bits.

"""
PARTS = """## Seeds that were not looked at before ({blind})

{blind_table}
{blind_score}

## Seeds that the limits were set with ({known})

{known_table}
{known_score}
"""

Run = tuple[int, int, int]         # kind, program, seed


def told(report: BusReport) -> str:
    """Return what a report says of the looks of the damage, as a column of the table."""
    for finding in report.findings:
        said = dict(finding.evidence).get('looks like', '')
        for begin, column in _LOOKS.items():
            if said.startswith(begin):
                return column
    return next((_RULES[one.rule] for one in report.findings if one.rule in _RULES),
                wrecked.NOTHING)


def run(one: Run) -> str:
    """Return what is said at the end of a run."""
    kind, program, seed = one
    scene = scene_of(KINDS[kind], PROGRAMS[program][1], seed)
    rig = scene.rig(seed)
    monitor = Monitor('bus', _MODELS, Settings(baud=scene.baud), idle_is_told=True)
    rig.listen(FULL_SPEED, lambda data, stamp: monitor.feed(data, BOOT + stamp),
               lambda now: monitor.flush_if_idle(BOOT + now))
    for number in range(1, 2 * SECONDS + 1):
        rig.clock.run(number * S // 2)
        report = monitor.report(BOOT + rig.clock.now)
    return told(report)


def row(number: int, seeds: Sequence[int]) -> tuple[str, Counter[str]]:
    """Return what was said of one kind, as a row of the table and as a score."""
    kind = KINDS[number]
    runs = list(product((number,), range(len(PROGRAMS)), seeds))
    with ProcessPoolExecutor() as pool:
        said = Counter(pool.map(run, runs))
    cells = ' | '.join(_cell(said[column], column, kind) for column in COLUMNS)
    score: Counter[str] = Counter()
    for word, count in said.items():
        score[_verdict(word, kind)] += count
    return f'| {kind.name} | {cells} |', score


def table(seeds: Sequence[int]) -> tuple[str, str]:
    """Return the confusion table of these seeds, and its score in words."""
    rows = [row(number, seeds) for number in range(len(KINDS))]
    head = (f'| what it was | {" | ".join(COLUMNS)} |', '|---' * (len(COLUMNS) + 1) + '|')
    total = sum((score for _, score in rows), Counter[str]())
    words = ', '.join(f'{total[word]} {word}' for word in ('right', 'silent', 'wrong'))
    return '\n'.join([*head, *(text for text, _ in rows)]) + '\n', \
        f'{words}, of {total.total()} runs.'


def _cell(count: int, column: str, kind: Kind) -> str:
    return f'**{count}**' if count and column in _right(kind) else str(count or '')


def _right(kind: Kind) -> tuple[str, ...]:
    return kind.right or (wrecked.NOTHING,)


def _verdict(word: str, kind: Kind) -> str:
    if word in _right(kind):
        return 'right'
    return 'silent' if word == wrecked.NOTHING else 'wrong'


def page() -> str:
    """Return docs/damage.md."""
    blind_table, blind_score = table(BLIND)
    known_table, known_score = table(KNOWN)
    return HEAD.format(enough=bits.ENOUGH, programs=len(PROGRAMS)) + PARTS.format(
        blind=', '.join(map(str, BLIND)), blind_table=blind_table, blind_score=blind_score,
        known=', '.join(map(str, KNOWN)), known_table=known_table, known_score=known_score)


def main() -> int:
    """Print the table of some seeds, or write the page."""
    if '--write' in sys.argv[1:]:
        PAGE.write_text(page(), encoding='utf-8')
        return 0
    print('\n'.join(table([int(word) for word in sys.argv[1:]] or KNOWN)))
    return 0


if __name__ == '__main__':
    sys.exit(main())
