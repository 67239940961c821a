# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""
What the benchmarks put on the bus: packets as they follow each other on the wire.

Taken from the simulated bus, with Protocol 2.0 of 20 devices of the five models of the thesis, or
from a recorded trace. The first two kinds are experiments 2 and 3 of the thesis; in `moving robot`
nearly every packet is different, as with a robot that moves.
"""

from itertools import islice

from mecarover_fakes.fake_bus import make_devices
from mecarover_fakes.fake_bus import make_line
from mecarover_fakes.line import Line
from mecarover_fakes.master import Master
from mecarover_fakes.traffic import PATTERNS
from msg_defs.dxl_packet import HEADER
from servobus.model.models import Models

BAUD = 2_000_000
PACKETS = 25_000                # for each kind: more than 400 KiB, as in the thesis
ROBOT = ('1-4:MX-64', '5-8:MX-106', '9-12:Rhoban DXL Board', '13-16:BitFoot', '17-20:Bit-Bots IMU')
FULL_BUS = ('0-252:MX-106',)
FAST_ROBOT = ('1-10:XM430-W350', '11-20:XL430-W250')
FAST = 'fast reads'
KINDS = {'read/write': 'read_write', 'ping': 'ping', 'moving robot': 'moving', FAST: 'fast'}
TRACE = 'trace'
BAUD_1 = 1_000_000
# The 1.0 family: what fake_bus calls it, and its devices, all of which move.
KINDS_1 = {'Feetech': ('feetech', ('1-6:STS3215',)),
           'Protocol 1.0': ('dxl1', ('1-5:AX-12A', '6-8:MX-28(1.0)'))}
LONGEST = 256                   # piece of a trace: no packet on that robot is longer


def packets(kind, count=PACKETS, devices=()):
    """Return the first packets of a kind of traffic; without devices, of a robot that knows it."""
    devices = devices or (FAST_ROBOT if kind == FAST else ROBOT)
    line = Line(make_devices(list(devices), Models(), BAUD), BAUD)
    master = Master(line, PATTERNS[KINDS[kind]], rate=0, gap=0)
    pieces = []
    for burst in master.bursts():
        if burst.data.startswith(HEADER):
            pieces.append(burst.data)
        else:                   # a further part of a fast reply
            pieces[-1] += burst.data
        if len(pieces) > count:
            break
    return pieces[:count]


def packets_1(kind, count=PACKETS):
    """Return the first packets of a robot of the 1.0 family that moves."""
    dialect, devices = KINDS_1[kind]
    line = make_line(make_devices(list(devices), Models(), BAUD_1, dialect=dialect), BAUD_1,
                     dialect)
    bursts = Master(line, PATTERNS['moving'], rate=0, gap=0).bursts()
    return [burst.data for burst in islice(bursts, count)]


def trace_packets(path):
    """Cut a trace in front of each header, and where for long there is none."""
    first, *others = path.read_bytes().split(HEADER)
    return [piece[at:at + LONGEST] for piece in (first, *(HEADER + other for other in others))
            for at in range(0, len(piece), LONGEST)]
