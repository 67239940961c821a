# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""A port as a source of a tool: its own adapter, or that of another program (usb:, tap:)."""

from __future__ import annotations

from collections.abc import Sequence
import queue
import sys
import time

from msg_defs.event import Chunk
from servobus.port.port_users import holders
from servobus.port.port_users import is_terminal
from servobus.port.preflight import busy
from servobus.sources.capture import Wire
from servobus.sources.capture_recorder import read_clocks
from servobus.sources.listener import in_use
from servobus.sources.listener import STARTING
from servobus.sources.listeners import listener_on
from servobus.sources.source import Chunks
from servobus.sources.source import keeps_rate
from servobus.sources.source import Source
from servobus.sources.source_name import bus_name
from servobus.sources.source_name import has_sides
from servobus.sources.source_name import rate_of

TICK_S = 0.1
QUEUED_CHUNKS_MAX = 100_000        # chunks that wait because our output is not taken


def _refuse_shared(name: str) -> None:
    """Raise PortError for a port that a program reads: each would take bytes from the other."""
    if is_terminal(name) and any(not (one.is_login or one.is_maker) for one in holders(name)):
        raise in_use(name, busy(name))


class LivePort(Source):
    """A live source, listened to by a thread, so that a slow terminal loses nothing."""

    is_live = True

    def __init__(self, name: str, baud: int | None, tool: str) -> None:
        super().__init__()
        self.began = read_clocks()
        _refuse_shared(name)
        self._tool = tool                              # who says what happens to the port
        self._bus = bus_name(name)
        self._overrides = baud is not None             # what the source says of the rate
        baud = rate_of(name, baud)
        self._queue: queue.SimpleQueue[Chunk] = queue.SimpleQueue()
        self._lost = 0
        self._listener = listener_on(name, baud, self._queue_chunks, bus=self._bus)
        self._listener.start()
        while self._listener.state.kind == STARTING:
            time.sleep(0.005)
        if not self._listener.state.is_open:
            words = self._listener.state.text
            self._listener.stop()
            raise ConnectionError(words)
        if has_sides(name) and sys.stderr.isatty():    # what is heard, or waited for
            print(f'{tool}: {self._listener.state.text}', file=sys.stderr)
        self.wires[self._bus] = Wire(self._bus, baud, self._listener.latency_timer_ms or 0, name)

    def _queue_chunks(self, chunks: Sequence[Chunk]) -> None:
        for chunk in chunks:
            if chunk.data and self._queue.qsize() > QUEUED_CHUNKS_MAX:
                self._lost += len(chunk.data)
            elif not self._overrides or keeps_rate(chunk):
                self._queue.put(chunk)

    def chunks(self) -> Chunks:
        while True:
            yield self._next()

    def _next(self) -> Chunk | None:
        try:
            return self._queue.get(timeout=TICK_S)
        except queue.Empty:
            if news := self._listener.news():
                print(f'{self._tool}: {news}', file=sys.stderr)
            return None

    def problems(self) -> list[str]:
        errors = self._listener.line_errors
        lost = errors.buf_overrun + errors.overrun if errors is not None else 0
        return [text for count, text in (
            (self._lost, f'{self._lost} bytes are not shown: the output was too slow'),
            (lost, f'the driver lost bytes {lost} times (overrun)')) if count] \
            + self._listener.problems()

    def close(self) -> None:
        self._listener.stop()
