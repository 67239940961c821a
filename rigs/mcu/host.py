# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""firmware/vel2d_receiver.c on this machine, with sanitizers, driven by a script."""
from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
import struct
import subprocess
from typing import NamedTuple

from rigs.harness import REPOSITORY

FIRMWARE = REPOSITORY / 'firmware'
WARNINGS = ('-std=c99', '-Wall', '-Wextra', '-Wpedantic', '-Wconversion', '-Werror')
SANITIZERS = ('-g', '-O1', '-fsanitize=address,undefined', '-fno-sanitize-recover=all')
STATES = ('waiting', 'running', 'stopped')
LARGEST = 1e6


class Taken(NamedTuple):
    """What a feed did: (place of the last byte, 24 bytes) of each frame that was taken."""

    frames: list[tuple[int, bytes]]
    bad: int
    refused: int


class Wheels(NamedTuple):
    """What the wheels may do, the 24 bytes as in a frame."""

    velocity: bytes
    state: str
    stops: int


def compiled(folder: Path, *options: str, sources: Sequence[Path] = ()) -> Path:
    """Compile the receiver for this machine with the sources, or else with host.c."""
    program = folder / 'receiver'
    sources = sources or [Path(__file__).with_name('host.c')]
    subprocess.run(['cc', *WARNINGS, *(options or SANITIZERS), f'-I{FIRMWARE}',
                    FIRMWARE / 'vel2d_receiver.c', *sources, '-o', program], check=True)
    return program


class Host:
    """Collects what a receiver gets; `run` returns what it answered to each call but `idle`."""

    def __init__(self, *, words: bool = False, watchdog_ms: int = 300, ramp_ms: int = 0,
                 gap_ms: int = 5, most: Sequence[float] = 3 * (LARGEST,)) -> None:
        self._script = bytearray(b'S' + struct.pack(
            '<4I3d', words, watchdog_ms, ramp_ms, gap_ms, *most))
        self._asked: list[str] = []

    def feed(self, data: bytes, now_ms: int) -> None:
        self._call('B', now_ms, struct.pack('<I', len(data)) + data)

    def idle(self) -> None:
        self._script += b'I'

    def turn(self, now_ms: int) -> None:
        self._call('N', now_ms)

    def report(self, now_ms: int) -> None:
        self._call('R', now_ms)

    def _call(self, what: str, now_ms: int, more: bytes = b'') -> None:
        self._script += what.encode() + struct.pack('<I', now_ms % 2**32) + more
        self._asked.append(what)

    def run(self, program: Path) -> list[Taken | Wheels | str]:
        done = subprocess.run([program], input=self._script, capture_output=True)
        assert done.returncode == 0, done.stderr.decode()
        answers = _Answers(done.stdout)
        return [getattr(answers, what)() for what in self._asked]


class _Answers:
    def __init__(self, data: bytes) -> None:
        self._data = data
        self._at = 0

    def _take(self, size: int) -> bytes:
        self._at += size
        return self._data[self._at - size:self._at]

    def _word(self) -> int:
        return int.from_bytes(self._take(4), 'little')

    def B(self) -> Taken:
        frames = [(self._word(), self._take(24)) for _ in range(self._word())]
        return Taken(frames, self._word(), self._word())

    def N(self) -> Wheels:
        return Wheels(self._take(24), STATES[self._word()], self._word())

    def R(self) -> str:
        return self._take(self._word()).decode()
