# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""
What really happened on the simulated bus: which answers were due, and which came undamaged.

It gets each exchange after the faults did their work, and unlike a listener it knows who sent
what.
"""

from __future__ import annotations

from collections import defaultdict
from dataclasses import asdict
from dataclasses import dataclass
import math
from typing import Any

from mecarover_fakes.line import Answer
from mecarover_fakes.line import Burst
from mecarover_fakes.line import Exchange
from msg_defs.dxl_instruction import Answers

MISSED_LIMIT = 4                 # more missed answers than this in a row: disconnected


@dataclass
class Known:
    """What happened to one ID."""

    asked: int = 0               # answers that were due
    answered: int = 0            # came undamaged
    missed: int = 0              # did not come, or damaged
    waiting: int = 0             # after a silent device: their turn never came
    missed_in_a_row: int = 0
    statuses: int = 0            # undamaged ones, due or not

    @property
    def state(self) -> str:
        """The word for it: unseen, connected or disconnected."""
        if self.missed_in_a_row > MISSED_LIMIT:
            return 'disconnected'
        return 'connected' if self.statuses else 'unseen'


def good_answers(exchange: Exchange) -> list[Answer]:
    """Return the answers that came; after a damaged block of a combined status none did (CRC)."""
    lost_from = min((answer.burst.start for answer in exchange.answers
                     if exchange.request.answers is Answers.COMBINED
                     and not answer.burst.intact), default=math.inf)
    return [answer for answer in exchange.answers
            if answer.burst.intact and answer.burst.start <= lost_from]


class GroundTruth:
    """Counts exchanges."""

    def __init__(self) -> None:
        self.known: dict[int, Known] = defaultdict(Known)
        self.bytes = 0
        self.instructions = 0
        self.statuses = 0            # frames, a combined one counts once
        self.damaged = 0             # bursts

    def count_bursts(self, bursts: list[Burst]) -> None:
        """Count the bytes on the line."""
        self.bytes += sum(len(burst.data) for burst in bursts)
        self.damaged += sum(not burst.intact for burst in bursts)

    def count_exchange(self, exchange: Exchange) -> None:
        """Count an exchange."""
        good = good_answers(exchange)
        self.statuses += len(good) if exchange.request.answers is not Answers.COMBINED \
            else len(good) == len(exchange.request.accesses)
        for answer in good:
            self.known[answer.id].statuses += 1
            self.known[answer.id].missed_in_a_row = 0
        if exchange.bursts[0].intact:
            self.instructions += 1
            self._judge(exchange, {answer.id for answer in good})

    def _judge(self, exchange: Exchange, heard: set[int]) -> None:
        sent = {answer.id for answer in exchange.answers}
        answers = exchange.request.answers
        stopped = False
        # Of a Ping of all only those are known that answered it: more devices may be there.
        for number in heard if answers is Answers.EVERYBODY else exchange.due:
            known = self.known[number]
            known.asked += 1
            if number in heard:
                known.answered += 1
            elif stopped and number not in sent:
                known.waiting += 1
            else:
                known.missed += 1
                known.missed_in_a_row += 1
                rest = exchange.due[exchange.due.index(number):]
                stopped = answers in (Answers.LISTED, Answers.COMBINED) \
                    and not sent.intersection(rest)

    def as_json(self) -> dict[str, Any]:
        """Return everything for --truth."""
        return {
            'bytes': self.bytes, 'instructions': self.instructions, 'statuses': self.statuses,
            'damaged': self.damaged,
            'devices': {number: {'state': known.state} | asdict(known)
                        for number, known in sorted(self.known.items())}}
