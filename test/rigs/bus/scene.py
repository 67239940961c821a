# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""What a scene is: a bus, a program, perhaps a fault, an adapter, and what must be said of it."""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

from rigs.bus import adapter
from rigs.bus import frames
from rigs.bus import frames1
from rigs.bus.rig import Rig
from rigs.bus.servo1 import Kind
from rigs.bus.servo1 import servo

SECONDS = 20.0
Key = tuple[str, int | None]       # rule, device (None: the bus)
WEAK = 'missed_answers dropout no_answer sync_read_stops'


class Scene(NamedTuple):
    """
    One run of 20 s.

    expected: what is really wrong; more than one where each says it. also: what else is true of
    this bus and may be said at WARN or ERROR. Nothing expected: a healthy bus.
    """

    name: str
    master: Callable
    expected: tuple[Key, ...] = ()
    faults: tuple[Callable, ...] = ()
    also: tuple[Key, ...] = ()
    ids: tuple[int, ...] = (1, 2, 3, 4, 5, 6)
    model: str | Kind = 'XL430-W250'
    firmware: int = 46
    delay: int = 0                 # Return Delay Time, 2 us units
    in_line: bool = True           # in a Sync Read they wait for the one before
    spares: tuple[int, ...] = ()   # servos that are there and are not in `ids`
    absent: tuple[int, ...] = ()   # IDs in `ids` without a servo
    baud: int = 1_000_000
    adapter: adapter.Kind = adapter.FULL_SPEED
    devices: tuple[str, ...] = ()  # the monitor's parameter
    latency_ms: float = 0.2        # the master's adapter
    wait_ms: float = 34.0
    why: str = ''                  # where the expectation needs a word
    since: float | None = None     # what is wrong is in the scene itself, from then on (s)

    def rig(self, seed):
        """Return the bus with its program, ready to run."""
        rig = Rig(self.baud, seed)
        for number in {*self.ids, *self.spares} - {*self.absent}:
            rig.add(servo(rig.wire, number, self.model, firmware=self.firmware, delay=self.delay,
                          in_line=self.in_line))
        rig.run_master(self.master, list(self.ids), 0.1, latency_ms=self.latency_ms,
                       wait_ms=self.wait_ms,
                       form=(frames if isinstance(self.model, str) else frames1).FORM)
        for fault in self.faults:
            fault(rig)
        if self.since is not None:
            rig.at(self.since, rig.alter)
        return rig


def keys(text):
    """
    Return the rules with their devices that a text names: 'weak dropout 1-3 5, noise'.

    Without a number, or for 'bus', it is the bus. 'weak': what is said of a device before it is
    clear what it has.
    """
    found = []
    for part in text.split(', ') if text else ():
        words = part.replace('weak', WEAK).split()
        rules = [word for word in words if not word[0].isdigit() and word != 'bus']
        ids = [number for word in words if word[0].isdigit() for number in numbers(word)]
        devices = [*ids, None] if 'bus' in words or not ids else [*ids]
        found += [(rule, number) for rule in rules for number in devices]
    return tuple(found)


def numbers(text):
    """Return the numbers that a text names: '1-3 5'."""
    ends = [[*map(int, word.split('-'))] for word in text.split()]
    return tuple(number for end in ends for number in range(end[0], end[-1] + 1))
