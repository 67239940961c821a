# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""GuardedReceiver: an MCU with the receiver of firmware/ and its watchdog, on simulated time."""
from __future__ import annotations

import math
from typing import Any

from mecarover_fakes.receiver import Arrival
from mecarover_fakes.receiver import Receiver
from msg_defs.mcu_report import McuReport
from msg_defs.mcu_report import RUNNING
from msg_defs.mcu_report import STOPPED
from msg_defs.mcu_report import WAITING
from msg_defs.nanoseconds import NS_PER_MS
from msg_defs.vel2d import decode
from msg_defs.vel2d import FRAME_SIZE
from msg_defs.vel2d import STOP
from msg_defs.vel2d import Vel2d

WATCHDOG_MS = 300
LARGEST = 1e6
_REPORT = 1_000_000_000


class GuardedReceiver(Receiver):
    """As vel2d_receiver.c: it realigns, follows the newest frame, and stops without frames."""

    def __init__(self, *arguments: Any, **options: Any) -> None:
        super().__init__(*arguments, **options)
        self.state = WAITING
        self._is_damaged = False       # since the last good frame or idle line
        self._good_at = 0
        self._reported = ('', -_REPORT)

    def overrun(self) -> None:
        """Drop what is in the buffer, and listen again."""
        super().overrun()
        self._deaf = False

    def text_to_host(self, now: int) -> str:
        """Return its report to the host, once a second and when its state changes."""
        state, stamp = self._reported
        if state == self.state and now - stamp < _REPORT:
            return ''
        self._reported = self.state, now
        totals = self.totals
        report = McuReport(state=self.state, good=totals.frames, bad=totals.crc_err,
                           refused=totals.refused, stops=totals.stops)
        return f'{report.line()}\r\n'

    def _call_back(self, stamp: int) -> None:
        frame, self._buffer = self._buffer, b''
        velocity = decode(frame, self._crc)
        if velocity is None:
            if len(frame) == FRAME_SIZE:
                self._buffer = frame[1:]            # a frame may begin at any of its bytes
            self.totals.crc_err += not self._is_damaged
        self._is_damaged = bool(self._buffer)
        if velocity is not None and not all(
                math.isfinite(one) and abs(one) <= LARGEST for one in velocity):
            self.totals.refused += 1
        elif velocity is not None:
            self.totals.frames += 1
            self.arrivals.append(Arrival(stamp, FRAME_SIZE, velocity))
            self._good.append((stamp, velocity))

    def _put(self, stamp: int, velocity: Vel2d) -> None:
        self._queue.clear()
        super()._put(stamp, velocity)
        self._good_at = stamp
        self.state = RUNNING

    def _next(self, now: int) -> Vel2d | None:
        if self.state == RUNNING and now // NS_PER_MS - self._good_at // NS_PER_MS >= WATCHDOG_MS:
            self.state = STOPPED
            self.totals.stops += 1
        return STOP if self.state == STOPPED else super()._next(now)
