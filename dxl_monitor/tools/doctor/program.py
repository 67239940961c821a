# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""
A program and what its pyserial ports say, as a source: dxl_doctor run -- COMMAND.

It goes on as without us: its input and output are ours, signals are handed on. It runs where
there is no fcntl, termios or pty, too.
"""

from __future__ import annotations

from collections.abc import Iterator
from collections.abc import Sequence
import ntpath
import secrets
import subprocess
import time

from dxl_monitor.port.tap_reader import TapReader
from dxl_monitor.port.tap_reader import TapRecord
from dxl_monitor.port.tap_sender import OPENED
from dxl_monitor.record.capture import Chunk
from dxl_monitor.record.capture import Wire
from dxl_monitor.tools.tap import environment
from dxl_monitor.tools.tap import hand_signals_on
from dxl_monitor.tools.tap import remedy

TICK_S = 0.1
REST_S = 1.0                       # for what the program said last


class Program:
    """A running program; OSError when it cannot be started. code: its exit code at the end."""

    is_live = True
    is_timed = True

    def __init__(self, command: Sequence[str]) -> None:
        name = f'doctor-{secrets.token_hex(4)}'
        self.code = 0
        self.ports: list[str] = []
        self._reader = TapReader(name)
        try:
            self._child = subprocess.Popen(command, env=environment(name))
        except OSError as error:
            self._reader.close()
            raise OSError(error.errno, f'{error.strerror}; {remedy(command)}',
                          command[0]) from error
        hand_signals_on(self._child)

    def chunks(self) -> Iterator[Chunk | None]:
        """Yield what it reads and writes, until it ends; None when nothing came for a moment."""
        while self._child.poll() is None:
            yield from self._some(self._reader.wait(TICK_S))
        until_s = time.monotonic() + REST_S
        while self._reader.programs and time.monotonic() < until_s:
            yield from self._some(self._reader.wait(TICK_S))
        yield from self._some(self._reader.rest())

    def _some(self, records: list[TapRecord]) -> Iterator[Chunk | None]:
        for record in records:
            chunk = self._chunk(record)
            if chunk is not None:
                yield chunk
        if not records:
            yield None

    def _chunk(self, record: TapRecord) -> Chunk | None:
        if record.kind == OPENED and record.port not in self.ports:
            self.ports.append(record.port)
        bus = ntpath.basename(record.port)           # works for both kinds of path
        if record.side:
            return Chunk(record.stamp, bus, record.data, record.side)
        if record.change is None or not bus:
            return None
        return Chunk(record.stamp, bus, change=record.change)

    def wire(self, bus: str) -> Wire:
        """Return what is known of a bus: its rate comes with its opening."""
        return Wire(bus, 0)

    def problems(self) -> list[str]:
        """Return what a person should know at the end."""
        return []

    def close(self) -> None:
        """Wait for the program, and stop to listen."""
        code = self._child.wait()
        self.code = 128 - code if code < 0 else code
        self._reader.close()
