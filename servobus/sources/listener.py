# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""
The read-only port thread: opens the port, has it read, hands on stamped chunks.

Never writes, and the kernel holds it to that: the descriptor is O_RDONLY. A lost port is opened
again for ever, and its path is looked up each time. A small process does the reading (reader.py);
the thread itself reads only where there is no descriptor to share, or while no process can be
started. The stamp of a chunk is the time at which it was read (ns, monotonic): its first byte came
earlier by the wire time.
"""

from __future__ import annotations

from collections.abc import Callable
from collections.abc import Sequence
from contextlib import suppress
from functools import partial
import math
import threading
import time
from typing import NamedTuple

from msg_defs.event import Chunk
from msg_defs.uart import byte_ns
from msg_defs.uart import idle_s
from servobus.bus.report import LineErrors
from servobus.port.port_error import PortError
from servobus.port.port_error import Reason
from servobus.port.readable import readable
from servobus.port.self_pipe import SelfPipe
from servobus.port.serial_port import as_port_error
from servobus.port.serial_port import Backoff
from servobus.port.serial_port import open_port
from servobus.port.serial_port import Port
from servobus.sources import reader
from servobus.sources.reader_process import ReaderProcess
from servobus.sources.reader_process import Record
from servobus.sources.serial_driver import latency_timer_ms
from servobus.sources.serial_driver import line_errors
from servobus.sources.serial_driver import set_low_latency
from servobus.sources.serial_driver import shorten_latency_timer
from servobus.sources.source_name import ways_to_hear

ERRORS_EVERY_NS = 1_000_000_000
# The process stamps, so its records can wait: many at a time cost a quarter less than a few.
RECORDS_EVERY_S = 0.05
PROCESS_RETRY_NS = 30_000_000_000       # until a process is tried again that did not start
STARTING = 'starting'           # the kind of state before the port was tried


def in_use(port: str, busy: Reason) -> PortError:
    """Return the error of a port that another program has: how else it can be heard."""
    return PortError(port, busy._replace(
        remedy=f'{busy.remedy}, or hear what it does with {ways_to_hear(port)}'))


class ListenerState(NamedTuple):
    """Whether the port is open; if not, why: `kind` for programs, `text` is a line for people."""

    is_open: bool
    kind: str = ''
    text: str = ''


class Listener:
    """
    A listener on one port; both callbacks come from its thread.

    on_chunks(chunks) for what one read brought: bytes, and changes from a source that reports
    some (usb_listener.py, tap_listener.py). on_idle(stamp) when nothing came until then, a few
    times a second while it lasts. Without either, the port was not read. bus: for the chunks.

    | attributes | who writes them |
    |---|---|
    | _stopping, _last_news | stop(), news(): the thread of the caller |
    | port, _bus, _on_..., _records_every_s, _in_thread, _pipe, _thread | set once |
    | all others | its thread: one value each, so that others read them without a lock |
    """

    def __init__(self, port: str, baud: int, on_chunks: Callable[[Sequence[Chunk]], object],
                 on_idle: Callable[[int], object] = lambda now: None, *, bus: str = '',
                 records_every_s: float = RECORDS_EVERY_S, in_thread: bool = False) -> None:
        self.port = port
        self.baud = baud
        self.state = ListenerState(False, STARTING, f'{port}: not opened yet')
        self.latency_timer_ms: int | None = None     # an FTDI adapter's
        self.low_latency = False
        self.reader_pid: int | None = None           # the process that reads at present
        self.listened = 0            # stamp (ns) up to which all that came was handed on
        self.bytes = self.reads = self.openings = 0  # totals since the start
        self.largest_gap = 0         # ns between two reads while bytes were waiting
        self.line_errors: LineErrors | None = None   # None: the driver counts none
        self._bus = bus
        self._on_chunks = on_chunks
        self._on_idle = on_idle
        self._records_every_s = records_every_s
        self._in_thread = in_thread
        self._backoff = Backoff()
        self._fd: int | None = None                  # the open port's, if it is a serial one
        self._errors_at = 0          # when the driver's counters were read
        self._errors_before = LineErrors()           # before this opening
        self._errors_at_opening: LineErrors | None = None
        self._stopping = False
        self._last_news = ''
        self._words = ''             # how the port was opened
        self._thread_reason = ''     # why no process reads
        self._pipe = SelfPipe()      # not drained: who is stopped sleeps no more
        self._thread = threading.Thread(target=self._run, name=f'listener {port}', daemon=True)

    @property
    def idle_s(self) -> float:
        """For how long the line must be silent before what is left can be judged."""
        return idle_s(self.baud, self.latency_timer_ms or 0)

    def news(self) -> str:
        """Return why the port is not open, or that it is again, if that is new to the caller."""
        state = self.state
        words = '' if state.is_open else state.text
        if words == self._last_news:
            return ''
        self._last_news = words
        return words or f'{self.port}: the port is open again'

    def problems(self) -> list[str]:
        """Return what a person should know at the end, besides the counters."""
        return []

    def start(self) -> None:
        """Begin to listen; the port may be absent."""
        self._thread.start()

    def is_alive(self) -> bool:
        """Tell whether the thread is there."""
        return self._thread.is_alive()

    def stop(self) -> None:
        """Close the port and end the thread; no callback comes after this returns."""
        self._stopping = True
        self._pipe.rouse()
        self._thread.join()
        self._pipe.close()

    def _run(self) -> None:
        while not self._stopping:
            try:
                self._listen_once()
            except Exception as mistake:            # no mistake ends the listening
                with suppress(MemoryError):
                    error = as_port_error(self.port, mistake)
                    self.state = ListenerState(False, error.kind, str(error))
            self._pause(self._backoff.next())
        self.state = ListenerState(False, 'stopped', f'{self.port}: closed')

    def _listen_once(self) -> None:
        """Open the port and listen until it is lost, which raises, or we are stopped."""
        try:
            port = open_port(self.port, self.baud, read_only=True)
        except PortError as error:
            if error.kind != 'busy':
                raise
            raise in_use(self.port, Reason(error.kind, error.reason, error.remedy)) from error
        try:
            self._prepare(port)
            self._listen(port)
        finally:
            port.close()

    def _prepare(self, port: Port) -> None:
        self._errors_before = self.line_errors or LineErrors()
        self._errors_at_opening = None
        self._fd = port.fd if port.is_tty else None
        if self._fd is not None:
            self._errors_at_opening = line_errors(self._fd)
            self.low_latency = set_low_latency(self._fd)
            shorten_latency_timer(self.port)
            self.latency_timer_ms = latency_timer_ms(self.port)
        self._opened(f'open at {self.baud} baud')

    def _opened(self, words: str) -> None:
        self.openings += 1
        self._set_open(words)

    def _set_open(self, words: str) -> None:
        self._words = words
        self.state = ListenerState(True, '', f'{self.port}: {words}')

    def _note(self, words: str) -> None:
        self.state = ListenerState(True, '', f'{self.port}: {self._words}; {words}')

    def _listen(self, port: Port) -> None:
        """Have the port read until it is lost (PortError) or we are stopped."""
        self.listened = time.monotonic_ns()
        if port.fd is None or self._in_thread:
            self._read_in_thread(port)
            return
        start = partial(ReaderProcess, port.fd, self.idle_s, reader.GATHER_S, self._pipe.fd,
                        byte_ns=byte_ns(self.baud))
        while not self._stopping:
            self._thread_reason = self._read_by_process(partial(self._accept_record, port), start)
            if self._thread_reason:
                self._note(f'its reader process did not start ({self._thread_reason}), so the '
                           'node reads it and may lose bytes under load')
                self._read_in_thread(port, PROCESS_RETRY_NS)

    def _read_in_thread(self, port: Port, ns: float = math.inf) -> None:
        def wait(seconds: float) -> bool:
            return port.wait(seconds, self._pipe.fd)

        def deliver(data: bytes, stamp: int) -> None:
            self.largest_gap = max(self.largest_gap, loop.largest_gap)
            self._deliver(Chunk(stamp, self._bus, data))

        loop = reader.Loop(wait, port.read, deliver, self._report_idle,
                           idle_s=self.idle_s, byte_ns=byte_ns(self.baud))
        end = time.monotonic_ns() + ns
        loop.run(lambda: self._stopping or time.monotonic_ns() > end)

    def _read_by_process(self, accept_record: Callable[[Record], object],
                         start: Callable[[], ReaderProcess]) -> str:
        """Have a process read until we are stopped; return why that cannot be, if so."""
        while not self._stopping:
            try:
                process = start()
            except OSError as error:
                return error.strerror or str(error)
            except MemoryError:
                return 'no memory is left'
            with process:
                was_ready = self._read_records(process, accept_record)
                if not was_ready and not self._stopping:
                    return f'it ends at once with {process.end()}'
            if not self._stopping:
                self._note(f'the reader process ended with {process.end()}, a new one continues')
        return ''

    def _read_records(self, process: ReaderProcess,
                      accept_record: Callable[[Record], object]) -> bool:
        """Read records until the process ends or we are stopped; return whether any came."""
        was_ready = False
        self.reader_pid = process.pid
        try:
            while not self._stopping and not process.is_over:
                if process.wait():
                    for record in process.records():
                        was_ready = True
                        if self._thread_reason:
                            self._thread_reason = ''
                            self._set_open(self._words)
                        self.largest_gap = max(self.largest_gap, record.largest_gap)
                        accept_record(record)
                    time.sleep(self._records_every_s)
        finally:
            self.reader_pid = None
        return was_ready

    def _accept_record(self, port: Port, record: Record) -> None:
        if record.kind == reader.CHUNK:
            self._deliver(Chunk(record.stamp, self._bus, record.data))
        elif record.kind == reader.IDLE:
            self._report_idle(record.stamp)
        elif record.kind == reader.LOST:
            raise port.lost(OSError(int(record.data), ''))

    def _deliver(self, *chunks: Chunk) -> None:
        """Count and hand on what one read brought."""
        if size := sum(len(chunk.data) for chunk in chunks):
            self.bytes += size
            self.reads += 1
            self._backoff.reset()
        self._on_chunks(chunks)
        self.listened = stamp = chunks[-1].stamp
        if stamp - self._errors_at > ERRORS_EVERY_NS:
            self._errors_at = stamp
            self._count_errors()

    def _report_idle(self, stamp: int) -> None:
        self._on_idle(stamp)
        self.listened = stamp

    def _count_errors(self) -> None:
        """Refresh the driver's counters: what it counted before we came is not ours."""
        if self._errors_at_opening is not None and self._fd is not None:
            counted = line_errors(self._fd)
            if counted is not None:
                self.line_errors = self._errors_before + counted.since(self._errors_at_opening)

    def _pause(self, seconds: float) -> None:
        """Wait, but not when we are stopped."""
        if not self._stopping:
            readable([self._pipe.fd], seconds)
