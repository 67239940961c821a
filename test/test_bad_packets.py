# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""Instructions that a program makes wrong each time, and damage on the way, which looks alike."""

from random import Random

from heard_bus import Bus
from heard_bus import MS
import pytest

from msg_defs import dxl1_packet
from msg_defs import dxl_packet
from msg_defs.event import IN
from msg_defs.event import OUT
from msg_defs.event import UNKNOWN

SERVOS = range(1, 7)
CHANCE = Random(49)


def goals(turn, error):
    """Return a Sync Write of goals in the 1.0 family, with an error in its Length or checksum."""
    parts = b''.join(bytes((number, turn % 200, 8)) for number in SERVOS)
    packet = bytearray(dxl1_packet.encode(254, 0x83, b'\x2a\x02' + parts))
    if error == 'sum':
        packet[-1] ^= 0xFF
    elif error == 'damage':
        packet[CHANCE.randrange(5, len(packet))] ^= 1 << CHANCE.randrange(8)
    elif error:
        packet[3] += error
        packet[-1] = packet[-1] - error & 0xFF
    return bytes(packet)


def goal_of_a_shell(turn, error):
    """Return a Write from a variable of a shell, which holds no bytes 00."""
    packet = dxl1_packet.encode(3, 3, bytes((42, 1 + turn % 200, 8, 0, 0, 232, 3)))
    return packet.replace(b'\0', b'')


def goal_2(turn, error):
    """Return a Write of Protocol 2.0, with an error in its Length or CRC."""
    packet = bytearray(dxl_packet.encode(1, 3, bytes((116, 0, turn % 200, 8, 0, 0))))
    if error == 'order':
        packet[-2:] = packet[:-3:-1]
    elif error == 'CRC':
        packet[-2:] = b'\0\0'
    elif error:
        packet[5] += error
        packet[-2:] = dxl_packet.body_crc(bytes(packet[4:-2])).to_bytes(2, 'little')
    return bytes(packet)


def found(write, error, has_sides, *, good_every=0, read_2=False, turns=100):
    """Return what is said of wrong packets of a program that reads two servos and writes goals."""
    bus = Bus()
    out, back = (OUT, IN) if has_sides else (UNKNOWN, UNKNOWN)
    for turn in range(turns):
        for number in (1, 2):
            asked, answer = (
                dxl_packet.encode(number, 2, b'\x84\0\4\0'),
                dxl_packet.encode(number, 0x55, bytes(4), error=0)) if read_2 else (
                dxl1_packet.encode(number, 2, b'\x38\2'), dxl1_packet.encode(number, 0, b'\0\x08'))
            for side, data in ((out, asked), (back, answer)):
                bus.now += 2 * MS
                bus.monitor.feed(data, bus.now, side)
        bus.now += 2 * MS
        is_good = good_every and turn % good_every == 0
        bus.monitor.feed(write(turn, 0 if is_good else error), bus.now, out)
        bus.now += 20 * MS
        if turn % 10 == 9:
            report = bus.report()
    return [one.message.partition(': no servo')[0] for one in report.findings
            if one.rule == 'wrong_packets']


@pytest.mark.parametrize(('write', 'error', 'has_sides', 'says'), [
    (goals, 1, True, 'each Sync Write has the wrong Length, 23, right is 22'),
    (goals, -2, True, 'each Sync Write has the wrong Length, 20, right is 22'),
    (goals, 'sum', True, 'each Sync Write has the wrong checksum, 0x5A, right is 0xA5, the '
     'inverted sum'),
    (goals, 1, False, 'each Sync Write has the wrong Length, 23, right is 22'),
    (goals, 'sum', False, 'each Sync Write has the wrong checksum, 0x5A, right is 0xA5, the '
     'inverted sum'),
    (goal_of_a_shell, '', True, 'each Write to 003 has the wrong Length, 9, right is 7, or 2 '
     'bytes 00 are missing'),
    (goal_2, 2, True, 'each Write to 001 has the wrong Length, 11, right is 9'),
    (goal_2, 'order', True, 'each Write to 001 has the wrong CRC, 0x53B5, right is 0xB553, low '
     'byte first'),
    (goal_2, 'order', False, 'each Write to 001 has the wrong CRC, 0x5021, right is 0x2150, low '
     'byte first'),
    (goal_2, 'CRC', True, 'each Write to 001 has the wrong CRC, 0x0000, right is 0xB553'),
])
def test_the_wrong_field_is_named(write, error, has_sides, says):
    assert found(write, error, has_sides, read_2=write is goal_2) == [says]


@pytest.mark.parametrize(('error', 'good_every'), [(0, 0), ('damage', 0), ('damage', 4), (1, 4)])
def test_damage_on_the_way_is_no_mistake_of_the_program(error, good_every):
    """Some are whole, or each is damaged in another way."""
    assert found(goals, error, False, good_every=good_every) == []


def test_noise_that_is_over_accuses_no_program():
    assert found(lambda turn, error: goals(turn, error if turn < 5 else 0), 1, True,
                 turns=500) == []
