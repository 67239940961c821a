# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""
Packets of the Protocol 1.0 family, Dynamixel 1.0 and Feetech: made and read byte by byte.

After the e-Manual (Protocol 1.0) and the SCS Communication Protocol; written for the rig alone.
"""

from rigs.bus.frames import Form
from rigs.bus.frames import Packet

HEAD = b'\xff\xff'
SMALLEST = 6                               # bytes of a packet without parameters


def packet(number, code, params=b''):
    """Return a packet as it stands on the wire."""
    body = bytes((number, len(params) + 2, code)) + params
    return HEAD + body + bytes((255 - sum(body) % 256,))


def _size(front):
    size = 4 + front[3]
    return 0 if front[2] == 0xFF or size < SMALLEST else size


def parse(data):
    """Return the whole packets in these bytes; the code of a status is its error bits."""
    found = []
    at = data.find(HEAD)
    while 0 <= at <= len(data) - SMALLEST:
        end = at + _size(data[at:])
        if end > at and end <= len(data) and sum(data[at + 2:end]) % 256 == 255:
            found.append(Packet(data[at + 2], data[at + 4], data[at + 4], data[at + 5:end - 1]))
            at = data.find(HEAD, end)
        else:
            at = data.find(HEAD, at + 1)
    return found


FORM = Form(HEAD, SMALLEST, _size, parse, 0, packet, lambda value: bytes((value,)))
read, write, sync_read, sync_write = FORM.read, FORM.write, FORM.sync_read, FORM.sync_write
