# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""
Random programs: what they ask, how they read, what they do without an answer; and one mistake.

A program is right by itself. A mistake (mistakes.py) changes it, its servos or its wire, and says
what has to be found. The same seed is the same case.
"""
from random import Random
import struct

from fuzz.programs.line import Clock
from fuzz.programs.line import Port
from fuzz.programs.line import S
from fuzz.programs.line import Wire
from fuzz.programs.servos import ALL
from fuzz.programs.servos import Bus
from fuzz.programs.servos import PING
from fuzz.programs.servos import READ
from fuzz.programs.servos import SYNC_READ
from fuzz.programs.servos import SYNC_WRITE
from fuzz.programs.servos import WRITE
from msg_defs.dxl1_packet import encode as encode_1
from msg_defs.dxl_packet import encode as encode_2

READERS = 'exact', 'head first', 'poll', 'bytewise', 'sdk'
SEEN = 'position', 'temperature', 'voltage', 'load', 'velocity'


class NoAnswer(Exception):
    """What an own program raises that does not go on without an answer."""


class Program:
    """One program, its servos and its machine; run() plays it to its end."""

    def __init__(self, family, seed, stutter=0.0):
        self.chance = chance = Random(f'{family} {seed}')
        self.family, self.is_2 = family, family == '2'
        count = chance.choice((1, 2, 3, 4, 6, 6, 8, 12))
        self.numbers = sorted(chance.sample(range(1, 20), count))
        self.clock = Clock(chance, stutter)
        self.bus = Bus(family, self.numbers, chance)
        self.model = self.bus.model
        self.reader = chance.choice(READERS)
        self.baud = chance.choice((1_000_000, 1_000_000, 500_000, 2_000_000))
        self.wire = Wire(self.clock, chance, self.bus, self.baud,
                         latency_ms=chance.choice((0.3, 1, 1, 4)))
        self.port = Port(self.clock, self.wire, self.baud)
        self.timeout = self.port.timeout = chance.choice((0.03, 0.05, 0.1, 0.2))
        self.tries = chance.choice((1, 1, 2, 3))
        self.clears = chance.random() < 0.7    # its input before each question
        self.raises = chance.random() < 0.2    # where it has no answer
        self.waits_for_acks = True
        self.period = 1 / chance.choice((5, 20, 50, 50, 100))
        self.seconds = chance.uniform(7, 14)
        self.pings, self.moves = chance.random() < 0.7, chance.random() < 0.6
        groups = family != '1'
        self.asks = [chance.choice(('sync read', 'read')) if groups else 'read']
        self.asks = [(self.asks[0], 'position')]
        if self.moves:
            self.asks.append((chance.choice(('sync write', 'write')), 'goal'))
        if chance.random() < 0.6:
            self.asks.append((chance.choice(('read', 'read next')), chance.choice(SEEN[1:])))
        self.torque, self.reads_limits = self.moves, chance.random() < 0.3
        self.first = []                        # asked once before the loop, in addition
        self.rests = chance.random() < 0.15    # for seconds, now and then: a person types
        self.spelling = lambda packet, code: packet        # how it spells its packets
        self.read_more = 0                     # bytes than the answer has
        self.read_after = None                 # s: reads what is there then, all of it
        self.goal_of = lambda turn, place: self.model.full // 2 + round(
            self.model.full / 5 * ((turn // 25 % 4) - 1.5) / 1.5)
        self.place, self.turn = 0, 0

    # --- what it does ----------------------------------------------------------------------------

    def run(self):
        """Play the program; return how it ended: '' or 'raised'."""
        end = self.clock.now + int(self.seconds * S)
        try:
            self._start()
            due = self.clock.now
            while self.clock.now < end:
                for ask, name in self.asks:
                    self._ask(ask, name)
                self.turn += 1
                due += int(self.period * S)
                self.clock.until(due)
                due = max(due, self.clock.now - int(self.period * S))
                if self.rests and self.chance.random() < self.period / 5:
                    self.clock.sleep(self.chance.uniform(0.3, 1.5))
                    due = self.clock.now
        except (NoAnswer, IndexError):         # what dynamixel-sdk 4.1 raises for a short answer
            return 'raised'
        return ''

    def _start(self):
        for number in self.numbers:
            if self.pings:
                self.exchange(number, PING, b'', 3 if self.is_2 else 0)
            if self.reads_limits:
                for name in ('max_temperature', 'max_position'):
                    self.read(number, name)
            if self.torque:
                self.write(number, 'torque', 1)
        for ask in self.first:
            ask()

    def _ask(self, ask, name):
        if ask == 'read':
            for number in self.numbers:
                self.read(number, name)
        elif ask == 'read next':
            self.place += 1
            self.read(self.numbers[self.place % len(self.numbers)], name)
        elif ask == 'write':
            for place, number in enumerate(self.numbers):
                self.write(number, name, self.goal_of(self.turn, place))
        elif ask == 'sync read':
            at, size = self.model.places[name]
            self.exchange(ALL, SYNC_READ, self._place(at, size) + bytes(self.numbers), size,
                          len(self.numbers))
        else:
            at, size = self.model.places[name]
            goals = b''.join(bytes((number,)) + self._value(self.goal_of(self.turn, place), size)
                             for place, number in enumerate(self.numbers))
            self.exchange(ALL, SYNC_WRITE, self._place(at, size) + goals, 0, 0)

    def read(self, number, name):
        at, size = self.model.places[name]
        return self.exchange(number, READ, self._place(at, size), size)

    def write(self, number, name, value):
        at, size = self.model.places[name]
        head = self._place(at, size)[:2 if self.is_2 else 1]
        return self.exchange(number, WRITE, head + self._value(value, size), 0,
                             int(self.waits_for_acks))

    def _place(self, at, size):
        return struct.pack('<HH' if self.is_2 else 'BB', at, size)

    @staticmethod
    def _value(value, size):
        return (value % (1 << 8 * size)).to_bytes(size, 'little')

    # --- one question, and its answer ------------------------------------------------------------

    def exchange(self, number, code, params, size, answers=1):
        """Ask until it is answered, as often as it tries; return the last answer's data."""
        if self.reader == 'sdk' and answers:
            return self._exchange_by_sdk(number, code, params, size, answers)
        packet = self.spelling((encode_2 if self.is_2 else encode_1)(number, code, params), code)
        data = None
        for _ in range(self.tries):
            if self.clears:
                self.port.reset_input_buffer()
            self.port.write(packet)
            if not answers:
                return b''
            whole = (11 if self.is_2 else 6) + size
            got = self._read(answers * whole + self.read_more)
            data = self._check(got[-whole:] if not self.read_more else got[:whole], whole)
            if data is not None and len(got) >= answers * whole:
                return data
        if self.raises:
            raise NoAnswer
        return data

    def _check(self, packet, whole):
        """Return the data of an answer that is right, None of any other."""
        if len(packet) < whole or packet[:2] != b'\xff\xff':
            return None
        if self.is_2:
            return packet[9:-2] if encode_2(packet[4], 0x55, packet[8:-2]) == packet else None
        return packet[5:-1] if encode_1(packet[2], packet[4], packet[5:-1]) == packet else None

    def _read(self, size):
        port = self.port
        if self.read_after is not None:
            self.clock.sleep(self.read_after)
            return port.read(port.in_waiting) if port.in_waiting else b''
        if self.reader == 'head first':
            head = port.read(min(5, size))
            return head + port.read(size - len(head)) if head else b''
        end, got = self.clock.now + int(self.timeout * S), b''
        if self.reader == 'bytewise':
            while len(got) < size and self.clock.now < end:
                got += port.read(1)
        elif self.reader == 'poll':
            while len(got) < size and self.clock.now < end:
                if waiting := port.in_waiting:
                    got += port.read(min(waiting, size - len(got)))
                else:
                    self.clock.sleep(0.0005)
        else:
            got = port.read(size)
        return got

    def _exchange_by_sdk(self, number, code, params, size, answers):
        """Ask by the maker's SDK: it waits by its own clock, and clears the input by itself."""
        if self.family == 'feetech':
            import scservo_sdk as sdk
            from scservo_sdk import port_handler
            packets = sdk.PacketHandler(0)
        else:
            import dynamixel_sdk as sdk
            from dynamixel_sdk import port_handler
            packets = sdk.PacketHandler(2.0 if self.is_2 else 1.0)
        real, port_handler.time = port_handler.time, self.clock
        try:
            port = sdk.PortHandler(self.port.port)
            port.ser, port.is_open, port.baudrate = self.port, True, self.baud
            port.tx_time_per_byte = 10_000 / self.baud
            return self._ask_sdk(sdk, port, packets, number, code, params, size)
        finally:
            port_handler.time = real

    def _ask_sdk(self, sdk, port, packets, number, code, params, size):
        at = int.from_bytes(params[:2 if self.is_2 else 1], 'little')
        data, result = None, -1
        for _ in range(self.tries):
            if code == PING:
                data, result, _ = packets.ping(port, number)
            elif code == READ:
                data, result, _ = packets.readTxRx(port, number, at, size)
            elif code == WRITE:
                value = [*params[2 if self.is_2 else 1:]]
                result, _ = packets.writeTxRx(port, number, at, len(value), value)
            else:
                group = sdk.GroupSyncRead(port, packets, at, size)
                for one in params[4 if self.is_2 else 2:]:
                    group.addParam(one)
                result = group.txRxPacket()
            if result == 0:
                return data
        if self.raises:
            raise NoAnswer
        return data
