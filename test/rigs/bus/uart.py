# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""
A UART at the level of its bits: what a receiver makes of a packet on a line that is not good.

The level of the line is followed in sixteenths of a bit: edges take time, noise and pulses are
added, the talker's clock may be off. The receiver is a usual one: it waits for a falling edge,
looks again in the middle of the start bit, and takes the majority of three samples around the
middle of each bit. Levels are shares of the swing, times are bit times of the receiver.
"""

from typing import NamedTuple

from rigs.bus.faults import spoiled
from rigs.bus.wire import BITS
from rigs.bus.wire import S

OVER = 16                          # samples per bit
THRESHOLD = 0.5
IDLE = 4                           # bits without a talker, in front of a packet and behind it


class Pulse(NamedTuple):
    """Something from outside that adds to the level for a while."""

    begin: float
    end: float
    level: float


class Line(NamedTuple):
    """What is not good about a line, for one packet."""

    clock: float = 1.0             # the talker's bit time, in bit times of the receiver
    rise: float = 0.0              # time constant of an edge that goes up, as with a weak pull-up
    fall: float = 0.0
    lift: float = 0.0              # what is added to the level all the time: ground is not ground
    noise: float = 0.0             # rms
    held: float = 0.0              # the line is still held high for so long into the packet
    lead: float = 0.0              # it lies low, undriven, for so long and until the packet begins
    pulses: tuple[Pulse, ...] = ()


GOOD = Line()


def received(data, line, random):
    """Return what a receiver makes of a packet."""
    if line == GOOD:
        return data
    return _sampled(_heights(_driven(data, line), line, random))


def _driven(data, line):
    """Return what the talker wants the level to be, in sixteenths of a bit."""
    bits = [1] * IDLE
    for byte in data:
        bits += [0, *(byte >> bit & 1 for bit in range(8)), 1]
    bits += [1] * IDLE
    count = round(len(bits) * line.clock * OVER)
    levels = [bits[min(len(bits) - 1, int(at / OVER / line.clock))] for at in range(count)]
    begin = round(IDLE * line.clock * OVER)
    for at in range(begin, min(count, begin + round(line.held * OVER))):
        levels[at] = 1
    gap = min(begin - OVER, round((IDLE - 1) * OVER))
    low = [0] * round(line.lead * OVER)
    return [*levels[:gap], *low, *levels[gap:]]


def _heights(levels, line, random):
    """Return whether the line is high, in sixteenths of a bit."""
    up = 1.0 if line.rise <= 0 else 1 / (1 + line.rise * OVER)
    down = 1.0 if line.fall <= 0 else 1 / (1 + line.fall * OVER)
    added = [0.0] * len(levels)
    for pulse in line.pulses:
        for at in range(max(0, round(pulse.begin * OVER)),
                        min(len(levels), round(pulse.end * OVER))):
            added[at] += pulse.level
    level, found = 1.0, []
    for at, wanted in enumerate(levels):
        level += (wanted - level) * (up if wanted > level else down)
        more = line.lift + added[at]
        if line.noise:
            more += random.gauss(0.0, line.noise)
        found.append(level + more > THRESHOLD)
    return found


def _sampled(is_high):
    found = bytearray()
    at, size = 1, len(is_high)
    while at < size:
        if is_high[at] or not is_high[at - 1]:
            at += 1
            continue
        if not _is_one(is_high, at + OVER // 2):       # else it was no start bit
            found.append(sum(_is_one(is_high, at + OVER // 2 + (bit + 1) * OVER) << bit
                             for bit in range(8)))
            at += OVER // 2 + 9 * OVER                 # the middle of the stop bit
            while at < size and not is_high[at]:       # a break: it needs an edge
                at += 1
        at += 1
    return bytes(found)


def _is_one(is_high, middle):
    return sum(is_high[at] for at in range(middle - 1, middle + 2) if at < len(is_high)) \
        + max(0, middle + 2 - len(is_high)) >= 2


# --- faults: what a line is like, packet by packet -----------------------------------------------

# A draw is a function of a Random, the bits of a packet and the time (bits): the line for it.


def bad_line(draw, who, at=2.0):
    """Send the packets of a talker (the start of its name) over a line that is not good."""
    return spoiled(lambda rig, now, data: received(
        data, draw(rig.random, BITS * len(data), now / (S / rig.wire.baud)), rig.random), who, at)


def varied(**given):
    """Let a line have these figures, or one between two from packet to packet."""
    return lambda random, size, now: Line(**{
        name: random.uniform(*one) if isinstance(one, tuple) else one
        for name, one in given.items()})


def glitches(share, least=0.5, most=1.0):
    """Let a pulse fall into a share of the packets, up or down, for about a bit."""
    def draw(random, size, now):
        if random.random() >= share:
            return GOOD
        begin = random.uniform(IDLE, IDLE + size)
        level = random.choice((-1.2, 1.2))
        return Line(pulses=(Pulse(begin, begin + random.uniform(least, most), level),))
    return draw


def beats(period, share):
    """Let a motor's PWM come through (period in bits): each edge, up and down, in some packets."""
    def draw(random, size, now):
        if random.random() >= share:
            return GOOD
        first = IDLE - now % period
        count = int((size + IDLE) / period) + 3
        return Line(pulses=tuple(Pulse(begin, begin + 0.8, (-1.2, 1.2)[turn % 2])
                                 for turn in range(count)
                                 for begin in (first + turn * period / 2,)))
    return draw


def floating(share):
    """Let the line lie low between two talkers, in a share of the packets: no pull-up."""
    def draw(random, size, now):
        return Line(lead=random.uniform(2.0, 12.0)) if random.random() < share else GOOD
    return draw
