# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""
The rover's set-point and its frame on the UART.

28 bytes, packed, no sync word: float64 x, y, omega and a uint32 CRC-32/MPEG-2 over the first
24 bytes, all little-endian (docs/frame.md). The receiver finds a frame by the idle line around it.
"""
import struct
from typing import NamedTuple

from msg_defs.crc import Checksum
from msg_defs.crc import crc32_mpeg2

FRAME_SIZE = 28
_VALUES = struct.Struct('<ddd')
_CRC = struct.Struct('<I')


class Vel2d(NamedTuple):
    """A planar velocity: x and y in m/s, omega in rad/s, in the frame of the rover."""

    x: float
    y: float
    omega: float


STOP = Vel2d(0.0, 0.0, 0.0)


def encode(velocity: Vel2d, crc: Checksum = crc32_mpeg2) -> bytes:
    """Return the 28 bytes of the frame; `crc` is one of msg_defs.crc.CRC_BY_INPUT."""
    values = _VALUES.pack(*velocity)
    return values + _CRC.pack(crc(values))


def decode(frame: bytes, crc: Checksum = crc32_mpeg2) -> Vel2d | None:
    """Return what a frame says, None when its size or checksum is wrong."""
    if len(frame) != FRAME_SIZE:
        return None
    values = frame[:_VALUES.size]
    if _CRC.unpack_from(frame, _VALUES.size)[0] != crc(values):
        return None
    return Vel2d(*_VALUES.unpack(values))
