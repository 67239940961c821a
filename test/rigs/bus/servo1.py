# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""A servo of the 1.0 family on the wire: AX-12 or MX-28 of Dynamixel 1.0, STS3215 of Feetech."""

from typing import NamedTuple

from rigs.bus import frames1 as frames
from rigs.bus.frames import PING
from rigs.bus.frames import READ
from rigs.bus.frames import SYNC_READ
from rigs.bus.frames import SYNC_WRITE
from rigs.bus.frames import WRITE
from rigs.bus.servo import AnyServo
from rigs.bus.servo import Servo

TURN = 4096
SIZE = 128                         # bytes that a control table has


class Kind(NamedTuple):
    """Where a family of servos has its registers, and what it knows."""

    number: int                    # Model Number
    model_at: int
    id_at: int
    delay_at: int
    torque_at: int
    goal_at: int
    place_at: int
    volts_at: int
    has_sync_read: bool
    firmware: tuple[tuple[int, int], ...]      # (address, value)


AX_12 = Kind(12, 0, 3, 5, 24, 30, 36, 42, False, ((2, 24),))
MX_28 = AX_12._replace(number=29, firmware=((2, 36),))
STS3215 = Kind(777, 3, 5, 7, 40, 42, 56, 62, True, ((0, 3), (1, 10)))


class Servo1(AnyServo):
    """One servo. errors: the bits that each of its statuses carries."""

    def __init__(self, wire, number, kind=STS3215, *, delay=0, own_us=40):
        super().__init__(wire, number, own_us, SIZE)
        self.kind = kind
        self.errors = 0
        self.mounted = 0               # so many steps more than it is at, it reports
        self._waits_for = None     # an ID; address, size of its turn
        self.put(kind.model_at, 2, kind.number)
        self.put(kind.id_at, 1, number)
        self.put(kind.delay_at, 1, delay)
        for at, value in kind.firmware:
            self.put(at, 1, value)
        self.stand(2048.0)

    def stand(self, place):
        """Be at a place, and want to be there."""
        self._at = place
        self.put(self.kind.goal_at, 2, round(place))

    @property
    def number(self):
        return self.table[self.kind.id_at]

    def _refresh(self):
        kind = self.kind
        wobble = self.move(self.get(kind.goal_at, 2),
                           bool(self.table[kind.torque_at]) and not self.errors & 0x20)
        self.put(kind.place_at, 2, round(self._at + wobble + self.mounted) % TURN)
        self.put(kind.volts_at, 1, round(10 * self.volts()))
        self.put(kind.volts_at + 1, 1, 35)         # the temperature, in both families

    # --- hearing: a status looks like an instruction, so who talks tells ------------------------

    def hear_packets(self, heard):
        """Take what was on the wire."""
        if not self.is_on:
            return
        is_asked = all(talk.who.startswith('master') for talk in heard.talks)
        for packet in frames.parse(heard.data):
            if is_asked:
                self._obey(packet)
            elif self._waits_for is not None and packet.id == self._waits_for[0]:
                self._take_turn(self._waits_for[1], self._waits_for[2])

    def _obey(self, packet):
        self._waits_for = None
        code, params = packet.instruction, packet.params
        if code == SYNC_WRITE:
            step = params[1] + 1
            for at in range(2, len(params), step):
                if params[at] == self.number:
                    self._store(params[0], params[at + 1:at + step])
        elif code == SYNC_READ and self.kind.has_sync_read:
            self._line_up(params[0], params[1], params[2:])
        elif packet.id == self.number:
            self._alone(code, params)

    def _alone(self, code, params):
        if code == PING:
            self._answer()
        elif code == READ:
            self._refresh()
            self._answer(bytes(self.table[params[0]:params[0] + params[1]]))
        elif code == WRITE:
            self._store(params[0], params[1:])
            self._answer()                             # with the new ID, if that was written

    def _store(self, at, data):
        self.table[at:at + len(data)] = data

    def _line_up(self, at, size, ids):
        place = ids.find(self.number)
        if place == 0:
            self._take_turn(at, size)
        elif place > 0:
            self._waits_for = ids[place - 1], at, size

    def _take_turn(self, at, size):
        self._waits_for = None
        self._refresh()
        self._answer(bytes(self.table[at:at + size]))

    def _answer(self, data=b''):
        self.asked += 1
        if self.loses():
            self.changed()
            return
        self.say_after(self.table[self.kind.delay_at],
                       frames.packet(self.number, self.errors, data))


def servo(wire, number, model, **options):
    """Return a servo of either family; the options are Servo's, of which Servo1 has some."""
    if isinstance(model, str):
        return Servo(wire, number, model, **options)
    return Servo1(wire, number, model, **{
        name: value for name, value in options.items() if name in ('delay', 'own_us')})
