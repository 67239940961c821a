# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""dxl_doctor: the one-minute answer. It listens to a bus, and says on one screen what is wrong."""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from contextlib import closing
import json
import os
import shutil
import sys
import time
from typing import Any

from servobus.bus.decoder import DEFAULTS
from servobus.bus.decoder import PROTOCOL_CHOICES
from servobus.doctor.finding_log import BusSummary
from servobus.errors import ParameterError
from servobus.errors import UsageError
from servobus.examination import ENOUGH_TRAFFIC_S
from servobus.examination import Examination
from servobus.examination import GIVE_UP_SILENCE_S
from servobus.model.models import Models
from servobus.port.port_error import PortError
from servobus.printable_text import printable
from servobus.sources import silence_reasons
from servobus.sources.capture import Wire
from servobus.sources.flight_recorder import FlightRecorder
from servobus.sources.opening import open_source
from servobus.sources.source_name import DEFAULT_BAUD
from servobus.tools.bus_options import add_bus_options
from servobus.tools.bus_options import models_of
from servobus.tools.bus_options import parse_run
from servobus.tools.bus_options import RUN
from servobus.tools.cli import DONE
from servobus.tools.cli import exit_code
from servobus.tools.cli import one_line
from servobus.tools.cli import print_problems
from servobus.tools.cli import run_tool
from servobus.tools.command_line import number
from servobus.tools.command_line import Parser
from servobus.tools.doctor import computer_facts
from servobus.tools.doctor import explain
from servobus.tools.doctor.answer_screen import HEIGHT
from servobus.tools.doctor.answer_screen import screen
from servobus.tools.doctor.answer_screen import WIDTH
from servobus.tools.doctor.error_window import ErrorWindow
from servobus.tools.doctor.issue_report import anonymous
from servobus.tools.doctor.issue_report import check_report
from servobus.tools.doctor.issue_report import load_report
from servobus.tools.doctor.issue_report import make_report
from servobus.tools.doctor.issue_report import new_devices
from servobus.tools.doctor.issue_report import new_names
from servobus.tools.doctor.issue_report import NOTHING
from servobus.tools.doctor.issue_report import SavedReport
from servobus.tools.doctor.program_source import Program
from servobus.tools.doctor.program_verdict import program_verdict
from servobus.tools.doctor.verdict import as_json
from servobus.tools.doctor.verdict import make_verdict
from servobus.tools.doctor.verdict import Verdict
from servobus.tools.dump.screen import has_colours
from servobus.tools.dump.screen import ProgressLine

PROGRESS_EVERY_S = 1.0
FLIGHT_FOLDER_BYTES = 1_000_000_000  # bytes of the folder
EXAMPLES = """examples:
  dxl_doctor run -- python my_script.py         a Python program, or any other (Linux: strace)
  dxl_doctor usb:/dev/ttyUSB0                   a program that runs already (Linux, root)
  dxl_doctor /dev/ttyUSB1 -b 1000000            a second adapter on the wire
  dxl_doctor bus.txt                            a recording of dxl_dump -w bus.txt
  dxl_doctor --report bus_report.txt run -- python my_script.py
  dxl_doctor --explain "There is no status packet!"
exit codes: 0 no problem, 1 could not run or nothing heard, 2 usage,
3 warning or not sure, 4 error"""


def main() -> int:
    """Run the command `dxl_doctor`."""
    return run_tool('dxl_doctor', _run)


def _run(arguments: list[str]) -> int:
    options, command = parse_run(_parser(), arguments)
    options.is_answered = False
    try:
        return _answer(options, command)
    except (UsageError, ParameterError, PortError, OSError) as error:
        if options.json and not (options.is_answered or isinstance(error, BrokenPipeError)):
            print(json.dumps({'error': one_line(error), 'exit': exit_code(error)}))
        raise


def _answer(options: argparse.Namespace, command: Sequence[str]) -> int:
    if options.explain is not None:
        return _explain(options.explain)
    if options.source is None:
        raise UsageError('SOURCE: none given; name a port, a file, or write dxl_doctor run -- '
                         'python my_script.py')
    models = models_of(options)
    is_file = not command and os.path.isfile(options.source)
    saved = load_report(options.source) if is_file else None
    if saved is not None:
        return _show_saved(saved, models, options)
    check_report(options.report)
    return _DoctorRun(options, command, models, _flight_recorder(options, is_file)).run()


def _explain(pasted: str) -> int:
    """Say what an error text means; return the exit code."""
    found = explain.find(pasted)
    if found:
        print(explain.in_words(found))
        return DONE
    near = explain.nearest(pasted)
    raise OSError(f'{pasted}: not a known error text; ' + (
        f'did you mean "{near}"?' if near else 'paste the line as the program printed it'))


def _flight_recorder(options: argparse.Namespace, is_file: bool) -> FlightRecorder | None:
    if not options.flight_recorder:
        return None
    if is_file:
        raise UsageError(f'--flight-recorder: {options.source} is a recording already; leave it '
                         'out')
    try:
        return FlightRecorder(options.flight_recorder, FLIGHT_FOLDER_BYTES, 1)
    except ParameterError as error:
        raise UsageError(f'--{error}'.replace('_', '-', 1)) from error


class _DoctorRun:
    """A source that is listened to, and what is said of it at the end."""

    def __init__(self, options: argparse.Namespace, command: Sequence[str], models: Models,
                 flight: FlightRecorder | None) -> None:
        self._options = options
        self._command = command
        self._flight = flight
        self._window = ErrorWindow()
        self._examination = Examination(models, options.devices, options.protocol,
                                        [self._window, *([flight] if flight else [])])
        self._program = Program(command, options.by, sys.stderr.fileno() if options.json else None
                                ) if command else None
        self._progress = ProgressLine(PROGRESS_EVERY_S)
        self._progress.is_shown &= self._program is None       # which may ask for a key there
        self._awaits_finding = self._progress.is_shown or self._program is not None
        self._source = self._program or open_source('dxl_doctor', options.source, options.baud,
                                                    options.adapter)

    def run(self) -> int:
        """Listen, print the answer; return the exit code."""
        with closing(self._source) as source:
            try:
                seconds = self._listen()
            finally:
                if self._flight is not None:
                    self._flight.stop()
            verdict = self._print_verdict(seconds)             # a program may go on
            if self._options.report:
                self._write_report(seconds)
            print_problems('dxl_doctor', [*source.problems(),
                                          *([self._flight.words] if self._flight else [])])
        return verdict.code

    def _listen(self) -> float:
        """Listen until there is enough; return for how long (s): of the file, or by the clock."""
        source, examination = self._source, self._examination
        began_s = time.monotonic()
        is_over = False
        try:
            for chunk in source.chunks():
                examination.feed_from(source, chunk)
                now_s = time.monotonic() - began_s
                if self._has_enough(now_s):
                    break
                self._show_progress(now_s)
            else:
                is_over = True
        except KeyboardInterrupt:
            pass
        finally:
            self._progress.clear()
        self._finish(is_over)
        return time.monotonic() - began_s if source.is_live else examination.seconds

    def _show_progress(self, now_s: float) -> None:
        """Say what is heard meanwhile, and once what is wrong: a program may run for hours."""
        examination = self._examination
        if self._awaits_finding and (worst := examination.worst()):
            self._awaits_finding = False
            self._progress.clear()
            print(f'{self._new_line}dxl_doctor: {worst}', file=sys.stderr, flush=True)
        self._progress.show(
            now_s, lambda: f'dxl_doctor, {now_s:.0f} s, Ctrl-C ends: {examination.summary()}')

    @property
    def _new_line(self) -> str:
        """What ends a line of the program on the screen."""
        return '\n' if self._program is not None and sys.stderr.isatty() else ''

    def _has_enough(self, now_s: float) -> bool:
        """Tell whether to end; now_s: since the start."""
        limit_s, examination = self._options.seconds, self._examination
        if limit_s is not None:
            return bool((now_s if self._source.is_live else examination.seconds) >= limit_s)
        if not self._source.is_live or self._program is not None:
            return False
        if not examination.first:
            return now_s >= GIVE_UP_SILENCE_S
        now = time.monotonic_ns()
        return now - examination.first >= ENOUGH_TRAFFIC_S * 1e9 \
            or now - examination.last >= GIVE_UP_SILENCE_S * 1e9

    def _finish(self, is_over: bool) -> None:
        examination, program = self._examination, self._program
        if program is None:
            examination.finish_source(self._source, is_over)
            return
        ending = program.ending
        examination.finish(examination.last if ending.is_over else time.monotonic_ns(), True,
                           ending.failed_alone, program.users)

    def _print_verdict(self, seconds: float) -> Verdict:
        source, program = self._source, self._program
        buses = self._examination.buses(source.is_timed)
        if program is None:
            name, is_quiet = self._options.source, not self._examination.bytes
            verdict = make_verdict(name, buses, seconds, source.is_timed, silence_reasons.reasons(
                name, source.is_live) if is_quiet else ())
            more = {}
        else:
            verdict = program_verdict(program, buses, seconds)
            more = {'program': {'exit': program.ending.code, 'error': program.ending.error}}
        _print(verdict, as_json(verdict, buses, seconds) | more, self._options)
        return verdict

    def _write_report(self, seconds: float) -> None:
        options, is_timed = self._options, self._source.is_timed
        ports = self._program.ports if self._program is not None else \
            list(filter(None, [computer_facts.port_of(options.source)]))
        buses = self._examination.buses(is_timed)
        shown, names = anonymous(buses), new_names(buses)
        source = computer_facts.plain_name(options.source, bool(self._command))
        verdict = make_verdict(source, shown, seconds, is_timed,
                               [] if self._examination.bytes else [NOTHING])
        about = [*computer_facts.system(), *computer_facts.adapters(ports, options.with_host)]
        if self._program is not None and (error := self._program.ending.error):
            about.append('error of the program: '
                         + (error if options.with_host else computer_facts.plain_text(error)))
        if options.with_host:
            about += computer_facts.personal(options.source, self._command)
        text = make_report(verdict, shown, seconds, about, new_devices(options.devices, names),
                           options.protocol, self._window.capture(names))
        with open(options.report, 'w', encoding='utf-8') as file:
            file.write(text)
        print(f'dxl_doctor: the report is in {printable(options.report)}', file=sys.stderr)


def _print(verdict: Verdict, for_programs: dict[str, Any], options: argparse.Namespace) -> None:
    options.is_answered = True         # a second object would be no JSON
    if options.json:
        print(json.dumps(for_programs), flush=True)
        return
    if options.source == RUN:
        print()                        # the program may have left a line without an end
    width, height = shutil.get_terminal_size((WIDTH, HEIGHT + 1))
    is_whole = options.full or not sys.stdout.isatty()
    print('\n'.join(screen(verdict, has_colours(), width,
                           None if is_whole else max(HEIGHT, height - 1))), flush=True)


def _show_saved(saved: SavedReport, models: Models, options: argparse.Namespace) -> int:
    """Show a report of somebody else, and what its capture says now."""
    if options.report:
        raise UsageError(f'--report: {options.source} is a report already; attach that')
    protocol = saved.protocol if saved.protocol in PROTOCOL_CHOICES else DEFAULTS.protocol
    examination = Examination(models, saved.devices, protocol)
    for chunk in saved.chunks:
        examination.feed_chunk(chunk, saved.wires.get(chunk.bus) or Wire(chunk.bus, DEFAULT_BAUD))
    examination.finish(examination.last, is_over=True)
    buses, seconds = examination.buses(is_timed=True), examination.seconds
    now = make_verdict('the capture of a report', buses, seconds, is_timed=True,
                       quiet=[] if examination.bytes else [NOTHING])
    verdict = saved.verdict or now
    _print(verdict, saved.as_json or as_json(now, buses, seconds), options)
    print_problems('dxl_doctor', [*saved.problems, *_difference(saved, buses)])
    return verdict.code


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
    add('--full', action='store_true', help='do not cut the answer to the size of the terminal')
    add('--json', action='store_true', help='print one JSON object, for programs')
    return parser


if __name__ == '__main__':
    sys.exit(main())
