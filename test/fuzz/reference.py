# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""
Reference: the rules of both wires a second time, as plainly as they can be put.

The targets compare with it, so it takes nothing from the package: not a constant, not a CRC; the
CRC of 2.0 and its stuffing are those of the simulated bus of rigs/.
It sees a stream as a whole and is slow. Sources: e-Manual, Protocol 2.0 and 1.0; docs/frame.md.
"""

from typing import NamedTuple

from rigs.bus import frames
from rigs.bus import frames1

TAIL = b'\xff\xfd\x00'                 # a header, but for its first byte, which may have got lost
LONGEST = 1024                         # Length of a packet


def crc16(data):
    return int.from_bytes(frames.crc(data), 'little')


def crc32(data):
    """Divide bit by bit: CRC-32/MPEG-2, which zlib does not have."""
    value = 0xFFFFFFFF
    for byte in data:
        value ^= byte << 24
        for _ in range(8):
            value = (value << 1 ^ (0x04C11DB7 if value >> 31 else 0)) & 0xFFFFFFFF
    return value


def crc32_words(data):
    return crc32(b''.join(data[at:at + 4][::-1] for at in range(0, len(data), 4)))


class Found(NamedTuple):
    """A good packet: where it ends, its bytes from the ID to the last parameter, noise ahead."""

    end: int
    body: bytes
    repaired: bool
    noise: int


class Stream:
    """All packets of a stream of bytes, by how much of it has come."""

    def __init__(self, data):
        self.data = data
        self._marks = []               # (second FF of a header, Length, whether the CRC holds)
        at = data.find(TAIL)
        while at >= 0:
            length = int.from_bytes(data[at + 4:at + 6], 'little')
            self._marks.append((at, length, self._holds(at, length)))
            at = data.find(TAIL, at + 1)

    def _holds(self, at, length):
        body, end = self.data[at + 3:at + 4 + length], at + 6 + length
        shortest = 4 if body[3:4] == b'\x55' else 3
        return (shortest <= length <= LONGEST and end <= len(self.data)
                and crc16(b'\xff' + TAIL + body).to_bytes(2, 'little') == self.data[end - 2:end])

    def found(self, size, idle):
        """Return packets and noise of the first `size` bytes; idle: nothing more will come."""
        packets = []
        noise = bytearray()
        done = 0
        decided = size if idle else max(0, size - len(TAIL))
        for at, length, holds in self._marks:
            end = at + 6 + length
            if at < done:
                continue
            if not idle and (at + 7 > size or (end > size and length <= LONGEST)):
                decided = min(decided, at - 1)
                break
            if holds and end <= size:
                begin = max(done, at - 1)
                packets.append(Found(end, self.data[at + 3:end - 2],
                                     begin == at or self.data[begin] != 0xFF, begin - done))
                noise += self.data[done:begin]
                done = end
        return packets, bytes(noise + self.data[done:max(done, decided)])


class Stream1:
    """All packets of the 1.0 family in a stream of bytes, by how much of it has come."""

    def __init__(self, data):
        self.data = data

    def found(self, size, idle):
        """Return packets and noise of the first `size` bytes; idle: nothing more will come."""
        data = self.data[:size]
        packets = []
        noise = bytearray()
        done = at = 0
        while at < size:
            fate = _fate_1(data[at:], idle)
            if fate is None:
                break
            if fate:
                packets.append(Found(at + fate, data[at + 2:at + fate - 1], False, at - done))
                noise += data[done:at]
                done = at = at + fate
            else:
                at += 1
        return packets, bytes(noise + data[done:at])


def _fate_1(data, idle):
    """Return the size of the packet at the beginning, 0 if there is none, None if undecided."""
    if data[:2] != b'\xff\xff'[:len(data)]:
        return 0
    if len(data) > 2 and data[2] == 0xFF:
        return 0 if len(data) > 3 or idle else None
    if len(data) < 4:
        return 0 if idle else None
    size = data[3] + 4
    if data[3] < 2:
        return 0
    if len(data) < size:
        return 0 if idle else None
    total = 0
    for byte in data[2:size - 1]:
        total += byte
    return size if data[size - 1] == 255 - total % 256 else 0


class Said(NamedTuple):
    """A packet of the 1.0 family and who said it: the master, or else a servo."""

    is_master: bool
    number: int                    # the ID in it
    code: int                      # instruction or error byte
    params: bytes
    after_ns: int                  # silence in front of it

    @property
    def wire(self):
        return frames1.packet(self.number, self.code, self.params)
