# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""
Script: the bytes of a fuzzer read as decisions, and as bus traffic with valid frames.

A fuzzer that had to guess checksums would never get past the Framer. An exhausted script says 0.
"""

from msg_defs import dxl1_packet
from msg_defs.crc import crc16
from msg_defs.dxl_instruction import NAMES
from msg_defs.dxl_packet import BROADCAST
from msg_defs.dxl_packet import encode
from msg_defs.dxl_packet import HEADER
from msg_defs.dxl_packet import STATUS

INSTRUCTIONS = sorted(NAMES)
TRICKY = (b'\xff\xff\xfd\x00', b'\xff\xff\xfd\xfd', b'\xff\xff\xfd', b'\xff\xff', b'\xff',
          b'\x00', b'\xfd', HEADER + b'\xfe\x00\x04', HEADER + b'\x01\xff\xff\x55')
TRICKY_1 = (b'\xff\xff', b'\xff', b'\xff\xff\xff', b'\x00', b'\xfd', b'\xff\xff\xfd\x00',
            b'\xff\xff\x01\x02', b'\xff\xff\x01\x00', b'\xff\xff\xfe\xff', b'\x01\x02\x01\xfb')


class Script:
    """Decisions one after the other."""

    def __init__(self, data):
        self._data = data
        self._at = 0

    def __bool__(self):
        return self._at < len(self._data)

    def take_bytes(self, size):
        taken = self._data[self._at:self._at + size]
        self._at += size
        return taken

    def take_rest(self):
        return self.take_bytes(len(self._data))

    def byte(self):
        return int.from_bytes(self.take_bytes(1), 'little')

    def word(self):
        return int.from_bytes(self.take_bytes(2), 'little')

    def pick(self, choices):
        return choices[self.byte() % len(choices)]


def _raw(script, last):
    return script.take_bytes(script.byte())


def _tricky(script, last):
    return script.pick(TRICKY)


def _params(script):
    return b''.join(script.pick(TRICKY) if one > 240 else bytes([one])
                    for one in script.take_bytes(script.byte() % 48))


def _instruction(script, last):
    kind = script.byte()
    instruction = kind if kind > 200 else INSTRUCTIONS[kind % len(INSTRUCTIONS)]
    return encode(_id(script), instruction, _params(script), 0 if instruction == STATUS else None,
                  stuffed=script.byte() < 200)


def _status(script, last):
    return encode(_id(script), STATUS, _params(script), _error(script))


def _read(script, last):
    """Make a read of a few devices, answered by most of them."""
    ids = [script.byte() % 6 for _ in range(1 + script.byte() % 4)]
    size = script.byte() % 8
    where = script.word().to_bytes(2, 'little') + size.to_bytes(2, 'little')
    answers = [encode(one, STATUS, script.take_bytes(size).ljust(size, b'\0'), _error(script))
               for one in ids if script.byte() < 200]
    return encode(BROADCAST, 0x82, where + bytes(ids)) + b''.join(answers)


def _fast_read(script, last):
    ids = [*dict.fromkeys(script.byte() % 6 for _ in range(1 + script.byte() % 4))]
    size = script.byte() % 8
    where = script.word().to_bytes(2, 'little') + size.to_bytes(2, 'little')
    blocks = [(_error(script), one, script.take_bytes(size).ljust(size, b'\0')) for one in ids]
    return encode(BROADCAST, 0x8A, where + bytes(ids)) + fast_reply(blocks)


def fast_reply(blocks):
    """Return the combined status of (error, id, data): each block ends with the CRC so far."""
    length = 1 + sum(len(data) + 4 for _, _, data in blocks)
    wire = HEADER + bytes([BROADCAST]) + length.to_bytes(2, 'little') + bytes([STATUS])
    for error, one, data in blocks:
        wire += bytes([error, one]) + data
        wire += crc16(wire).to_bytes(2, 'little')
    return wire


def _flipped(script, last):
    if not last:
        return last
    bit = script.word() % (8 * len(last))
    damaged = bytearray(last)
    damaged[bit // 8] ^= 1 << bit % 8
    return bytes(damaged)


def _cut(script, last):
    return last[:script.byte()]


def _headless(script, last):
    return last[1:]


def _again(script, last):
    return last


def _id(script):
    number = script.byte()
    return number % 6 if number < 230 else number


def _error(script):
    error = script.byte()
    return error if error > 240 else 0


def _tricky_1(script, last):
    return script.pick(TRICKY_1)


def _packet_1(script, last):
    return dxl1_packet.encode(script.byte(), script.byte(), script.take_bytes(script.byte() % 24))


PIECES_2 = (_raw, _tricky, _instruction, _instruction, _status, _status, _read, _read, _fast_read,
            _flipped, _cut, _headless, _again)
NOISE = (_raw, _raw, _tricky, _tricky_1)
PIECES_1 = (_raw, _raw, _tricky_1, _tricky_1, _packet_1, _packet_1, _flipped, _cut)


def traffic(script, pieces=PIECES_2):
    """Yield pieces of bus traffic until the script is over: frames, damaged ones, noise."""
    last = b''
    while script:
        last = script.pick(pieces)(script, last)
        yield last
