# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""
The programs that people run, as what they send, in which order, and what they do about failure.

After the public sources, read for behaviour and not copied: DynamixelSDK (Python, group read and
write examples), dynamixel_hardware_interface (start-up, indirect data, Fast Sync Read),
bitbots_ros_control with its dynamixel_workbench (Sync Read of 126, 144 and 70), LeRobot (motors
bus: handshake, calibration, one try, torque off at the end), a Wizard-like scan, a first program.
"""

from itertools import product
from math import sin

from rigs.bus import frames
from rigs.bus import servo as reg
from rigs.bus.frames import two
from rigs.bus.master import MS
from rigs.bus.master import Say
from rigs.bus.master import Sleep


def goal(port, number, swing=500.0):
    """Return where a servo is sent at this time: a slow wave."""
    return round(2048 + swing * sin(2 * port.seconds() + number)).to_bytes(4, 'little')


def goals(port, ids, at=reg.GOAL, size=4):
    """Return the group write that sends all of them there."""
    return Say(port.form.sync_write(at, size, [(one, goal(port, one)[:size]) for one in ids]))


def sdk_loop(port, ids, *, rate=100.0, address=reg.PLACE, size=4, goal_at=reg.GOAL, goal_size=4,
             torque=True, retries=0):
    """Group read, then group write, as the examples of the SDK do; rate 0: without a pause."""
    for number in ids if torque else ():
        yield from port.write(number, reg.TORQUE, b'\1')
    turns = port.turns(rate) if rate else None
    while True:
        for _ in range(retries + 1):
            found = yield from port.sync_read(ids, address, size)
            if len(found) == len(ids):
                break
        yield goals(port, ids, goal_at, goal_size)
        if turns:
            yield next(turns)


def hardware_interface(port, ids, *, rate=100.0, fast=True, pings=True, volts=True):
    """Start as dynamixel_hardware_interface does, then read and write indirect data."""
    items = [(reg.LOAD, 2), (reg.SPEED, 4), (reg.PLACE, 4), (reg.ERRORS, 1)]
    if volts:
        items += [(reg.VOLTS, 2), (reg.HEAT, 1)]
    watched = [at + byte for at, size in items for byte in range(size)]
    for number in ids if pings else ():
        yield from port.ping(number)
        yield from port.write(number, reg.TORQUE, b'\0')
        yield from port.write(number, reg.DELAY, b'\0')
        for slot, at in enumerate(watched):
            yield from port.write(number, reg.REDIRECTS + 2 * slot, two(at))
        yield from port.write(number, reg.TORQUE, b'\1')
        yield Sleep(port.now + 2 * MS)
    size, turns = len(watched), port.turns(rate)
    packet = frames.sync_read(
        ids, reg.REDIRECTED, size, frames.FAST_SYNC_READ if fast else frames.SYNC_READ)
    while True:
        if fast:
            yield from port.ask_fast(packet, ids, size)
        else:
            yield from port.ask_all(packet, ids, size)
        yield goals(port, ids)
        yield next(turns)


def bitbots(port, ids, *, board=0, rate=100.0):
    """Walk: all joints each cycle, supply and errors now and then, a board beside."""
    for number in ids:
        yield from port.ping(number)
    yield Say(frames.sync_write(reg.TORQUE, 1, [(one, b'\1') for one in ids]))
    turns, turn = port.turns(rate), 0
    while True:
        yield from port.sync_read(ids, 126, 10)
        if board:
            yield from port.read(board, 36, 16)
        if turn % 10 == 3:
            yield from port.sync_read(ids, 144, 3)
        if turn % 10 == 7:
            yield from port.sync_read(ids, 70, 1)
        yield goals(port, ids)
        turn += 1
        yield next(turns)


def lerobot(port, ids, *, rate=30.0, gives_up=True):
    """Run handshake, settings, a loop of one try; a failure ends it and the torque."""
    for number in ids:
        if (yield from port.ping(number)) is None:
            return
    for number in ids:
        yield from port.write(number, reg.TORQUE, b'\0')
        yield from port.write(number, reg.DELAY, b'\0')
    for at, size in ((20, 4), (52, 4), (48, 4), (10, 1)):
        yield from port.sync_read(ids, at, size)
    for number in ids:
        yield from port.write(number, reg.MODE, b'\3')
        yield from port.write(number, reg.TORQUE, b'\1')
    yield from lerobot_loop(port, ids, rate, gives_up, (reg.PLACE, 4), (reg.GOAL, 4),
                            (reg.TORQUE,))


def lerobot_loop(port, ids, rate, gives_up, place, goal_register, switches):
    """Try each group read once; a failure ends the loop and switches the torque off."""
    turns = port.turns(rate)
    while len((yield from port.sync_read(ids, *place))) == len(ids) or not gives_up:
        yield goals(port, ids, *goal_register)
        yield next(turns)
    for number, at in product(ids, switches):
        for _ in range(6):
            if (yield from port.write(number, at, b'\0')):
                break


def xs_start(port, ids):
    """Start as xs_sdk does: three rounds of Ping and torque off, also where the Ping failed."""
    for _ in range(3):
        for number in ids:
            yield from port.ping(number)
            yield from port.write(number, reg.TORQUE, b'\0')


def scan(port, ids, *, first=0, last=252, again=True, dwell_ms=3.0):
    """Look for servos as the Wizard does: a Ping to every ID; then whole tables of those found."""
    found = []
    port.wait_ms = dwell_ms
    for number in range(first, last + 1):
        answer = yield from port.ping(number)
        found += [number] if answer else []
    port.wait_ms = 34.0
    while again and found:
        for number in found:
            yield from port.read(number, 0, 147)
            yield Sleep(port.now + 20 * MS)


def beginner(port, ids, *, print_ms=4.0, address=reg.GOAL, wanted=reg.PLACE, torque=reg.TORQUE,
             size=4):
    """Do as a first program: send a goal, read the position for a while and print it."""
    for number in ids:
        yield from port.write(number, torque, b'\1')
    while True:
        for number in ids:
            place = goal(port, number)[:size]
            yield from port.write(number, address, place)
            for _ in range(8):
                yield from port.read(number, wanted, size)
                yield Sleep(port.now + round(port.random.expovariate(1 / print_ms) * MS))


def poller(port, ids, *, rate=20.0, torque=False, ping=False, writes=None, enables=True):
    """Item by item and device by device, as dynamixel_workbench: read, now and then write."""
    for number in () if not enables else ids if writes is None else writes:
        yield from port.write(number, reg.TORQUE, b'\1')
    turns = port.turns(rate)
    while True:
        for number in ids:
            if ping:
                yield from port.ping(number)
            if torque:
                yield from port.read(number, reg.TORQUE, 1)
            yield from port.read(number, reg.PLACE, 4)
            if writes is None or number in writes:
                yield from port.write(number, reg.GOAL, goal(port, number))
        yield next(turns)


def ping_flood(port, ids, *, every_ms=20.0):
    """Broadcast Pings one after the other, far faster than all can answer."""
    while True:
        yield Say(frames.instruction(frames.EVERYBODY, frames.PING))
        yield Sleep(port.now + round(every_ms * MS))


def setup_then(first, loop):
    """One program, then another, on the same port."""
    def both(port, ids):
        yield from first(port, ids)
        yield from loop(port, ids)
    return both


def beside(loop, extra, *, at=8.0, every_s=0.2):
    """Make a loop that does something else as well, between two turns."""
    def both(port, ids):
        due = at
        for step in loop(port, ids):
            if isinstance(step, Sleep) and port.seconds() >= due:
                due = port.seconds() + every_s
                yield from extra(port, ids)
            yield step
    return both


def asks(what):
    """One instruction with its answer."""
    def ask(port, ids):
        yield from what(port)
    return ask


def reads(number, at, size):
    """One Read of one device."""
    return asks(lambda port: port.read(number, at, size))


def writes(number, at, data):
    """One Write to one device."""
    return asks(lambda port: port.write(number, at, data))


def writes_eeprom(number, at, data):
    """Torque off, then a Write."""
    return setup_then(writes(number, reg.TORQUE, b'\0'), writes(number, at, data))


def sync_reads(at, size, *ids):
    """One Sync Read, of which the first answer is awaited."""
    return asks(lambda port: port.ask(port.form.sync_read(ids, at, size), ids[0], size))


def writes_unstuffed(number, at, data):
    """One Sync Write as the official Python SDK sends it."""
    def say(port, ids):
        yield Say(frames.UNSTUFFED.sync_write(at, len(data), [(number, data)]))
    return say
