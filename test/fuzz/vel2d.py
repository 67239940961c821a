# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""The rover's frame: 28 bytes to a velocity and back."""

import struct

from fuzz import reference
from fuzz.script import Script
from msg_defs.crc import CRC_BY_INPUT
from msg_defs.vel2d import decode
from msg_defs.vel2d import encode
from msg_defs.vel2d import Vel2d

SIZE = 28
CRCS = {'bytes': reference.crc32, 'words': reference.crc32_words}
TELLING = (0.0, -0.0, 1.0, -1.0, 5e-324, 1.7976931348623157e308, float('inf'), float('-inf'),
           float('nan'))


def check(data):
    """
    Check one frame, made and taken.

    Never raises; a frame is three little-endian doubles and their CRC by either way of feeding
    it, as fuzz/reference.py has it; what is decoded is that to the bit, NaN and -0.0 included; a
    flipped bit, a missing or a further byte is never a frame.
    """
    script = Script(data)
    name = script.pick(tuple(CRCS))
    crc = CRC_BY_INPUT[name]
    bit, at = script.word() % (8 * SIZE), script.byte() % SIZE
    values = b''.join(value(script) for _ in range(3))
    frame = encode(Vel2d(*struct.unpack('<ddd', values)), crc)
    assert frame == values + CRCS[name](values).to_bytes(4, 'little')
    assert struct.pack('<ddd', *decode(frame, crc)) == values
    for flipped in (bit, *range(192, 8 * SIZE)):
        number = int.from_bytes(frame, 'little') ^ 1 << flipped
        assert decode(number.to_bytes(SIZE, 'little'), crc) is None
    for size in (frame[:at] + frame[at + 1:], frame + frame[at:at + 1], frame[:at], frame * 2):
        assert decode(size, crc) is None
    rest = script.take_rest()
    for candidate in (rest, rest[:SIZE]):
        velocity = decode(candidate, crc)
        is_frame = len(candidate) == SIZE and candidate[24:] == CRCS[name](
            candidate[:24]).to_bytes(4, 'little')
        assert (velocity is not None) == is_frame
        assert not is_frame or struct.pack('<ddd', *velocity) == candidate[:24]


def value(script):
    """Return the 8 bytes of a double: any, or one that is easily got wrong."""
    if script.byte() < 100:
        return struct.pack('<d', script.pick(TELLING))
    return script.take_bytes(8).ljust(8, b'\0')
