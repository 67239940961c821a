# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""
The listener on `usb:NAME`: what any program exchanges with a USB adapter, as usbmon shows it.

NAME is a tty, a socket (1-1.2), a number (1.7), or a Unix socket that gives events as /dev/usbmonN
does (fake_bus --usbmon). The tty itself is never opened. A plugged-in adapter is looked up each
time, so that one that comes back under another number is followed.
"""

from __future__ import annotations

from functools import partial
import os
from pathlib import Path
import socket
import time

from msg_defs.event import BAUD
from msg_defs.event import Change
from msg_defs.event import Chunk
from msg_defs.event import LATENCY_TIMER
from msg_defs.event import LOST
from servobus.port.port_error import PortError
from servobus.port.port_error import Reason
from servobus.sources import reader
from servobus.sources.listener import Listener
from servobus.sources.reader_process import ReaderProcess
from servobus.sources.reader_process import Record
from servobus.sources.source_name import USB
from servobus.sources.usb_find import find
from servobus.sources.usb_port import Place
from servobus.sources.usb_port import UNPLUGGED_CHANGE
from servobus.sources.usb_port import UsbPort
from servobus.sources.usb_survey import Survey
from servobus.sources.usbmon import INPUT
from servobus.sources.usbmon import Records
from servobus.sources.usbmon import UsbEvent

_MONITOR = '/dev/usbmon{}'
_AT_ONCE_NS = 100_000               # two clocks were read without a pause between


class UsbListener(Listener):
    """A listener on one adapter; dropped: events that the kernel had no room for."""

    dropped = 0
    _place: Place | None = None            # None: a stream says itself what is there

    def problems(self) -> list[str]:
        return [f'the kernel dropped {self.dropped} USB events: there is too much other traffic '
                'on this USB bus; missing data looks like silence'] \
            if self.dropped else []

    def _listen_once(self) -> None:
        self._records = Records()
        self._usb: UsbPort | None = None
        self._newest = 0
        self._last = time.monotonic_ns()           # when the line said something
        name = self.port.removeprefix(USB)
        if Path(name).is_socket():
            self._survey = Survey()
            with socket.socket(socket.AF_UNIX) as stream:
                stream.connect(name)
                self._read('listening to a stream of USB events', stream.fileno(), ())
        else:
            self._listen_to_bus(name)

    def _listen_to_bus(self, name: str) -> None:
        target = find(name)
        self._place = place = target.place
        path = _MONITOR.format(place.bus)
        fd = _open(self.port, path)
        try:
            self._usb = UsbPort(place, target.adapter, self._bus)
            self.latency_timer_ms = target.latency_timer_ms
            self._read(f'listening to {target.words} through {path}', fd,
                       (place.device, target.adapter.IDLE_SIZE, place.bulk_in | INPUT,
                        place.bulk_out))
        finally:
            os.close(fd)

    def _read(self, words: str, fd: int, usb: tuple[int, ...]) -> None:
        """Have a process read; raise PortError when the adapter or the stream has gone."""
        self._opened(words)
        problem = self._read_by_process(self._accept_usb_record, partial(
            ReaderProcess, fd, self.idle_s, reader.GATHER_LONGEST_S,       # events have stamps
            self._pipe.fd, usb))
        if problem:
            raise PortError(self.port, Reason('other', f'its reader process: {problem}',
                                              'start this program again if that lasts'))

    def _accept_usb_record(self, record: Record) -> None:
        if record.kind == reader.CHUNK:
            self._decode_events(record.data, record.stamp)
        elif record.kind == reader.DROPPED:
            self.dropped += int(record.data)
            self._deliver(Chunk(max(record.stamp, self._newest), self._bus,
                                change=Change(LOST, int(record.data))))
        elif record.kind == reader.LOST:
            raise self._gone()
        if record.kind == reader.IDLE or record.stamp - self._last > self.idle_s * 1e9:
            self._report_idle(record.stamp)
        # It may have gone while no program used it; then the kernel reports nothing.
        if record.kind == reader.IDLE and self._place is not None \
                and find(self.port.removeprefix(USB)).place != self._place:
            raise self._gone()

    def _decode_events(self, data: bytes, read_at: int) -> None:
        """Hand on what was read at this moment; the events have stamps of the wall-clock."""
        chunks: list[Chunk] = []
        skim = None
        if self._usb is not None:
            self._usb.later = _to_monotonic()
            skim = partial(self._usb.skim, decoded=chunks)
        for event in self._records.events(data, skim):
            usb = self._usb or self._find_port(event)
            if usb is not None:
                found = usb.decode_event(event)
                chunks += found
                if found and found[-1].change == UNPLUGGED_CHANGE:
                    break
        for at, chunk in enumerate(chunks):    # no time is before the one in front
            stamp = max(self._newest, min(read_at, chunk.stamp))
            if stamp != chunk.stamp:
                chunks[at] = chunk._replace(stamp=stamp)
            self._newest = stamp
            if chunk.data:
                self._last = stamp
            elif chunk.change is not None:
                self._follow_change(chunk.change)
        if chunks:
            self._deliver(*chunks)
            if chunks[-1].change == UNPLUGGED_CHANGE:
                raise self._gone()

    def _follow_change(self, change: Change) -> None:
        """Learn the rate and the latency timer."""
        if change.what == BAUD:
            self.baud = change.value
        elif change.what == LATENCY_TIMER:
            self.latency_timer_ms = change.value

    def _find_port(self, event: UsbEvent) -> UsbPort | None:
        """Find the port in a stream that says itself what is plugged in."""
        self._survey.add_event(event)
        for one in self._survey.ports():
            self._usb = UsbPort(one.place, one.adapter, self._bus)
            self._usb.later = _to_monotonic()
        return self._usb

    def _gone(self) -> PortError:
        return PortError(self.port, Reason('lost', 'the adapter was unplugged',
                                           'plug it in again; it is then found by itself'))


def _to_monotonic() -> int:
    """Return the ns from the wall-clock to the monotonic one, read without a pause between."""
    for _ in range(10):
        before, wall, after = time.monotonic_ns(), time.time_ns(), time.monotonic_ns()
        if after - before < _AT_ONCE_NS:
            break
    return after - wall


def _open(name: str, path: str) -> int:
    try:
        return os.open(path, os.O_RDONLY | os.O_NONBLOCK | os.O_CLOEXEC)
    except FileNotFoundError:
        raise PortError(name, Reason('absent', f'there is no {path}: the kernel module is not '
                                     'loaded', 'sudo modprobe usbmon')) from None
    except PermissionError:
        raise PortError(name, Reason(
            'permission', f'{path} belongs to root, because it shows keyboards too',
            'use sudo for one session, or let a group read it by a udev rule')) from None
