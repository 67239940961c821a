# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""
What a source hears: bytes with the side they came from, and changes of the line.

A second adapter hears both sides mixed and no change. The port of the master itself has both.
"""

from typing import NamedTuple

# The side of a chunk: which end of the bus put its bytes there.
UNKNOWN = ''
OUT = 'out'                        # from the master
IN = 'in'                          # to the master

# What a change is about. The value follows it.
BAUD = 'baud'                      # bit/s
LATENCY_TIMER = 'latency_timer_ms'
DTR = 'dtr'                        # 0 or 1
RTS = 'rts'
PURGED = 'purged'                  # 1: what was received, 2: what was to be sent, 3: both
OVERRUN, PARITY, FRAMING, BREAK = 'overrun', 'parity', 'framing', 'break'      # how often
NOT_SENT = 'not_sent'              # bytes that the master wrote and the adapter did not take
UNREAD = 'unread'                  # bytes that the master had received and not read
GAVE_UP = 'gave_up_us'             # the master looked in vain so long before it wrote or closed
BUSY = 'busy_us'                   # CPU time of the master's thread in the pause before it wrote
AWAY = 'away_us'                   # what follows was there: the master did not look for so long
LINE_MODE = 'line_mode'            # what the driver does with bytes, as a sum; 0: it is raw
HOLDS_LINES = 1                    # that come, until a line ends (ICANON)
CHANGES_BYTES = 2                  # that come, as 0D to 0A (ICRNL)
ADDS_RETURNS = 4                   # it sends 0D 0A for 0A (ONLCR)
HAS_ADDED_RETURN = 8               # in what the master wrote last
TRACED = 'traced_us'               # what strace took since the master wrote before
LOST = 'lost'                      # events or bytes that the source itself lost
CLOSED = 'closed'                  # the master closed its port
GONE = 'unplugged'                 # or the driver has hung up: the errno that the master got
CHANGES = (BAUD, LATENCY_TIMER, DTR, RTS, PURGED, OVERRUN, PARITY, FRAMING, BREAK, NOT_SENT,
           UNREAD, GAVE_UP, AWAY, BUSY, LINE_MODE, TRACED, LOST, CLOSED, GONE)


class Change(NamedTuple):
    """
    An event that a source reports besides bytes: one of the names above and its value.

    Not all change a state, as the rate does: parity errors and a closed port are such events, too.
    """

    what: str
    value: int


Changes = list[Change]


class Chunk(NamedTuple):
    """
    Bytes that were read at once; stamp: when, monotonic ns.

    side: who put them on the wire, UNKNOWN, OUT or IN. Where there is a change there are no bytes.
    """

    stamp: int
    bus: str
    data: bytes = b''
    side: str = UNKNOWN
    change: Change | None = None
