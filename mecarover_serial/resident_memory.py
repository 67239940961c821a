# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""What this process costs in memory."""
from __future__ import annotations

import math
import os
from pathlib import Path

from msg_defs.diagnostics import Metric

_PAGE_MB = os.sysconf('SC_PAGE_SIZE') / 1e6


def resident_memory() -> Metric:
    """Return the resident memory of this process; NaN when no descriptor is left."""
    try:
        value = int(Path('/proc/self/statm').read_text().split()[1]) * _PAGE_MB
    except OSError:
        value = math.nan
    return Metric('resident_memory', 'MB', value=value)
