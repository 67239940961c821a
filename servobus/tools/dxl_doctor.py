# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""dxl_doctor: the one-minute answer. It listens to a bus, and says on one screen what is wrong."""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from contextlib import closing
import json
import os
import shlex
import shutil
import sys
import time
from typing import Any

from servobus.bus.decoder import DEFAULTS
from servobus.bus.decoder import PROTOCOLS
from servobus.doctor.finding_log import BusSummary
from servobus.errors import ParameterError
from servobus.errors import UsageError
from servobus.examination import ARRIVAL_NS
from servobus.examination import Examination
from servobus.examination import SILENCE_S
from servobus.examination import TRAFFIC_S
from servobus.model.models import Models
from servobus.plain import on_screen
from servobus.plain import plain
from servobus.plain import printable
from servobus.sources.capture import Wire
from servobus.sources.flight_recorder import FlightRecorder
from servobus.sources.opening import open_source
from servobus.sources.source import Source
from servobus.sources.source_name import DEFAULT_BAUD
from servobus.tools.cli import DONE
from servobus.tools.cli import run_tool
from servobus.tools.command_line import number
from servobus.tools.command_line import Parser
from servobus.tools.doctor import explain
from servobus.tools.doctor import machine
from servobus.tools.doctor import no_data
from servobus.tools.doctor import report_file
from servobus.tools.doctor.answer_screen import HEIGHT
from servobus.tools.doctor.answer_screen import screen
from servobus.tools.doctor.answer_screen import WIDTH
from servobus.tools.doctor.error_window import ErrorWindow
from servobus.tools.doctor.issue_report import anonymous
from servobus.tools.doctor.issue_report import check_report
from servobus.tools.doctor.issue_report import Maker
from servobus.tools.doctor.issue_report import new_names
from servobus.tools.doctor.issue_report import NOTHING
from servobus.tools.doctor.issue_report import report
from servobus.tools.doctor.program import Program
from servobus.tools.doctor.report_file import SavedReport
from servobus.tools.doctor.verdict import as_json
from servobus.tools.doctor.verdict import Verdict
from servobus.tools.doctor.verdict import verdict
from servobus.tools.dump.screen import has_colours
from servobus.tools.run import add_bus_options
from servobus.tools.run import models_of
from servobus.tools.run import parse_run
from servobus.tools.run import RUN

PROGRESS_S = 1.0
FLIGHT_SIZE = 1_000_000_000        # bytes of the folder
EXAMPLES = """examples:
  dxl_doctor run -- python my_script.py         a Python program, or any other (Linux: strace)
  dxl_doctor usb:/dev/ttyUSB0                   a program that runs already (Linux, root)
  dxl_doctor /dev/ttyUSB1 -b 1000000            a second adapter on the wire
  dxl_doctor bus.txt                            a recording of dxl_dump -w bus.txt
  dxl_doctor --report bus_report.txt run -- python my_script.py
  dxl_doctor --explain "There is no status packet!"
exit codes: 0 no problem, 1 could not run or nothing heard, 2 usage, 3 warning, 4 error"""


def main() -> int:
    """Run the command `dxl_doctor`."""
    return run_tool('dxl_doctor', _run)


def _run(arguments: list[str]) -> int:
    options, command = parse_run(_parser(), arguments)
    if options.explain is not None:
        return _explain(options.explain)
    _check(options)
    models = models_of(options)
    is_file = not command and os.path.isfile(options.source)
    stored = report_file.load(options.source) if is_file else None
    if stored is not None:
        return _retell(stored, models, options)
    check_report(options.report)
    flight = _flight(options, is_file)
    window = ErrorWindow()
    examination = Examination(models, options.devices, options.protocol,
                              [window] if flight is None else [window, flight])
    with closing(_open(options, command)) as source:
        try:
            seconds = _listen(source, examination, options.seconds)
        finally:
            if flight is not None:
                flight.stop()
        said = _answer(source, examination, seconds, options, command)
        if options.report:
            _write_report(source, examination, seconds, options, command, window)
        for problem in [*source.problems(), *([flight.words] if flight is not None else [])]:
            print(f'dxl_doctor: {printable(problem)}', file=sys.stderr)
    return said.code


def _answer(source: Source, examination: Examination, seconds: float,
            options: argparse.Namespace, command: Sequence[str]) -> Verdict:
    """Print what was found; a program may go on."""
    buses = examination.buses(source.is_timed)
    why = [] if examination.bytes else _why_quiet(options.source, source, command)
    if isinstance(source, Program):
        ending = source.ending
        said = verdict(shlex.join(command), buses, seconds, source.is_timed, why, source.ports,
                       ending.trouble(), ending.doubts())
        more = {'program': {'exit': ending.code, 'error': ending.error}}
    else:
        said = verdict(options.source, buses, seconds, source.is_timed, why)
        more = {}
    _show(said, as_json(said, buses, seconds) | more, options)
    return said


def _explain(pasted: str) -> int:
    """Say what an error text means; return the exit code."""
    found = explain.find(pasted)
    if found:
        print('\n'.join(explain.lines(found)))
        return DONE
    near = explain.nearest(pasted)
    raise OSError(f'{pasted}: not a known error text; ' + (
        f'did you mean "{near}"?' if near else 'paste the line as the program printed it'))


def _check(options: argparse.Namespace) -> None:
    if options.source is None:
        raise UsageError('SOURCE: none given; name a port, a file, or write dxl_doctor run -- '
                         'python my_script.py')


def _flight(options: argparse.Namespace, is_file: bool) -> FlightRecorder | None:
    if not options.flight_recorder:
        return None
    if is_file:
        raise UsageError(f'--flight-recorder: {options.source} is a recording already; leave it '
                         'out')
    try:
        return FlightRecorder(options.flight_recorder, FLIGHT_SIZE, 1)
    except ParameterError as error:
        raise UsageError(f'--{error}'.replace('_', '-', 1)) from error


def _open(options: argparse.Namespace, command: Sequence[str]) -> Source:
    if not command:
        return open_source('dxl_doctor', options.source, options.baud, options.adapter)
    return Program(command, options.by, sys.stderr.fileno() if options.json else None)


def _listen(source: Source, examination: Examination, limit_s: float | None) -> float:
    """Listen until there is enough; return for how long (s): of the file, or by the clock."""
    began_s = time.monotonic()
    is_over = True
    with _Progress() as progress:
        try:
            for chunk in source.chunks():
                if chunk is not None:
                    examination.take(chunk, source.wire(chunk.bus))
                elif source.is_live:
                    examination.pass_time(time.monotonic_ns() - ARRIVAL_NS)
                now_s = time.monotonic() - began_s
                if _has_enough(source, examination, now_s, limit_s):
                    is_over = False
                    break
                progress.show(examination, now_s)
        except KeyboardInterrupt:
            is_over = not source.is_live
    failed, users = '', {}
    if isinstance(source, Program):
        is_over, users = True, source.users
        if not source.ending.users:            # else they may have read what is missing
            failed = source.ending.failed
    ended = source.ended if is_over else 0
    if ended > examination.last:               # a recording that went on in silence
        examination.pass_time(ended)
        examination.finish(ended, is_over=False)
    else:
        goes_on = not is_over or (isinstance(source, Program) and not source.ending.is_over)
        examination.finish(time.monotonic_ns() if goes_on else examination.last, is_over, failed,
                           users)
    return time.monotonic() - began_s if source.is_live else examination.seconds


def _has_enough(source: Source, examination: Examination, now_s: float,
                limit_s: float | None) -> bool:
    """Tell whether to end; now_s: since the start."""
    if not source.is_live:
        return limit_s is not None and examination.seconds >= limit_s
    if limit_s is not None:
        return now_s >= limit_s
    if isinstance(source, Program):
        return False
    if not examination.first:
        return now_s >= SILENCE_S
    now = time.monotonic_ns()
    return now - examination.first >= TRAFFIC_S * 1e9 or now - examination.last >= SILENCE_S * 1e9


class _Progress:
    """What is heard meanwhile, in one line in place, and the first finding; on a terminal."""

    def __init__(self) -> None:
        self._is_shown = sys.stderr.isatty()
        self._next_s = PROGRESS_S
        self._is_well = True

    def show(self, examination: Examination, now_s: float) -> None:
        if not self._is_shown:
            return
        worst = examination.worst() if self._is_well else ''
        if worst:
            self._is_well = False
            on_screen(sys.stderr, f'\r\033[Kdxl_doctor: {plain(worst)}\r\n')
        if now_s >= self._next_s:
            self._next_s = now_s + PROGRESS_S
            text = plain(f'dxl_doctor, {now_s:.0f} s, Ctrl-C ends: {examination.summary()}')
            on_screen(sys.stderr, f'\r{text[:78]}\033[K\r')       # a program may print there too

    def __enter__(self) -> _Progress:
        return self

    def __exit__(self, *_: object) -> None:
        if self._is_shown:
            on_screen(sys.stderr, '\r\033[K')


def _why_quiet(name: str, source: Source, command: Sequence[str]) -> list[str]:
    if isinstance(source, Program):
        return no_data.of_program(command, source.ports, source.ending)
    return no_data.reasons(name, source.is_live)


def _show(said: Verdict, for_programs: dict[str, Any], options: argparse.Namespace) -> None:
    if options.json:
        print(json.dumps(for_programs), flush=True)
        return
    if options.source == RUN:
        print()                        # the program may have left a line without an end
    width, height = shutil.get_terminal_size((WIDTH, HEIGHT + 1))
    print('\n'.join(screen(said, has_colours(), width, max(HEIGHT, height - 1))),
          flush=True)


def _write_report(source: Source, examination: Examination, seconds: float,
                  options: argparse.Namespace, command: Sequence[str],
                  window: ErrorWindow) -> None:
    ports = source.ports if isinstance(source, Program) else \
        [port for port in [machine.device(options.source)] if port]
    buses = examination.buses(source.is_timed)
    names = new_names(buses)
    shown = anonymous(buses)
    said = verdict(machine.plain_name(options.source, bool(command)), shown, seconds,
                   source.is_timed, [] if examination.bytes else [NOTHING])
    maker = Maker(machine.system(), machine.adapters(ports, options.with_host),
                  machine.host(options.source, command) if options.with_host else (),
                  options.devices, options.protocol)
    text = report(said, shown, seconds, maker, window.capture(names))
    with open(options.report, 'w', encoding='utf-8') as file:
        file.write(text)
    print(f'dxl_doctor: the report is in {printable(options.report)}', file=sys.stderr)


def _retell(stored: SavedReport, models: Models, options: argparse.Namespace) -> int:
    """Show a report of somebody else, and what its capture says now."""
    if options.report:
        raise UsageError(f'--report: {options.source} is a report already; attach that')
    protocol = stored.protocol if stored.protocol in PROTOCOLS else DEFAULTS.protocol
    examination = Examination(models, stored.devices, protocol)
    for chunk in stored.chunks:
        examination.take(chunk, stored.wires.get(chunk.bus) or Wire(chunk.bus, DEFAULT_BAUD))
    examination.finish(examination.last, is_over=True)
    buses, seconds = examination.buses(is_timed=True), examination.seconds
    now = verdict('the capture of a report', buses, seconds, is_timed=True,
                  quiet=[] if examination.bytes else [NOTHING])
    said = stored.said or now
    _show(said, stored.as_json or as_json(now, buses, seconds), options)
    for problem in (*stored.problems, *_difference(stored, buses)):
        print(f'dxl_doctor: {problem}', file=sys.stderr)
    return said.code


def _difference(then: SavedReport, now: Sequence[BusSummary]) -> list[str]:
    """Say what the capture of a report shows that the report does not."""
    if then.logged is None:
        return []
    return [f"read by this version, its capture also shows {one.finding.rule.replace('_', ' ')} "
            f'of {bus.who(one.finding.device)}' for bus in now for one in bus.logged
            if (bus.report.name, one.finding.rule, str(one.finding.device)) not in then.logged]


def _parser() -> Parser:
    parser = Parser(
        'dxl_doctor', epilog=EXAMPLES,
        usage='dxl_doctor [options] SOURCE\n       dxl_doctor [options] run -- COMMAND',
        description='Listens to a servo bus and says what is wrong with it. It never sends. '
        'It ends after 10 s of traffic, 5 s of silence, or with COMMAND.')
    add = parser.add_argument
    add('source', metavar='SOURCE', nargs='?',
        help='a port, usb:PORT, tap:NAME, a recording; or run, with a command after --')
    add_bus_options(parser)
    add('--seconds', type=number(float, 0.1), metavar='S', help='listen for S seconds')
    add('--flight-recorder', metavar='DIR',
        help='folder for recordings of faults: 60 s before each new finding and 30 s after it')
    add('--report', metavar='FILE', help='write a report to attach to an issue')
    add('--with-host', action='store_true',
        help='put host, user, serial number and command line into it')
    add('--explain', metavar='TEXT', help='explain an error text and exit')
    add('--json', action='store_true', help='print one JSON object, for programs')
    return parser


if __name__ == '__main__':
    sys.exit(main())
