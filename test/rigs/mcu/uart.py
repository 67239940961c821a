# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""A cable to a UART: the speed of the line, and what can happen to each frame on it."""
import time

from rigs.bus.wire import render
from rigs.bus.wire import Talk
from rigs.cable import Cable
from rigs.damage import flip_bit
from rigs.damage import lose_byte

CHARACTER_S = 10 / 115200
SLICE = 4                           # bytes that arrive together
PAUSE_S = 0.008                     # between the pieces of a frame


def at_rate(error):
    """Let the clock of the receiver be wrong by a share."""
    return lambda _, frame: [render((Talk(0, frame, 1.0),), 1 + error).data]


def lost(chance, frame):
    return [lose_byte(chance, frame)]


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
    'a byte of each frame lost': lost,
    'a bit of each frame turned': lambda chance, frame: [flip_bit(chance, frame)],
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
