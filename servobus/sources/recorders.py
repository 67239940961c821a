# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""What a node records: a capture of all the time, a flight recorder, both, or nothing."""
from __future__ import annotations

from collections.abc import Iterator

from msg_defs.diagnostics import Pairs
from msg_defs.event import Chunk
from servobus.sources.capture import Wire
from servobus.sources.capture_recorder import Recorder
from servobus.sources.flight_recorder import FlightRecorder


class Recorders:
    """Those that are not None. record_chunk may be called from any thread."""

    def __init__(self, capture: Recorder | None, flight: FlightRecorder | None) -> None:
        self.flight = flight
        both = {'Capture': capture, 'Flight recorder': flight}
        self._all = {name: one for name, one in both.items() if one is not None}
        self._last_news: dict[str, str] = {}

    def __bool__(self) -> bool:
        return bool(self._all)

    @property
    def problem(self) -> str:
        return '; '.join(one.problem for one in self._all.values() if one.problem)

    def values(self) -> Pairs:
        """Return what each does, for a status."""
        return [(name, one.words) for name, one in self._all.items()]

    def record_chunk(self, wire: Wire, chunk: Chunk) -> None:
        for one in self._all.values():
            one.record_chunk(wire, chunk)

    def save(self) -> tuple[bool, str]:
        """Have the flight recorder write; return whether it does, and its file or why not."""
        if self.flight is None:
            return False, 'the flight recorder is off; set flight_recorder to a folder'
        return bool(path := self.flight.save('asked')), path or self.flight.problem

    def start(self) -> None:
        for one in self._all.values():
            one.start()

    def stop(self) -> None:
        for one in self._all.values():
            one.stop()

    def news(self) -> Iterator[tuple[str, bool]]:
        """Yield what is new since the last call, and whether it is a problem."""
        for name, one in self._all.items():
            if one.words != self._last_news.get(name):
                self._last_news[name] = one.words
                yield one.words, bool(one.problem)
