# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""Limit: a velocity scaled into its bounds by one factor, so that its direction stays. Pure."""
from __future__ import annotations

from msg_defs.vel2d import Vel2d


def limit(velocity: Vel2d, limits: Vel2d) -> Vel2d:
    """Scale a finite velocity by one factor into the limits (0 = none): the direction stays."""
    biggest = max(map(abs, velocity))
    if biggest == 0.0:
        return velocity
    unit = [part / biggest for part in velocity]     # first, as no product may overflow
    length = min([biggest] + [
        bound / abs(part) for part, bound in zip(unit, limits, strict=True)
        if bound > 0.0 and abs(part) > 0.0])
    if length == biggest:
        return velocity
    return Vel2d(*(
        max(-bound, min(bound, part * length)) if bound > 0.0 else part * length
        for part, bound in zip(unit, limits, strict=True)))
