# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""
The programs that people run on Protocol 1.0 and on Feetech servos, as what they send.

After the public sources, read for behaviour and not copied: LeRobot's Feetech bus with
feetech-servo-sdk 1.0.0 (connect, loop, end), the read_write example of DynamixelSDK with Protocol
1.0, dynamixel_motor (a round of reads), Phantom Phoenix, pypot. Both SDKs wait for the bytes and
34 ms more, take the first whole packet of the wanted ID, and stop a group read at a gap.
"""

from functools import partial

from rigs.bus import frames1 as frames
from rigs.bus.master import MS
from rigs.bus.master import Say
from rigs.bus.master import Sleep
from rigs.bus.masters import beginner
from rigs.bus.masters import goal
from rigs.bus.masters import goals
from rigs.bus.masters import lerobot_loop


def lerobot_feetech(port, ids, *, rate=30.0, gives_up=True, firmware=False):
    """Connect, set up, and loop as LeRobot does with Feetech servos."""
    for number in ids:
        if (yield from port.ping(number)) is not None:
            yield from port.read(number, 3, 2)
    for number in ids if firmware else ():
        yield from port.read(number, 0, 1)
        yield from port.read(number, 1, 1)
    for number in ids:
        for at, value in ((40, 0), (55, 0), (7, 0), (85, 254), (41, 254), (40, 1), (55, 1)):
            yield from port.write(number, at, bytes((value,)))
    yield from lerobot_loop(port, ids, rate, gives_up, (56, 2), (42, 2), (40, 55))


def check(port, ids):
    """Look again and again which motors are there, as a user does who starts it again."""
    while True:
        for number in ids:
            if (yield from port.ping(number)) is not None:
                yield from port.read(number, 3, 2)
        yield Sleep(port.now + 1000 * MS)


read_write = partial(beginner, address=30, wanted=36, torque=24, size=2)


def set_id(port, ids, *, to=5):
    """Give a Feetech servo another ID as a simple tool does; Lock goes to the old one."""
    old = ids[0]
    yield from port.ping(old)
    for at, value in ((55, 0), (5, to), (55, 1)):
        yield from port.write(old, at, bytes((value,)))
    while True:
        yield from port.ping(to)
        yield from port.read(to, 56, 2)
        yield Sleep(port.now + 50 * MS)


def sweep(port, ids, *, rate=30.0, reads=20):
    """Switch the torque of all on without a wait, again and again, and read them one by one."""
    turns = port.turns(rate)
    while True:
        for number in ids:
            yield Say(frames.write(number, 40, b'\1'))
        for _ in range(reads):
            for number in ids:
                yield from port.read(number, 56, 2)
            yield next(turns)


def rounds(port, ids, *, rate=16.0, size=8, torque=True):
    """Read state from one servo after the other, as dynamixel_motor and pypot do."""
    for number in ids if torque else ():
        yield from port.write(number, 24, b'\1')
    turns = port.turns(rate)
    while True:
        for number in ids:
            yield from port.read(number, 36, size)
        yield goals(port, ids, 30, 2)
        yield next(turns)


def hexapod(port, ids, *, rate=40.0):
    """Write all goals at once, and read a position now and then."""
    yield Say(frames.sync_write(24, 1, [(one, b'\1') for one in ids]))
    turns, turn = port.turns(rate), 0
    while True:
        yield Say(frames.sync_write(30, 4, [(one, goal(port, one)[:2] + b'\0\1')
                                            for one in ids]))
        number = ids[turn % len(ids)]
        yield Sleep(port.now + 5 * MS)
        yield from port.read(number, 36, 2)
        turn += 1
        yield next(turns)
