# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""What a bad line does to bytes: each takes a Random and bytes, and returns what arrives."""


def flip_bit(random, data):
    """Turn over one bit somewhere."""
    bit = random.randrange(8 * len(data))
    return data[:bit // 8] + bytes((data[bit // 8] ^ 1 << bit % 8,)) + data[bit // 8 + 1:]


def lose_byte(random, data):
    """Leave one byte out."""
    at = random.randrange(len(data))
    return data[:at] + data[at + 1:]


def replace_bytes(random, data):
    """Replace some bytes in the middle."""
    at = random.randrange(len(data))
    size = random.randint(1, 4)
    return data[:at] + random.randbytes(size) + data[at + size:]


def cut_end(random, data):
    """Leave the end out."""
    return data[:random.randrange(1, len(data))]
