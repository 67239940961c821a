# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""
Worker: a thread that is started once, for calls that may block.

A thread for each call would be one that may not be had: a limit of tasks (ulimit -u, TasksMax=,
--pids-limit) or of memory may be reached while a node runs.
"""
from __future__ import annotations

from collections.abc import Callable
from contextlib import suppress
import queue
import threading

MORE_TASKS = 'raise the limit of tasks (ulimit -u, TasksMax=) or end some'
_Call = tuple[Callable[[], object], threading.Event]


class Worker:
    """Makes calls one after the other; `call` from any thread. It ends with the process."""

    def __init__(self, name: str) -> None:
        self._calls: queue.SimpleQueue[_Call | None] = queue.SimpleQueue()
        self._thread = threading.Thread(target=self._run, name=name, daemon=True)

    def start(self) -> None:
        """Start the thread, if it does not run; RuntimeError where none can be started."""
        if not self._thread.is_alive():
            self._thread.start()

    def call(self, function: Callable[[], object]) -> threading.Event:
        """Have something called; the event is set when it has returned or raised."""
        done = threading.Event()
        self._calls.put((function, done))
        return done

    def stop(self) -> None:
        """End the thread after the calls that wait."""
        self._calls.put(None)

    def _run(self) -> None:
        while (call := self._calls.get()) is not None:
            function, done = call
            with suppress(Exception):       # the caller looks for its result
                function()
            done.set()
            del call, function, done        # a port that was closed is not kept
