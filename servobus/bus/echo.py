# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""What comes back to a master of its own: byte by byte, for a program may read it in part."""

from collections import deque

from servobus.bus import evidence as ev
from servobus.bus.evidence import Evidence

LONGER = 6                         # bytes: a Ping of the 1.0 family may be a status as well,
READ = 8                           # and a Read that nothing follows, but not two different ones
KEPT = 64                          # writes of which nothing came back yet
MUCH = 4096                        # bytes received since


class EchoCounter:
    """Counts the writes of one master that came back to it, wholly or as far as it read them."""

    def __init__(self, evidence: Evidence) -> None:
        self._counts = evidence.counts
        self._sent: deque[bytes] = deque(maxlen=KEPT)
        self._came = b''                       # since then
        self._alone = b''                      # a Read, or an answer like it
        self._is_last = False                  # that, and nothing else may come

    def send(self, chunk: bytes) -> None:
        """Take what the master sends."""
        if self._came:
            self._end()
        self._sent.append(chunk)
        self._is_last = False

    def hear(self, chunk: bytes) -> None:
        """Look for what the master sent in what it receives."""
        if self._is_last:
            self.wait(len(chunk))
        if self._sent:
            self._came = (self._came + chunk)[-MUCH:]
        while self._sent and (at := self._came.find(self._sent[0])) >= 0:
            said = self._sent.popleft()
            size = len(said)
            self._came = self._came[at + size:]
            before, self._alone = self._alone or said, b'' if self._came else said
            is_echo = size > (READ if before == self._alone else LONGER) \
                or bool(self._came and not self._sent)
            self._count(is_echo)
            self._is_last = not (is_echo or self._sent)

    def wait(self, waiting: int) -> None:
        """Take how many bytes came or wait since; one write has one answer."""
        self._count(self._is_last and waiting > 0)
        self._is_last = False

    def drop(self, waiting: int, is_due: bool) -> None:
        """Take note that the master throws so many bytes away; is_due: answers may be there."""
        if not (is_due or self._came) and 0 < waiting == sum(map(len, self._sent)):
            self._count(len(self._sent))       # nothing else may come
        self._end()

    def _end(self) -> None:
        """Begin again; the first write may have come back as far as it was read."""
        said = self._sent[0] if self._sent else b''
        if said[:LONGER] in self._came:        # an answer mostly holds none of it
            self._count(any(self._came.endswith(said[:size])
                            for size in range(LONGER, len(said))))
        self._sent.clear()
        self._came = b''

    def _count(self, writes: int) -> None:
        if writes:                     # a kind that did not occur has no count
            self._counts[ev.ECHO] += writes
