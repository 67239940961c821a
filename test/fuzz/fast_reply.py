# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""Fast replies: one status of many devices, whole, cut, damaged, or not one at all."""

from fuzz.script import fast_reply
from fuzz.script import Script
from fuzz.script import TRICKY
from msg_defs.dxl_instruction import Access
from msg_defs.dxl_instruction import split_combined
from msg_defs.dxl_packet import encode
from servobus.model.models import Models
from servobus.monitor import Monitor

MODELS = Models()
FAST_BULK_READ = 0x9A
AT = 600                # behind all that tells what a device is


def check(data):
    """
    Check one combined status: as it is split, and what a bus with these devices makes of it.

    Never raises; a reply cut anywhere gives the blocks that are whole; after a flipped bit only
    blocks in front of it; a block that says another ID ends it; in no case a block that
    was not asked for. Each device's table gets its own data and no other.
    """
    script = Script(data)
    sizes = [script.byte() % 24 for _ in range(script.byte() % 8)]
    first = script.byte() % 200
    ids = [(first + 7 * n) % 253 for n in range(len(sizes))]
    accesses = tuple(Access(*one, None) for one in zip(ids, [AT] * len(ids), sizes, strict=True))
    blocks = [(_error(script), number, _data(script, size))
              for number, size in zip(ids, sizes, strict=True)]
    cut, bit, wrong, garbage = script.word(), script.word(), script.byte(), script.take_rest()
    reply = fast_reply(blocks)[4:]
    ends = [4 + sum(sizes[:n + 1]) + 4 * (n + 1) for n in range(len(sizes))]

    def splits_up_to(body, end):
        whole = sum(one <= end for one in ends)
        found = split_combined(body, accesses)
        assert found == [(number, error, block) for error, number, block in blocks[:whole]]
        bus_holds(accesses, blocks[:whole], body)

    cut %= len(reply) + 1
    bit %= 8 * (len(reply) - 4) or 1
    splits_up_to(reply, len(reply))
    splits_up_to(reply[:cut], cut)
    if blocks:
        damaged = bytearray(reply)
        damaged[4 + bit // 8] ^= 1 << bit % 8
        splits_up_to(bytes(damaged), 4 + bit // 8)
        wrong %= len(blocks)
        error, number, block = blocks[wrong]
        stranger = [*blocks[:wrong], (error, number + 1, block), *blocks[wrong + 1:]]
        splits_up_to(fast_reply(stranger)[4:], ends[wrong] - 1)
    found = split_combined(garbage.ljust(4, b'\0'), accesses)
    assert [(one.id, len(one.data)) for one in found] == [
        (one.id, one.length) for one in accesses[:len(found)]]


def bus_holds(accesses, blocks, body):
    """Hold that a device that spoke is known by its data; no other table has anything."""
    monitor = Monitor('bus', MODELS)
    asked = b''.join(bytes([one.id]) + one.address.to_bytes(2, 'little')
                     + one.length.to_bytes(2, 'little') for one in accesses)
    monitor.feed(encode(0xFE, FAST_BULK_READ, asked), 1_000_000_000)
    monitor.feed(b'\xff\xff\xfd\x00' + body, 1_001_000_000)
    monitor.flush_if_idle(2_100_000_000)
    devices = monitor.decoder.registry.devices
    assert set(devices) == {one.id for one in accesses}
    for error, number, data in blocks:
        known = bytes(AT) + data if data and not error & 0x7F else b''
        assert devices[number].table._settle().data == known
        assert devices[number].counts.answers == 1
    for one in accesses[len(blocks):]:
        assert not devices[one.id].table._settle().data
        assert not devices[one.id].counts.answers


def _error(script):
    error = script.byte()
    return error if error > 200 else 0


def _data(script, size):
    return b''.join(script.pick(TRICKY) if script.byte() > 200 else script.take_bytes(4)
                    for _ in range(size // 4 + 1)).ljust(size, b'\0')[:size]
