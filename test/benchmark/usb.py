# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""
A bus at 4.5 MBd through `usb:`: what is lost, what it costs.

A recorded stream (a robot that walks, without a pause on the wire) is played at its own pace, as
the events of an FTDI adapter with a latency timer of 1 ms. The listener and its reader are a
process each, as in the node; the monitor takes what comes, nothing is published.
"""

from __future__ import annotations

from pathlib import Path
import socket
import tempfile
import time

from benchmark.traffic import ROBOT
from mecarover_fakes.fake_bus import make_devices
from mecarover_fakes.line import Line
from mecarover_fakes.line import MASTER
from mecarover_fakes.master import Master
from mecarover_fakes.traffic import PATTERNS
from mecarover_fakes.usb_adapter import FakeAdapter
from rigs.harness import Child
from rigs.harness import Figure
from rigs.harness import usage
from servobus.model.models import Models

S = 1_000_000_000
BAUD = 4_500_000
TICK_NS = 1_000_000
LATENCY_NS = 1_000_000          # what an adapter holds bytes back
TRANSFER = 510                  # bytes of the line in a full one
LEAD_NS = 1_500_000_000         # until the listener is there


def run(options):
    """Play the stream in each round."""
    seconds = min(options.seconds, 5.0)
    line = Line(make_devices(list(ROBOT), Models(), BAUD), BAUD)
    bursts = list(Master(line, PATTERNS['moving'], rate=0, gap=0).bursts(round(seconds * S)))
    sent = sum(len(burst.data) for burst in bursts)
    rounds = [through_usb(bursts, seconds) for _ in range(options.rounds)]
    section = f'usb: {BAUD / 1e6:g} MBd'
    return [Figure(section, 'CPU of listener, reader and monitor', '%',
                   [100 * cpu for cpu, _ in rounds]),
            Figure(section, f'bytes lost of {sent}', 'B', [sent - heard for _, heard in rounds])]


def through_usb(bursts, seconds):
    """Return the share of a core that hearing them takes, and how many bytes are heard."""
    with tempfile.TemporaryDirectory() as folder, socket.socket(socket.AF_UNIX) as server:
        path = Path(folder, 'usb')
        server.bind(str(path))
        server.listen()
        with Child('benchmark.heard', f'usb:{path}', '0') as listener:
            reader, _ = server.accept()
            with reader:
                adapter = FakeAdapter('ftdi')
                begin = time.time_ns() + LEAD_NS
                reader.sendall(adapter.plug(begin) + adapter.set_baud(BAUD, begin))
                rows = [(begin + at, make(data, begin + at)) for at, make, data in _transfers(
                    bursts, adapter)]
                listener.read_json()
                before = usage(listener.pid)
                _play(rows, reader.sendall)
                cpu_s = usage(listener.pid).cpu_s - before.cpu_s
                listener.send_json('report')
                return cpu_s / seconds, listener.read_json()['bytes']


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


def _play(rows, write):
    """Write rows of (when in ns, what) at their pace."""
    at = 0
    while at < len(rows):
        now = time.time_ns()
        first = at
        while at < len(rows) and rows[at][0] <= now:
            at += 1
        if at > first:
            write(b''.join(row for _, row in rows[first:at]))
        time.sleep(TICK_NS / S)
    time.sleep(0.3)
