# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""
What damage looks like bit by bit, on lines that are simulated at bit level.

Each run is one kind of bad line, with its figures drawn from the seed, under one program; what the
doctor adds as "looks like" at the end is counted. `scripts/python -m benchmark.baseline` does so
with the seeds below. The equipment (rigs/bus/uart.py) shares nothing with what it judges.
"""

from __future__ import annotations

from collections import Counter
from itertools import product

from rigs.bus import wrecked
from rigs.bus.score import reports
from rigs.bus.wrecked import KINDS
from rigs.bus.wrecked import PROGRAMS
from rigs.bus.wrecked import scene_of
from servobus.doctor import bit_errors

KNOWN = (1, 2, 3)                  # the limits were set with these seeds
BLIND = (2301, 2302, 2303, 2304)   # and not with these
SECONDS = 9
_LOOKS = {bit_errors.CLOCK: wrecked.CLOCK, bit_errors.SIGNAL_LEVEL: wrecked.LEVEL,
          bit_errors.PWM: wrecked.PWM, bit_errors.INTERFERENCE: wrecked.INTERFERENCE,
          bit_errors.TWO_SENDERS: wrecked.SPEAKERS}
_RULES = {'turnaround': wrecked.TURN, 'stray_bytes': wrecked.STRAY}


def told(report):
    """Return what a report says the damage looks like."""
    for finding in report.findings:
        said = dict(finding.evidence).get('looks like', '')
        for begin, column in _LOOKS.items():
            if said.startswith(begin):
                return column
    return next((_RULES[one.rule] for one in report.findings if one.rule in _RULES),
                wrecked.NOTHING)


def run(one):
    """Return what is said at the end of a run."""
    kind, program, seed = one
    scene = scene_of(KINDS[kind], PROGRAMS[program][1], seed)
    *_, (report, _) = reports(scene, scene.rig(seed), SECONDS)
    return told(report)


def cells(number, seeds):
    """Return what is right of one kind, what was said of its runs, '', and how many are right."""
    kind = KINDS[number]
    said = Counter(run((number, program, seed))
                   for program, seed in product(range(len(PROGRAMS)), seeds))
    score = Counter()
    for word, count in said.items():
        score[_verdict(word, kind)] += count
    return (' or '.join(_right(kind)), _spell(said), '', _spell(score))


def _spell(counts):
    return ', '.join(f'{count} {word}' for word, count in sorted(counts.items()))


def _right(kind):
    return kind.right or (wrecked.NOTHING,)


def _verdict(word, kind):
    if word in _right(kind):
        return 'right'
    return 'silent' if word == wrecked.NOTHING else 'wrong'
