# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""
The limits that a servo has from the factory, for where the master never read its own.

Initial values of Temperature Limit, Min and Max Voltage Limit in the control tables (e-Manual). A
model that is not here is not judged before its own limits are seen.
"""

from typing import NamedTuple


class Limits(NamedTuple):
    """degrees: °C; low and high: V."""

    degrees: float
    low: float
    high: float


_MX = Limits(80.0, 9.5, 16.0)
_AX = Limits(70.0, 6.0, 14.0)
_MX_1 = Limits(80.0, 6.0, 16.0)
FACTORY = {
    12: _AX, 18: _AX, 300: _AX,                    # AX-12A, AX-18A, AX-12W
    29: _MX_1, 310: _MX_1, 320: _MX_1, 360: _MX_1,  # MX-28, MX-64, MX-106, MX-12W (1.0)
    311: _MX, 321: _MX, 30: _MX,                   # MX-64, MX-106, MX-28 (2.0)
    1020: Limits(80.0, 9.5, 16.0), 1030: Limits(80.0, 9.5, 16.0),      # XM430-W350, XM430-W210
    1060: Limits(72.0, 6.0, 14.0),                 # XL430-W250
    1120: Limits(80.0, 10.0, 16.0), 1130: Limits(80.0, 10.0, 16.0),    # XM540-W270, XM540-W150
    1190: Limits(70.0, 3.5, 7.0), 1200: Limits(70.0, 3.5, 7.0),        # XL330-M077, XL330-M288
}
