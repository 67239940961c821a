# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""A bus as a tracker hears it, and packets of Protocol 2.0 in few words."""

import struct

from msg_defs.dxl_instruction import Instruction as I
from msg_defs.dxl_packet import BROADCAST
from msg_defs.dxl_packet import encode
from msg_defs.dxl_packet import Framer
from msg_defs.dxl_packet import STATUS
from servobus.bus.evidence import Evidence
from servobus.bus.registry import DeviceRegistry
from servobus.bus.tracker import Tracker
from servobus.model.models import Models

MODELS = Models()
MX_64 = 311
BYTE_NS = 5_000                    # at 2 MBd
POSITION = 132
GOAL = 116


def words(*numbers):
    return struct.pack(f'<{len(numbers)}H', *numbers)


def damaged(packet):
    return packet[:-1] + bytes([packet[-1] ^ 1])


class Bus:
    """A bus as a tracker hears it: a chunk for each packet, 1 ms after the last."""

    def __init__(self, *expected, write_acks='auto', models=MODELS):
        self.evidence = Evidence()
        self.registry = DeviceRegistry(models, expected, 2_000_000, self.evidence)
        self.tracker = Tracker(self.registry, self.evidence, 4, write_acks)
        self.framer = Framer()
        self.now = 1_000_000_000

    def hear(self, *packets, gap_ns=1_000_000):
        for packet in packets:
            self.now += gap_ns
            frames = self.framer.frames(packet)
            self.tracker.process_frames(frames, self.now, self.framer.bytes)

    def idle(self):
        self.tracker.process_frames(self.framer.flush_frames(), self.now, self.framer.bytes)

    def device(self, number):
        device = self.registry.devices[number]
        self.registry.resolve(device)
        return device

    def counts(self, number):
        return self.device(number).counts

    def known(self, number, address, size=4):
        return self.registry.devices[number].table.bytes(address, size)

    def kinds(self):
        return [incident.kind for incident in self.evidence.incidents]


def ping(number):
    return encode(number, I.PING)


def pong(number, model=MX_64, firmware=41):
    return encode(number, STATUS, words(model) + bytes([firmware]), error=0)


def read(number, address=POSITION, length=4):
    return encode(number, I.READ, words(address, length))


def reply(number, data=b'', error=0):
    return encode(number, STATUS, data, error=error)


def write(number, address, data):
    return encode(number, I.WRITE, words(address) + data)


def sync_read(*numbers, address=POSITION, length=4):
    return encode(BROADCAST, I.SYNC_READ, words(address, length) + bytes(numbers))


def fast_read(*numbers, length=4):
    return encode(BROADCAST, I.FAST_SYNC_READ, words(POSITION, length) + bytes(numbers))


SENSELESS = encode(BROADCAST, I.SYNC_WRITE, words(GOAL, 4) + b'\x01\xff\xff\xfd\xfd\x02bbbb',
                   stuffed=False)          # as the official Python client sends it
# Device 1, an MX-64, says its position, takes a goal, and says its ID and its Drive Mode.
FILLED = (ping(1), pong(1), read(1), reply(1, b'pppp'), write(1, GOAL, b'gggg'), reply(1),
          read(1, 7, 4), reply(1, b'\x01\x03\xfa\x00'))


def notes(bus):
    return [(one.stamp, one.kind, one.device, one.detail) for one in bus.evidence.incidents]


# --- packets in words, as pairing.yaml has them

ASKED = {'ping': ping, 'pong': pong, 'read': read, 'sync_read': sync_read, 'fast_read': fast_read}


def packet(text):
    """Return the packet that a few words are; pairing.yaml says which."""
    what, *numbers = text.split()
    if what == 'damaged':
        return damaged(packet(' '.join(numbers)))
    if what == 'hex':
        return bytes_of(*numbers)
    if what in ASKED:
        return ASKED[what](*map(int, numbers))
    if what == 'write':
        return write(int(numbers[0]), int(numbers[1]), bytes_of(numbers[2]))
    if what == 'reply':
        said, _, error = ' '.join(numbers).partition(' error ')
        number, *data = said.split()
        return reply(int(number), bytes_of(*data), int(error or 0))
    code = int(what, 16) if what.startswith('0x') else I[what]
    return encode(int(numbers[0]), code, bytes_of(*numbers[1:]))


def bytes_of(text=''):
    """Return the bytes of hex, or so many times the same: 00*300."""
    data, _, times = text.partition('*')
    return bytes.fromhex(data) * int(times or 1)


def packets(text):
    """Return the chunks that an entry is: `6 x ping 1; pong 1` is twelve."""
    times, x, rest = text.partition(' x ')
    if text == 'filled':
        return FILLED
    return [b''.join(map(packet, chunk.split(' + ')))
            for chunk in (rest or text).split('; ')] * (int(times) if x else 1)
