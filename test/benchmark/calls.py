# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""
What a packet and a report cost, without a clock: calls, and executed bytecodes, of Python.

Both are the same in each run of one version of Python, on any machine: so benchmark/calls.tsv has
a limit for each, and test_benchmark.py holds them. Calls are those of Python and of C functions,
within Monitor.feed() or Monitor.report(), once all is cached that can be.

usage: scripts/python -m benchmark.calls [--write] [--trace FILE]
"""

import argparse
from functools import cache
from itertools import islice
from itertools import product
import math
from operator import itemgetter
from pathlib import Path
import sys
from typing import NamedTuple

from benchmark.confusion import by_sides
from benchmark.traffic import BAUD
from benchmark.traffic import BAUD_1
from benchmark.traffic import FAST_ROBOT
from benchmark.traffic import KINDS_1
from benchmark.traffic import ROBOT
from mecarover_fakes.fake_bus import make_devices
from mecarover_fakes.fake_bus import make_line
from mecarover_fakes.faults import parse
from mecarover_fakes.master import Master
from mecarover_fakes.traffic import bulk_write
from mecarover_fakes.traffic import Pattern
from mecarover_fakes.traffic import PATTERNS
from mecarover_fakes.traffic import read
from mecarover_fakes.traffic import sync_write
from mecarover_fakes.traffic import write
from mecarover_fakes.traffic import write_register
from msg_defs.event import UNKNOWN
from servobus.bus.decoder import Settings
from servobus.bus.expected_devices import parse_all
from servobus.model.models import Models
from servobus.monitor import Monitor

PYTHON = (3, 11)                   # the figures are those of this version
ONE_PYTHON = f'the limits are those of Python {PYTHON[0]}.{PYTHON[1]}'
LIMITS = Path(__file__).with_name('calls.tsv')
CHUNKS = (4096, 64)                # bytes
BURSTS = 600                       # in a stream or on a bus: most are one packet
LEARNING = 0.4                     # so much of a stream comes before anything is counted
BYTE_NS = 10_000_000_000
REPORT_NS = 500_000_000
MODELS = Models()


def read_write(fleet, cycle):
    """Read each servo, and write a register that the monitor follows: what is there already."""
    for device in fleet.servos:
        if not cycle:                          # or EEPROM cannot be written
            yield from write_register(device, 'Torque Enable', b'\0')
        own, at = bytes((device.id,)), device.model.by_name['ID'].at
        yield read(device.id, at, 6)
        yield write(device.id, at, own)
        yield from sync_write(at, [(device.id, own)])
        yield from bulk_write([(device.id, at, own)])


class Stream(NamedTuple):
    """Traffic of a simulated bus."""

    pattern: Pattern
    devices: tuple[str, ...]
    dialect: str = '2'
    faults: tuple[str, ...] = ()
    rate: float = 0                # cycles a second, 0: without a pause

    @property
    def baud(self):
        return BAUD if self.dialect == '2' else BAUD_1


STREAMS = {
    'read/write': Stream(read_write, ('1-10:MX-64', '11-20:MX-106')),
    'ping': Stream(PATTERNS['ping'], ROBOT),
    # As a recording of a real robot is: part of it is noise, some of its packets are damaged.
    'recorded robot': Stream(PATTERNS['moving'], ROBOT, faults=(
        'glitch::0', 'noise::0', 'header:3:0', 'drop::0', 'silent:7:0')),
    'fast reads': Stream(PATTERNS['fast'], FAST_ROBOT),
    **{kind: Stream(PATTERNS['moving'], devices, dialect)
       for kind, (dialect, devices) in KINDS_1.items()},
}
SICK = ('noise::0', 'silent:3:0', 'hot:4:0', 'latched:5:0', 'low_voltage:2:0')
BUSES = {f'{health}, {count} devices': Stream(PATTERNS['moving'], (f'0-{count - 1}:MX-106',),
                                              faults=faults, rate=20)
         for count in (6, 30, 253) for health, faults in (('healthy', ()), ('sick', SICK))}


def calls_of(function):
    """Return how many functions a call leads into, those of Python and of C."""
    calls = -1                                 # without the one that ends it

    def count(frame, event, _):
        nonlocal calls
        calls += event == 'call' or event == 'c_call'

    sys.setprofile(count)
    try:
        function()
    finally:
        sys.setprofile(None)
    return calls


def bytecodes_of(function):
    """Return how many instructions the interpreter executes in a call."""
    executed = 0

    def count(frame, event, _):
        nonlocal executed
        executed += event == 'opcode'
        return count

    def enter(frame, event, _):
        frame.f_trace_opcodes, frame.f_trace_lines = True, False
        return count

    before = sys.gettrace()
    sys.settrace(enter)
    try:
        function()
    finally:
        sys.settrace(before)
    return executed


def chunks_of(stream, size, is_sided):
    """Return chunks of at most `size` bytes with stamps and sides; sided: each of one side."""
    bursts = _bursts(stream)
    if not is_sided:
        return _cut(b''.join(burst.data for burst in bursts), size, stream.baud)
    heard = sorted((part for burst in bursts for part in by_sides(burst, stream.baud)),
                   key=itemgetter(0))
    return [(data[at:at + size], stamp, side) for stamp, side, data in heard
            for at in range(0, len(data), size)]


def cost_of(chunks, baud, count=calls_of):
    """Return what a packet costs in Monitor.feed(), by calls_of() or bytecodes_of()."""
    monitor = Monitor('', MODELS, Settings(baud=baud), clock=_no_clock)
    learning = round(LEARNING * len(chunks))
    for chunk in chunks[:learning]:
        monitor.feed(*chunk)
    packets = monitor.decoder.total('packets')
    spent = count(lambda: [monitor.feed(*chunk) for chunk in chunks[learning:]])
    return spent / (monitor.decoder.total('packets') - packets)


def calls_of_a_report(bus):
    """Return the calls of the second report of a bus, on which nothing is new."""
    bursts = _bursts(bus)
    devices = tuple(parse_all(list(bus.devices)))
    now = bursts[-1].end
    for _ in range(2):                         # what can be kept was kept the first time
        monitor = Monitor('', MODELS, Settings(baud=bus.baud, devices=devices), clock=_no_clock)
        for burst in bursts:
            monitor.feed(burst.data, burst.end)
        monitor.report(now)
        calls = calls_of(lambda monitor=monitor, now=now: monitor.report(now + REPORT_NS))
    return calls


def of_packets():
    """Return what a packet of each stream costs, by the name of that and what is counted."""
    found = {}
    for (name, stream), is_sided in product(STREAMS.items(), (False, True)):
        before = None
        for size in CHUNKS:
            chunks = chunks_of(stream, size, is_sided)
            if chunks != before:               # with sides most are shorter than either
                costs = [cost_of(chunks, stream.baud, count) for count in (calls_of, bytecodes_of)]
            before = chunks
            full = f'{name}, chunks of {size}{", sided" if is_sided else ""}'
            found[full, 'calls a packet'], found[full, 'bytecodes a packet'] = costs
    return found


def of_reports():
    """Return what a report of each bus costs, in the same way."""
    return {(name, 'calls a report'): calls_of_a_report(bus) for name, bus in BUSES.items()}


def limits():
    """Return the limits by name and what is counted."""
    rows = (line.split('\t') for line in LIMITS.read_text('utf-8').splitlines()[1:])
    return {(name, what): float(limit) for name, what, limit in rows}


def _no_clock():
    return 0


@cache
def _bursts(stream):
    devices = make_devices(list(stream.devices), MODELS, stream.baud, dialect=stream.dialect)
    master = Master(make_line(devices, stream.baud, stream.dialect), stream.pattern,
                    rate=stream.rate, gap=0, seed=1, started=bool(stream.rate),
                    faults=[parse(fault) for fault in stream.faults])
    return list(islice(master.bursts(), BURSTS))


def _cut(data, size, baud):
    return [(data[at:at + size], min(at + size, len(data)) * BYTE_NS // baud, UNKNOWN)
            for at in range(0, len(data), size)]


def main():
    parser = argparse.ArgumentParser(prog='scripts/python -m benchmark.calls', description=(
        'Count calls and bytecodes of a packet and a report, and compare them with their limits.'))
    parser.add_argument('--write', action='store_true', help='make them the limits')
    parser.add_argument('--trace', type=Path, metavar='FILE', help='raw bytes of a real bus, too')
    options = parser.parse_args()
    if sys.version_info[:2] != PYTHON:
        sys.exit(f'calls: {ONE_PYTHON}; run this with it')
    if options.trace is not None:
        chunks = _cut(options.trace.read_bytes(), CHUNKS[0], BAUD)
        print(f'{options.trace.name}: {cost_of(chunks, BAUD):.2f} calls a packet')
    found = {name: math.ceil(10 * figure) / 10
             for name, figure in (of_packets() | of_reports()).items()}
    known = found if options.write else limits()
    over = {key for key, figure in found.items() if figure > known.get(key, 0)}
    for key, figure in found.items():
        print(f'{key[0]:42}{key[1]:20}{figure:10.1f}, at most {known.get(key, 0):10.1f}'
              f'{" OVER" * (key in over)}')
    if not options.write:
        return bool(over)
    LIMITS.write_text('stream or bus\twhat\tlimit\n' + ''.join(
        f'{name}\t{what}\t{figure:.1f}\n' for (name, what), figure in found.items()), 'utf-8')
    return 0


if __name__ == '__main__':
    sys.exit(main())
