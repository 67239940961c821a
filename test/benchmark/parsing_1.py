# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""
Full tracking of the 1.0 family from memory, as in parsing.py; the makers' own clients beside.

Feetech's robot is read with feetech-servo-sdk (which LeRobot uses), that of Protocol 1.0 with
dynamixel-sdk: `rxPacket` alone, on the statuses of the same traffic. The monitor is told the
protocol, or finds it out (`auto`). CPU time per packet; cases take turns.
"""

from functools import partial
from pkgutil import resolve_name
import time

from benchmark.parsing import CHUNKS
from benchmark.parsing import cut
from benchmark.parsing import FULL_PACKETS
from benchmark.parsing import Memory
from benchmark.parsing import monitor_us
from benchmark.parsing import QUICK_PACKETS
from benchmark.parsing import SDK_PACKETS
from benchmark.traffic import BAUD_1
from benchmark.traffic import KINDS_1
from benchmark.traffic import packets_1
from rigs.harness import Figure
from rigs.harness import interleaved
from servobus.bus.decoder import Settings
from servobus.model.models import Models

# Their parsers by name: what only compares our own commits does without them.
CLIENTS = {'Feetech': ('feetech', 'feetech-servo-sdk',
                       'scservo_sdk.protocol_packet_handler:protocol_packet_handler'),
           'Protocol 1.0': ('1', 'dynamixel-sdk',
                            'dynamixel_sdk.protocol1_packet_handler:Protocol1PacketHandler')}
LAST_ERROR = 0x7F                  # what the clients take for a status


def run(options):
    """Measure both dialects."""
    count = QUICK_PACKETS if options.quick else FULL_PACKETS
    return [figure for kind in KINDS_1
            for figure in measure(kind, packets_1(kind, count), options.rounds)]


def measure(kind, pieces, rounds):
    """Return the figures of one dialect: us per packet, and times the client's rate."""
    protocol, client, handler = CLIENTS[kind]
    data = b''.join(pieces)
    statuses = [one for one in pieces if one[2] <= 252 and one[4] <= LAST_ERROR][:SDK_PACKETS]
    models = Models()
    cases = {
        f'monitor, {told}, chunks of {size}': partial(
            monitor_us, models, cut(data, size), Settings(baud=BAUD_1, protocol=told))
        for told in (protocol, 'auto') for size in CHUNKS}
    theirs = f'{client} rxPacket'
    cases[theirs] = partial(client_us, resolve_name(handler), statuses)
    results = interleaved(cases, rounds)
    section = f'parsing: {kind}, {len(data) / len(pieces):.1f} bytes per packet'
    figures = [Figure(section, name, 'us/packet', values) for name, values in results.items()]
    for name, values in results.items():
        if name != theirs:
            ratios = [one / ours for one, ours in zip(results[theirs], values, strict=True)]
            figures.append(Figure(section, f"{name}: times the client's rate", '', ratios))
    return figures


def client_us(handler, statuses):
    """Return the CPU time per status of a client's parser, in us."""
    parser = handler()
    port = Memory(b''.join(statuses))
    start = time.process_time_ns()
    for _ in statuses:
        parser.rxPacket(port)
    return (time.process_time_ns() - start) / 1000 / len(statuses)
