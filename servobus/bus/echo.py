# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""What comes back to a master of its own: byte by byte, for a program may read it in part."""

from collections import deque
from itertools import islice

from servobus.bus import evidence as ev
from servobus.bus.evidence import Evidence

PING_BYTES = 6                     # bytes: a Ping of the 1.0 family may be a status as well,
READ_BYTES = 8                     # and a Read that nothing follows, but not two different ones
HEAD_BYTES = 5                     # header, ID, Length, instruction of the 1.0 family
_PING, _READ = 1, 2
_LENGTH_AT, _CODE_AT, _SIZE_AT = 3, 4, 6  # a Read of 2 bytes and its answer have one Length
_RESERVED = 0xFD                   # Protocol 2.0, where an answer begins as an instruction
WRITES_KEPT = 512                  # as many as lie unread in the 4 kB of a tty
SEARCHED_WRITES = 16               # any of them may be the first that came back whole
RECEIVED_KEPT_BYTES = 4096         # bytes received since


class EchoCounter:
    """Counts the writes of one master that came back to it, wholly or as far as it read them."""

    def __init__(self, evidence: Evidence) -> None:
        self._evidence = evidence
        self._sent: deque[bytes] = deque(maxlen=WRITES_KEPT)
        self._came = b''                       # since then
        self._alone = b''                      # a Read, or an answer like it
        self._last = b''                       # the write that came back, if nothing else may
        self._before = b''                     # the same, of the question before
        self._waiting = 0                      # bytes that it has left unread

    def process_sent(self, chunk: bytes) -> None:
        """Take what the master sends; the echo of it may come after all that still waits."""
        if self._came and not self._waiting:
            self._restart()
        self._sent.append(chunk)
        self._before, self._last = self._last, b''

    def process_received(self, chunk: bytes) -> None:
        """Look for what the master sent in what it receives."""
        if self._last:
            self._count_echoes(1)
            self._last = b''
        if self._sent:
            self._came = (self._came + chunk)[-RECEIVED_KEPT_BYTES:]
        if self._before and len(self._came) >= _CODE_AT:
            self._count_echoes(self._is_late_answer())
            self._before = b''
        while self._sent and ((at := self._came.find(self._sent[0])) >= 0
                              or (self._waiting and (at := self._skip_damaged()) >= 0)):
            sent = self._sent.popleft()
            size = len(sent)
            self._came = self._came[at + size:]
            before, self._alone = self._alone or sent, b'' if self._came else sent
            is_echo = size > (READ_BYTES if before == self._alone else PING_BYTES) \
                or bool(self._came and not self._sent)
            self._count_echoes(is_echo)
            self._last = b'' if is_echo or self._sent else sent

    def _is_late_answer(self) -> bool:
        """Tell whether the answer to a Ping is read as one to a Read, after the Ping itself."""
        codes = self._before[_CODE_AT:HEAD_BYTES] + self._sent[0][_CODE_AT:HEAD_BYTES]
        return codes == bytes((_PING, _READ)) \
            and self._came[:_CODE_AT] == self._before[:_CODE_AT]

    def _skip_damaged(self) -> int:
        """Forget writes before the next that came back whole; return where it is, -1: nowhere."""
        for number, sent in enumerate(islice(self._sent, 1, SEARCHED_WRITES), 1):
            if (at := self._came.find(sent)) >= 0:
                for _ in range(number):
                    self._sent.popleft()
                return at
        return -1

    def note_waiting(self, waiting: int) -> None:
        """Take how many bytes came or wait since; one write has one answer."""
        self._count_echoes(bool(self._last) and waiting > 0)
        self._last = b''
        self._waiting = waiting

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
        self._came = self._before = b''
        self._waiting = 0

    def _count_echoes(self, writes: int) -> None:
        if writes:                     # a kind that did not occur has no count
            self._evidence.counts[ev.ECHO] += writes
            self._evidence.has_echo = True


def _begins_answer(sent: bytes) -> bool:
    """Tell whether the answer may begin as the instruction: of the same Length, with an error."""
    if len(sent) <= _SIZE_AT:
        return True                    # a Ping
    length = sent[_SIZE_AT] + 2 if sent[_CODE_AT] == _READ else 2
    return sent[_LENGTH_AT] == length
