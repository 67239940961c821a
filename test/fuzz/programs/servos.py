# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""
Servos by the makers' manuals: XL430-W250 (2.0), AX-12A (1.0), STS3215 (Feetech), what is needed.

A fault of hardware is an attribute of a servo or of its bus; what it does is not said elsewhere.
"""
import struct

from msg_defs.dxl1_packet import encode as encode_1
from msg_defs.dxl_packet import encode as encode_2

PING, READ, WRITE, REBOOT, SYNC_READ, SYNC_WRITE = 1, 2, 3, 8, 0x82, 0x83
ALL = 0xFE
MS, US = 1_000_000, 1000
ACCESS_ERROR, LIMIT_ERROR = 7, 6    # numbers of a status, Protocol 2.0
ANGLE_LIMIT = 2                    # a bit, Protocol 1.0


class Model:
    """A control table: name -> (address, size); values at power on."""

    def __init__(self, protocol, places, values, *, full, eeprom_end):
        self.protocol, self.places, self.values = protocol, places, values
        self.full, self.eeprom_end = full, eeprom_end     # its largest position; first RAM address


MODELS = {
    '2': Model('2', {
        'model': (0, 2), 'firmware': (6, 1), 'id': (7, 1), 'return_level': (68, 1),
        'mode': (11, 1), 'max_temperature': (31, 1), 'velocity_limit': (44, 4),
        'max_position': (48, 4), 'torque': (64, 1), 'error': (70, 1), 'goal_velocity': (104, 4),
        'goal': (116, 4), 'load': (126, 2), 'velocity': (128, 4), 'position': (132, 4),
        'voltage': (144, 2), 'temperature': (146, 1)},
        {'model': 1060, 'firmware': 45, 'return_level': 2, 'mode': 3, 'max_temperature': 72,
         'velocity_limit': 265, 'max_position': 4095, 'voltage': 120, 'temperature': 38,
         'position': 2048, 'goal': 2048}, full=4095, eeprom_end=64),
    '1': Model('1', {
        'model': (0, 2), 'firmware': (2, 1), 'id': (3, 1), 'max_temperature': (11, 1),
        'max_position': (8, 2), 'min_voltage': (12, 1), 'max_voltage': (13, 1),
        'return_level': (16, 1), 'torque': (24, 1), 'goal': (30, 2), 'speed': (32, 2),
        'position': (36, 2), 'velocity': (38, 2), 'load': (40, 2), 'voltage': (42, 1),
        'temperature': (43, 1)},
        {'model': 12, 'firmware': 24, 'max_temperature': 70, 'max_position': 1023,
         'min_voltage': 60, 'max_voltage': 140, 'return_level': 2, 'voltage': 111,
         'temperature': 36, 'position': 512, 'goal': 512}, full=1023, eeprom_end=24),
    'feetech': Model('feetech', {
        'firmware': (0, 2), 'model': (3, 2), 'id': (5, 1), 'return_level': (8, 1),
        'max_position': (11, 2), 'max_temperature': (13, 1), 'max_voltage': (14, 1),
        'min_voltage': (15, 1), 'mode': (33, 1), 'torque': (40, 1), 'goal': (42, 2),
        'lock': (55, 1), 'position': (56, 2), 'velocity': (58, 2), 'load': (60, 2),
        'voltage': (62, 1), 'temperature': (63, 1), 'error': (65, 1), 'current': (69, 2)},
        {'firmware': 0x0A03, 'model': 777, 'return_level': 1, 'max_position': 4095,
         'max_temperature': 70, 'max_voltage': 140, 'min_voltage': 40, 'lock': 1, 'voltage': 121,
         'temperature': 33, 'position': 2048, 'goal': 2048}, full=4095, eeprom_end=40)}


class Servo:
    """
    One servo. answers(code, params, now) -> the params and error of its status, or None.

    silent: from when on (ns) it says nothing. follows: whether its position goes to its goal.
    """

    def __init__(self, number, model, chance):
        self.number, self.model, self.chance = number, model, chance
        self.table = bytearray(256)
        for name, value in {**model.values, 'id': number}.items():
            self.set(name, value)
        self.silent, self.loses, self.delay_ns = 1 << 62, 0.0, 250 * US
        self.follows, self.alert, self.twin, self.answers_reads = True, 0, None, True
        self.group_reads = model.protocol != '1'

    def set(self, name, value):
        at, size = self.model.places[name]
        self.table[at:at + size] = (value % (1 << 8 * size)).to_bytes(size, 'little')

    def get(self, name):
        at, size = self.model.places[name]
        return int.from_bytes(self.table[at:at + size], 'little')

    def restart(self):
        """Start again: what is in RAM is as at power on, but the joint is where it was."""
        place, number = self.get('position'), self.get('id')
        fresh = Servo(number, self.model, self.chance).table
        self.table[self.model.eeprom_end:] = fresh[self.model.eeprom_end:]
        self.set('position', place)
        self.set('goal', place)

    def read(self, at, size):
        """Return registers; the joint moves a part of its way between two reads."""
        if self.follows and self.get('torque'):
            place, goal = self.get('position'), self.get('goal')
            self.set('position', place + round((goal - place) * 0.4))
        self.set('load', self.chance.randrange(40))
        return bytes(self.table[at:at + size])

    def write(self, at, data):
        """Take a write; return the error number of the status, 0 for none."""
        is_2 = self.model.protocol == '2'
        if is_2 and at < self.model.eeprom_end and self.get('torque'):
            return ACCESS_ERROR                # EEPROM is locked by torque
        limit = self.get('max_position')
        if at == self.model.places['goal'][0] and int.from_bytes(data, 'little') > limit:
            if self.model.protocol != 'feetech':
                return LIMIT_ERROR if is_2 else ANGLE_LIMIT
            data = limit.to_bytes(2, 'little')             # it goes as far as it may
        self.table[at:at + len(data)] = data
        return 0


class Bus:
    """
    Servos in the order of their cable, and what they answer to a packet.

    A supply that fails: `restarts`, when (ns) all do. text: bytes that come instead of answers.
    """

    def __init__(self, protocol, numbers, chance):
        self.model, self.chance, self.is_2 = MODELS[protocol], chance, protocol == '2'
        self.servos = {one: Servo(one, self.model, chance) for one in numbers}
        self.restarts, self.away_ns, self.text, self.baud_ok = 1 << 62, 300 * MS, b'', True
        self._away_until = 0

    def __call__(self, data, now):
        if now >= self.restarts:
            self.restarts, self._away_until = 1 << 62, now + self.away_ns
            for one in self.servos.values():
                one.restart()
        if self.text:
            return [(self.chance.randint(1, 5) * MS, self.text)]
        if now < self._away_until or not self.baud_ok:
            return []
        packet = self._parse(data)
        return self._answers(*packet, now) if packet else []

    def _parse(self, data):
        """Return ID, instruction and params of a packet that is right."""
        if self.is_2:
            if data[:4] != b'\xff\xff\xfd\0' or len(data) < 10 \
                    or encode_2(data[4], data[7], data[8:-2]) != data:
                return None
            return data[4], data[7], data[8:-2]
        if data[:2] != b'\xff\xff' or len(data) < 6 \
                or encode_1(data[2], data[4], data[5:-1]) != data:
            return None
        return data[2], data[4], data[5:-1]

    def _split(self, params):
        """Return address, size, and the rest of the params of a group instruction."""
        at, size = struct.unpack_from('<HH' if self.is_2 else 'BB', params)
        return at, size, params[4 if self.is_2 else 2:]

    def _answers(self, number, code, params, now):
        if code == SYNC_READ:
            at, size, numbers = self._split(params)
            found, after = [], 0
            for one in numbers:
                servo = self.servos.get(one)
                if servo is None or not servo.group_reads or not self._is_there(servo, now):
                    if self.is_2:
                        break                  # who waits for its status never has a turn
                    continue
                after += servo.delay_ns
                found.append((after, self._status(servo, 0, servo.read(at, size))))
                after += len(found[-1][1]) * 10_000
            return found
        if code == SYNC_WRITE:
            at, size, rest = self._split(params)
            for place in range(0, len(rest) - size, size + 1):
                servo = self.servos.get(rest[place])
                if servo and self._is_there(servo, now):
                    servo.write(at, rest[place + 1:place + 1 + size])
            return []
        if number == ALL:
            return [(one.delay_ns * (2 + 3 * turn), self._pong(one))
                    for turn, one in enumerate(self.servos.values())
                    if code == PING and self._is_there(one, now)]
        servo = self.servos.get(number)
        return self._single(servo, code, params) if servo and self._is_there(servo, now) else []

    def _is_there(self, servo, now):
        return now < servo.silent and self.chance.random() >= servo.loses

    def _single(self, servo, code, params):
        error, data = 0, b''
        if code == READ:
            if not servo.answers_reads or self._level(servo) < 1:
                return []
            at, size = struct.unpack_from('<HH' if self.is_2 else 'BB', params)
            data = servo.read(at, size)
        elif code == WRITE:
            head = 2 if self.is_2 else 1
            at = int.from_bytes(params[:head], 'little')
            error = servo.write(at, params[head:])
            if self._level(servo) < 2:
                return []
        elif code == REBOOT:
            servo.restart()
        elif code != PING:
            return []
        answer = self._pong(servo) if code == PING else self._status(servo, error, data)
        found = [(servo.delay_ns, answer)]
        if servo.twin:                         # a second servo of this ID, a little slower
            found.append((servo.delay_ns + servo.twin, self._status(
                servo, 0, bytes(one ^ 5 for one in data))))
        return found

    @staticmethod
    def _level(servo):
        """Return what it answers to: 0 Pings, 1 Reads too, 2 all. Feetech counts from 1."""
        return servo.get('return_level') + (servo.model.protocol == 'feetech')

    def _pong(self, servo):
        return self._status(servo, 0, bytes((
            *servo.table[:2], servo.get('firmware') & 0xFF)) if self.is_2 else b'')

    def _status(self, servo, error, data):
        if self.is_2:
            return encode_2(servo.number, 0x55, bytes((error | servo.alert,)) + data)
        return encode_1(servo.number, error | servo.alert, data)
