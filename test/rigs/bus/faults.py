# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""
What goes wrong on a rig. Each fault is a function of the rig; `at` is in seconds.

Each one notes when the first byte is different because of it, by itself: a dead servo when its
first answer is not there, not when its supply ended.
"""

from functools import partial

from rigs.bus import frames
from rigs.bus import frames1
from rigs.bus import servo as reg
from rigs.bus.servo1 import servo
from rigs.bus.wire import S


def _both(*faults):
    def fault(rig):
        for one in faults:
            one(rig)
    return fault


def _altering(at, do):
    """Do something at a time that changes the bytes from then on."""
    return lambda rig: rig.altering(at, lambda: do(rig))


def attribute(number, at=8.0, **values):
    """Change plain attributes of a servo."""
    def fault(rig):
        for name, value in values.items():
            assert hasattr(rig.servos[number], name)
            rig.at(at, partial(setattr, rig.servos[number], name, value))
    return fault


def changed(number, at=8.0, **values):
    """Change plain attributes of a servo, with which its bytes are different at once."""
    return _both(attribute(number, at=at, **values), _altering(at, lambda rig: None))


def dead(number, at=8.0):
    """End the supply of a servo, or pull the plug in front of it."""
    return _both(attribute(number, at=at, is_on=False), _silence(number, at))


def deaf(number, at=8.0):
    """Let it hear nothing any more."""
    return _both(attribute(number, at=at, is_deaf=True), _silence(number, at))


def _silence(number, at):
    """Note the first instruction that this servo would have answered."""
    group = (frames.SYNC_READ, frames.FAST_SYNC_READ)

    def fault(rig):
        def hear(heard):
            if rig.altered is None and rig.clock.now >= at * S and any(
                    packet.id == number or packet.instruction in group
                    for packet in frames.parse(heard.data, fast=True)):
                rig.alter()
        rig.wire.listeners.append(hear)
    return fault


def loose(number, share, at=8.0):
    """Loosen a plug: some answers are not there."""
    return lambda rig: attribute(number, at=at, loses=lambda: rig.random.random() < share)(rig)


def away(number, at=12.0, seconds=0.4, restart=True):
    """Take the supply away for a moment: RAM is at its defaults afterwards."""
    def back(rig):
        if restart:
            rig.at(at + seconds, rig.servos[number].start)
    return _both(_silence(number, at), attribute(number, at=at, is_on=False),
                 attribute(number, at=at + seconds, is_on=True), back)


def latched(number, bits=0x20, at=8.0, *, torque_off=True):
    """Latch a hardware error (e-Manual, Hardware Error Status)."""
    latch = register(number, reg.ERRORS, 1, bits, at)
    return _both(latch, register(number, reg.TORQUE, 1, 0, at)) if torque_off else latch


def register(number, at_register, size, value, at=0.0):
    """Give a register this value."""
    return _altering(at, lambda rig: rig.servos[number].put(at_register, size, value))


def _ramped(attribute, first, number, last, at=2.0, seconds=12.0):
    """Let an attribute of a servo go from one value to another; nine tenths of the way alter."""
    def fault(rig):
        rig.at(at + 0.9 * seconds, rig.alter)
        setattr(rig.servos[number], attribute, lambda: first + (last - first) * min(1.0, max(
            0.0, (rig.clock.now / S - at) / seconds)))
    return fault


heating = partial(_ramped, 'heat', 40.0)       # near its limit at the end
sagging = partial(_ramped, 'volts', 12.0)      # as the supply from a battery that is nearly empty


def supply(volts):
    """Feed XL330, whose limits are 3.5 and 7.0 V."""
    def fault(rig):
        for one in rig.servos.values():
            one.put(reg.MAX_VOLTS, 2, 70)
            one.put(reg.MIN_VOLTS, 2, 35)
            one.volts = lambda: volts
    return fault


def spoiled(change, who, at):
    """Change the bytes of a talker (the start of its name), packet by packet."""
    def fault(rig):
        def spoiler(now, talker, data):
            if now < at * S or not (talker + ' ').startswith(who):
                return data
            heard = change(rig, now, data)
            if heard != data:
                rig.alter()
            return heard
        rig.wire.spoilers.append(spoiler)
    return fault


def spoil(change, share, *who, at=8.0):
    """Change a share of the packets of all, of 'servo' or of 'servo', 3."""
    return spoiled(lambda rig, now, data: change(rig.random, data)
                   if rig.random.random() < share else data, ''.join(f'{one} ' for one in who), at)


def first_byte(random, data):
    """Damage the first byte, as a line that turns round too late."""
    return bytes((random.choice((0xFE, 0xFC, 0x7F, 0xF0)),)) + data[1:]


def lost_first(random, data):
    """Leave the first byte out."""
    return data[1:]


def stray(random, data):
    """Put a byte in front that was never said."""
    return b'\0' + data


def acknowledgement(random, data):
    """Leave out a status without data."""
    return data if len(data) > 11 else b''


def echo(at=0.0):
    """Let the adapter of the master echo what it sends."""
    return spoiled(lambda rig, now, data: data + data, 'master', at)


def twin(number, at=0.0, *, own_us=40, model='XL430-W250', place=1000.0):
    """Add a second servo with the same ID."""
    def fault(rig):
        def join():
            other = servo(rig.wire, number, model, own_us=own_us)
            other.stand(place)
            other.tremor = number + 1.6    # two joints never stand in the same place to the step
            other.changed = rig.alter
            rig.alter()
        rig.at(at, join)
    return fault


def master_stops(at=10.0):
    return _altering(at, lambda rig: rig.ports[0].stop())


def second_master(master, ids, at=6.0, **options):
    """Another program on the same line."""
    def fault(rig):
        rig.run_master(master, ids, at, **options)
        rig.at(at, rig.alter)
    return fault


def _repeated(do, at, period):
    """Do something that changes the bytes again and again."""
    def fault(rig):
        def turn():
            do(rig)
            rig.alter()
            rig.at(rig.clock.now / S + period + rig.random.random() / 300, turn)
        rig.at(at, turn)
    return fault


def elsewhere(number, at=8.0):
    """Let a master that this line does not hear ask a servo that it hears."""
    def answer(rig):
        data = bytes(rig.servos[number].table[reg.PLACE:reg.PLACE + 4])
        rig.wire.talk(f'servo {number}', frames.status(number, 0, data))
    return _repeated(answer, at, 0.05)


def protocol_1(at=6.0):
    """Ask a device of Protocol 1.0, and let it answer (e-Manual, Protocol 1.0)."""
    def ask(rig):
        rig.wire.talk('master 0', frames1.read(9, 36, 2))
        rig.at(rig.clock.now / S + 0.0003, lambda: rig.wire.talk(
            'servo 9', frames1.packet(9, 0, b'\0\2')))
    return _repeated(ask, at, 0.1)


def wait_less(ms, at=8.0):
    """Make the time-out of the program shorter than the answers take."""
    return _altering(at, lambda rig: setattr(rig.ports[0], 'wait_ms', ms))


def busy_host(ms, at=6.0):
    """Let the master's computer be late, differently each time."""
    return _altering(at, lambda rig: setattr(
        rig.ports[0], 'slow_ms', lambda: rig.random.expovariate(1 / ms)))
