# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""Kinds of damage at bit level, each under some programs, with figures drawn from a seed."""

from collections.abc import Callable
from functools import partial
from random import Random
from typing import NamedTuple

from rigs import damage
from rigs.bus import faults as f
from rigs.bus import masters as m
from rigs.bus import uart
from rigs.bus.scene import Scene

AT = 1.0                           # s: when it begins
ONE, SERVOS, ALL = 'servo 3 ', 'servo', ''
NOTHING = 'nothing'
CLOCK, LEVEL, INTERFERENCE, PWM = 'clock', 'level or edge', 'interference', 'PWM'
SPEAKERS, TURN, STRAY = 'two at once', 'turn-round', 'stray bytes'


class Kind(NamedTuple):
    """One kind. right: what may be said of it besides nothing; draw: its faults from a seed."""

    name: str
    right: tuple[str, ...]
    draw: Callable[[Random], tuple[Callable, ...]]


def _line(draw, who):
    return lambda random: (uart.bad_line(draw(random), who, AT),)


def _slow(random):
    off = random.uniform(0.058, 0.066)     # 8.5 bits of the receiver are then 8 of the talker
    return uart.varied(clock=(1 + off, 1.008 + off), noise=0.05)


def _fast(random):
    off = random.uniform(0.050, 0.062)
    return uart.varied(clock=(0.992 - off, 1 - off), noise=0.05)


def _edge(random):
    least = random.uniform(0.55, 0.62)
    return uart.varied(rise=(least, least + 0.12), noise=0.03)


def _lifted(random):
    least = random.uniform(0.34, 0.37)
    return uart.varied(lift=(least, least + 0.02), noise=0.07)


def _twin_apart(random):
    return (f.twin(3, AT, own_us=40 + random.randint(1, 60)),)


KINDS = (
    Kind('clock of one servo slow', (CLOCK,), _line(_slow, ONE)),
    Kind('clock of one servo fast', (CLOCK,), _line(_fast, ONE)),
    Kind('pull-up too weak', (LEVEL,), _line(_edge, SERVOS)),
    Kind('low level lifted, one servo', (LEVEL,), _line(_lifted, ONE)),
    Kind('glitches on the line', (INTERFERENCE,), _line(
        lambda random: uart.glitches(random.uniform(0.03, 0.2)), ALL)),
    Kind('PWM of a motor', (PWM, INTERFERENCE), _line(
        lambda random: uart.beats(random.uniform(40.0, 60.0), random.uniform(0.05, 0.2)), SERVOS)),
    Kind('turns round too late', (TURN,), _line(
        lambda random: uart.varied(held=(0.2, random.uniform(1.5, 6.0))), ONE)),
    Kind('no pull-up, the line floats', (STRAY, TURN), _line(
        lambda random: uart.floating(random.uniform(0.1, 0.5)), SERVOS)),
    Kind('two with one ID, same delay', (SPEAKERS,), lambda random: (f.twin(3, AT),)),
    Kind('two with one ID, delays apart', (SPEAKERS,), _twin_apart),
    Kind('bytes replaced by others', (), lambda random: (
        f.spoil(damage.replace_bytes, random.uniform(0.05, 0.2), SERVOS, at=AT),)),
    Kind('answers cut off', (), lambda random: (
        f.spoil(damage.cut_end, random.uniform(0.05, 0.2), SERVOS, 3, at=AT),)),
)
PROGRAMS = (
    ('item by item', partial(m.poller, rate=10.0, torque=True)),
    ('group read and write', partial(m.sdk_loop, rate=20.0)))


def scene_of(kind, master, seed):
    """Return a run of one kind."""
    random = Random(f'{kind.name} {seed}')
    return Scene(kind.name, master, faults=kind.draw(random), baud=random.choice(
        (57_600, 1_000_000, 1_000_000)))
