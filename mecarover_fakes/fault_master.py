# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""Faults of the simulated bus that sit in the master's program or in its adapter."""

from __future__ import annotations

from mecarover_fakes.fault import Effect
from mecarover_fakes.fault import ONLY_2
from mecarover_fakes.fault import Play
from mecarover_fakes.line import Exchange
from mecarover_fakes.line import wire_ns
from mecarover_fakes.traffic import Ask
from mecarover_fakes.traffic import Asks
from mecarover_fakes.traffic import read
from mecarover_fakes.traffic import words
from mecarover_fakes.traffic import write
from mecarover_fakes.traffic import write_register
from msg_defs.dxl_instruction import Instruction
from msg_defs.nanoseconds import NS_PER_MS

LATENCY_NS = 16 * NS_PER_MS      # an FTDI adapter as delivered
RIVAL_PERIOD_NS = 37 * NS_PER_MS
# Torque Enable of another series: PRO (an X device has nothing there); X (an AX has nothing).
FOREIGN_TORQUE = {'2': 562, '1': 64}
HEADER_LIKE = b'\xff\xff\xfd\x00'


class Impatient(Effect):
    """The master gives up while the answer is on its way, and asks again."""

    share = 0.1

    def again_at(self, exchange: Exchange) -> int | None:
        answers = [answer for answer in exchange.answers if self.concerns(answer.id)]
        if not answers or self.rng.random() > self.share:
            return None
        burst = answers[0].burst
        return (burst.start + burst.end) // 2 if self.rng.random() < 0.5 \
            else exchange.end + wire_ns(1, self.line.baud)


class Latency(Effect):
    """The adapter hands over received bytes only every 16 ms."""

    def play(self) -> Play:
        self.timing.gap += LATENCY_NS
        yield
        self.timing.gap -= LATENCY_NS


class TwoMasters(Effect):
    """Another program asks on the same bus, in its own time."""

    over = 0                         # the last exchange

    def play(self) -> Play:
        self._due = self.fault.begin + RIVAL_PERIOD_NS
        yield

    def rival(self, exchange: Exchange) -> Exchange | None:
        over, self.over = self.over, exchange.end
        if self._due > exchange.end:
            return None
        due = max(self._due, over + wire_ns(1, self.line.baud))
        while self._due <= exchange.end:
            self._due += RIVAL_PERIOD_NS
        clash = any(burst.start < due + wire_ns(14, self.line.baud) and burst.end > due
                    for burst in exchange.bursts)
        exchange = self.line.exchange(self.device.id, Instruction.READ, words(0, 6), due,
                                      is_understood=not clash)
        exchange.bursts[0].written = ()         # by our master
        return exchange


class WrongMap(Effect):
    """The master uses the addresses of another model series."""

    protocols = ('2', '1')
    every = 5

    def ask(self) -> Asks:
        address = FOREIGN_TORQUE[self.line.protocol]
        yield write(self.device.id, address, b'\x01')
        yield read(self.device.id, address, 1)


class Eeprom(Effect):
    """The master writes an EEPROM register while the torque is on."""

    protocols = ONLY_2
    every = 10

    def ask(self) -> Asks:
        return write_register(self.device, 'Return Delay Time', b'\x00')


class EepromWear(Effect):
    """The master writes an EEPROM register again and again (torque off: it is accepted)."""

    def play(self) -> Play:
        self.device.set('Torque Enable', 0)
        yield

    def ask(self) -> Asks:
        field = self.device.field('Homing Offset') or self.device.field('Temperature Limit')
        if field is not None:
            yield write(self.device.id, field.at, self.device.bytes_in(field))


class Unstuffed(Effect):
    """The master does not stuff what it sends, as the official Python SDK."""

    protocols = ONLY_2
    every = 5

    def ask(self) -> Asks:
        name = 'Goal PWM' if self.device.field('Goal PWM') else 'LED'
        return write_register(self.device, name, HEADER_LIKE)

    def swap(self, ask: Ask) -> Ask:
        return ask._replace(stuffed=False)


class Overload(Effect):
    """The master wants more per cycle than the bus can carry."""

    def ask(self) -> Asks:
        room = self.timing.period
        while room > 0:
            for device in self.line.chain:
                length = min(146, len(device.image))
                yield read(device.id, 0, length)
                room -= wire_ns(14 + 11 + length, self.line.baud)


class Jitter(Effect):
    """The master's cycle time varies widely."""

    def play(self) -> Play:
        self.timing.jitter = 0.8
        yield
        self.timing.jitter = 0.0


class LateCycles(Effect):
    """The master begins 6 % of its cycles 1.5 periods late, and goes on from there."""

    def play(self) -> Play:
        self._usual = self.timing.period
        yield
        self.timing.period = self._usual

    def ask(self) -> Asks:
        is_late = self.rng.random() < 0.06
        self.timing.period = self._usual * 5 // 2 if is_late else self._usual
        return ()
