# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""The UART line between the bridge and the board: its speed, and what can happen to its bytes."""
from __future__ import annotations

from collections.abc import Callable
from contextlib import suppress
import os
from pathlib import Path
import random
import threading
import time
import tty
from types import TracebackType

from mecarover_serial.pty import Pty
from mecarover_serial.readable import readable

BAUD = 115200
CHARACTER_S = 10 / BAUD
TICK_S = 0.001
Damage = Callable[[random.Random, bytes], list[bytes]]      # the pieces that arrive, 8 ms between
PAUSE_S = 0.008


def whole(_: random.Random, frame: bytes) -> list[bytes]:
    return [frame]


def nothing(_: random.Random, frame: bytes) -> list[bytes]:
    return []


def noise(chance: random.Random, frame: bytes) -> list[bytes]:
    return [chance.randbytes(len(frame))]


def half(chance: random.Random, frame: bytes) -> list[bytes]:
    at = chance.randrange(1, len(frame))
    return [chance.choice((frame[:at], frame[at:]))]


def paused(chance: random.Random, frame: bytes) -> list[bytes]:
    at = chance.randrange(1, len(frame))
    return [frame[:at], frame[at:]]


def dropped(chance: random.Random, frame: bytes) -> list[bytes]:
    at = chance.randrange(len(frame))
    return [frame[:at] + frame[at + 1:]]


def flipped(chance: random.Random, frame: bytes) -> list[bytes]:
    bit = chance.randrange(8 * len(frame))
    return [(int.from_bytes(frame, 'little') ^ 1 << bit).to_bytes(len(frame), 'little')]


def flooded(chance: random.Random, frame: bytes) -> list[bytes]:
    """All that the line carries in 33 ms is noise, the frame is lost."""
    return [chance.randbytes(380)]


def surrounded(chance: random.Random, frame: bytes) -> list[bytes]:
    """Noise without a pause before and after it."""
    return [chance.randbytes(150) + frame + chance.randbytes(150)]


def sometimes(damage: Damage) -> Damage:
    """Damage one frame of four."""
    return lambda chance, frame: (damage if chance.random() < 0.25 else whole)(chance, frame)


def at_rate(error: float) -> Damage:
    """Let the receiver's clock be wrong by a share: it samples each bit in its middle."""
    def heard(_: random.Random, frame: bytes) -> list[bytes]:
        bits = [1, *(bit for byte in frame for bit in (
            0, *(byte >> place & 1 for place in range(8)), 1)), *[1] * 20]
        found, start = bytearray(), 1
        while (start := next((at for at in range(start, len(bits))
                              if bits[at - 1] and not bits[at]), len(bits))) < len(bits) - 20:
            sampled = [bits[min(int(start + (place + 0.5) * (1 + error)), len(bits) - 1)]
                       for place in range(10)]
            if sampled[9]:              # else a framing error: the byte is dropped
                found.append(sum(bit << place for place, bit in enumerate(sampled[1:9])))
            start = int(start + 9.5 * (1 + error))
        return [bytes(found)]
    return heard


class Line:
    """Carries bytes between `path` and the board, at the speed of a UART; a thread does."""

    def __init__(self, link: Path, board: str, seed: int = 1) -> None:
        self.damage: Damage = whole
        self.frames = 0
        self._far = os.open(board, os.O_RDWR | os.O_NOCTTY | os.O_NONBLOCK)
        tty.setraw(self._far)
        self._near = Pty(str(link))
        self.path = str(link)
        self._chance = random.Random(seed)
        self._waiting: list[tuple[float, bytes]] = []       # when each byte has arrived
        self._free_at = 0.0
        self._done = threading.Event()
        self._thread = threading.Thread(target=self._run, name='line')

    def _run(self) -> None:
        while not self._done.is_set():
            if readable([self._near.master, self._far], TICK_S if self._waiting else 0.02):
                self._read()
            now = time.monotonic()
            due = b''
            while self._waiting and self._waiting[0][0] <= now:
                due += self._waiting.pop(0)[1]
            with suppress(BlockingIOError):
                if due:
                    os.write(self._far, due)

    def _read(self) -> None:
        with suppress(BlockingIOError):
            for at in range(0, len(chunk := os.read(self._near.master, 4096)), 28):
                self.frames += 1
                self._send(self.damage(self._chance, chunk[at:at + 28]))
        with suppress(BlockingIOError):
            os.write(self._near.master, os.read(self._far, 4096))

    def _send(self, pieces: list[bytes]) -> None:
        at = max(self._free_at, time.monotonic())
        for piece in pieces:
            for byte in piece:
                at += CHARACTER_S
                self._waiting.append((at, bytes([byte])))
            at += PAUSE_S if len(pieces) > 1 else 2 * CHARACTER_S
        self._free_at = at

    def __enter__(self) -> Line:
        self._thread.start()
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None,
                 trace: TracebackType | None) -> None:
        self._done.set()
        self._thread.join()
        self._near.close()
        os.close(self._far)
