# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""Framers as tests read them: chunks in, whole packets out, without what was damaged."""
from typing import NamedTuple

from msg_defs.dxl_packet import packet_of
from msg_defs.frame import is_good


def packets_in(framer, chunk, stamp=0):
    """Return the packets that this chunk completes."""
    return [packet_of(one, stamp) for one in filter(is_good, framer.frames(chunk))]


def packets_left(framer, stamp=0):
    """Return the packets that are found when the line is idle."""
    return [packet_of(one, stamp) for one in filter(is_good, framer.flush_frames())]


class Packet1(NamedTuple):
    """A packet of the 1.0 family. code: the instruction, or the error byte of a status."""

    offset: int
    id: int
    code: int
    params: bytes


def packets_1_in(framer, chunk):
    """Return the packets that this chunk completes; None: the line is idle."""
    found = framer.flush_frames() if chunk is None else framer.frames(chunk)
    return [Packet1(begin, number, code, params)
            for begin, _, _, number, code, params, _ in filter(is_good, found)]
