# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""What a program asks from one opening of its port to the next, and whether that is answered."""

from servobus.bus import evidence as ev
from servobus.bus.evidence import Evidence

# A board that the opening restarts is silent for longer than the first, and until the second.
BOARD_START_MIN_NS = 1_000_000_000
BOARD_START_MAX_NS = 1_500_000_000
QUESTION_MAX_BYTES = 20            # in a session: it asked once


class PortSessions:
    """The sessions of one bus; opened_ns: stamp of the opening, 0: the port is closed."""

    def __init__(self, evidence: Evidence) -> None:
        self._evidence = evidence
        self.opened_ns = 0
        self.is_closed = False                 # after a session; before the first it is unknown
        self._sent = 0                         # bytes before it

    def begin(self, stamp: int, sent: int) -> None:
        """Note that the port is open; sent: bytes of the program so far."""
        self.opened_ns, self._sent, self.is_closed = stamp, sent, False

    def end(self, stamp: int, sent: int, asked: int, answered: int) -> None:
        """Note that the port is closed; asked, answered: stamps of the last of each."""
        opened, self.opened_ns, self.is_closed = self.opened_ns, 0, True
        size = sent - self._sent
        if not size or not opened:
            return
        if answered < opened:
            if stamp - opened < BOARD_START_MAX_NS:
                self._evidence.add_incident(stamp, ev.SESSION_UNANSWERED, ev.NO_DEVICE)
        elif size <= QUESTION_MAX_BYTES and asked - opened >= BOARD_START_MIN_NS:
            self._evidence.add_incident(stamp, ev.SESSION_ANSWERED_LATE, ev.NO_DEVICE)
        else:
            self._evidence.counts[ev.SESSION_ANSWERED] += 1
