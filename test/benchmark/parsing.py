# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""
Full tracking from memory, in chunks as a port gives them, and the official client.

`monitor` is all that the node does with a chunk short of publishing: lock, framing, pairing,
tables, timing statistics. `rxPacket` of dynamixel-sdk only parses, and only statuses: it is given
the statuses of the same traffic, out of memory. CPU time per packet; cases take turns.
"""

from functools import partial
from pkgutil import resolve_name
import time

from benchmark.traffic import BAUD
from benchmark.traffic import KINDS
from benchmark.traffic import packets
from benchmark.traffic import TRACE
from benchmark.traffic import trace_packets
from msg_defs.dxl_packet import Framer
from msg_defs.servo_frame import IS_STATUS
from rigs.harness import Figure
from rigs.harness import interleaved
from servobus.bus.decoder import Settings
from servobus.model.models import Models
from servobus.monitor import Monitor

CHUNKS = (4096, 64)
QUICK_PACKETS = 5_000
FULL_PACKETS = 25_000
SDK_PACKETS = 2_000                # for the official client, which takes several times as long
SETTINGS = Settings(baud=BAUD)
CLIENT = ('dynamixel-sdk', 'dynamixel_sdk.protocol2_packet_handler:Protocol2PacketHandler',
          False)


class Memory:
    """What the official client takes for a port: bytes that are all there already."""

    is_using = False

    def __init__(self, data):
        self._data = data
        self._at = 0

    def readPort(self, length):
        at = self._at
        self._at = at + length
        return self._data[at:at + length]

    def isPacketTimeout(self):
        return True


def run(options):
    """Measure every kind of traffic, the trace too where there is one."""
    count = QUICK_PACKETS if options.quick else FULL_PACKETS
    traffic = {kind: packets(kind, count) for kind in KINDS}
    if options.trace is not None:
        traffic[TRACE] = trace_packets(options.trace)
    figures = []
    for kind, pieces in traffic.items():
        figures += measure(kind, pieces, options.rounds)
    return figures


def measure(kind, pieces, rounds):
    """Return the figures of one kind of traffic: us per packet, and times the client's rate."""
    data = b''.join(pieces)
    statuses = _statuses(data)[:SDK_PACKETS]
    models = Models()
    monitors = {
        f'monitor, chunks of {size}': partial(monitor_us, models, cut(data, size))
        for size in CHUNKS}
    return compare(f'parsing: {kind}', monitors, CLIENT, statuses, rounds)


def compare(section, monitors, client, statuses, rounds):
    """
    Return the figures of monitors (name to measurement) and of a client, and their ratios.

    client: its name, where its parser is, and what rxPacket takes besides the port.
    """
    name, handler, *options = client
    theirs = f'{name} rxPacket'
    cases = dict(monitors)
    if statuses:
        cases[theirs] = partial(client_us, handler, statuses, *options)
    results = interleaved(cases, rounds)
    return [Figure(section, name, 'us/packet', values) for name, values in results.items()] + [
        Figure(section, f"{name}: times the client's rate", '',
               [one / ours for one, ours in zip(results[theirs], results[name], strict=True)])
        for name in monitors if statuses]


def monitor_us(models, chunks, settings=SETTINGS):
    """Return the CPU time per packet of a fresh monitor, in us."""
    monitor = Monitor('bus', models, settings)
    byte_ns = 10 * 10**9 // settings.baud
    stamps = []
    received = 0
    for chunk in chunks:
        received += len(chunk)
        stamps.append(1 + received * byte_ns)
    feed = monitor.feed
    start = time.process_time_ns()
    for chunk, stamp in zip(chunks, stamps, strict=True):
        feed(chunk, stamp)
    spent = time.process_time_ns() - start
    return spent / 1000 / monitor.report(stamps[-1]).counters['Packets']


def client_us(handler, statuses, *options):
    """Return the CPU time per status of a client's parser, in us."""
    parser = resolve_name(handler)()
    port = Memory(b''.join(statuses))
    start = time.process_time_ns()
    for _ in statuses:
        parser.rxPacket(port, *options)
    return (time.process_time_ns() - start) / 1000 / len(statuses)


def cut(data, size):
    """Return data in chunks of a size."""
    return [data[at:at + size] for at in range(0, len(data), size)]


def _statuses(data):
    """Return the whole statuses that the client could take: not repaired, no fast replies."""
    framer = Framer()
    return [data[begin:end] for begin, end, kind, number, _, _, flaw in framer.frames(data)
            if kind == IS_STATUS and number <= 252
            and (flaw is None or not (flaw.reason or flaw.repaired))]
