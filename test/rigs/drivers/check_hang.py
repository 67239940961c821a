# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""A board on USB that hangs: it takes nothing, and its driver can drop nothing."""
from __future__ import annotations

import time

from rigs.drivers.adapters import Acm
from rigs.drivers.rover import rover_on

HANG_S = 25.0


def test_a_board_that_hangs_for_25_s_is_told_before_it_revives(guest, record_property):
    with rover_on(Acm, guest) as rover:
        rover.drive()
        board = rover.adapter.board
        begin = time.monotonic()
        board.signal('STOP')
        rover.bridge.wait_for('takes no data', timeout_s=HANG_S)
        record_property('figure', f'told after {time.monotonic() - begin:.0f} s')
        time.sleep(max(0.0, begin + HANG_S - time.monotonic()))
        board.signal('CONT')
        known = len(rover.mcu.set_points)
        guest.until(lambda: any(point.is_stop for point in rover.mcu.set_points[known:]))
        rover.drive()
