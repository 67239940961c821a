# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""
The programs that people run on Protocol 1.0 and on Feetech servos, as what they send.

After the public sources, read for behaviour and not copied: LeRobot's Feetech bus with
feetech-servo-sdk 1.0.0 (connect, loop, end), the read_write example of DynamixelSDK with Protocol
1.0, dynamixel_motor (a round of reads), Phantom Phoenix, pypot. Both SDKs wait for the bytes and
34 ms more, take the first whole packet of the wanted ID, and stop a group read at a gap.
"""

from __future__ import annotations

from collections.abc import Generator

from rigs.bus import frames1 as frames
from rigs.bus.frames1 import Packet
from rigs.bus.master import Listen
from rigs.bus.master import MS
from rigs.bus.master import Port
from rigs.bus.master import Program
from rigs.bus.master import Say
from rigs.bus.master import Sleep
from rigs.bus.master import Step
from rigs.bus.masters import goal
from rigs.bus.masters import Ids


def receive(port: Port, wanted: int, until: int) -> Generator[Step, None, Packet | None]:
    """Return the next status of this ID, None for a time-out or a wrong sum."""
    data = port.input
    while True:
        start = data.find(frames.HEAD)
        if start >= 0 and len(data) >= start + frames.SMALLEST:
            size = 4 + data[start + 3]
            if data[start + 2] == 0xFF or size < frames.SMALLEST:
                del data[:start + 1]
                continue
            if len(data) >= start + size:
                found = frames.parse(bytes(data[start:start + size]))
                del data[:start + size]
                if not found or found[0].id == wanted:
                    return found[0] if found else None
                continue
        if port.now >= until:
            return None
        yield Listen(until)


def ask(port: Port, packet: bytes, wanted: int,
        size: int = 0) -> Generator[Step, None, Packet | None]:
    """Say an instruction to one device and return its status."""
    port.clear()
    yield Say(packet)
    return (yield from receive(port, wanted, port.patience(size + frames.SMALLEST)))


def ask_all(port: Port, packet: bytes, ids: Ids, size: int) -> Generator[Step, None, int]:
    """Say a group read; return how many answered up to the first that does not."""
    port.clear()
    yield Say(packet)
    until = port.patience((size + frames.SMALLEST) * len(ids))
    for count, number in enumerate(ids):
        if (yield from receive(port, number, until)) is None:
            return count
    return len(ids)


def _goals(port: Port, ids: Ids) -> list[tuple[int, bytes]]:
    return [(number, goal(port, number)[:2]) for number in ids]


def lerobot(port: Port, ids: Ids, *, rate: float = 30.0, gives_up: bool = True,
            firmware: bool = False) -> Program:
    """Connect, set up, and loop as LeRobot does with Feetech servos."""
    for number in ids:
        if (yield from ask(port, frames.packet(number, frames.PING), number)) is not None:
            yield from ask(port, frames.read(number, 3, 2), number, 2)
    for number in ids if firmware else ():
        yield from ask(port, frames.read(number, 0, 1), number, 1)
        yield from ask(port, frames.read(number, 1, 1), number, 1)
    for number in ids:
        for at, value in ((40, 0), (55, 0), (7, 0), (85, 254), (41, 254), (40, 1), (55, 1)):
            yield from ask(port, frames.write(number, at, bytes((value,))), number)
    due = port.now
    while True:
        count = yield from ask_all(port, frames.sync_read(ids, 56, 2), ids, 2)
        if count < len(ids) and gives_up:
            break
        yield Say(frames.sync_write(42, 2, _goals(port, ids)))
        sleep, due = port.pace(due, 1000 / rate)
        yield sleep
    for number in ids:
        for at in (40, 55):
            for _ in range(6):
                if (yield from ask(port, frames.write(number, at, b'\0'), number)):
                    break


def check(port: Port, ids: Ids) -> Program:
    """Look again and again which motors are there, as a user does who starts it again."""
    while True:
        for number in ids:
            if (yield from ask(port, frames.packet(number, frames.PING), number)) is not None:
                yield from ask(port, frames.read(number, 3, 2), number, 2)
        yield Sleep(port.now + 1000 * MS)


def read_write(port: Port, ids: Ids, *, print_ms: float = 4.0) -> Program:
    """Run the read_write example: torque on, a goal, the position until it is there."""
    for number in ids:
        yield from ask(port, frames.write(number, 24, b'\1'), number)
    while True:
        for number in ids:
            yield from ask(port, frames.write(number, 30, goal(port, number)[:2]), number)
            for _ in range(8):
                yield from ask(port, frames.read(number, 36, 2), number, 2)
                yield Sleep(port.now + round(port.random.expovariate(1 / print_ms) * MS))


def set_id(port: Port, ids: Ids, *, to: int = 5) -> Program:
    """Give a Feetech servo another ID as a simple tool does; Lock goes to the old one."""
    old = ids[0]
    yield from ask(port, frames.packet(old, frames.PING), old)
    for at, value in ((55, 0), (5, to), (55, 1)):
        yield from ask(port, frames.write(old, at, bytes((value,))), old)
    while True:
        yield from ask(port, frames.packet(to, frames.PING), to)
        yield from ask(port, frames.read(to, 56, 2), to, 2)
        yield Sleep(port.now + 50 * MS)


def sweep(port: Port, ids: Ids, *, rate: float = 30.0, turns: int = 20) -> Program:
    """Switch the torque of all on without a wait, again and again, and read them one by one."""
    due = port.now
    while True:
        for number in ids:
            yield Say(frames.write(number, 40, b'\1'))
        for _ in range(turns):
            for number in ids:
                yield from ask(port, frames.read(number, 56, 2), number, 2)
            sleep, due = port.pace(due, 1000 / rate)
            yield sleep


def rounds(port: Port, ids: Ids, *, rate: float = 16.0, size: int = 8) -> Program:
    """Read state from one servo after the other, as dynamixel_motor and pypot do."""
    due = port.now
    while True:
        for number in ids:
            yield from ask(port, frames.read(number, 36, size), number, size)
        yield Say(frames.sync_write(30, 2, _goals(port, ids)))
        sleep, due = port.pace(due, 1000 / rate)
        yield sleep


def hexapod(port: Port, ids: Ids, *, rate: float = 40.0) -> Program:
    """Write all goals at once, and read a position now and then."""
    due, turn = port.now, 0
    while True:
        yield Say(frames.sync_write(30, 4, [(one, place + b'\0\1') for one, place in
                                            _goals(port, ids)]))
        number = ids[turn % len(ids)]
        yield Sleep(port.now + 5 * MS)
        yield from ask(port, frames.read(number, 36, 2), number, 2)
        turn += 1
        sleep, due = port.pace(due, 1000 / rate)
        yield sleep


def duck(port: Port, ids: Ids, *, rate: float = 50.0) -> Program:
    """Read positions and speeds of all, write goals, fifty times a second; it goes on."""
    due = port.now
    while True:
        yield from ask_all(port, frames.sync_read(ids, 56, 2), ids, 2)
        yield from ask_all(port, frames.sync_read(ids, 58, 2), ids, 2)
        yield Say(frames.sync_write(42, 2, _goals(port, ids)))
        sleep, due = port.pace(due, 1000 / rate)
        yield sleep
