# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""
Sources, from their names on the command line to a conclusion: ports, a recording, a program.

The page and mecarover_status differ only in what they do with the statuses.
"""
from __future__ import annotations

import argparse
from collections.abc import Callable
from collections.abc import Iterator
from collections.abc import Sequence
import shlex
import sys
import time

from mecarover_dashboard.local_monitor import LocalMonitor
from msg_defs.event import Chunk
from msg_defs.nanoseconds import NS_PER_S
from servobus.bus.report import BusReport
from servobus.doctor import OPTIONS
from servobus.model.models import Models
from servobus.monitor import Monitor
from servobus.monitored_bus import MonitoredBus
from servobus.printable_text import printable
from servobus.settings import buses
from servobus.settings import settings_of
from servobus.sources import silence_reasons
from servobus.sources.capture import Wire
from servobus.sources.recorders import Recorders
from servobus.sources.source_name import rate_of
from servobus.sources.tap_reader import HOLD_S
from servobus.status import PortState
from servobus.tools.bus_options import models_of
from servobus.tools.doctor.program_source import Program
from servobus.tools.doctor.program_verdict import program_verdict
from servobus.tools.doctor.verdict import make_verdict
from servobus.tools.doctor.verdict import Verdict

TURN_S = 0.1


class HeardBus:
    """A bus of a program or of a recording: all that came up to a report was handed on."""

    def __init__(self, wire: Wire, models: Models, options: argparse.Namespace) -> None:
        self._port = printable(wire.port or wire.name)
        settings = settings_of(wire.name, wire, options.devices, options.protocol)
        self.monitor = Monitor(printable(wire.name), models, settings, idle_is_told=True,
                               names=OPTIONS)

    def is_late(self, now: int) -> bool:
        return False

    def report(self, now: int) -> BusReport:
        self.monitor.flush_if_idle(now)
        return self.monitor.report(now)

    def port_state(self) -> PortState:
        return PortState(self._port, '', ())


class SourceRun:
    """What all kinds of sources have in common; `words` says what they are."""

    is_timed = True

    def __init__(self, tool: str, options: argparse.Namespace, words: str,
                 monitor: LocalMonitor) -> None:
        self.words = words
        self._tool = tool
        self._options = options
        self._monitor = monitor
        self._models = models_of(options)
        self._began_s = time.monotonic()
        self._heard: dict[str, HeardBus] = {}

    def start(self) -> None:
        """Begin to listen."""

    def play(self, show: Callable[[], bool]) -> None:
        """Hand on what comes until the end, or Ctrl-C, or show() says so, called all the time."""
        try:
            for now in self._stamps():
                self._monitor.turn(now)
                if show():
                    break
        except KeyboardInterrupt:
            pass

    def _stamps(self) -> Iterator[int]:
        """Yield up to when all was handed on, a few times a second."""
        raise NotImplementedError

    def _feed_bus(self, chunk: Chunk, wire: Wire) -> None:
        bus = self._heard.get(chunk.bus)
        if bus is None:
            bus = self._heard[chunk.bus] = HeardBus(wire, self._models, self._options)
            self._monitor.add(bus)
        bus.monitor.feed_chunks([chunk])

    def end(self) -> Verdict:
        """Close the sources; return what dxl_doctor says of the run."""
        raise NotImplementedError

    def _verdict(self, quiet: Callable[[], Sequence[str]]) -> Verdict:
        found = self._monitor.summaries(self.is_timed)
        is_silent = not any(one.report.counters['Bytes'] for one in found)
        return make_verdict(self.words, found, time.monotonic() - self._began_s, self.is_timed,
                       quiet() if is_silent else ())


class PortsRun(SourceRun):
    """Ports of this machine, until Ctrl-C; one that is lost is opened again."""

    def __init__(self, tool: str, options: argparse.Namespace, monitor: LocalMonitor) -> None:
        super().__init__(tool, options, ', '.join(options.source), monitor)
        given = {'ports': options.source, 'devices': options.devices,
                 'protocols': [options.protocol],
                 'bauds': [rate_of(name, options.baud) for name in options.source]}
        self._ports = [MonitoredBus(bus, self._models, Recorders(None, None), names=OPTIONS)
                       for bus in buses(given, self._models)]

    def start(self) -> None:
        for bus in self._ports:
            self._monitor.add(bus)
            bus.listener.start()

    def _stamps(self) -> Iterator[int]:
        while True:
            time.sleep(TURN_S)
            yield time.monotonic_ns()
            for bus in self._ports:
                if news := bus.listener.news():
                    print(f'{self._tool}: {news}', file=sys.stderr)

    def end(self) -> Verdict:
        self._monitor.report(time.monotonic_ns())
        states = [bus.listener.state for bus in self._ports]
        closed = [state.text for state in states if not state.is_open]
        for bus in self._ports:
            bus.listener.stop()
        return self._verdict(
            lambda: closed or silence_reasons.reasons(self._options.source[0], is_live=True))


class ProgramRun(SourceRun):
    """A program that is started, until it ends."""

    def __init__(self, tool: str, command: Sequence[str], options: argparse.Namespace,
                 monitor: LocalMonitor) -> None:
        super().__init__(tool, options, shlex.join(command), monitor)
        self._command = command
        self._known = time.monotonic_ns()

    def start(self) -> None:
        self._program = Program(self._command, self._options.by, tool=self._tool)

    def _stamps(self) -> Iterator[int]:
        for chunk in self._program.chunks():
            if chunk is None:
                self._known = max(self._known, time.monotonic_ns() - int(HOLD_S * NS_PER_S))
            else:
                self._known = max(self._known, chunk.stamp)
                self._feed_bus(chunk, self._program.wire(chunk.bus))
            yield self._known

    def end(self) -> Verdict:
        self._program.close()
        ending = self._program.ending
        for name, bus in self._heard.items():
            bus.monitor.end(self._known, ending.failed_alone,
                            self._program.users.get(name, ()))
        self._monitor.report(self._known)
        return program_verdict(self._program, self._monitor.summaries(self.is_timed),
                               time.monotonic() - self._began_s)
