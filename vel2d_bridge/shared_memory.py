# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""
Board: what the bridge and its dead man share, in memory that outlives each of them.

Words of 64 bits, each written by one side only, and a record: the port, and what is to be done
with it. The record has two places; its number is written last, so that a bridge that is killed
while it writes leaves the record before.
"""
from __future__ import annotations

import marshal
import mmap
from typing import NamedTuple

# The bridge writes BEATEN and _RECORD, the dead man ACTED and ALIVE, both of its processes the
# rest. HANDLED: the record that the dead man acts on now, with its port if it names one.
BEATEN, ACTED, HANDLED, ALIVE, SERVER, WATCH, _RECORD = range(7)
_WORDS = 64                        # bytes
_PLACE = 16384                     # bytes: two paths of 4096, and some
AWAY, HELD, OWED, GOODBYE = range(4)    # no port; open; lost while the rover drove; leave


class PortRecord(NamedTuple):
    """What the dead man needs to stop the rover, when no one is left to ask."""

    number: int = 0
    what: int = AWAY
    stop: bytes = b''              # the frame
    baud: int = 1
    path: str = ''                 # where a lost port is looked for, '' for a URL
    device: str = ''               # what is looked for: see claim.identity
    settings: bytes = b''          # struct termios2, the rate among them
    claim: str = ''                # see claim.py


class SharedBoard:
    """To be made before the fork."""

    def __init__(self) -> None:
        memory = memoryview(mmap.mmap(-1, _WORDS + 2 * _PLACE))
        self.words = memory[:_WORDS].cast('Q')
        self._places = memory[_WORDS:_WORDS + _PLACE], memory[_WORDS + _PLACE:]

    def write(self, record: PortRecord) -> None:
        """Replace the record; its number is one more than that before."""
        data = marshal.dumps(tuple(record))
        self._places[record.number % 2][:len(data)] = data
        self.words[_RECORD] = record.number

    def read(self) -> PortRecord:
        while True:
            number = self.words[_RECORD]
            data = bytes(self._places[number % 2])
            if self.words[_RECORD] == number:
                return PortRecord(*marshal.loads(data)) if number else PortRecord()

    def is_new(self, record: PortRecord) -> bool:
        return self.words[_RECORD] != record.number
