# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""What comes back to a master of its own: byte by byte, for a program may read it in part."""

from collections import deque

from servobus.bus import evidence as ev
from servobus.bus.evidence import Evidence

PING_BYTES = 6                         # bytes: a Ping of the 1.0 family may be a status as well,
READ_BYTES = 8  # and a Read that nothing follows, but not two different ones
HEAD_BYTES = 5                         # header, ID, Length, instruction of the 1.0 family
_READ, _LENGTH_AT, _SIZE_AT = 2, 3, 6    # a Read of 2 bytes and its answer have one Length
_RESERVED = 0xFD                       # Protocol 2.0, where an answer begins as an instruction
WRITES_KEPT = 64                          # writes of which nothing came back yet
RECEIVED_KEPT_BYTES = 4096                        # bytes received since


class EchoCounter:
    """Counts the writes of one master that came back to it, wholly or as far as it read them."""

    def __init__(self, evidence: Evidence) -> None:
        self._counts = evidence.counts
        self._sent: deque[bytes] = deque(maxlen=WRITES_KEPT)
        self._came = b''                       # since then
        self._alone = b''                      # a Read, or an answer like it
        self._is_last = False                  # that, and nothing else may come

    def process_sent(self, chunk: bytes) -> None:
        """Take what the master sends."""
        if self._came:
            self._restart()
        self._sent.append(chunk)
        self._is_last = False

    def process_received(self, chunk: bytes) -> None:
        """Look for what the master sent in what it receives."""
        if self._is_last:
            self.count_waiting(len(chunk))
        if self._sent:
            self._came = (self._came + chunk)[-RECEIVED_KEPT_BYTES:]
        while self._sent and (at := self._came.find(self._sent[0])) >= 0:
            sent = self._sent.popleft()
            size = len(sent)
            self._came = self._came[at + size:]
            before, self._alone = self._alone or sent, b'' if self._came else sent
            is_echo = size > (READ_BYTES if before == self._alone else PING_BYTES) \
                or bool(self._came and not self._sent)
            self._count_echoes(is_echo)
            self._is_last = not (is_echo or self._sent)

    def count_waiting(self, waiting: int) -> None:
        """Take how many bytes came or wait since; one write has one answer."""
        self._count_echoes(self._is_last and waiting > 0)
        self._is_last = False

    def process_discarded(self, waiting: int, is_due: bool) -> None:
        """Note that the master throws so many bytes away; is_due: answers may be there."""
        if not (is_due or self._came) and 0 < waiting == sum(map(len, self._sent)):
            self._count_echoes(len(self._sent))       # nothing else may come
        self._restart(waiting)

    def _restart(self, waiting: int = 0) -> None:
        """Begin again; the first write may have come back as far as it was read."""
        sent = self._sent[0] if self._sent else b''
        if sent[:PING_BYTES] in self._came:        # an answer mostly holds none of it
            self._count_echoes(any(self._came.endswith(sent[:size])
                            for size in range(PING_BYTES, len(sent))))
        elif self._came == sent[:HEAD_BYTES] and sent[2] != _RESERVED:
            self._count_echoes(waiting > len(sent) - HEAD_BYTES or not _begins_answer(sent))
        self._sent.clear()
        self._came = b''

    def _count_echoes(self, writes: int) -> None:
        if writes:                     # a kind that did not occur has no count
            self._counts[ev.ECHO] += writes


def _begins_answer(sent: bytes) -> bool:
    """Tell whether the answer may begin as the instruction: of the same Length, with an error."""
    if len(sent) <= _SIZE_AT:
        return True                    # a Ping
    length = sent[_SIZE_AT] + 2 if sent[HEAD_BYTES - 1] == _READ else 2
    return sent[_LENGTH_AT] == length
