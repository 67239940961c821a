# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""
A servo of the X series on the wire (e-Manual: XL430-W250, XM430-W350, XL330-M288, MX-106(2.0)).

It hears what is on the wire, answers as its registers say, and moves towards its goal. Faults set
its plain attributes; what they change about its bytes it reports through `changed`.
"""

from math import sin
from typing import NamedTuple

from rigs.bus import frames
from rigs.bus.wire import S

US = 1_000
BAUD_CODES = (9600, 57_600, 115_200, 1_000_000, 2_000_000, 3_000_000, 4_000_000, 4_500_000)
SIZE = 661                         # bytes of the control table
EEPROM = range(7, 64)
# Register: address and bytes (control table of XL430-W250 and XM430-W350).
ID, BAUD, DELAY, MODE, MAX_HEAT, MAX_VOLTS, MIN_VOLTS = 7, 8, 9, 11, 31, 32, 34
TORQUE, LED, LEVEL, ERRORS, WATCHDOG = 64, 65, 68, 70, 98
GOAL, TICK, LOAD, SPEED, PLACE, VOLTS, HEAT = 116, 120, 126, 128, 132, 144, 146
REDIRECTS, REDIRECTED = 168, 224   # 28 indirect addresses, and the data that they stand for
GOALS = range(100, 120)
READ_ONLY = (range(7), range(70, 71), range(120, 148))
MODELS = {'XL430-W250': 1060, 'XM430-W350': 1020, 'XL330-M288': 1200, 'MX-106': 321, 'MX-64': 311,
          'XM540-W270': 1120}
FAST_SINCE = {'XL330-M288': 46}    # the others: 45; MX(2.0): never
NO_FAST = ('MX-106', 'MX-64')


class _Turn(NamedTuple):
    """An answer that waits for others: in a Sync Read for one, in a fast read for bytes."""

    accesses: list[tuple[int, int, int]]
    mine: int                      # which of them
    is_fast: bool
    heard: bytes                   # a fast reply so far


class AnyServo:
    """What servos of both families are. own_us: what its own code takes, after its delay."""

    def __init__(self, wire, number, own_us, size):
        self.wire = wire
        self.clock = wire.clock
        self.own_us = own_us
        self.is_on = True              # supplied
        self.loses = lambda: False       # an answer, now and then
        self.changed = lambda: None
        self.volts = lambda: 12.0
        self.tremor = float(number)    # where in its small movements it is
        self.asked = self.answered = 0
        self.table = bytearray(size)
        self._at = 2048.0
        self._moved = 0
        wire.listeners.append(self.hear_packets)

    def hear_packets(self, heard):
        raise NotImplementedError

    def put(self, at, size, value):
        self.table[at:at + size] = (value % (1 << 8 * size)).to_bytes(size, 'little')

    def get(self, at, size=1):
        return int.from_bytes(self.table[at:at + size], 'little')

    def move(self, goal, has_torque):
        """Go towards the goal since the last time, 4000 steps per second; return how it shakes."""
        seconds = (self.clock.now - self._moved) / S
        self._moved = self.clock.now
        if has_torque:
            step = 4000 * seconds
            self._at += max(-step, min(step, goal - self._at))
        return 2 * sin(self.clock.now / 7e7 + self.tremor)

    def say_after(self, delay, packet, later=0):
        """Say a status after a Return Delay Time (2 us units) and what the firmware takes."""
        self.answered += 1
        self.clock.at(self.clock.now + (2 * delay + self.own_us) * US + later,
                      lambda: self._say(packet))

    def _say(self, packet):
        if self.is_on:
            self.wire.talk(f'servo {self.number}', packet)

    @property
    def number(self):
        raise NotImplementedError


class Servo(AnyServo):
    """One servo of the X series."""

    def __init__(self, wire, number, model='XL430-W250', *, firmware=46, delay=0, own_us=40,
                 in_line=True):
        super().__init__(wire, number, own_us, SIZE)
        self.model = model
        self.firmware = firmware
        self.in_line = in_line         # in a Sync Read it waits for the one before it for ever
        self.is_deaf = False           # hears nothing, as behind a broken wire
        self.wrong_size = 0            # bytes that its answers have too many
        self.heat = lambda: 35.0
        self._turn = None
        self._born = 0
        self._fed = 0                  # the bus watchdog
        self._redirects = []    # indirect data: where, of what
        self._factory(number, delay)

    # --- registers -------------------------------------------------------------------------

    def _factory(self, number, delay):
        self.put(0, 2, MODELS[self.model])
        self.put(6, 1, self.firmware)
        self.put(ID, 1, number)
        self.put(BAUD, 1, BAUD_CODES.index(self.wire.baud))
        self.put(DELAY, 1, delay)
        self.put(MODE, 1, 3)
        self.put(MAX_HEAT, 1, 72 if self.model == 'XL430-W250' else 80)
        self.put(MAX_VOLTS, 2, 140 if self.model == 'XL430-W250' else 160)
        self.put(MIN_VOLTS, 2, 60 if self.model == 'XL430-W250' else 95)
        self.put(48, 4, 4095)
        self.put(63, 1, 52)
        self.start()

    def start(self):
        """Begin as after power on: RAM at its defaults (e-Manual, RAM area)."""
        keep = bytes(self.table[:64])
        self.table[:] = keep + bytes(SIZE - 64)
        self.put(LEVEL, 1, 2)
        self._redirect()
        self._born = self.clock.now
        self.put(GOAL, 4, round(self._at))
        self.is_on = True

    def stand(self, place):
        """Be at a place, and want to be there."""
        self._at = place
        self.put(GOAL, 4, round(place))

    @property
    def number(self):
        return self.table[ID]

    def _refresh(self):
        """Bring up to date what changes by itself: place, tick, supply, temperature."""
        wobble = self.move(self.get(GOAL, 4),
                           bool(self.table[TORQUE]) and not self.table[ERRORS])
        self.put(PLACE, 4, round(self._at) + round(wobble))
        self.put(TICK, 2, (self.clock.now - self._born) // 1_000_000 % 32_768)
        self.put(LOAD, 2, round(40 * sin(self.clock.now / 3e8)))
        self.put(VOLTS, 2, round(10 * self.volts()))
        self.put(HEAT, 1, round(self.heat()))
        for slot, target in self._redirects:   # indirect data follow what they stand for
            self.table[slot] = self.table[target]

    def _store(self, at, data):
        """Write; return the error number of the status (e-Manual, Error of Status Packet)."""
        if at + len(data) > SIZE or any(at in zone for zone in READ_ONLY):
            return frames.ACCESS
        if at in EEPROM and self.table[TORQUE]:
            return frames.ACCESS
        if self.table[WATCHDOG] == 0xFF and at in GOALS:
            return frames.DATA_RANGE
        sizes = {ID: 1, BAUD: 1, GOAL: 4, TORQUE: 1, 104: 4, 112: 4, 108: 4, 48: 4, 52: 4, 20: 4}
        if at in sizes and len(data) < sizes[at]:
            return frames.DATA_LENGTH
        if at == BAUD and data[0] >= len(BAUD_CODES):
            return frames.DATA_RANGE
        if at == GOAL and not self.get(52, 4) <= int.from_bytes(data, 'little') <= self.get(48, 4):
            return frames.DATA_LIMIT
        self.table[at:at + len(data)] = data
        if at >= REDIRECTS:
            self._redirect()
            for slot, target in self._redirects:   # a write to them goes where they point
                if at <= slot < at + len(data):
                    self.table[target] = data[slot - at]
        return 0

    def _redirect(self):
        self._redirects = [(REDIRECTED + slot, target) for slot in range(28)
                           if (target := self.get(REDIRECTS + 2 * slot, 2))]

    # --- hearing ---------------------------------------------------------------------------

    def hear_packets(self, heard):
        """Take what was on the wire: instructions, and the statuses of those before it."""
        is_at_rate = BAUD_CODES[self.table[BAUD]] == self.wire.baud
        if not self.is_on or self.is_deaf or not is_at_rate:
            return
        self._watch()
        if self._turn is not None and self._turn.is_fast:
            self._wait_fast(heard.data)
        packets = frames.parse(heard.data, fast=True)
        for packet in packets:
            if packet.instruction == frames.STATUS:
                self._wait_in_line(packet)
            else:
                self._obey(packet)

    def _watch(self):
        limit = self.table[WATCHDOG]
        if 0 < limit < 0x80 and self.table[TORQUE] \
                and self.clock.now - self._fed > limit * 20_000_000:
            self.table[WATCHDOG] = 0xFF
            self.changed()
        self._fed = self.clock.now

    def _obey(self, packet):
        self._turn = None
        code = packet.instruction
        if code == frames.SYNC_WRITE:
            for number, at, data in frames.group_writes(packet):
                if number == self.number:
                    self._store(at, data)
        elif code == frames.SYNC_READ or (code == frames.FAST_SYNC_READ and self._is_fast):
            self._take_turn(frames.accesses(packet), code == frames.FAST_SYNC_READ)
        elif code == frames.FAST_SYNC_READ:
            return                             # firmware that does not know it
        elif packet.id in (self.number, frames.EVERYBODY):
            self._alone(packet)

    @property
    def _is_fast(self):
        return self.model not in NO_FAST and self.firmware >= FAST_SINCE.get(self.model, 45)

    def _alone(self, packet):
        """Obey an instruction to one device, or a Ping to all."""
        code, params = packet.instruction, packet.params
        if code == frames.PING:
            turns = self.number * 3000 * US if packet.id == frames.EVERYBODY else 0
            self._answer(0, bytes(self.table[0:2]) + bytes(self.table[6:7]), always=True,
                         later=turns)
        elif code == frames.READ and packet.id == self.number:
            self._refresh()
            at, size = params[0] | params[1] << 8, params[2] | params[3] << 8
            if at + size > SIZE:
                self._answer(frames.ACCESS)
            else:
                self._answer(0, bytes(self.table[at:at + size]), level=1)
        elif code == frames.WRITE:
            self._obey_write(packet)
        elif packet.id != frames.EVERYBODY:    # none answers a Read of all (e-Manual)
            self._answer(frames.BAD_INSTRUCTION, level=2)

    def _obey_write(self, packet):
        at, data = packet.params[0] | packet.params[1] << 8, packet.params[2:]
        number, code = self.table[ID], self.table[BAUD]
        error = self._store(at, data)
        if code != self.table[BAUD]:           # it acknowledges at the old rate
            self.changed()
            later = self.table[BAUD]
            self.table[BAUD] = code
            self.clock.at(self.clock.now + 3_000_000, lambda: self.put(BAUD, 1, later))
        if number != self.table[ID]:
            self.changed()
        if packet.id != frames.EVERYBODY:
            self._answer(error, level=2)

    # --- answering -------------------------------------------------------------------------

    def _answer(self, error, data=b'', *, level=1, always=False, later=0):
        """Say a status, after the Return Delay Time (2 us units) and what the firmware takes."""
        self.asked += 1
        if not always and self.table[LEVEL] < level:
            return
        if self.loses():
            self.changed()
            return
        if data and self.wrong_size and not always:
            self.changed()
            data = data[:self.wrong_size] if self.wrong_size < 0 else data + bytes(self.wrong_size)
        alert = frames.ALERT if self.table[ERRORS] else 0
        packet = frames.status(self.number, error | alert, data)
        self.say_after(self.table[DELAY], packet, later)

    def _take_turn(self, accesses, is_fast):
        mine = next((i for i, one in enumerate(accesses) if one[0] == self.number), -1)
        if mine < 0:
            return
        self._turn = _Turn(accesses, mine, is_fast, b'')
        if mine == 0:
            self._my_turn()
        elif not self.in_line and not is_fast:
            before = sum(size + 11 for _, _, size in accesses[:mine])
            wait = before * self.wire.byte_ns + mine * (self.own_us + 2 * self.table[DELAY]) * US
            self.clock.at(self.clock.now + round(wait), self._my_turn)

    def _wait_in_line(self, packet):
        turn = self._turn
        if turn is None or turn.is_fast or not self.in_line or turn.mine == 0:
            return
        if packet.id == turn.accesses[turn.mine - 1][0]:
            self._my_turn()

    def _wait_fast(self, data):
        turn = self._turn
        if turn is None or (data[:4] == frames.START and turn.heard):
            return
        turn = self._turn = turn._replace(heard=turn.heard + data)
        before = 8 + sum(size + 4 for _, _, size in turn.accesses[:turn.mine])
        if turn.mine and len(turn.heard) >= before:
            self._my_turn()

    def _my_turn(self):
        turn = self._turn
        if turn is None:
            return
        self._turn = None
        self._refresh()
        _, at, size = turn.accesses[turn.mine]
        if not turn.is_fast:
            self._answer(0, bytes(self.table[at:at + size]))
            return
        self.asked += 1
        if self.loses():
            self.changed()
            return
        if self.table[LEVEL] < 1:
            return
        self.answered += 1
        self._say_block(turn, bytes(self.table[at:at + size]))

    def _say_block(self, turn, data):
        """Say its part of a fast reply (e-Manual, Fast Sync Read): a CRC covers all before."""
        before = turn.heard
        block = bytes((frames.ALERT if self.table[ERRORS] else 0, self.number)) + data
        if turn.mine == 0:
            length = 1 + sum(size + 4 for _, _, size in turn.accesses)
            block = frames.START + bytes((frames.EVERYBODY,)) + frames.two(length) \
                + bytes((frames.STATUS,)) + block
        piece = block + frames.crc(before + block)
        wait = (2 * self.table[DELAY] + self.own_us) * US if turn.mine == 0 else 0
        self.clock.at(self.clock.now + wait, lambda: self._say(piece))
