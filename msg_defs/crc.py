# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""
The checksums on our wires, from crcmod: CRC-32/MPEG-2 (rover), CRC-16/0x8005 (Dynamixel).

Both are unreflected and without final xor. Check values over b'123456789': 0x0376E6E7 and 0xFEE8.
crcmod has a C part; without it everything works, ten to twenty times slower (CRC_IS_FAST).
"""
from array import array
from collections.abc import Callable
from typing import Any

import crcmod
from crcmod.crcmod import _usingExtension  # in crcmod 1.7 (apt) crcmod.crcmod is crcmod itself

CRC_IS_FAST: bool = _usingExtension
SLOW_CRC_WARNING = (
    'crcmod: its C part is missing, checksums are ten times slower; '
    'install python3-crcmod (apt) or crcmod-plus (pip)')

Checksum = Callable[[bytes], int]
crc32_mpeg2: Checksum = crcmod.mkCrcFun(
    0x104C11DB7, initCrc=0xFFFFFFFF, rev=False, xorOut=0)

# crc16(data, crc) continues from crc: the blocks of a fast reply are checked that way.
crc16: Callable[..., int] = crcmod.mkCrcFun(0x18005, initCrc=0, rev=False, xorOut=0)


def bare_crc(wrapped: Callable[..., int]) -> tuple[Callable[[bytes, int, Any], int], Any]:
    """
    Return what crcmod wraps in a function of Python, and its table: crc = bare(data, crc, table).

    Both are defaults of that function in crcmod 1.7 and crcmod-plus 2; of any other: itself.
    """
    defaults = wrapped.__defaults__ or ()
    if len(defaults) == 3 and callable(defaults[2]):
        return defaults[2], defaults[1]
    return lambda data, crc, table: wrapped(data, crc), None


# What is called for each packet spares the wrapper: 40 ns.
bare_crc16, CRC16_TABLE = bare_crc(crc16)


def crc32_mpeg2_words(data: bytes) -> int:
    """
    CRC-32/MPEG-2 as an STM32 CRC unit gives it when fed little-endian 32-bit words.

    The unit shifts the most significant byte of each word in first, so it sees the bytes of
    every word reversed. The length must be a multiple of four.
    """
    words = array('I', data)           # ValueError where a word is not whole
    words.byteswap()
    return crc32_mpeg2(words.tobytes())


CRC_BY_INPUT: dict[str, Checksum] = {
    'bytes': crc32_mpeg2,
    'words': crc32_mpeg2_words,
}
