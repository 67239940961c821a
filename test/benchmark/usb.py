# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""
The same bus at 4.5 MBd through a tty and through `usb:`: what is lost, what it costs.

A recorded stream (a robot that walks, without a pause on the wire) is played at its own pace: to a
pty, and as the events of an FTDI adapter with a latency timer of 1 ms. The listener and its reader
are a process each, as in the node; the monitor takes what comes, nothing is published.
"""

from __future__ import annotations

from functools import partial
from pathlib import Path
import socket
import tempfile
import time
from typing import NamedTuple

from benchmark.traffic import ROBOT
from mecarover_fakes.fake_bus import make_devices
from mecarover_fakes.line import Line
from mecarover_fakes.line import MASTER
from mecarover_fakes.master import Master
from mecarover_fakes.traffic import PATTERNS
from mecarover_fakes.usb_adapter import FakeAdapter
from mecarover_fakes.virtual_uart import VirtualUart
from rigs.harness import Child
from rigs.harness import Figure
from rigs.harness import interleaved
from rigs.harness import usage
from servobus.model.models import Models

S = 1_000_000_000
BAUD = 4_500_000
TICK_NS = 1_000_000
LATENCY_NS = 1_000_000          # what an adapter holds bytes back
TRANSFER = 510                  # bytes of the line in a full one
LEAD_NS = 1_500_000_000         # until the listener is there


class Run(NamedTuple):
    """What came of one run: share of a core, 0 to 1; bytes sent and bytes that were not heard."""

    cpu: float
    sent: int
    lost: int


def run(options):
    """Play the stream both ways, one round after the other."""
    seconds = min(options.seconds, 5.0)
    line = Line(make_devices(list(ROBOT), Models(), BAUD), BAUD)
    bursts = list(Master(line, PATTERNS['moving'], rate=0, gap=0).bursts(round(seconds * S)))
    results = interleaved({'tty': partial(through_tty, bursts, seconds),
                           'usb:': partial(through_usb, bursts, seconds)}, options.rounds)
    figures = []
    for name, runs in results.items():
        section = f'usb: {BAUD / 1e6:g} MBd through {name}'
        figures += [
            Figure(section, 'CPU of listener, reader and monitor', '%',
                   [100 * one.cpu for one in runs]),
            Figure(section, f'bytes lost of {runs[0].sent}', 'B', [one.lost for one in runs])]
    return figures


def through_tty(bursts, seconds):
    outlet = VirtualUart()
    try:
        with Child('benchmark.heard', outlet.path, str(BAUD)) as listener:
            rows = [(burst.end, burst.data) for burst in bursts]
            return _measure(listener, rows, outlet.write, seconds,
                            sum(len(burst.data) for burst in bursts), time.monotonic_ns)
    finally:
        outlet.close()


def through_usb(bursts, seconds):
    with tempfile.TemporaryDirectory() as folder, socket.socket(socket.AF_UNIX) as door:
        path = Path(folder, 'usb')
        door.bind(str(path))
        door.listen()
        with Child('benchmark.heard', f'usb:{path}', '0') as listener:
            reader, _ = door.accept()
            with reader:
                adapter = FakeAdapter('ftdi')
                begin = time.time_ns() + LEAD_NS
                reader.sendall(adapter.plug(begin) + adapter.set_baud(BAUD, begin))
                rows = [(at, make(data, begin + at)) for at, make, data in _transfers(
                    bursts, adapter)]
                return _measure(listener, rows, reader.sendall, seconds,
                                sum(len(burst.data) for burst in bursts), time.time_ns, begin)


def _transfers(bursts, adapter):
    """Yield what crosses USB: answers gathered up to a full transfer or the latency timer."""
    held, began, ended = b'', 0, 0
    for burst in bursts:
        if held and (burst.sender == MASTER or burst.end - began > LATENCY_NS
                     or len(held) + len(burst.data) > TRANSFER):
            yield ended, adapter.received, held
            held = b''
        if burst.sender == MASTER:
            yield burst.start, adapter.sent, burst.data
        else:
            began = began if held else burst.start
            held += burst.data
            ended = burst.end
    if held:
        yield ended, adapter.received, held


def _measure(listener, rows, write, seconds, sent, clock, begin=None):
    """Play rows of (when in ns, what) at their pace; return what the listener made of it."""
    listener.hear()
    begin = clock() if begin is None else begin
    before = usage(listener.pid)
    at = 0
    while at < len(rows):
        now = clock() - begin
        first = at
        while at < len(rows) and rows[at][0] <= now:
            at += 1
        if at > first:
            write(b''.join(row for _, row in rows[first:at]))
        time.sleep(TICK_NS / S)
    time.sleep(0.3)
    cpu_s = usage(listener.pid).cpu_s - before.cpu_s
    listener.tell('report')
    return Run(cpu_s / seconds, sent, sent - listener.hear()['bytes'])
