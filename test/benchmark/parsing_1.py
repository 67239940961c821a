# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""
Full tracking of the 1.0 family from memory, as in parsing.py; the makers' own clients beside.

Feetech's robot is read with feetech-servo-sdk (which LeRobot uses), that of Protocol 1.0 with
dynamixel-sdk: `rxPacket` alone, on the statuses of the same traffic. The monitor is told the
protocol, or finds it out (`auto`). CPU time per packet; cases take turns.
"""

from functools import partial

from benchmark.parsing import CHUNKS
from benchmark.parsing import compare
from benchmark.parsing import cut
from benchmark.parsing import FULL_PACKETS
from benchmark.parsing import monitor_us
from benchmark.parsing import QUICK_PACKETS
from benchmark.parsing import SDK_PACKETS
from benchmark.traffic import BAUD_1
from benchmark.traffic import KINDS_1
from benchmark.traffic import packets_1
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
    protocol, *client = CLIENTS[kind]
    data = b''.join(pieces)
    statuses = [one for one in pieces if one[2] <= 252 and one[4] <= LAST_ERROR][:SDK_PACKETS]
    models = Models()
    monitors = {
        f'monitor, {told}, chunks of {size}': partial(
            monitor_us, models, cut(data, size), Settings(baud=BAUD_1, protocol=told))
        for told in (protocol, 'auto') for size in CHUNKS}
    section = f'parsing: {kind}, {len(data) / len(pieces):.1f} bytes per packet'
    return compare(section, monitors, client, statuses, rounds)
