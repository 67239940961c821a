# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""
The simulated RS-485 line: an instruction goes in, bytes of master and devices come out, timed.

Times are ns of an arbitrary clock that the caller owns. Which device answers when: e-Manual,
Protocol 2.0, instruction packets; combined replies are sent piece by piece, one per device.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from dataclasses import InitVar
from typing import NamedTuple

from mecarover_fakes.fake_servo import FakeDevice
from mecarover_fakes.fake_servo import WATCHDOG_UNIT_NS
from msg_defs import dxl1_packet
from msg_defs.crc import crc16
from msg_defs.dxl1_instruction import Dialect
from msg_defs.dxl1_instruction import parse as parse_1
from msg_defs.dxl1_instruction import protocol_2_error
from msg_defs.dxl1_instruction import widen_instruction
from msg_defs.dxl_instruction import Access
from msg_defs.dxl_instruction import Answers
from msg_defs.dxl_instruction import Instruction
from msg_defs.dxl_instruction import NAMES
from msg_defs.dxl_instruction import parse
from msg_defs.dxl_instruction import Request
from msg_defs.dxl_packet import BROADCAST
from msg_defs.dxl_packet import encode
from msg_defs.dxl_packet import Framer
from msg_defs.dxl_packet import HEADER
from msg_defs.dxl_packet import STATUS
from msg_defs.servo_frame import Frame

MASTER = -1
STRAY = -2                       # bytes that were not sent on purpose
AnyFramer = Framer | dxl1_packet.Dxl1Framer
BITS_PER_BYTE = 10               # 8N1
BLOCK = 4                        # error, ID and CRC of each device in a combined status


@dataclass(eq=False)
class Burst:
    """
    Bytes that one sender puts on the line without a gap.

    written: what the master wrote for it, with the time of each; nothing on the wire changes that.
    """

    start: int
    data: bytes
    sender: int
    baud: InitVar[int]
    intact: bool = True

    def __post_init__(self, baud: int) -> None:
        self.end = self.start + wire_ns(len(self.data), baud)
        self.written = ((self.start, self.data),) * (self.sender == MASTER)


class Answer(NamedTuple):
    """What one device sent: error byte as in 2.0 and data, and their place on the line."""

    id: int
    error: int
    params: bytes
    burst: Burst


class Exchange(NamedTuple):
    """An instruction with all that follows from it; `due` are the IDs that must answer."""

    request: Request
    params: bytes
    bursts: list[Burst]          # the instruction first
    due: tuple[int, ...]
    answers: list[Answer]

    @property
    def end(self) -> int:
        """When the line is quiet again."""
        return max(burst.end for burst in self.bursts)

    @property
    def complete(self) -> bool:
        """Whether everybody who must answer did."""
        return {answer.id for answer in self.answers} >= set(self.due)


def wire_ns(count: int, baud: int) -> int:
    """Return the time that `count` bytes take on the line."""
    return count * BITS_PER_BYTE * 1_000_000_000 // baud


class Line:
    """
    A line at `baud` with devices in the order of the cable.

    dialect: of the 1.0 family; None: Protocol 2.0.
    `waits_in_line`: a device in a Sync or Bulk Read answers only after the one before it did, so
    that all after a silent one stay silent too; else they answer after its slot.
    """

    def __init__(self, devices: Iterable[FakeDevice], baud: int,
                 dialect: Dialect | None = None, *, waits_in_line: bool = True) -> None:
        self.chain = list(devices)
        self.baud = baud
        self.dialect = dialect
        self.waits_in_line = waits_in_line
        self.protocol = dialect.protocol if dialect else '2'         # as model files call it
        self.header = dxl1_packet.HEADER if dialect else HEADER
        self.status_size = 6 if dialect else 11      # bytes of a status without parameters
        self.addresses = 0x100 if dialect else 0x10000       # that an instruction can name
        self._heard_at = 0

    def at(self, number: int) -> FakeDevice | None:
        """Return the device with this ID."""
        return next((device for device in self.chain if device.id == number), None)

    def exchange(self, number: int, instruction: int, params: bytes, start: int, *,
                 stuffed: bool = True, is_understood: bool = True) -> Exchange:
        """Put an instruction on the line at `start`; devices that understand it, answer."""
        if self.dialect:
            narrowed = narrow(instruction, params)
            wire = dxl1_packet.encode(number, instruction, narrowed)
            request = parse_1(instruction, number, narrowed, self.dialect)
        else:
            wire = encode(number, instruction, params, stuffed=stuffed)
            request = parse(instruction, number, params)
        asked = Burst(start, wire, MASTER, self.baud)
        exchange = Exchange(request, params, [asked], self._due(request), [])
        if is_understood:
            self._watch(asked.end)
            self._answer(exchange, asked.end)
        return exchange

    # --- packets ---------------------------------------------------------------------------

    def status_wire(self, number: int, error: int, params: bytes) -> bytes:
        """Return the bytes of a status on the wire."""
        if self.dialect:
            return dxl1_packet.encode(number, error, params)
        return encode(number, STATUS, params, error)

    def knows(self, instruction: int) -> bool:
        """Tell whether there is such an instruction."""
        return instruction in (self.dialect.entries if self.dialect else NAMES)

    def framer(self) -> AnyFramer:
        """Return what finds the instructions of a real master in its bytes."""
        return dxl1_packet.Dxl1Framer() if self.dialect else Framer()

    def parse_frame(self, frame: Frame) -> tuple[int, int, bytes, bool]:
        """Return a frame's ID, instruction, parameters, and whether it was stuffed."""
        number, code, params, flaw = frame[3:]
        if self.dialect:
            return number, code, widen_instruction(code, number, params)[1], True
        return number, code, params, flaw is None or not flaw.unstuffed

    # --- devices ---------------------------------------------------------------------------

    def _watch(self, now: int) -> None:
        if now - self._heard_at > WATCHDOG_UNIT_NS:
            for device in self.chain:
                device.watch(now - self._heard_at)
        self._heard_at = now

    def _listening(self, number: int, now: int) -> list[FakeDevice]:
        return [device for device in self.chain
                if device.id == number and device.is_listening(self.baud, now)]

    def _due(self, request: Request) -> tuple[int, ...]:
        """Return who must answer, Status Return Level considered; an unknown device must."""
        if request.answers in (Answers.LISTED, Answers.COMBINED):
            asked = [access.id for access in request.accesses]
        else:                    # a Ping to all is due from none: who is there is unknown
            asked = [request.id] * (request.id != BROADCAST)
        return tuple(number for number in asked if (device := self.at(number)) is None
                     or device.acknowledges(request.instruction))

    # --- ways to answer --------------------------------------------------------------------

    def _answer(self, exchange: Exchange, now: int) -> None:
        request = exchange.request
        if request.answers is Answers.COMBINED:
            self._combined(exchange, now)
        elif request.answers is Answers.LISTED or request.instruction in _LISTED_WRITES:
            self._listed(exchange, now)
        elif request.id != BROADCAST:
            self._obey(exchange, self._listening(request.id, now), now)
        elif request.instruction != Instruction.FACTORY_RESET or exchange.params != b'\xff':
            # The latter is ignored by firmware 42 and later.
            numbers = sorted({device.id for device in self.chain})
            for devices in [self._listening(number, now) for number in numbers]:
                now = self._obey(exchange, devices, now)

    def _obey(self, exchange: Exchange, devices: list[FakeDevice], now: int,
              access: Access | None = None) -> int:
        """Let devices do what they are asked for, and answer; return when they have."""
        request, end = exchange.request, now
        for device in devices:
            # Read the policy first: the instruction may change it, or take the device away.
            number, start, alert = device.id, now + device.return_delay_ns, device.error_byte(0)
            answers = device.acknowledges(request.instruction)
            if access is None:
                reply = device.execute(request.instruction, exchange.params, now)
            elif access.data is None:
                reply = device.read(access.address, access.length, now)
            else:
                reply = device.write(access.address, access.data, now)
            if answers and (request.id != BROADCAST or request.answers is not Answers.NONE):
                error = reply.error | alert
                end = max(end, self._send(exchange, number, error, reply.params, start))
        return end

    def _send(self, exchange: Exchange, number: int, error: int, params: bytes, start: int,
              wire: bytes = b'') -> int:
        """Put a status, or that part of a combined one, on the line; return when it ends."""
        burst = Burst(start, wire or self.status_wire(number, error, params), number, self.baud)
        exchange.bursts.append(burst)
        if self.dialect:
            error = protocol_2_error(error, self.dialect)
        exchange.answers.append(Answer(number, error, params, burst))
        return burst.end

    def _listed(self, exchange: Exchange, now: int) -> None:
        for access in exchange.request.accesses:
            end = self._obey(exchange, self._listening(access.id, now), now, access)
            if end == now and access.data is None:
                if self.waits_in_line:
                    return
                end += wire_ns(access.length + self.status_size, self.baud)
            now = end

    def _combined(self, exchange: Exchange, now: int) -> None:
        accesses = exchange.request.accesses
        length = 1 + sum(access.length + BLOCK for access in accesses)
        status = bytearray(HEADER + bytes([BROADCAST, *length.to_bytes(2, 'little'), STATUS]))
        sent = 0
        for access in accesses:
            device = next(iter(self._listening(access.id, now)), None)
            if device is None or not device.has_fast_reads:
                return
            reply = device.read(access.address, access.length, now)
            error, data = device.error_byte(reply.error), reply.params or bytes(access.length)
            status += bytes([error, access.id]) + data
            status += crc16(status).to_bytes(2, 'little')
            start = now if sent else now + device.return_delay_ns
            now = self._send(exchange, access.id, error, data, start, bytes(status[sent:]))
            sent = len(status)


_LISTED_WRITES = (Instruction.SYNC_WRITE, Instruction.BULK_WRITE)


def mix(bursts: Iterable[Burst], baud: int) -> list[Burst]:
    """
    Return the bursts on the line, in order of time.

    Where two senders overlap neither is intact, and a bit is low as soon as one drives it low.
    """
    mixed: list[Burst] = []
    half_a_byte = wire_ns(1, baud) // 2
    for burst in sorted(bursts, key=lambda one: one.start):
        if mixed and burst.start + half_a_byte < mixed[-1].end:
            mixed[-1] = _clash(mixed[-1], burst, baud)
        else:
            mixed.append(burst)
    return mixed


def _clash(first: Burst, second: Burst, baud: int) -> Burst:
    first.intact = second.intact = False
    offset = round((second.start - first.start) / wire_ns(1, baud))
    both = bytearray(max(len(first.data), offset + len(second.data)))
    both[:len(first.data)] = first.data
    for at, byte in enumerate(second.data, offset):
        both[at] = both[at] & byte if at < len(first.data) else byte
    clash = Burst(first.start, bytes(both), STRAY, baud, intact=False)
    clash.written = first.written + second.written
    return clash


def narrow(instruction: int, params: bytes) -> bytes:
    """Return parameters of 2.0 with addresses and sizes as wide as those of 1.0."""
    if len(params) < len(b'\0\0\0'):            # nothing, or what makes no sense
        return params
    if instruction in (Instruction.READ, Instruction.SYNC_READ, Instruction.SYNC_WRITE):
        return params[:1] + params[2:3] + params[4:]
    if instruction in (Instruction.WRITE, Instruction.REG_WRITE):
        return params[:1] + params[2:]
    if instruction == Instruction.BULK_READ:
        return b'\0' + b''.join(bytes((params[at + 3], params[at], params[at + 1]))
                                for at in range(0, len(params) - 4, 5))
    return params

