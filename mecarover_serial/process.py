# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""What this process costs."""
import math
import os
from pathlib import Path

_PAGE_MB = os.sysconf('SC_PAGE_SIZE') / 1e6


def resident_memory_mb() -> float:
    """Return the resident memory of this process in MB; NaN when no descriptor is left."""
    try:
        return int(Path('/proc/self/statm').read_text().split()[1]) * _PAGE_MB
    except OSError:
        return math.nan
