# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""Which rate a bus really has, from what a UART at the wrong rate makes of packet headers."""

from __future__ import annotations

from functools import lru_cache

from msg_defs.dxl_packet import HEADER
from msg_defs.uart import heard_at

RATES = (9600, 57_600, 115_200, 1_000_000, 2_000_000, 3_000_000, 4_000_000, 4_500_000)
ENOUGH = 3                         # headers
CERTAIN = 2                        # bytes of a header as it looks: fewer say nothing


def likely_rate(noise: bytes, baud: int) -> int | None:
    """Return the Dynamixel rate at which headers look like these bytes; None if unsure."""
    counts = {rate: noise.count(look) for rate, look in _looks(baud).items()}
    best = max(counts, key=lambda rate: (counts[rate], len(_looks(baud)[rate])))
    rivals = [rate for rate in counts if counts[rate] == counts[best]
              and len(_looks(baud)[rate]) == len(_looks(baud)[best])]
    return best if counts[best] >= ENOUGH and len(rivals) == 1 else None


@lru_cache(maxsize=16)
def _looks(baud: int) -> dict[int, bytes]:
    """Return what the first bytes of a packet look like, for each rate the bus may have."""
    looks = {rate: _look(baud / rate) for rate in RATES if rate != baud}
    return {rate: look for rate, look in looks.items() if len(look) >= CERTAIN} or {baud: HEADER}


def _look(ratio: float) -> bytes:
    """Return the bytes that are the same for every ID after the header."""
    looks = [heard_at(HEADER + bytes([number, 4, 0]), ratio) for number in (1, 0x55, 0xFE)]
    same = 0
    while all(same < len(look) and look[same] == looks[0][same] for look in looks):
        same += 1
    return looks[0][:same]
