# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""The rover's frame: 28 bytes to a velocity and back."""

import struct

from fuzz.script import Script
from msg_defs.crc import CRC_INPUTS
from msg_defs.vel2d import decode
from msg_defs.vel2d import encode
from msg_defs.vel2d import FRAME_SIZE
from msg_defs.vel2d import Vel2d


def check(data):
    """
    Check one frame, made and taken.

    Never raises; what is decoded encodes to the same bytes, NaN and -0.0 included; a flipped bit
    or a missing byte is never a frame.
    """
    script = Script(data)
    crc = script.pick(tuple(CRC_INPUTS.values()))
    bit, at = script.word() % (8 * FRAME_SIZE), script.byte() % FRAME_SIZE
    values = struct.unpack('<ddd', script.take(24).ljust(24, b'\0'))
    frame = encode(Vel2d(*values), crc)
    assert len(frame) == FRAME_SIZE
    assert struct.pack('<ddd', *decode(frame, crc)) == frame[:24]
    flipped = bytearray(frame)
    flipped[bit // 8] ^= 1 << bit % 8
    assert decode(bytes(flipped), crc) is None
    assert decode(frame[:at] + frame[at + 1:], crc) is None
    rest = script.rest()
    for candidate in (rest, rest[:FRAME_SIZE]):
        velocity = decode(candidate, crc)
        assert velocity is None or encode(velocity, crc) == candidate
