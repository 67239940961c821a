# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""Faults of the simulated bus that sit on the wire, in a transceiver or at the listener."""

from __future__ import annotations

from collections.abc import Iterator

from mecarover_fakes.fault import Effect
from mecarover_fakes.fault import FAMILY_1
from mecarover_fakes.fault import ONLY_2
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
OTHERS = 200                     # ID of a device of the other protocol


class Damage(Effect, is_fault=False):
    """A share of the bursts does not arrive as it was sent."""

    share = RARELY

    def damage(self, burst: Burst) -> None:
        if burst.data and self.concerns(burst.sender) and self.rng.random() < self.share:
            data, is_repaired = self.damaged(bytearray(burst.data))
            burst.data = bytes(data)
            burst.intact &= is_repaired and self.line.dialect is None

    def damaged(self, data: bytearray) -> tuple[bytearray, bool]:
        """Return what arrives, and whether the framing repairs it: the first byte of a header."""
        return data, True


class Flip(Damage):
    """One bit of a byte arrives wrong."""

    def damaged(self, data: bytearray) -> tuple[bytearray, bool]:
        data[self.rng.randrange(len(data))] ^= 1 << self.rng.randrange(8)
        return data, data[1:4] == HEADER[1:] and data[0] != HEADER[0]


class Drop(Damage):
    """A byte does not arrive."""

    def damaged(self, data: bytearray) -> tuple[bytearray, bool]:
        has_header, rest = data.startswith(HEADER), data[1:]
        del data[self.rng.randrange(len(data))]
        return data, has_header and data == rest         # either FF of a header may be lost


class Header(Damage):
    """The first byte of a status is missing or wrong, the rest is good."""

    share = OFTEN
    longest = 1

    def damage(self, burst: Burst) -> None:
        if burst.sender >= 0 and burst.data.startswith(self.line.header):
            super().damage(burst)

    def damaged(self, data: bytearray) -> tuple[bytearray, bool]:
        count = self.rng.randint(1, self.longest)
        garbage = bytes(self.rng.choice((0x00, 0x80, 0xF8, 0xFE)) for _ in range(count))
        data[:count] = b'' if self.rng.random() < 0.5 else garbage
        return data, count == 1


class Turnaround(Header):
    """The line turns round too late: one to three bytes of a status are missing or wrong."""

    longest = 3                  # a damaged last answer looks like one that never came


class Stray(Effect, is_fault=False):
    """Bytes that belong to no exchange, after some of them."""

    gap = 0                      # bytes of silence in front of them

    @property
    def sender(self) -> int:
        """Who sends them."""
        return STRAY

    def stray(self, exchange: Exchange) -> Iterator[Burst]:
        if self.rng.random() < SOMETIMES:
            yield Burst(exchange.end + wire_ns(self.gap, self.line.baud), self.data(),
                        self.sender, self.line.baud, intact=self.sender != STRAY)

    def data(self) -> bytes:
        """Return the bytes."""
        return b''


class Glitch(Stray):
    """The driver enable leaves a byte on the line between packets."""

    gap = 2

    def data(self) -> bytes:
        return self.rng.choice((b'\x00', b'\xff'))


class Noise(Flip, Stray):
    """Disturbance on the wire: wrong bits in every direction, garbage in between."""

    share = SOMETIMES

    def stray(self, exchange: Exchange) -> Iterator[Burst]:
        return super().stray(exchange) if self.fault.id is None else iter(())

    def data(self) -> bytes:
        return bytes(self.rng.randrange(256) for _ in range(self.rng.randint(1, 6)))


class Foreign(Stray):
    """A status that no instruction asked for."""

    @property
    def sender(self) -> int:
        return self.device.id

    def data(self) -> bytes:
        return self.line.status_wire(self.sender, 0, bytes(4))


class Protocol1(Stray):
    """A Protocol 1.0 device on the same bus, and its master."""

    protocols = ONLY_2

    def data(self) -> bytes:
        return dxl1_packet.encode(OTHERS, Instruction.READ, b'\x24\x08') \
            + dxl1_packet.encode(OTHERS, 0, bytes(range(0x20, 0x28)))


class Protocol2(Stray):
    """A Protocol 2.0 device on the same bus, and its master."""

    protocols = FAMILY_1

    def data(self) -> bytes:
        return encode(OTHERS, Instruction.READ, bytes((0x84, 0, 8, 0))) \
            + encode(OTHERS, STATUS, bytes(range(0x20, 0x28)), 0)


class Echo(Effect):
    """The adapter repeats what its master sends."""

    def stray(self, exchange: Exchange) -> Iterator[Burst]:
        asked = exchange.bursts[0]
        length = asked.end - asked.start
        for burst in exchange.bursts[1:]:
            burst.start += length
            burst.end += length
        yield Burst(asked.end, asked.data, STRAY, self.line.baud)


class WrongBaud(Effect):
    """The listener runs at another rate than the bus."""

    def damage(self, burst: Burst) -> None:
        burst.data = heard_at(burst.data, WRONG_BAUD)
        burst.intact = False
