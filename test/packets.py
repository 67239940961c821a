# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""A Framer as tests read it: chunks in, whole packets out, without what was damaged."""

from msg_defs.dxl_packet import Frame
from msg_defs.dxl_packet import Framer
from msg_defs.dxl_packet import Packet
from msg_defs.dxl_packet import packet_of


def packets_in(framer: Framer, chunk: bytes, stamp: int = 0) -> list[Packet]:
    """Return the packets that this chunk completes."""
    return _good(framer.frames(chunk), stamp)


def packets_left(framer: Framer, stamp: int = 0) -> list[Packet]:
    """Return the packets that are found when the line is idle."""
    return _good(framer.flush_frames(), stamp)


def _good(frames: list[Frame], stamp: int) -> list[Packet]:
    return [packet_of(one, stamp) for one in frames if one[2] is None or not one[2].reason]
