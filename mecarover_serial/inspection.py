# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""
What disturbs a port although it is open, while a node runs: a login, a console, another program.

A login may be started long after the port was opened, and it opens the port past its lock.
"""
from __future__ import annotations

from collections.abc import Sequence
import threading

from mecarover_serial import preflight
from mecarover_serial.worker import Worker

EVERY_S = 30.0              # a look takes 20 ms of CPU where 100 processes run


class Inspection:
    """
    Looks at a port at each opening and every EVERY_S; `ours` are programs that may have it open.

    complaints: what was found last, 'port: reason; remedy'. It looks at every process of the
    system, so it does that in a thread, which says nothing: it may outlive ROS.
    """

    def __init__(self, port: str, ours: Sequence[str]) -> None:
        self.complaints: list[str] = []
        self._port = port
        self._ours = ours
        self._opening = 0
        self._due_s = 0.0
        self._worker = Worker('inspection')
        self._worker.start()
        self._looked = threading.Event()            # the last look is over
        self._looked.set()

    def look(self, opening: int, now_s: float) -> None:
        """Look if it is time; opening: its number, now_s: monotonic."""
        if (opening == self._opening and now_s < self._due_s) or not self._looked.is_set():
            return
        self._opening, self._due_s = opening, now_s + EVERY_S
        self._looked = self._worker.call(self._inspect)

    def _inspect(self) -> None:
        self.complaints = [f'{self._port}: {found.reason}; {found.remedy}'
                           for found in preflight.warnings(self._port, ours=self._ours)]
