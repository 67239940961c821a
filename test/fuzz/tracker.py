# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""Tracker and Monitor: any traffic, with pauses, to a report."""

from functools import lru_cache

from fuzz.framer import pieces
from fuzz.framer import Watched
from fuzz.script import Script
from fuzz.script import traffic
from msg_defs.dxl_packet import encode
from servobus.bus.decoder import BusDecoder
from servobus.bus.evidence import PROTOCOL_1
from servobus.model.models import Models
from servobus.monitor import Monitor

MODELS = Models()
PAUSES_NS = (0, 0, 0, 1_000, 1_000_000, 30_000_000, 1_500_000_000, 12_000_000_000)
DECIDES_NS = 30_000_000                # the line, or the delivery? the next chunk shows
LIMITS = {'errors': 50, 'incidents': 1000, 'waits': 256, 'cycles': 32, 'noise': 256}
SLOTS = 8192 + 255                     # for all plans together, and those of the last one
TABLE_END = 0x4000
SPANS = 64
ERRORS = 64


def check(data):
    """
    Check one bus over one stretch of traffic.

    Never raises, in a report neither; every byte is packet, noise or pending, by
    a count of its own; all that is kept is bounded, also of a flood; an ID is 0 to 252; what came
    at one stamp gives the same in any split, but where the first chunk after a pause decides.
    """
    script = Script(data)
    seed = script.word()
    bursts = [(piece, script.pick(PAUSES_NS)) for piece in filter(None, traffic(script))]
    if seed > 65_200:
        bursts.append((flood(), 0))
    whole = run((([piece], pause) for piece, pause in bursts))
    before = (0, *(pause for _, pause in bursts))
    assert run((([piece] if last == DECIDES_NS else list(pieces(piece, seed)), pause)
                for last, (piece, pause) in zip(before, bursts, strict=False))) == whole


@lru_cache
def flood():
    """More distinct instructions, silent devices, errors, spans and IDs than are kept."""
    where = [at.to_bytes(2, 'little') for at in range(600, 2100)]
    asked = b''.join(encode(0xFE, 0x82, one + b'\x02\0' + bytes(range(100, 132)))
                     for one in where[:270])
    refused = b''.join(encode(1, 2, one + b'\x02\0') + encode(1, 0x55, b'', 1 + at % 120)
                       for at, one in enumerate(where[:1100]))
    spread = b''.join(encode(2, 3, one + b'x') + encode(2, 0x55, b'', 0) for one in where[::10])
    strangers = b''.join(encode(one, 0x55, b'', 0) + encode(one, 2, b'\0\3\1\0')
                         for one in range(256))
    listed = encode(0xFE, 0x83, b'\0\3\1\0' + bytes(range(256)))
    far = encode(3, 3, b'\xf0\x3f' + bytes(200)) + encode(3, 0x55, b'', 0)
    return asked + refused + strangers + listed + far + spread


def run(bursts):
    """Feed bursts of chunks, each at one stamp; return what does not hang on the chunks."""
    decoder = BusDecoder(MODELS)
    decoder.framers[''] = framer = Watched()
    monitor = Monitor('bus', MODELS, decoder=decoder)
    now = 1_000_000_000
    total = 0
    for chunks, pause in bursts:
        for chunk in chunks:
            total += len(chunk)
            monitor.feed(chunk, now)
        kept(monitor)
        if pause >= 1_000_000_000:
            bounded(monitor.report(now), total, framer)
        now += pause
    now += 4_000_000_000               # not 5: a device is silent after so long, to the ns
    report = monitor.report(now)
    bounded(report, total, framer)
    assert report.counters['Pending Bytes'] == 0
    kept(monitor)
    tables = {number: one.table for number, one in monitor.decoder.registry.devices.items()}
    assert all(len(one._settle().data) <= TABLE_END for one in tables.values())
    # Noise is searched for packets of the 1.0 family once a second: as far as chunks had come.
    kinds = {kind: count for kind, count in report.kinds.items() if kind != PROTOCOL_1}
    return report.counters, kinds, [
        (device.id, device.model_name, device.state, device.totals, device.errors,
         *(bytes(part) for part in (tables[device.id]._settle().data,
                                    tables[device.id]._settle().sources)))
        for device in report.devices]


def kept(monitor):
    """Hold that what was not looked at yet is bounded too."""
    registry, planner = monitor.decoder.registry, monitor.decoder.tracker.planner
    assert sum(1 + len(plan.slots) for plan in planner.known.values()) <= SLOTS
    assert registry.devices.keys() <= set(range(253))
    for number, device in registry.devices.items():
        assert device.number == number
        assert len(device.table._latest) <= SPANS
        assert len(device.errors) <= ERRORS


def bounded(report, total, framer):
    counters = report.counters
    assert counters['Bytes'] == total
    assert counters['Packet Bytes'] == framer.accounted
    assert counters['Noise Bytes'] == total - framer.accounted - framer.pending
    assert counters['Pending Bytes'] == framer.pending
    assert counters['Packets'] == len(framer.good)
    assert all(len(getattr(report, name)) <= limit for name, limit in LIMITS.items())
    assert len({device.id for device in report.devices}) == len(report.devices) <= 253
