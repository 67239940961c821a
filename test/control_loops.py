# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""
Plays the programs of control_loops.yaml on simulated servos, in simulated time.

It shares nothing with the product but the bytes of packets: the log of a program is when its own
loops began.
"""

import heapq
from pathlib import Path
import random
import struct

import yaml

from msg_defs.dxl1_packet import encode as encode_1
from msg_defs.dxl_packet import encode as encode_2
from msg_defs.event import Change
from msg_defs.event import GAVE_UP
from msg_defs.event import IN
from msg_defs.event import OUT
from msg_defs.event import UNKNOWN

PROGRAMS = {row['name']: row for row in yaml.safe_load(
    Path(__file__).with_name('control_loops.yaml').read_text(encoding='utf-8'))}
BYTE_NS = 10_000                   # at 1 MBd
S, MS = 1_000_000_000, 1_000_000
SERVO_NS = 60_000                  # from a question to its answer, and between two answers
BETWEEN_NS = 80_000                # the program, between two exchanges
CODES = {'PING': 1, 'READ': 2, 'WRITE': 3, 'SYNC_READ': 0x82, 'SYNC_WRITE': 0x83,
         'BULK_READ': 0x92}
SWITCHED_ON = b'\x01'
ALL = 0xFE


class Dialect:
    """How packets of a protocol are spelt."""

    def __init__(self, protocol):
        self.is_2 = protocol == '2'

    def ask(self, number, code, at, size, servos=()):
        params = struct.pack('<HH' if self.is_2 else 'BB', at, size) if code != 1 else b''
        if code == CODES['BULK_READ']:
            params = b''.join(struct.pack('<BHH', one, at, size) for one in servos)
        elif code == CODES['SYNC_READ']:
            params += bytes(servos)
        elif code == CODES['SYNC_WRITE']:
            params += b''.join(bytes((one,)) + SWITCHED_ON + bytes(size - 1) for one in servos)
        elif code == CODES['WRITE']:
            params = params[:2 if self.is_2 else 1] + SWITCHED_ON + bytes(size - 1)
        return (encode_2 if self.is_2 else encode_1)(number, code, params)

    def answer(self, number, size):
        data = bytes(size)
        return encode_2(number, 0x55, b'\0' + data) if self.is_2 else encode_1(number, 0, data)


class Program:
    """A program and its servos. feed(bytes, stamp, side); change(change, stamp)."""

    def __init__(self, row, feed, change, has_sides=True, seed=1):
        self.row, self.feed, self.change, self.has_sides = row, feed, change, has_sides
        self.random = random.Random(seed)
        self.dialect = Dialect(row.get('protocol', '2'))
        self.servos = range(1, 1 + row['servos'])
        self.dead = set(row.get('dead', ()))
        self.timeout = int(row.get('timeout_ms', 20) * MS)
        self.now = S
        self.vain = 0              # when it last looked for an answer in vain
        self.turn = 0
        self.logs = []             # when each loop began, by loop

    def run(self, seconds):
        """Play so many seconds; return the log of each loop."""
        for _ in self.exchanges(self.row.get('start', ())):
            self.now += BETWEEN_NS
        due = []
        end = self.now + seconds * S
        for number, loop in enumerate(self.row['loops']):
            self.logs.append([])
            heapq.heappush(due, (self.now, number, self.loop(loop, self.logs[-1])))
        while self.now < end:
            at, number, steps = heapq.heappop(due)
            self.now = max(self.now, at)
            heapq.heappush(due, (next(steps), number, steps))
        return self.logs

    def loop(self, loop, log):
        """Yield when to go on, after each exchange and at the end of each cycle."""
        period = int(1e9 / loop['hz']) if loop['hz'] else 0
        pace, first, seldom = loop.get('pace'), self.now, self.now
        least, most = (int(one * MS) for one in loop.get('think_ms', (0, 0)))
        while True:
            began = self.now
            log.append(began)
            asks = list(loop['asks'])
            if began >= seldom and 'every_s' in loop:
                asks += loop['seldom']
                seldom += int(loop['every_s'] * S)
            for _ in self.exchanges(asks):
                yield self.now + BETWEEN_NS
            late = int(self.random.random() ** 3 * loop.get('jitter_ms', 0.1) * MS)
            if pace == 'deadline':
                first += period
                first = max(first, self.now - period)
                yield max(first, self.now) + late
            elif pace == 'rest':
                yield max(began + period, self.now) + late
            else:
                yield self.now + period + self.random.randint(least, most) + late

    def exchanges(self, asks):
        """Ask what is due, and wait for the answers; yield after each exchange."""
        for ask in asks:
            name, *rest = ask.split()
            code = CODES[name]
            at, size = map(int, rest[:2]) if code != 1 else (0, 0)
            if code > 3:
                is_write = name == 'SYNC_WRITE'
                packet = self.dialect.ask(ALL, code, at, size, self.servos)
                yield self.exchange(packet, () if is_write else self.servos, size)
                continue
            for number in self.addressed(rest[-1]):
                packet = self.dialect.ask(number, code, at, size)
                is_dead = number in self.dead or number not in self.servos
                for _ in range(self.row.get('tries', 1) if is_dead else 1):
                    yield self.exchange(packet, (number,), size if code == 2 else
                                        3 * (code == 1 and self.dialect.is_2))

    def addressed(self, words):
        if words == 'next':
            self.turn += 1
            return [self.servos[self.turn % len(self.servos)]]
        if words == 'living':
            return [one for one in self.servos if one not in self.dead]
        if '-' in words:
            low, high = map(int, words.split('-'))
            return range(low, high + 1)
        return self.servos

    def exchange(self, packet, asked, size):
        if self.vain and self.has_sides:
            self.change(Change(GAVE_UP, (self.now - self.vain) // 1000), self.now)
        self.vain = 0
        began = self.now
        self.now += len(packet) * BYTE_NS
        if self.has_sides:
            self.feed(packet, began, OUT)
        else:
            self.feed(packet, self.now, UNKNOWN)
        for number in asked:
            if number in self.dead or number not in self.servos:
                continue
            answer = self.dialect.answer(number, size)
            self.now += SERVO_NS + len(answer) * BYTE_NS
            self.feed(answer, self.now, IN if self.has_sides else UNKNOWN)
        if any(number in self.dead or number not in self.servos for number in asked):
            self.now = self.vain = began + self.timeout
