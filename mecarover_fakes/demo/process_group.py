# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""The processes of the demo: started as a user would, their lines collected, all of them ended."""
from __future__ import annotations

from collections import deque
from collections.abc import Sequence
from contextlib import ExitStack
import os
import subprocess
import sys
import threading
import time

TIMEOUT_S = 5.0


class DemoProcess:
    """One process; what it prints is kept in `lines`, and `exit_code` is None while it runs."""

    def __init__(self, name: str, arguments: Sequence[str]) -> None:
        self.name = name
        self.lines: deque[str] = deque(maxlen=10_000)
        self._arguments = arguments
        self.start()

    def start(self) -> None:
        """Start it, or start it again, as respawn in a launch file does."""
        # A session of its own: Ctrl-C in the terminal is ours to pass on, in the right order.
        self._process = subprocess.Popen(
            self._arguments, stdin=subprocess.DEVNULL, stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT, text=True, errors='replace', start_new_session=True,
            env={**os.environ, 'PYTHONUNBUFFERED': '1'})
        self._reader = threading.Thread(target=self._read, args=(self._process,), daemon=True)
        self._reader.start()

    def _read(self, process: subprocess.Popen[str]) -> None:
        assert process.stdout is not None
        for line in process.stdout:
            self.lines.append(line.rstrip('\n'))

    @property
    def exit_code(self) -> int | None:
        """The exit code, None while it runs."""
        return self._process.poll()

    def kill(self) -> float:
        """Kill it as `kill -9` does; return when (monotonic s)."""
        self._process.kill()
        stamp = time.monotonic()
        self._process.wait()
        return stamp

    def end(self) -> None:
        """
        End it politely; kill it when it does not listen.

        Not with SIGINT: what a script starts in the background inherits that it is ignored.
        """
        self._process.terminate()
        try:
            self._process.wait(TIMEOUT_S)
        except subprocess.TimeoutExpired:
            self.kill()
        self._reader.join(1.0)


class ProcessGroup(ExitStack):
    """All processes of the demo; leaving it ends them in the reverse order of their start."""

    def __init__(self) -> None:
        super().__init__()
        self.processes: list[DemoProcess] = []

    def start(self, module: str, *arguments: str) -> DemoProcess:
        """Start a module of this package with the Python that runs us."""
        package, _, name = module.partition('.')
        process = DemoProcess(name if package == 'mecarover_fakes' else package,
                      [sys.executable, '-m', module, *arguments])
        self.callback(process.end)
        self.processes.append(process)
        return process
