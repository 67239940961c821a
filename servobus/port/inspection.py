# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""
What disturbs a port although it is open, while a node runs: a login, a console, another program.

A login may be started long after the port was opened, and it opens the port past its lock.
"""
from __future__ import annotations

from collections.abc import Sequence
import threading

from servobus.port import preflight
from servobus.port.port_error import Reason
from servobus.port.port_watch import PortWatch
from servobus.worker import Worker

INSPECT_EVERY_S = 30.0      # a look takes 20 ms of CPU where 100 processes run
INSPECT_APART_S = 1.0       # at least, where a program opens the port again and again
INSPECT_AFTER_CHANGE_S = 2.0       # once more: a process that ends has its terminal longer


class Inspection:
    """
    Looks at a port at each opening, when another program opens or closes it, and each 30 s.

    `ours` are programs that may have it open. complaints: what was found last, 'port: reason;
    remedy'. It looks at every process of the system, so it does that in a thread, which says
    nothing: it may outlive ROS.
    """

    def __init__(self, port: str, ours: Sequence[str]) -> None:
        self.complaints: list[str] = []
        self._port = port
        self._ours = ours
        self._opening = 0
        self._looked_s = self._due_s = 0.0
        self._watch = PortWatch()
        self._was_opened = False
        self._worker = Worker('inspection')
        self._worker.start()
        self._looked = threading.Event()            # the last look is over
        self._looked.set()

    def inspect_if_due(self, opening: int, now_s: float) -> None:
        """Look if it is time; opening: its number, now_s: monotonic."""
        if opening != self._opening:
            self._watch.begin(self._port)
        self._watch.read()
        due_s = self._looked_s + INSPECT_APART_S if self._watch.has_changed else self._due_s
        if (opening == self._opening and now_s < due_s) or not self._looked.is_set():
            return
        self._looked_s = now_s
        self._due_s = now_s + (
            INSPECT_AFTER_CHANGE_S if self._watch.has_changed else INSPECT_EVERY_S)
        self._opening, self._was_opened = opening, self._watch.was_opened
        self._watch.clear()
        self._looked = self._worker.call(self._inspect)

    def _inspect(self) -> None:
        found = preflight.warnings(self._port, ours=self._ours) or self._of_unknown()
        self.complaints = [f'{self._port}: {one.reason}; {one.remedy}' for one in found]

    def _of_unknown(self) -> list[Reason]:
        """Say that somebody opened it: another user's process, or one that has closed it again."""
        if self._watch.is_open:
            return [Reason('busy', 'another program has it open too',
                           f'sudo fuser -v {self._port} names it; stop that program')]
        if self._was_opened:
            return [Reason('busy', 'another program opened it for a moment', 'it may have sent '
                           'bytes; find it (a script, stty, ModemManager) and stop it')]
        return []
