# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""
Calls that come again and again, in a thread of their own.

An executor of rclpy makes a new wait set of all that a node has each time one of its timers is
due, which takes more CPU than most of these calls.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
import threading
import time

STOP_WAIT_S = 1.0                # for how long a call that has begun is waited for


@dataclass
class Timer:
    """A call and how often it comes; the call may change `period_s`, from its end on."""

    period_s: float
    call: Callable[[], object]
    due: float                         # monotonic s


class Timers:
    """Some timers and their thread; all calls come from that."""

    def __init__(self) -> None:
        self._timers: list[Timer] = []
        self._stopping = threading.Event()
        self._turning = threading.Lock()
        self._mistake: Exception | None = None
        self._thread = threading.Thread(target=self._run, name='timers', daemon=True)

    def add(self, period_s: float, call: Callable[[], object]) -> Timer:
        """Have something called each period, from one period after now on; before the start."""
        timer = Timer(period_s, call, time.monotonic() + period_s)
        self._timers.append(timer)
        return timer

    def start(self) -> None:
        """Begin to call."""
        self._thread.start()

    def stop(self) -> None:
        """Call no more; a call that has begun has ended when this returns, or hangs."""
        self._stopping.set()
        if self._thread.is_alive() and threading.current_thread() is not self._thread:
            self._thread.join(STOP_WAIT_S)

    def check(self) -> None:
        """Raise what a call raised; wait for one that goes on, so that a watchdog sees it hang."""
        with self._turning:
            mistake, self._mistake = self._mistake, None
        if mistake is not None:
            raise mistake

    def is_alive(self) -> bool:
        """Tell whether the thread is there."""
        return self._thread.is_alive()

    def _run(self) -> None:
        wait_s = 0.0
        while not self._stopping.wait(wait_s):
            with self._turning:
                try:
                    self.call_due(time.monotonic())
                except Exception as mistake:        # for the one who checks
                    self._mistake = mistake
                    if not isinstance(mistake, MemoryError):    # the next call may have some
                        return
            wait_s = max(0.0, min(one.due for one in self._timers) - time.monotonic())

    def call_due(self, now: float) -> None:
        """Make the calls that are due."""
        for timer in self._timers:
            if timer.due <= now and not self._stopping.is_set():
                try:
                    timer.call()
                finally:
                    timer.due += timer.period_s
                    if timer.due <= now:       # those that were missed are not made up for
                        timer.due = now + timer.period_s
