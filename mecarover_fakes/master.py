# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""
The simulated master: plays a traffic pattern on the line, cycle by cycle, with faults and truth.

Pure: simulated time (ns from 0), one seed, an endless iterator of bursts in order of time.
It waits for its answers as the official SDK does: wire time of all answers + 34 ms.
"""

from __future__ import annotations

from collections.abc import Iterable
from collections.abc import Iterator
from random import Random

from mecarover_fakes.fault import Fault
from mecarover_fakes.fault import FaultScope
from mecarover_fakes.fault import MasterTiming
from mecarover_fakes.faults import Faults
from mecarover_fakes.ground_truth import GroundTruth
from mecarover_fakes.line import Burst
from mecarover_fakes.line import Exchange
from mecarover_fakes.line import Line
from mecarover_fakes.line import mix
from mecarover_fakes.line import wire_ns
from mecarover_fakes.traffic import Ask
from mecarover_fakes.traffic import Asks
from mecarover_fakes.traffic import Fleet
from mecarover_fakes.traffic import Pattern
from mecarover_fakes.traffic import start_up
from msg_defs.dxl_instruction import Answers
from msg_defs.nanoseconds import NS_PER_S

PATIENCE_NS = 34_000_000         # SDK: two latency timers of 16 ms, and 2 ms
GAP_NS = 100_000
ENDLESS_NS = 100_000_000         # exchanges that run into each other for so long
BROADCAST_PING_NS = 3_000_000    # a master cannot know who will come last
QUIET_NS = 10_000_000            # what an empty cycle of endless rate lasts


class Master:
    """
    A master on a line; `rate` in cycles per second, 0: as fast as the line allows.

    `started`: it was there before we listened, so no Pings and no torque on at the beginning.
    """

    def __init__(self, line: Line, pattern: Pattern, *, rate: float = 100.0,
                 faults: Iterable[Fault] = (), seed: int = 1, started: bool = False,
                 gap: int = GAP_NS, patience: int = PATIENCE_NS) -> None:
        self.line = line
        self.now = 0
        self.truth = GroundTruth()
        self.pattern = pattern
        self._started = started
        self._fleet = Fleet(line, lambda: self.now)
        self._timing = MasterTiming(round(NS_PER_S / rate) if rate else 0, gap, patience)
        self._rng = Random(seed)
        self.faults = Faults(list(faults), FaultScope(line, self._fleet, self._timing, self._rng))
        self._backlog: list[Exchange] = []
        self._pending: list[Burst] = []        # not yet decided, with what is around them
        self._busy_until = 0
        self._strays_until = 0
        self._until: int | None = None
        self._is_stopped = False

    def bursts(self, until: int | None = None) -> Iterator[Burst]:
        """Yield the bursts on the line until a time (None: until stop()), exchanges whole."""
        self._until = until
        self.faults.update(0)
        if self._started:
            for device in self._fleet.servos:
                device.set('Torque Enable', 1)
        else:
            yield from self._play(start_up(self._fleet))
        begin = self.now
        cycle = 0
        while not self.is_over(self.now):
            yield from self._play(self.pattern(self._fleet, cycle))
            for effect in self.faults.active:
                yield from self._play(effect.asks(cycle))
            cycle += 1
            begin = self._next_cycle(begin)
        self.now = max(self.now, self._busy_until)
        yield from self._flush()

    def stop(self) -> None:
        """End bursts() after the exchange in progress, or before it has begun."""
        self._is_stopped = True

    def respond(self, ask: Ask, now: int) -> list[Burst]:
        """Return the bursts on the line when a real master sends an instruction at `now`."""
        self.faults.update(now)
        self.now = now
        self._exchange(ask)
        self.now = self._busy_until
        return list(self._flush())

    def is_over(self, now: int) -> bool:
        """Tell whether bursts() has nothing more to come at `now`."""
        return self._is_stopped or (self._until is not None and now >= self._until)

    def _next_cycle(self, begin: int) -> int:
        """Move on to the next cycle; return when it should have begun."""
        timing = self._timing
        if not timing.period:
            if self.now == begin:
                self.now += QUIET_NS
            return self.now
        begin += timing.period
        late = round(timing.period * timing.jitter * self._rng.random())
        self.now = max(self.now, begin + late)
        self.faults.update(self.now)
        return max(begin, self.now - timing.period)    # a lost cycle is not made up for

    def _play(self, asks: Asks) -> Iterator[Burst]:
        for ask in asks:
            if self.is_over(self.now):
                return
            self.now += self._timing.pause
            self._timing.pause = 0
            yield from self._ask(ask)

    def _ask(self, ask: Ask) -> Iterator[Burst]:
        self.faults.update(self.now)
        for effect in self.faults.active:
            ask = effect.swap(ask)
        again: int | None = self.now
        while again is not None:
            self.now = again
            yield from self._flush()
            exchange = self._exchange(ask)
            again = next((at for effect in self.faults.active
                          if (at := effect.again_at(exchange)) is not None), None)
        self.now = self._free_at(exchange)

    def _exchange(self, ask: Ask) -> Exchange:
        exchange = self.line.exchange(ask.id, ask.instruction, ask.params, self.now,
                                      stuffed=ask.stuffed)
        self._add(exchange)
        for effect in self.faults.active:
            rival = effect.rival(exchange)
            if rival is not None:
                self._add(rival)
        return exchange

    def _add(self, exchange: Exchange) -> None:
        strays = [burst for effect in self.faults.active for burst in effect.stray(exchange)]
        self._backlog.append(exchange)
        self._pending += [*exchange.bursts, *strays]
        self._strays_until = max((burst.end for burst in strays), default=0)
        self._busy_until = max(self._busy_until, exchange.end, self._strays_until)

    def _free_at(self, exchange: Exchange) -> int:
        """Return when the master asks next: it has its answers, or has waited for them."""
        asked = exchange.bursts[0]
        if exchange.request.answers is Answers.EVERYBODY:
            wait = max(exchange.end - asked.end, BROADCAST_PING_NS)
        else:
            sizes = [access.length for access in exchange.request.accesses] or [0]
            size = sum(sizes) + self.line.status_size * len(sizes)
            wait = wire_ns(size, self.line.baud) + self._timing.patience
            if exchange.complete:
                wait = min(wait, exchange.end - asked.end)
        return max(asked.end + wait, self._strays_until) + self._timing.gap

    def _flush(self) -> Iterator[Burst]:
        """
        Yield what is decided: nothing that starts now can run into it any more.

        Exchanges whole, unless one runs into the other without an end.
        """
        if not self._pending or self._busy_until > self.now < self._pending[0].start + ENDLESS_NS:
            return
        mixed = mix(self._pending, self.line.baud)
        bursts = [burst for burst in mixed if burst.end <= self.now]
        self._pending = [burst for burst in mixed if burst.end > self.now]
        for burst in bursts:
            for effect in self.faults.active:
                if burst.start >= effect.fault.begin:
                    effect.damage(burst)
        self.truth.count_bursts(bursts)
        done = [exchange for exchange in self._backlog if exchange.end <= self.now]
        for exchange in sorted(done, key=lambda one: one.bursts[0].start):
            self.truth.count_exchange(exchange)
            self._backlog.remove(exchange)
        yield from bursts
