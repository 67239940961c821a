# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""
Frame: one packet as each framer hands it on, in any protocol; no header, no checksum.

A plain tuple, because there is one for each packet: unpack it by name.
"""

from functools import lru_cache
from typing import NamedTuple

# What a frame is.
IS_STATUS = 0
INSTRUCTION_2 = 1                  # Protocol 2.0
INSTRUCTION_1 = 2                  # the 1.0 family; its parameters are as wide as those of 2.0
MALFORMED_1 = 3                    # the 1.0 family, and its parameters do not fit
EITHER_1 = 4                       # the 1.0 family: an instruction or a status
UNPROVEN_1 = 5                     # it looks like that and may be chance (dxl1_detector.py)

# Bytes of noise in front of a frame that count as none. A line that turns round leaves a byte or
# two, on a real robot in front of one packet in thirteen; 3 cannot hide an instruction of 2.0.
GLITCH = 3
OPEN = 'open'                      # the reason of a frame that stays EITHER_1


class Flaw(NamedTuple):
    """What was not as it should be around a frame."""

    reason: str                    # '', 'crc', 'cut' (it ends early), 'length', or as above
    repaired: bool = False         # the first header byte was missing or wrong
    noise_length: int = 0          # bytes of noise in front of it
    unstuffed: bool = False        # a master of 2.0 that does not stuff sent it
    length: int = 0                # what a damaged frame has as its Length


@lru_cache(maxsize=64)
def good_frame_flaw(repaired: bool, noise_length: int, unstuffed: bool = False) -> Flaw:
    """Return the flaw of a good frame; most are alike, so they are not made each time."""
    return Flaw('', repaired, noise_length, unstuffed)


# (begin, end, kind, id, code, data, flaw)
# begin, end: stream offsets of its first byte, and after its last.
# kind: one of the above. id: as addressed; in a status, who sent it.
# code: the instruction; in a status, the error byte.
# data: the parameters without stuffing; in a damaged frame its bytes from the ID on.
# flaw: None for a good frame directly after the last one.
Frame = tuple[int, int, int, int, int, bytes, Flaw | None]
Frames = list[Frame]


def is_good(frame: Frame) -> bool:
    """Return whether a frame is whole, and what it means is known."""
    flaw = frame[6]
    return flaw is None or not flaw.reason
