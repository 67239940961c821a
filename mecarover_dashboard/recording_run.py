# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""
A recording as a source of the page: played as fast as it was made, stopped, heard from elsewhere.

A thread hears all of it first, as dxl_doctor does: for its length, what was found when, and the
conclusion.
"""
from __future__ import annotations

import argparse
from collections.abc import Callable
from collections.abc import Iterator
import threading
import time
from typing import Any

from mecarover_dashboard.local_monitor import LocalMonitor
from mecarover_dashboard.source_run import SourceRun
from mecarover_dashboard.source_run import TURN_S
from msg_defs.diagnostics import Level
from msg_defs.nanoseconds import NS_PER_S
from servobus.examination import Examination
from servobus.examination import LONGEST_PAUSE_NS
from servobus.examination import REPORT_NS
from servobus.sources import silence_reasons
from servobus.sources.opening import open_file
from servobus.sources.source import File
from servobus.tools.doctor.verdict import make_verdict
from servobus.tools.doctor.verdict import Verdict

END = 1 << 64                       # a stamp after all others
_MOST_EVENTS = 200


class RecordingRun(SourceRun):
    """
    Plays until Ctrl-C; at_once: all is heard at the first turn.

    | attributes | who writes them |
    |---|---|
    | _wanted_s, _is_on | control(), from any thread; the thread that plays |
    | _survey, events, length_s | _examine_all(), in its thread |
    | all others | the thread that plays |
    """

    def __init__(self, tool: str, options: argparse.Namespace, monitor: LocalMonitor,
                 at_once: bool) -> None:
        super().__init__(tool, options, options.source[0], monitor)
        self._at_once = at_once
        self._is_on = True
        self._wanted_s: float | None = None
        self.restart: Callable[[], object] = lambda: None      # for the page, before going back
        self._survey: Examination | None = None
        self.events: list[tuple[float, int, str]] = []         # s, level, text
        self.length_s = 0.0
        self._begin()
        monitor.begin = self._first = self._now
        self.is_timed = self._file.is_timed

    def start(self) -> None:
        if not self._at_once:
            threading.Thread(target=self._examine_all, daemon=True).start()

    def _open(self) -> File:
        return open_file(self.words, self._options.baud, self._options.adapter, tool=self._tool)

    def _examine_all(self) -> None:
        heard = Examination(self._models, self._options.devices, self._options.protocol)
        source = self._open()
        for chunk in source.chunks():
            heard.feed_from(source, chunk)
        source.close()
        heard.finish_source(source, is_over=True)
        found = [(round(one.first_s, 1), int(one.finding.level),
                  f'{bus.who(one.finding.device)}: {one.finding.message}')
                 for bus in heard.buses(self.is_timed) for one in bus.logged
                 if one.finding.level > Level.OK]
        self.events = sorted(found)[:_MOST_EVENTS]
        self.length_s = heard.seconds
        self._survey = heard

    def control(self, at_s: float | None, is_on: bool | None) -> None:
        """Go to a time (s from the first byte), play or stop; from any thread."""
        self._is_on = self._is_on if is_on is None else is_on
        self._wanted_s = self._wanted_s if at_s is None else at_s

    def state(self) -> dict[str, Any]:
        """Return where it is, for the page."""
        return {'at': round((self._now - self._first) / NS_PER_S, 1),
                'length': round(self.length_s, 1), 'on': self._is_on, 'events': len(self.events)}

    def _begin(self) -> None:
        """Go to the first byte."""
        self._file = self._open()
        self._chunks = filter(None, self._file.chunks())
        self._next = next(self._chunks, None)
        self._now = self._judged_until = self._next.stamp if self._next else 0

    def _stamps(self) -> Iterator[int]:
        last_s = time.monotonic()
        while True:
            now_s = time.monotonic()
            wanted_s, self._wanted_s = self._wanted_s, None
            if wanted_s is not None:
                self._go(self._first + int(wanted_s * NS_PER_S))
                now_s = time.monotonic()            # that took some time
            elif self._is_on:
                self._forward(END if self._at_once
                              else self._now + int((now_s - last_s) * NS_PER_S))
            last_s = now_s
            yield self._now
            time.sleep(TURN_S)

    def _go(self, stamp: int) -> None:
        """Hear what is missing up to a stamp: to go back, all from the first byte."""
        if stamp < self._now:
            self.restart()
            self._file.close()
            self._heard.clear()
            self._monitor.clear()
            self._begin()
        self._forward(stamp)

    def _forward(self, until: int) -> None:
        """Hear what there is up to a stamp, and report on it as often as dxl_doctor does."""
        while self._next is not None and self._next.stamp <= until:
            chunk = self._next
            if chunk.stamp - self._judged_until > LONGEST_PAUSE_NS:
                self._judged_until = chunk.stamp
            while chunk.stamp - self._judged_until >= REPORT_NS:
                self._judged_until += REPORT_NS
                self._monitor.judge_buses(self._judged_until)
            self._feed_bus(chunk, self._file.wire(chunk.bus))
            self._now = chunk.stamp
            self._next = next(self._chunks, None)
            if self._next is None:
                self._is_on = False
                for bus in self._heard.values():
                    bus.monitor.end(self._now)
        if self._next is not None:
            self._now = until

    def end(self) -> Verdict:
        self._file.close()
        heard = self._survey
        if heard is None or not heard.bytes:
            return self._verdict(lambda: silence_reasons.of_file(self.words))
        return make_verdict(self.words, heard.buses(self.is_timed), heard.seconds, self.is_timed)
