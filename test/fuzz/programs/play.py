# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""Plays one program below the tap's own wrappers, and judges what the doctor says of it."""
from pathlib import Path
from typing import NamedTuple

from fuzz.programs.grammar import Program
from fuzz.programs.mistakes import MISTAKES
from msg_defs.diagnostics import Level
from msg_defs.event import Change
from msg_defs.event import CHANGES
from msg_defs.event import Chunk
from servobus.examination import Examination
from servobus.model.models import Models
from servobus.sources import tap_pyserial
from servobus.sources.capture import Wire
from servobus.tools.doctor.verdict import make_verdict

FAMILIES = '2', '1', 'feetech'
MODELS = Models()
ADVICE = {'cycle_time', 'echo'}    # is right at level OK, too


class Result(NamedTuple):
    """score: right, wrong, unsure or silent. wrong: names that are not true."""

    score: str
    found: frozenset[str]
    wrong: frozenset[str]
    unsure: tuple[str, ...]
    texts: tuple[str, ...]         # all that was found, in words


class Sender:
    """What the wrappers of the tap report to: an examination, in the program's time."""

    def __init__(self, clock, wire):
        self.clock, self.wire, self.rivals, self.serials = clock, wire, {}, set()
        self.examination = Examination(MODELS)

    def put(self, kind, port, data):
        self.examination.feed_chunk(Chunk(self.clock.now, self.wire.name, data, kind), self.wire)

    def number(self, kind, port, value):
        if kind in CHANGES:
            self.examination.feed_chunk(
                Chunk(self.clock.now, self.wire.name, change=Change(kind, value)), self.wire)

    def opened(self, name, baud):
        return 1


SCORES = Path(__file__).with_name('scores.tsv')
SEEDS = range(1, 6)
WORST_LAST = 'right', 'unsure', 'silent', 'wrong'


def kept_scores():
    """Return the scores of SEEDS by kind and family, as they were when they were kept last."""
    rows = (line.split('\t') for line in SCORES.read_text().splitlines())
    return {(kind, family): scores.split() for kind, family, scores in rows}


def kinds():
    """Yield each kind and the families in which it can happen."""
    for kind, (_, _, _, families) in MISTAKES.items():
        yield from ((kind, family) for family in families)


def play(kind, family, seed, stutter=0.0):
    """Play one program with a mistake; return what the doctor made of it."""
    make, right, fine, _ = MISTAKES[kind]
    program = Program(family, f'{kind} {seed}', stutter)
    make(program)
    sender = Sender(program.clock, Wire('arm', program.baud))
    real, tap_pyserial.time = tap_pyserial.time, program.clock
    try:
        with tap_pyserial.tapped(program.port, sender):
            ended = program.run()
    finally:
        tap_pyserial.time = real
    examination = sender.examination
    examination.finish(examination.last, True, ended)
    verdict = make_verdict('x', examination.buses(True), 1.0, True)
    found = {one.rule for one in verdict.wrong if one.level > Level.OK or one.rule in ADVICE}
    if stutter and not program.clears:     # after one stop it reads old answers for ever
        fine = fine | {'unread_answers'}
    return judge(found, [f'{one.who} {one.rule}: {one.message}; try: {one.step}'
                         for one in verdict.not_sure], right, fine,
                 [f'{one.rule} {one.who}: {one.message}' for one in verdict.wrong])


def judge(found, unsure, right, fine, texts=()):
    """Return the score of what was found, where `right` was to be found."""
    wrong = found - right - fine - ADVICE
    score = 'wrong' if wrong else 'right' if found & right or not right \
        else 'unsure' if unsure else 'silent'
    return Result(score, frozenset(found), frozenset(wrong), tuple(unsure), tuple(texts))
