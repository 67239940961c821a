# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""
What the simulated master asks: one function per traffic pattern, in PATTERNS by name.

A pattern yields the instructions of one cycle; it is advanced instruction by instruction, so that
its goals are those of the time at which they go out. `read_write` and `ping` are experiments 2
and 3 of the thesis, `moving` follows the cycle of its robot trace.
"""

from __future__ import annotations

from collections.abc import Callable
from collections.abc import Iterable
from typing import NamedTuple

from mecarover_fakes.fake_servo import FakeDevice
from mecarover_fakes.line import BLOCK
from mecarover_fakes.line import Line
from mecarover_fakes.values import pack
from msg_defs.dxl_instruction import Instruction
from msg_defs.dxl_packet import BROADCAST
from servobus.model.control_table import Field

LOOK_AHEAD_S = 0.02              # a goal is where the joint shall be a little later
SLOW = 25                        # cycles between two looks at voltage and temperature
IDLE_CYCLES = 100
ROOM = 1000                      # bytes of parameters: a device's buffer is 1 KiB


class Ask(NamedTuple):
    """One instruction of the master."""

    id: int
    instruction: int
    params: bytes = b''
    stuffed: bool = True


class CommonRange(NamedTuple):
    """A range of registers that a list of devices has in common."""

    address: int
    length: int
    ids: tuple[int, ...]


Asks = Iterable[Ask]
Pattern = Callable[['Fleet', int], Asks]


class Fleet:
    """The devices of a line as the master knows them."""

    def __init__(self, line: Line, clock: Callable[[], int]) -> None:
        self.line = line
        self._clock = clock
        self.devices = list(line.chain)
        self.id_of = {device: device.id for device in self.devices}    # as it takes them for
        self.servos = [device for device in self.devices if device.field('Goal Position')]
        self.boards = [device for device in self.devices if not device.field('Goal Position')]
        self.unwritten: set[int] = set()     # the master never writes to these

    def spans(self, *names: str) -> list[CommonRange]:
        """Return the ranges that cover these registers, devices with equal addresses together."""
        groups: dict[tuple[int, int], list[int]] = {}
        for device, number in self.id_of.items():
            fields = [field for name in names if (field := device.field(name)) is not None
                      and field.at < self.line.addresses]
            if fields:
                first, end = min(f.at for f in fields), max(f.end for f in fields)
                groups.setdefault((first, end - first), []).append(number)
        return [CommonRange(*place, tuple(ids)) for place, ids in groups.items()]

    def read(self, *names: str) -> Asks:
        """Read these registers of all, one by one where there is no Sync Read."""
        for span in self.spans(*names):
            if self.line.knows(Instruction.SYNC_READ):
                yield from sync_read(span)
            else:
                yield from (read(number, span.address, span.length) for number in span.ids)

    def goals(self) -> list[tuple[int, int, bytes]]:
        """Return what to write to the servos' Goal Positions: ID, address, data."""
        found = []
        for device in self.servos:
            number = self.id_of[device]
            if number not in self.unwritten and device.motion is not None:
                field = device.model.by_name['Goal Position']
                angle = device.motion.angle(self._clock() * 1e-9 + LOOK_AHEAD_S)
                found.append((number, field.at, pack(field, angle)))
        return found


def words(*numbers: int) -> bytes:
    """Return 16-bit words as bytes of an instruction."""
    return b''.join(number.to_bytes(2, 'little') for number in numbers)


def read(number: int, address: int, length: int) -> Ask:
    """Ask one device for registers."""
    return Ask(number, Instruction.READ, words(address, length))


def write(number: int, address: int, data: bytes) -> Ask:
    """Write registers of one device."""
    return Ask(number, Instruction.WRITE, words(address) + data)


def read_register(device: FakeDevice, name: str) -> Asks:
    """Ask a device for a register, if it has it."""
    field = device.field(name)
    if field is not None:
        yield read(device.id, field.at, field.size)


def write_register(device: FakeDevice, name: str, data: bytes) -> Asks:
    """Write a register of a device, if it has it."""
    field = device.field(name)
    if field is not None:
        yield write(device.id, field.at, data)


def sync_read(span: CommonRange, instruction: int = Instruction.SYNC_READ) -> Asks:
    """Ask several devices for the same registers."""
    return _to_many(instruction, words(span.address, span.length),
                    ((bytes([number]), span.length + BLOCK) for number in span.ids))


def sync_write(address: int, data: list[tuple[int, bytes]]) -> Asks:
    """Write the same registers of several devices."""
    return _to_many(Instruction.SYNC_WRITE, words(address, len(data[0][1])),
                    ((bytes([number]) + content, len(content) + 1) for number, content in data))


def bulk_read(spans: list[CommonRange], instruction: int = Instruction.BULK_READ) -> Asks:
    """Ask several devices, each for its own registers."""
    entries = ((bytes([number]) + words(span.address, span.length), span.length + BLOCK)
               for span in spans for number in span.ids)
    return _to_many(instruction, b'', entries)


def bulk_write(data: Iterable[tuple[int, int, bytes]]) -> Asks:
    """Write several devices, each its own registers (id, address, data)."""
    entries = (bytes([number]) + words(address, len(content)) + content
               for number, address, content in data)
    return _to_many(Instruction.BULK_WRITE, b'', ((entry, len(entry)) for entry in entries))


def _to_many(instruction: int, head: bytes, entries: Iterable[tuple[bytes, int]]) -> Asks:
    """Ask many devices, with (parameters, bytes that they or the answer take) for each."""
    params, room = head, ROOM
    for entry, size in entries:
        if size > room:
            yield Ask(BROADCAST, instruction, params)
            params, room = head, ROOM
        params += entry
        room -= size
    if params != head:
        yield Ask(BROADCAST, instruction, params)


def start_up(fleet: Fleet) -> Asks:
    """Do what a robot's master does first: look who is there, switch the torque on."""
    for device, number in fleet.id_of.items():
        yield Ask(number, Instruction.PING)
        if fleet.line.dialect:     # its Ping does not say which model it is
            yield read(number, device.model.by_name['Model Number'].at, 2)
    for device in fleet.servos:
        field = device.field('Torque Enable')
        number = fleet.id_of[device]
        if field is not None and number not in fleet.unwritten:
            yield write(number, field.at, b'\x01')


def moving(fleet: Fleet, cycle: int) -> Asks:
    """Walk like the robot of the trace: positions, one board after the other, goals."""
    yield from fleet.read('Present Position', 'Present Velocity', 'Present Current')
    if fleet.boards:
        board = _sensor_span(fleet.boards[cycle % len(fleet.boards)])
        yield read(board.ids[0], board.address, board.length)
    yield from _goals(fleet)
    if cycle % SLOW == 1:
        yield from fleet.read('Present Input Voltage', 'Present Temperature')
    if cycle % SLOW == 2:
        yield from fleet.read('Hardware Error Status')


def sync(fleet: Fleet, cycle: int) -> Asks:
    """Sync Read of positions and Sync Write of goals, nothing else."""
    yield from fleet.read('Present Position')
    yield from _goals(fleet)


def bulk(fleet: Fleet, cycle: int) -> Asks:
    """Bulk Read of positions and boards, Bulk Write (in 1.0 Sync Write) of goals."""
    yield from bulk_read(_everything(fleet))
    if fleet.line.knows(Instruction.BULK_WRITE):
        yield from bulk_write(fleet.goals())
    else:
        yield from _goals(fleet)


def fast(fleet: Fleet, cycle: int) -> Asks:
    """Fast Sync Read of positions, every other time Fast Bulk Read, and goals."""
    if cycle % 2:
        yield from bulk_read(_everything(fleet), Instruction.FAST_BULK_READ)
    else:
        for span in fleet.spans('Present Position'):
            yield from sync_read(span, Instruction.FAST_SYNC_READ)
    yield from _goals(fleet)


def registered(fleet: Fleet, cycle: int) -> Asks:
    """Goals by Reg Write to each servo, then one Action for all."""
    for number, address, data in fleet.goals():
        yield Ask(number, Instruction.REG_WRITE, words(address) + data)
    yield Ask(BROADCAST, Instruction.ACTION)
    yield from fleet.read('Present Position')


def read_write(fleet: Fleet, cycle: int) -> Asks:
    """
    Experiment 2 of the thesis: each device with every kind of read and write.

    What is written is what is there. A device without a register to write is only read.
    """
    everything = _everything(fleet)
    for device in fleet.devices:
        span = next(span for span in everything if device.id in span.ids)
        own = span._replace(ids=(device.id,))
        yield Ask(device.id, Instruction.PING)
        yield read(device.id, span.address, span.length)
        yield from sync_read(own)
        yield from bulk_read([own])
        field = _harmless(device)
        if field is not None:
            data = device.bytes_in(field)
            yield write(device.id, field.at, data)
            yield from sync_write(field.at, [(device.id, data)])
            yield from bulk_write([(device.id, field.at, data)])


def _harmless(device: FakeDevice) -> Field | None:
    """Return a register in RAM that may be written at any time, None where there is none."""
    return device.field('LED') or device.field('Goal Position') or next(
        (field for field in device.model.fields
         if field.access == 'rw' and field.memory == 'ram'), None)


def ping(fleet: Fleet, cycle: int) -> Asks:
    """Experiment 3 of the thesis: Pings only, the model number changes after each."""
    numbers = sorted({device.model.number or 0 for device in fleet.devices} | {311, 321})
    for position, device in enumerate(fleet.devices):
        device.become(numbers[(cycle + position) % len(numbers)])
        yield Ask(device.id, Instruction.PING)


def broadcast(fleet: Fleet, cycle: int) -> Asks:
    """Look who is there, again and again."""
    yield Ask(BROADCAST, Instruction.PING)


def idle(fleet: Fleet, cycle: int) -> Asks:
    """Be nearly silent: a Ping now and then."""
    ids = list(fleet.id_of.values())
    if ids and cycle % IDLE_CYCLES == 0:
        yield Ask(ids[cycle // IDLE_CYCLES % len(ids)], Instruction.PING)


def mixed(fleet: Fleet, cycle: int) -> Asks:
    """Do a bit of everything, one pattern per cycle."""
    yield from _MIX[cycle % len(_MIX)](fleet, cycle // len(_MIX))


def none(fleet: Fleet, cycle: int) -> Asks:
    """Say nothing: the devices wait for a master at the other end."""
    return iter(())


def _goals(fleet: Fleet) -> Asks:
    groups: dict[tuple[int, int], list[tuple[int, bytes]]] = {}
    for number, address, data in fleet.goals():
        groups.setdefault((address, len(data)), []).append((number, data))
    for (address, _), goals in groups.items():
        yield from sync_write(address, goals)


def _sensor_span(device: FakeDevice) -> CommonRange:
    """Return what there is to read from a board: all after its writable head."""
    fields = [field for field in device.model.fields if field.access == 'r' and field.at > 6]
    begin, end = (fields[0].at, fields[-1].end) if fields else (0, 3)
    return CommonRange(begin, end - begin, (device.id,))


def _everything(fleet: Fleet) -> list[CommonRange]:
    return fleet.spans('Present Position') + [
        _sensor_span(device) for device in fleet.devices if not device.field('Present Position')]


PATTERNS: dict[str, Pattern] = {one.__name__: one for one in (
    moving, sync, bulk, fast, registered, read_write, ping, broadcast, idle, mixed, none)}
# What a master can ask that has no more than the instructions of the 1.0 family.
FAMILY_1 = {'1': ('moving', 'sync', 'bulk', 'registered', 'broadcast', 'idle', 'none'),
            'feetech': ('moving', 'sync', 'registered', 'broadcast', 'idle', 'none')}
_MIX: tuple[Pattern, ...] = (moving, sync, bulk, registered, read_write)
