# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""Faults of the simulated bus that sit on the wire, in a transceiver or in the listener's ear."""

from __future__ import annotations

from collections.abc import Iterator

from mecarover_fakes.fault import Effect
from mecarover_fakes.fault import Fault
from mecarover_fakes.fault import FaultScope
from mecarover_fakes.line import Burst
from mecarover_fakes.line import Exchange
from mecarover_fakes.line import STRAY
from mecarover_fakes.line import wire_ns
from msg_defs import dxl1_packet
from msg_defs.dxl_instruction import Instruction
from msg_defs.dxl_packet import encode
from msg_defs.dxl_packet import HEADER
from msg_defs.dxl_packet import STATUS
from msg_defs.uart import heard_at

OFTEN, SOMETIMES, RARELY = 0.2, 0.05, 0.01       # shares of bursts or exchanges
WRONG_BAUD = 2.0                 # what the listener is set to, as a multiple of the real rate


class Flip(Effect):
    """One bit of a byte arrives wrong."""

    share = RARELY

    def damage(self, burst: Burst) -> None:
        if burst.data and self.concerns(burst.sender) and self.rng.random() < self.share:
            data = bytearray(burst.data)
            data[self.rng.randrange(len(data))] ^= 1 << self.rng.randrange(8)
            burst.data = bytes(data)
            # A lost first header byte is repaired by the framing.
            burst.intact = (burst.intact and self.line.repairs_headers
                            and data[1:4] == HEADER[1:] and data[0] != HEADER[0])


class Drop(Effect):
    """A byte does not arrive."""

    def damage(self, burst: Burst) -> None:
        if burst.data and self.concerns(burst.sender) and self.rng.random() < RARELY:
            at = self.rng.randrange(len(burst.data))
            rest = burst.data[:at] + burst.data[at + 1:]
            # Either FF of a header may be the one that is lost: the framing repairs it.
            burst.intact &= (self.line.repairs_headers and burst.data.startswith(HEADER)
                             and rest == burst.data[1:])
            burst.data = rest


class Header(Effect):
    """The first byte of a status is missing or wrong, the rest is good."""

    longest = 1

    def damage(self, burst: Burst) -> None:
        if burst.sender < 0 or not self.concerns(burst.sender) \
                or not burst.data.startswith(self.line.header) or self.rng.random() > OFTEN:
            return
        count = self.rng.randint(1, self.longest)
        garbage = bytes(self.rng.choice((0x00, 0x80, 0xF8, 0xFE)) for _ in range(count))
        lost = self.rng.random() < 0.5
        burst.data = (b'' if lost else garbage) + burst.data[count:]
        burst.intact = burst.intact and count == 1 and self.line.repairs_headers


class Turnaround(Header):
    """The line turns round too late: one to three bytes of a status are missing or wrong."""

    exact = False                # a damaged last answer looks like one that never came
    longest = 3


class Glitch(Effect):
    """The driver enable leaves a byte on the line between packets."""

    def stray(self, exchange: Exchange) -> Iterator[Burst]:
        if self.rng.random() < SOMETIMES:
            start = exchange.end + wire_ns(2, self.line.baud)
            yield Burst(start, self.rng.choice((b'\x00', b'\xff')), STRAY, self.line.baud,
                        intact=False)


class Echo(Effect):
    """The adapter repeats what its master sends."""

    exact = False

    def stray(self, exchange: Exchange) -> Iterator[Burst]:
        asked = exchange.bursts[0]
        length = asked.end - asked.start
        for burst in exchange.bursts[1:]:
            burst.start += length
            burst.end += length
        yield Burst(asked.end, asked.data, STRAY, self.line.baud)


class Noise(Effect):
    """Disturbance on the wire: wrong bits in every direction, garbage in between."""

    exact = False

    def __init__(self, fault: Fault, scene: FaultScope) -> None:
        super().__init__(fault, scene)
        self._flip = Flip(fault, scene)
        self._flip.share = SOMETIMES

    def damage(self, burst: Burst) -> None:
        self._flip.damage(burst)

    def stray(self, exchange: Exchange) -> Iterator[Burst]:
        if self.fault.id is None and self.rng.random() < SOMETIMES:
            garbage = bytes(self.rng.randrange(256) for _ in range(self.rng.randint(1, 6)))
            yield Burst(exchange.end, garbage, STRAY, self.line.baud, intact=False)


class WrongBaud(Effect):
    """The listener runs at another rate than the bus."""

    exact = False

    def damage(self, burst: Burst) -> None:
        burst.data = heard_at(burst.data, WRONG_BAUD)
        burst.intact = False


class Foreign(Effect):
    """A status that no instruction asked for."""

    exact = False

    def stray(self, exchange: Exchange) -> Iterator[Burst]:
        if self.rng.random() < SOMETIMES:
            status = self.line.status_wire(self.device.id, 0, bytes(4))
            yield Burst(exchange.end, status, self.device.id, self.line.baud)


class Protocol1(Effect):
    """A Protocol 1.0 device on the same bus, and its master."""

    number = 200

    def stray(self, exchange: Exchange) -> Iterator[Burst]:
        if self.rng.random() < SOMETIMES:
            yield Burst(exchange.end, self.packets(), STRAY, self.line.baud, intact=False)

    def packets(self) -> bytes:
        """Return a question and its answer."""
        return dxl1_packet.encode(self.number, Instruction.READ, b'\x24\x08') \
            + dxl1_packet.encode(self.number, 0, bytes(range(0x20, 0x28)))


class Protocol2(Protocol1):
    """A Protocol 2.0 device on the same bus, and its master."""

    def packets(self) -> bytes:
        return encode(self.number, Instruction.READ, bytes((0x84, 0, 8, 0))) \
            + encode(self.number, STATUS, bytes(range(0x20, 0x28)), 0)
