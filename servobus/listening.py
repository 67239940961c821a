# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""
Listen from inside of a program: around its own serial port, or to a source by its name.

Around a port of pyserial there is no thread and no second process: what the program reads and
writes is decoded in these very calls, and twice a second one of them makes a report as well
(docs/library.md says what that costs).
"""
from __future__ import annotations

from collections.abc import Callable
from collections.abc import Sequence
from contextlib import ExitStack
from threading import RLock
import time
from types import TracebackType
from typing import Any

from msg_defs.diagnostics import Level
from msg_defs.event import BAUD
from msg_defs.event import Change
from msg_defs.event import CHANGES
from msg_defs.event import Chunk
from msg_defs.event import CLOSED
from msg_defs.event import IN
from msg_defs.event import OUT
from servobus.bus.decoder import DEFAULTS
from servobus.bus.decoder import PROTOCOL_CHOICES
from servobus.bus.expected_devices import parse_all
from servobus.bus.report import BusReport
from servobus.bus.report import FAILED
from servobus.bus.report import Finding
from servobus.bus.report import RAISED
from servobus.bus.report import SERVO_LIBRARIES
from servobus.doctor.case import ARGUMENTS
from servobus.errors import ClosedError
from servobus.errors import NothingHeardError
from servobus.errors import ParameterError
from servobus.errors import UsageError
from servobus.examination import Examination
from servobus.model.models import Models
from servobus.settings import check_devices
from servobus.settings import check_models
from servobus.sources import silence_reasons
from servobus.sources import tap_pyserial
from servobus.sources.capture import Wire
from servobus.sources.opening import open_source
from servobus.sources.source import Source

OnFinding = Callable[[Finding], object]


def listen(port: Any, *, baud: int | None = None, devices: Sequence[str] = (),
           protocol: str = DEFAULTS.protocol, models: Models | None = None,
           on_finding: OnFinding | None = None) -> Listening:
    """
    Listen to a bus for as long as the `with` block lasts.

    port: an open port of pyserial, or the name of a source ('tap:arm', '/dev/ttyUSB1', a
    recording), which is heard by run(). baud: bit/s; None: that of the port, or what the source
    says. devices: what is on the bus, as '1-6:STS3215'. protocol: 'auto', '2', '1', 'feetech'.
    on_finding: called with each finding of WARN or above when it begins; what it raises is raised
    at the end of the block. Raises ParameterError, UsageError, PortError or OSError; at the end
    of the block NothingHeardError, if run() heard no byte.
    """
    models = models or Models()
    if isinstance(devices, str) or not all(isinstance(one, str) for one in devices):
        raise ParameterError(f"devices: {devices!r} is no list of texts; write ['1-6:STS3215']")
    if isinstance(port, str):
        check_devices(devices, models)
    else:                                      # a port is one bus, without a name
        check_models(parse_all(devices), models)
    if protocol not in PROTOCOL_CHOICES:
        raise ParameterError(
            f'protocol: {protocol!r} is none; use one of {", ".join(PROTOCOL_CHOICES)}')
    if baud is not None and not (isinstance(baud, int) and baud > 0):
        raise ParameterError(f'baud: {baud!r} is no baud rate; give bit/s, or leave it out')
    if not (on_finding is None or callable(on_finding)):
        raise ParameterError(f'on_finding: {on_finding!r} cannot be called; give a function')
    calls = _FindingCalls(on_finding)
    examination = Examination(models, devices, protocol, [calls], ARGUMENTS)
    if isinstance(port, str):
        return SourceListening(examination, calls, port, open_source('servobus', port, baud))
    if not all(hasattr(port, name) for name in ('read', 'write', 'baudrate', 'is_open')):
        raise UsageError(f'{type(port).__name__}: not a port of pyserial; give an open '
                         'serial.Serial, or the name of a source')
    if not port.is_open:
        raise UsageError(f'{port.port}: this port is not open; open it first')
    return PortListening(examination, calls, port, baud)


class _FindingCalls:
    """A watcher that hands on each finding of WARN or above when it begins."""

    def __init__(self, on_finding: OnFinding | None) -> None:
        self.mistake: Exception | None = None  # the first that the function raised
        self._on_finding = on_finding
        self._known: dict[str, set[tuple[str, int | None]]] = {}

    def record_chunk(self, wire: Wire, chunk: Chunk) -> None:
        """Bytes are no news."""

    def record_report(self, bus: str, report: BusReport) -> None:
        """Hand on what was not in the last report of this bus."""
        if self._on_finding is None:
            return
        serious = [one for one in report.findings if one.level >= Level.WARN]
        before = self._known.get(bus, set())
        self._known[bus] = {(one.rule, one.device) for one in serious}
        for one in serious:
            if (one.rule, one.device) not in before:
                try:
                    self._on_finding(one)
                except Exception as mistake:   # not into the program's read or write
                    self.mistake = self.mistake or mistake


class Listening:
    """A bus that is listened to; it may be asked from any thread."""

    def __init__(self, examination: Examination, calls: _FindingCalls) -> None:
        self._examination = examination
        self._calls = calls
        self._lock = RLock()                   # on_finding may ask for reports
        self._stack = ExitStack()

    @property
    def findings(self) -> list[Finding]:
        """What was found since the beginning, the worst first; what went away again as well."""
        with self._lock:
            return [one.finding for bus in self._examination.buses(is_timed=True)
                    for one in bus.logged]

    def reports(self) -> list[BusReport]:
        """Return the last report of each bus: of a port there is one, once bytes came."""
        with self._lock:
            return [bus.report for bus in self._examination.buses(is_timed=True)]

    def run(self, seconds: float | None = None) -> None:
        """Decode a recording to its end, or what a live source says for so long (None: ever)."""
        raise UsageError('run() is for a source; a port is heard while the program uses it')

    def __enter__(self) -> Listening:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None,
                 trace: TracebackType | None) -> None:
        self._stack.__exit__(kind, error, trace)
        mistake = self._calls.mistake or self._why_unheard()
        if mistake is not None:
            if error is None:
                raise mistake
            _begin_with(mistake, error)

    def _why_unheard(self) -> Exception | None:
        """Return an error where nothing was heard and something should have been."""
        return None


def _begin_with(first: BaseException, error: BaseException) -> None:
    """Let the traceback of an error begin with another one."""
    chain = [error]
    while (before := _shown_before(chain[-1])) and before not in chain:
        chain.append(before)
    if first in chain:
        return
    one = first                                # where it was raised while that was handled
    while one.__context__ is not None and one.__context__ not in chain:
        one = one.__context__
    one.__context__ = None                     # a circle would have no end
    chain[-1].__context__, chain[-1].__suppress_context__ = first, False


def _shown_before(error: BaseException) -> BaseException | None:
    """Return the error that a traceback shows before this one."""
    return error.__cause__ or (None if error.__suppress_context__ else error.__context__)


class SourceListening(Listening):
    """What comes from a source: a tap, a port of its own, or a recording."""

    def __init__(self, examination: Examination, calls: _FindingCalls, name: str,
                 source: Source) -> None:
        super().__init__(examination, calls)
        self._name = name
        self._source = source
        self._has_run = self._is_closed = False
        self._stack.callback(self._close)

    def run(self, seconds: float | None = None) -> None:
        if self._is_closed:
            raise ClosedError(f'{self._name}: closed at the end of the with block; call run() '
                              'inside of it')
        self._has_run = True
        until = None if seconds is None else time.monotonic() + seconds
        is_over = False
        for chunk in self._source.chunks():
            with self._lock:
                self._examination.feed_from(self._source, chunk)
            if until is not None and time.monotonic() >= until:
                break
        else:
            is_over = True
        with self._lock:
            self._examination.finish_source(self._source, is_over)

    def _close(self) -> None:
        self._source.close()
        self._is_closed = True

    def _why_unheard(self) -> NothingHeardError | None:
        if self._examination.bytes or not self._has_run:
            return None
        why = [*self._source.problems(),
               *silence_reasons.reasons(self._name, self._source.is_live)]
        return NothingHeardError(f'{self._name}: nothing was heard. {" ".join(why)}')


class PortListening(Listening):
    """What a program exchanges through its own port of pyserial."""

    def __init__(self, examination: Examination, calls: _FindingCalls, port: Any,
                 baud: int | None) -> None:
        super().__init__(examination, calls)
        self._port = port
        self._wire = Wire('', baud or int(port.baudrate), port=str(port.port))
        self.serials = set[Any]()              # for tap_pyserial: more ports are not its matter

    def __enter__(self) -> Listening:
        self._stack.push(self._finish)
        self._stack.enter_context(tap_pyserial.tapped(self._port, self))
        return self

    def _finish(self, kind: object, error: BaseException | None, trace: object) -> None:
        failed = ''                            # how the block ended (bus/report.py)
        if isinstance(error, Exception):       # the question before it may be the reason
            of_library = tap_pyserial.packages_of(error) & SERVO_LIBRARIES
            failed = RAISED if of_library or isinstance(error, OSError) else FAILED
        with self._lock:
            self._examination.finish(time.monotonic_ns(), is_over=True, failed=failed)

    # What the wrappers of tap_pyserial.py call, as they call a Sender.

    def put(self, kind: str, number: int, data: bytes) -> None:
        if kind in (OUT, IN):
            self._accept(Chunk(time.monotonic_ns(), self._wire.name, data, kind))

    def number(self, kind: str, number: int, value: int) -> None:
        if kind in CHANGES:
            self._accept(Chunk(time.monotonic_ns(), self._wire.name, change=Change(kind, value)))

    def opened(self, name: str, baud: int) -> int:
        self.rate(0, baud)
        return 0

    def rate(self, number: int, baud: int) -> None:
        if baud != self._wire.baud:
            self._wire = self._wire._replace(baud=baud)
            self.number(BAUD, number, baud)

    def closed(self, number: int) -> None:
        self.number(CLOSED, number, 1)

    def _accept(self, chunk: Chunk) -> None:
        with self._lock:
            self._examination.feed_chunk(chunk, self._wire)
