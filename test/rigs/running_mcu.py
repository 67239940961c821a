# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""A fake MCU in a thread, for tests and rigs."""

from __future__ import annotations

from contextlib import contextmanager
import threading

from mecarover_fakes.fake_mcu import FakeMcu

PUMP_S = 0.01


class RunningMcu(FakeMcu):
    """A fake MCU that keeps every set-point it takes; `running` pumps it in a thread."""

    def __init__(self, *arguments, **options):
        super().__init__(*arguments, **options)
        self.set_points = []
        self._lock = threading.RLock()               # the thread pumps, the test unplugs

    def pump(self, timeout_s):
        with self._lock:
            taken = super().pump(timeout_s)
        self.set_points += taken
        return taken

    def send_text(self, text):
        with self._lock:
            super().send_text(text)

    def vanish(self):
        with self._lock:
            super().vanish()

    def come_back(self):
        with self._lock:
            super().come_back()

    @contextmanager
    def running(self):
        """Pump in a thread; leaving ends it and closes the pty."""
        done = threading.Event()

        def loop():
            while not done.is_set():
                self.pump(PUMP_S)

        thread = threading.Thread(target=loop, name='fake_mcu')
        thread.start()
        try:
            yield self
        finally:
            done.set()
            thread.join()
            self.close()
