# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""Doubles of frames, and what a receiver reads where its double is a float."""
import math
import random
import struct


def doubles(count):
    """Return edges of both kinds and values by chance, `count` of any bits, as many of a rover."""
    chance = random.Random(1)
    edges = [(exponent << 52) + step & 2 ** 63 - 1
             for exponent in (0, 1, 0x36A, 0x380, 0x381, 0x47E, 0x47F, 0x7FE, 0x7FF)
             for step in (-2 ** 29, -1, 0, 1, 2 ** 29 - 1, 2 ** 29)]
    values = [struct.unpack('<d', struct.pack('<Q', bits))[0]
              for bits in (*edges, *(chance.getrandbits(64) for _ in range(count)))]
    values += [chance.uniform(-2, 2) for _ in range(count)]
    return [sign * value for value in values for sign in (1, -1)]


def as_float(value):
    """Return the float next to a double, toward zero, NaN for none; 0: it is too small."""
    if not abs(value) < 2.0 ** 128:
        return math.nan
    bits, = struct.unpack('<Q', struct.pack('<d', value))
    if abs(value) < 2.0 ** -126:
        bits &= 1 << 63
    return struct.unpack('<d', struct.pack('<Q', bits >> 29 << 29))[0]
