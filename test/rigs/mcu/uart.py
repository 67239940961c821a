# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""A cable to a UART: the speed of the line, and what can happen to each frame on it."""
import time

from rigs.cable import Cable

CHARACTER_S = 10 / 115200
SLICE = 4                           # bytes that arrive together
PAUSE_S = 0.008                     # between the pieces of a frame


def at_rate(error):
    """Let the clock of the receiver be wrong by a share: it samples each bit in its middle."""
    def heard(_, frame):
        bits = [1]
        for byte in frame:
            bits += [0, *(byte >> place & 1 for place in range(8)), 1]
        found, at, last = bytearray(), 1, len(bits)
        bits += [1] * 12
        while at < last:
            if bits[at - 1] <= bits[at]:
                at += 1             # no edge of a start bit
                continue
            byte = [bits[int(at + (place + 0.5) * (1 + error))] for place in range(10)]
            if byte[9]:             # else a framing error
                found.append(sum(bit << place for place, bit in enumerate(byte[1:9])))
            at += int(9.5 * (1 + error))
        return [bytes(found)]
    return heard


def lost(chance, frame):
    """Lose a byte."""
    at = chance.randrange(len(frame))
    return [frame[:at] + frame[at + 1:]]


def turned(chance, frame):
    """Turn a bit."""
    bit = chance.randrange(8 * len(frame))
    return [(int.from_bytes(frame, 'little') ^ 1 << bit).to_bytes(len(frame), 'little')]


def whole(_, frame):
    return [frame]


# {name: what becomes of a frame: its pieces}. No good frame comes through the former, and at
# least a share through the latter: a busy machine makes a pause in one now and then.
FAULTS = {
    'silence': lambda chance, frame: [],
    'noise': lambda chance, frame: [chance.randbytes(28)],
    'flood': lambda chance, frame: [chance.randbytes(380)],         # all that the line carries
    'half frames': lambda chance, frame: [frame[:chance.randrange(28)]],
    'a pause in each frame': lambda chance, frame: [frame[:14], frame[14:]],
    'a byte of each frame lost': lost, 'a bit of each frame turned': turned,
    'baud rate 6 % off': at_rate(0.06)}
HARMLESS = {
    'none': (whole, 0.8), 'baud rate 2 % off': (at_rate(0.02), 0.8),
    'noise around each frame': (
        lambda chance, frame: [chance.randbytes(150) + frame + chance.randbytes(150)], 0.8),
    'one frame of four without a byte': (
        lambda chance, frame: (whole if chance.random() < 0.75 else lost)(chance, frame), 0.5)}


class Uart(Cable):
    """Carries what the host sends at 115200 baud; `fault` is one of the above."""

    def __init__(self, device, link):
        super().__init__(device, link)
        self.fault = whole
        self.frames = 0
        self._free_at = 0.0

    def _carry(self, source, target):
        has_come = super()._carry(source, target)
        if has_come and source == self._near.master:
            _, _, chunk = self._late.pop()
            for at in range(0, len(chunk), 28):
                self.frames += 1
                self._send(target, self.fault(self._chance, chunk[at:at + 28]))
        return has_come

    def _send(self, target, pieces):
        at = max(self._free_at, time.monotonic())
        for piece in pieces:
            for begin in range(0, len(piece), SLICE):
                at += SLICE * CHARACTER_S
                self._late.append((at, target, piece[begin:begin + SLICE]))
            at += PAUSE_S if len(pieces) > 1 else CHARACTER_S
        self._free_at = at
