# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""
What a fault of the simulated bus is: Fault (when, where) and Effect (what it does to the bus).

The effects are in the other files fault_*.py. Each enters itself in Effect.kinds by the name of
its class: WrongBaud is `wrong_baud`.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from random import Random
import re
from typing import ClassVar
from typing import NamedTuple

from mecarover_fakes.fake_servo import FakeDevice
from mecarover_fakes.line import Burst
from mecarover_fakes.line import Exchange
from mecarover_fakes.line import Line
from mecarover_fakes.traffic import Ask
from mecarover_fakes.traffic import Asks
from mecarover_fakes.traffic import Fleet

ALL = ('2', '1', 'feetech')
ONLY_2 = ('2',)
FAMILY_1 = ('1', 'feetech')
Play = Iterator[None]


class Fault(NamedTuple):
    """A fault by name, for one ID or all, from `begin` to `end` (ns; None: for ever)."""

    name: str
    id: int | None = None
    begin: int = 0
    end: int | None = None


@dataclass
class MasterTiming:
    """How the master keeps time; faults may change it (all ns)."""

    period: int                  # ns for a cycle; 0: the next at once
    gap: int                     # between the end of a reply and the next instruction
    patience: int                # beyond the wire time of the answers
    jitter: float = 0.0          # as a share of the period
    pause: int = 0               # once, before the next instruction


class FaultScope(NamedTuple):
    """All that a fault can get at."""

    line: Line
    fleet: Fleet
    timing: MasterTiming
    rng: Random


class Effect:
    """
    What one fault does; every hook does nothing by default.

    protocols: in which it can happen. The line of documentation is for the user, too.
    """

    kinds: ClassVar[dict[str, type[Effect]]] = {}    # by name
    protocols: ClassVar[tuple[str, ...]] = ALL
    every: ClassVar[int] = 1         # cycles from one ask() to the next; 0: it comes once
    now = 0
    cycle = 0

    def __init_subclass__(cls, *, is_fault: bool = True) -> None:
        if is_fault:
            cls.kinds[re.sub('(?<=.)(?=[A-Z])', '_', cls.__name__).lower()] = cls

    def __init__(self, fault: Fault, scope: FaultScope) -> None:
        self.fault = fault
        self.line, self.fleet, self.timing, self.rng = scope
        self.has_asked = False

    @property
    def device(self) -> FakeDevice:
        """The device it is about: that of the ID, the first of the chain without one."""
        found = None if self.fault.id is None else self.line.at(self.fault.id)
        return found or self.line.chain[0]

    @property
    def devices(self) -> list[FakeDevice]:
        """The devices it is about: that of the ID, all without one."""
        return list(self.line.chain) if self.fault.id is None else [self.device]

    def concerns(self, number: int) -> bool:
        """Tell whether it is about this ID."""
        return self.fault.id in (None, number)

    def play(self) -> Play:
        """Begin, yield, end; `now` is the time."""
        parts = [self.affect_device(device) for device in self.devices]
        for part in parts:
            next(part)
        yield
        for part in parts:
            next(part, None)

    def affect_device(self, device: FakeDevice) -> Play:
        """Begin, yield, end, of one of `devices`."""
        yield

    def step(self) -> None:
        """See time pass; called before each instruction."""

    def asks(self, cycle: int) -> Asks:
        """Return what the master asks besides, at the end of a cycle."""
        if cycle % self.every if self.every else self.has_asked:
            return ()
        self.has_asked = True
        self.cycle = cycle
        return self.ask()

    def ask(self) -> Asks:
        """Return what the master asks besides, in a cycle in which it does."""
        return ()

    def swap(self, ask: Ask) -> Ask:
        """Return the instruction that the master really sends."""
        return ask

    def again_at(self, exchange: Exchange) -> int | None:
        """Return when the master sends the same instruction again, None if it waits."""
        return None

    def stray(self, exchange: Exchange) -> Iterator[Burst]:
        """Yield what else gets onto the line around an exchange."""
        return iter(())

    def rival(self, exchange: Exchange) -> Exchange | None:
        """Return an exchange of another master that runs into this one."""
        return None

    def damage(self, burst: Burst) -> None:
        """Change what the listener hears of a burst; clear `intact` where that spoils it."""
