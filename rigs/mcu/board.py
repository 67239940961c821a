# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""An STM32F405 with firmware/, emulated by QEMU: its USART is a pty, its trace is read here."""
from __future__ import annotations

from pathlib import Path
import re
import shutil
import struct
import subprocess
import threading
import time
from types import TracebackType
from typing import NamedTuple

from rigs.debian import Missing
from rigs.mcu.host import FIRMWARE
from rigs.mcu.host import WARNINGS

TOOLS = {'arm-none-eabi-gcc': 'gcc-arm-none-eabi', 'qemu-system-arm': 'qemu-system-arm'}
CORTEX_M4 = ('-mcpu=cortex-m4', '-mthumb', '-mfpu=fpv4-sp-d16', '-mfloat-abi=hard')
HERE = Path(__file__).parent


class Event(NamedTuple):
    """What the board says: a good frame or the wheels."""

    tick: int                       # ms of its SysTick
    velocity: tuple[float, ...]
    stamp: float                    # when it was read here, s


def check_tools() -> None:
    """Raise Missing unless compiler and emulator are here."""
    missing = [package for tool, package in TOOLS.items() if shutil.which(tool) is None]
    if missing:
        raise Missing(f'{", ".join(missing)}: not installed; '
                      f'sudo apt install --no-install-recommends {" ".join(missing)}')


def built(folder: Path, *options: str) -> Path:
    """Compile the board's program; the receiver with all warnings."""
    receiver, image = folder / 'receiver.o', folder / 'board.elf'
    gcc = ('arm-none-eabi-gcc', *CORTEX_M4, '-O2', '-ffreestanding', f'-I{FIRMWARE}', '-Wall',
           '-Wextra', '-Werror')
    subprocess.run([*gcc, *WARNINGS, '-c', FIRMWARE / 'vel2d_receiver.c', '-o', receiver],
                   check=True)
    subprocess.run([*gcc, *options, '-nostdlib', '-nostartfiles', f'-T{HERE / "board.ld"}',
                    HERE / 'board.c', receiver, '-lgcc', '-o', image], check=True)
    return image


def sizes(receiver: Path) -> tuple[int, int]:
    """Return the bytes of flash and of static RAM that an object file takes."""
    said = subprocess.run(['arm-none-eabi-size', receiver], check=True, capture_output=True,
                          text=True).stdout
    text, data, bss = map(int, said.splitlines()[1].split()[:3])
    return text + data, data + bss


class Board:
    """The running board: `path` is its line; `good` and `wheels` grow."""

    def __init__(self, image: Path) -> None:
        self._process = subprocess.Popen(
            ['qemu-system-arm', '-M', 'netduinoplus2', '-display', 'none', '-monitor', 'none',
             '-chardev', 'pty,id=line', '-serial', 'chardev:line',
             '-chardev', 'stdio,id=trace,signal=off', '-serial', 'chardev:trace',
             '-kernel', image], stdin=subprocess.DEVNULL, stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT, text=True, start_new_session=True)
        self.good: list[Event] = []
        self.wheels: list[Event] = []
        self.memory: list[int] = []     # the receiver, and the stack that feed, now, report take
        self.volume: list[int] = []     # bytes, frames, wrong ones, damages
        self.other = ''
        self.path = ''
        self._known = threading.Event()
        self._thread = threading.Thread(target=self._read, daemon=True)
        self._thread.start()
        assert self._known.wait(20), self.other

    def _read(self) -> None:
        assert self._process.stdout is not None
        for line in self._process.stdout:
            what, *words = line.split()
            if what in ('G', 'W'):
                event = Event(int(words[0]), struct.unpack('<3d', bytes.fromhex(words[1])),
                              time.monotonic())
                (self.good if what == 'G' else self.wheels).append(event)
            elif what in ('M', 'V'):
                (self.memory if what == 'M' else self.volume).extend(map(int, words))
            elif found := re.search(r'redirected to (/dev/pts/\d+)', line):
                self.path = found[1]
                self._known.set()
            else:
                self.other += line

    def __enter__(self) -> Board:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None,
                 trace: TracebackType | None) -> None:
        self._process.terminate()
        self._process.wait()
        self._thread.join()
