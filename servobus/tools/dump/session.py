# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""
One run of dxl_dump: from the source through a monitor per bus to what was asked for.

Several views may share a run (--json with --summary, -w with --stats). Ctrl-C ends the run as
the end of a file does: what comes at the end still comes.
"""
from __future__ import annotations

import argparse
from collections.abc import Iterator
from contextlib import contextmanager
from contextlib import suppress
from functools import partial
import json
import sys
import time

from msg_defs.event import Chunk
from servobus.bus.report import BusReport
from servobus.bus.report import PROTOCOL_SHOWN_BYTES
from servobus.doctor.case import OPTIONS
from servobus.monitor import Monitor
from servobus.printable_text import printable
from servobus.settings import settings_of
from servobus.sources.opening import open_source
from servobus.sources.silence_reasons import reasons
from servobus.tools.bus_options import models_of
from servobus.tools.cli import print_problems
from servobus.tools.dump.decode import parts_of
from servobus.tools.dump.filter import is_wanted
from servobus.tools.dump.json import json_line
from servobus.tools.dump.listing import Entry
from servobus.tools.dump.listing import Listing
from servobus.tools.dump.packet_lines import Lines
from servobus.tools.dump.recording_writers import open_recording
from servobus.tools.dump.recording_writers import PacketRecording
from servobus.tools.dump.screen import ProgressLine
from servobus.tools.dump.screen import Screen
from servobus.tools.dump.stats import stats
from servobus.tools.dump.stats import summary

PAINT_EVERY_S = 1.0
PROGRESS_EVERY_S = 0.5
SILENCE_S = 5.0                    # without a byte: time to say what may be the reason
PAINT_SHARE = 5                    # at most one part in so many of the time goes into painting


class Session:
    """options: those of main.py, understood."""

    def __init__(self, options: argparse.Namespace) -> None:
        self._options = options
        self._lists = options.json or not (
            options.summary or options.stats or options.write)
        self._models = models_of(options)
        self._source = open_source('dxl_dump', options.source, options.baud,
                                   options.adapter)
        self._recording = open_recording(self._source, options)
        self._packets = self._recording if isinstance(self._recording, PacketRecording) else None
        self._monitors: dict[str, Monitor] = {}
        self._screen = Screen(sys.stdout)
        self._lines = Lines(options.colours, options.time)
        self._shown = 0
        self._bytes = 0
        self._first = self._last = 0           # stamps of chunks; 0: none yet
        self._started_s = self._next_paint_s = time.monotonic()
        self._progress = ProgressLine(PROGRESS_EVERY_S)
        self._progress.is_shown &= not (self._lists and self._screen.is_terminal)
        self._is_silence_printed = False

    def __enter__(self) -> Session:
        return self

    def __exit__(self, kind: object, *_: object) -> None:
        self._source.close()
        if self._recording is not None:
            with suppress(OSError) if kind is not None else self._naming_the_file():
                self._recording.close()

    def run(self) -> None:
        """Run to the end of the source, the limits that were set, or Ctrl-C."""
        try:
            for chunk in self._source.chunks():
                if chunk is not None:
                    self._feed_chunk(chunk)
                if self._is_over():
                    break
                self._paint()
                self._print_silence()
        except KeyboardInterrupt:
            pass
        self._finish()

    def _feed_chunk(self, chunk: Chunk) -> None:
        self._first = self._first or chunk.stamp
        self._last = chunk.stamp
        self._bytes += len(chunk.data)
        monitor = self._monitors.get(chunk.bus) or self._new_monitor(chunk.bus)
        try:
            monitor.feed_chunks([chunk])
        finally:                       # the reader of the list may have left: `| head`
            if self._recording is not None:
                with self._naming_the_file():
                    self._recording.record_chunk(chunk, self._monitors)
        if self._source.is_live and self._lists:
            sys.stdout.flush()

    def _new_monitor(self, bus: str) -> Monitor:
        settings = settings_of(bus, self._source.wire(bus), self._options.devices,
                               self._options.protocol)
        listing = None
        shows = self._lists or self._options.count is not None
        if shows or self._packets is not None:
            listing = Listing(self._models, lambda entry: show(entry), settings,
                              self._source.is_timed, is_plain=not shows)
            show = partial(self._accept_entry, bus, listing)
        self._monitors[bus] = monitor = Monitor(printable(bus), self._models, settings,
                                                decoder=listing, names=OPTIONS)
        return monitor

    def _accept_entry(self, bus: str, listing: Listing, entry: Entry) -> None:
        if self._packets is not None:
            try:                       # no context manager: this is for each packet
                self._packets.record_entry(bus, entry)
            except OSError as error:
                raise self._named(error) from error
        if is_wanted(entry, self._options) and not self._has_enough():
            self._shown += entry.packet is not None
            if self._lists:
                self._show(printable(bus), listing, entry)

    def _show(self, bus: str, listing: Listing, entry: Entry) -> None:
        began = self._source.began
        stamp = entry.stamp - began.stamp + began.wall
        parts = parts_of(entry, listing)
        if not self._options.json:
            self._fit_lines()
            line = self._lines.line(bus, stamp, entry, parts)
        elif entry.packet is not None:
            line = json_line(bus, stamp // 1000, entry.packet, entry, parts)
        sys.stdout.write(line + '\n')

    def _fit_lines(self) -> None:
        """Make lines for the terminal as wide as it is now, and the buses that are known now."""
        is_cut = self._screen.is_terminal and not self._options.full
        self._lines.width = self._screen.width if is_cut else None
        self._lines.show_bus = len(self._source.wires) > 1

    def _has_enough(self) -> bool:
        count: int | None = self._options.count
        return count is not None and self._shown >= count

    def _is_over(self) -> bool:
        limit_s: float | None = self._options.seconds
        if self._has_enough() or limit_s is None:
            return self._has_enough()
        if self._source.is_live:
            return time.monotonic() - self._started_s >= limit_s
        return bool(self._first) and self._last - self._first >= 1e9 * limit_s

    def _print_silence(self) -> None:
        """Say once why nothing is shown: a port that is silent looks like a program that hangs."""
        if self._is_silence_printed or self._bytes or not self._source.is_live \
                or time.monotonic() - self._started_s < SILENCE_S:
            return
        self._is_silence_printed = True
        why = ''.join(f'\n  {reason}' for reason in reasons(self._options.source, is_live=True))
        print(f'dxl_dump: {self._options.source}: no byte in {SILENCE_S:g} s, still listening.'
              f'{why}', file=sys.stderr)

    @contextmanager
    def _naming_the_file(self) -> Iterator[None]:
        try:
            yield
        except OSError as error:
            raise self._named(error) from error

    def _named(self, error: OSError) -> OSError:
        """Give an error of writing the name of the file; a pipe that is closed has none."""
        return error if isinstance(error, BrokenPipeError) else OSError(
            error.errno, f'{error.strerror}; make room, or give another file', self._options.write)

    # --- what is painted on the way, and at the end ----------------------------------------

    def _reports(self, now: int) -> list[BusReport]:
        return [monitor.report(now) for monitor in self._monitors.values()]

    def _paint(self) -> None:
        now_s = time.monotonic()
        if not self._options.stats:
            self._progress.show(now_s - self._started_s, self._how_far)
        elif self._source.is_live and now_s >= self._next_paint_s:
            self._paint_screen(self._reports(time.monotonic_ns()))
            cost_s = time.monotonic() - now_s
            self._next_paint_s = now_s + max(PAINT_EVERY_S, PAINT_SHARE * cost_s)

    def _paint_screen(self, reports: list[BusReport], is_last: bool = False) -> None:
        self._screen.paint(stats(reports, self._screen.width, self._options.colours,
                                 self._source.is_timed), is_last)

    def _how_far(self) -> str:
        total = self._source.total
        if total:
            return f'{100 * self._source.position() // total} % of {total / 1e6:.0f} MB'
        return f'{time.monotonic() - self._started_s:.0f} s, {self._bytes} bytes; Ctrl-C ends'

    def _finish(self) -> None:
        self._progress.clear()
        is_live = self._source.is_live
        now = time.monotonic_ns() if is_live else self._last
        if not is_live:
            for monitor in self._monitors.values():
                monitor.end(now)
        reports = self._reports(now)
        if self._packets is not None:
            with self._naming_the_file():
                self._packets.finish(now, self._monitors)
        if self._options.stats:
            self._paint_screen(reports, is_last=True)
        if self._options.summary:
            print(json.dumps(summary(reports)))
        sys.stdout.flush()
        if self._recording is not None and self._bytes and sys.stderr.isatty():
            print(f'dxl_dump: recorded {self._bytes} bytes of the bus to {self._options.write}',
                  file=sys.stderr)
        print_problems('dxl_dump', [*self._no_packet(reports), *self._source.problems(),
                                    *self._models.problems])

    def _no_packet(self, reports: list[BusReport]) -> list[str]:
        """Ask about bytes without a single packet: of no bus, or heard at another rate."""
        if not self._bytes or any(report.counters['Packets'] for report in reports):
            return []
        question = 'check that it is a recording of a servo bus, made at its baud rate' \
            if self._bytes >= PROTOCOL_SHOWN_BYTES else 'if it is of Protocol 1.0 or Feetech, ' \
            'add --protocol 1 or --protocol feetech'
        if self._source.is_live:
            question = (f'check that it is a servo bus at {reports[0].baud} baud; --baud sets '
                        'another rate') if reports[0].baud else 'check that it is a servo bus'
        return [f'{self._options.source}: {self._bytes} bytes, but no packet; {question}']
