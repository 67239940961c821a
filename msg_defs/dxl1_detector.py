# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""
Detector: whether the 1.0 family is spoken on a wire where 2.0 is looked for as well.

One right sum of eight bits proves little, several packets directly after each other do, and so
does a packet that the program wrote as a whole: no byte in front of it, none after it.
"""

from typing import Any
from typing import NamedTuple

from msg_defs.servo_frame import Frame
from msg_defs.servo_frame import GLITCH

PROOF_FRAMES = 3                   # frames directly after each other that prove the family
PROOF_SINGLE_FRAMES = 16           # or so many in all, with fewer wrong ones than 16 to each


class Candidate(NamedTuple):
    """A good frame with the form of the 1.0 family, which waits, and the chunk that it came in."""

    framer: Any                    # a MixedFramer, or one of the 1.0 family alone
    frame: Frame
    stamp: int
    received: int                  # stream offset after its chunk
    side: str


class Detector:
    """
    Decides whether the 1.0 family is spoken on a bus, for the framers of all its sides.

    proven: the IDs that speak it. proof: earlier frames that the last chunk proved, and the one
    that did so.
    """

    def __init__(self) -> None:
        self.proven: set[int] = set()
        self.proof: list[Candidate] = []
        self.streak: list[Candidate] = []      # directly after each other, not yet proof
        self._single = 0                       # good frames that were given up

    def add_candidate(self, one: Candidate, is_whole: bool) -> bool:
        """
        Take a frame that may be chance; return whether it is proof, with those in `proof`.

        is_whole: it is all that the program wrote at once.
        """
        flaw = one.frame[6]
        if flaw is not None and flaw.noise_length > GLITCH:
            self.reject_streak()
        self.streak.append(one)
        one.framer.held += one.frame[1] - one.frame[0]
        if not is_whole and len(self.streak) < PROOF_FRAMES \
                and not (self._single >= PROOF_SINGLE_FRAMES
                         and PROOF_SINGLE_FRAMES * self._single > one.framer.failed_candidates):
            return False
        for held in self.streak[:-1]:
            held.framer.claim(held.frame)
            self.proof = self.streak
        self._release_streak()
        one.framer.claim(one.frame)
        return True

    def reject_streak(self) -> None:
        """Give up what is not proven: its bytes are noise."""
        self._single += len(self.streak)
        self._release_streak()

    def _release_streak(self) -> None:
        for held in self.streak:
            held.framer.held = 0
        self.streak = []
