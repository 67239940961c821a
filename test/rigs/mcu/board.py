# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""An STM32F405 with firmware/, emulated by QEMU: its USART is a pty, its trace is read here."""
from collections import namedtuple
import struct
import subprocess
import threading
import time

from rigs.mcu.host import FIRMWARE
from rigs.mcu.host import HERE

QEMU = ('qemu-system-arm', '-M', 'netduinoplus2', '-display', 'none', '-monitor', 'none',
        '-chardev', 'pty,id=line', '-serial', 'chardev:line',
        '-chardev', 'stdio,id=trace,signal=off', '-serial', 'chardev:trace', '-kernel')
GCC = ('arm-none-eabi-gcc', '-mcpu=cortex-m4', '-mthumb', '-mfpu=fpv4-sp-d16', '-mfloat-abi=hard',
       '-O2', '-Wall', '-Wextra', '-Wconversion', '-Werror', f'-I{FIRMWARE}')


# What the board says of a good frame or its wheels: ms of its SysTick, and when it was read (s).
Event = namedtuple('Event', 'tick velocity stamp')


def built(folder, *options):
    """Compile the board's program, and receiver.o in the same folder."""
    receiver, image = folder / 'receiver.o', folder / 'board.elf'
    subprocess.run([*GCC, '-std=c99', '-c', FIRMWARE / 'vel2d_receiver.c', '-o', receiver],
                   check=True)
    subprocess.run([*GCC, *options, '-nostartfiles', '-T', HERE / 'board.ld', HERE / 'board.c',
                    receiver, '-o', image], check=True)
    return image


class Board:
    """The running board: `path` is its line; `good`, `wheels` and `figures` grow."""

    def __init__(self, image):
        self._process = subprocess.Popen([*QEMU, image], stdin=subprocess.DEVNULL,
                                         stdout=subprocess.PIPE, text=True)
        self.path = next(self._process.stdout).split()[4]   # char device redirected to PATH (...
        self.good, self.wheels = [], []
        self.figures = {}                       # lines M and V of board.c
        threading.Thread(target=self._read, daemon=True).start()

    def _read(self):
        for line in self._process.stdout:
            what, *words = line.split()
            if what in 'GW':
                (self.good if what == 'G' else self.wheels).append(Event(
                    int(words[0]), struct.unpack('<3d', bytes.fromhex(words[1])),
                    time.monotonic()))
            else:
                self.figures[what] = list(map(int, words))

    def __enter__(self):
        return self

    def __exit__(self, *_):
        self._process.terminate()
        self._process.communicate()
