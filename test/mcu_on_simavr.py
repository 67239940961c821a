# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""The receiver and the Arduino sketch of firmware/ on a simulated ATmega328P: scripts/test-mcu."""
import math
from pathlib import Path
import struct
import subprocess
import threading

from harness import wait
import pytest
from running_bridge import bridge

from msg_defs.crc import CRC_BY_INPUT
from msg_defs.mcu_report import McuReport
from msg_defs.mcu_report import parse_report
from msg_defs.vel2d import encode
from msg_defs.vel2d import Vel2d
from rigs.cable import Cable
from rigs.mcu.host import FIRMWARE
from rigs.mcu.host import HERE
from rigs.mcu.values import as_float
from rigs.mcu.values import doubles

ARDUINO = Path('/usr/share/arduino/hardware/arduino/avr')
RECEIVER = FIRMWARE / 'vel2d_receiver.c'
AVR = ('-mmcu=atmega328p', '-Os', '-Wall', '-Wextra', f'-I{FIRMWARE}')
FRAME_MS, GOOD = 50, Vel2d(0.5, -0.25, 1.0)


@pytest.fixture(scope='module')
def simulator(tmp_path_factory):
    program = tmp_path_factory.mktemp('simavr') / 'avr'
    subprocess.run(['cc', '-Wall', '-Wextra', HERE / 'avr.c', '-lsimavr', '-o', program],
                   check=True)
    return program


def run(simulator, image, what):
    """Return the lines that the MCU sent and the changes of its LED, by ms."""
    done = subprocess.run([simulator, image], text=True, check=True, capture_output=True,
                          input='\n'.join(f'{ms} {said}' for ms, said in sorted(what.items())))
    lines = (line.partition(' ') for line in done.stdout.splitlines())
    return [(int(ms), said) for ms, _, said in lines if ms.isdecimal()]


def frame(*velocity):
    return encode(Vel2d(*velocity), CRC_BY_INPUT['bytes']).hex()


def test_a_double_of_4_bytes(simulator, tmp_path):
    sent = doubles(100)
    subprocess.run(['avr-gcc', '-std=gnu99', *AVR, RECEIVER, HERE / 'values.c',
                    HERE / 'avr_stdio.c', '-o', tmp_path / 'values.elf'], check=True)
    what = {10 * at: frame(value, 0.0, value) for at, value in enumerate(sent, 1)}
    said = run(simulator, tmp_path / 'values.elf', {**what, 10 * len(sent) + 20: 'end'})
    read = [struct.unpack('<3f', bytes.fromhex(line)) for _, line in said]
    assert [f'{one} {two}' for one, _, two in read] == [
        f'{value} {value}' for value in map(as_float, sent)]


@pytest.fixture(scope='module')
def sketch(tmp_path_factory):
    """Compile the sketch and the core of the Uno as Arduino does."""
    folder = tmp_path_factory.mktemp('sketch')
    cores = [ARDUINO / 'cores/arduino', ARDUINO / 'variants/standard']
    options = (*AVR[:2], f'-I{FIRMWARE}', *(f'-I{core}' for core in cores), '-DF_CPU=16000000L',
               '-DARDUINO=10819', '-DARDUINO_ARCH_AVR', '-ffunction-sections', '-fdata-sections')
    core = sorted(path for path in cores[0].iterdir() if path.suffix in ('.c', '.cpp', '.S'))
    objects = []
    for path in (*core, RECEIVER, FIRMWARE / 'examples/arduino/arduino.ino'):
        objects.append(folder / f'{path.name}.o')
        language = ['-x', 'c++', '-include', 'Arduino.h'] if path.suffix == '.ino' else []
        # Debian's core 1.8.7 needs DECIMAL_DIG, its avr-gcc 5.4 has none in C++.
        is_cpp = path.suffix in ('.ino', '.cpp')
        subprocess.run(['avr-gcc', *options, *(['-std=gnu++11', '-fno-exceptions',
                                                '-fno-threadsafe-statics', '-DDECIMAL_DIG=9']
                                               if is_cpp else []),
                        *language, '-c', path, '-o', objects[-1]], check=True)
    image = folder / 'arduino.elf'
    subprocess.run(['avr-gcc', *AVR[:2], '-Wl,--gc-sections', *objects, '-lm', '-o', image],
                   check=True)
    return image


def test_the_sketch(simulator, sketch):
    """It drives, refuses, stops by its watchdog, and drives again, after a reset too."""
    good = frame(*GOOD)
    bad = [frame(value, 0.0, 0.0) for value in (math.nan, math.inf, 0.5500001, 1e300, 2.0 ** 127)]
    what = dict.fromkeys(range(100, 3000, FRAME_MS), good)
    what |= {ms: bad[ms // FRAME_MS % len(bad)] for ms in range(1000, 2000, FRAME_MS)}
    said = run(simulator, sketch, {**what, 2525: 'reset', 3500: 'end'})
    led = [(ms, line) for ms, line in said if line.startswith('led')][1:]
    wanted = [(103, 'led 1'), (1253, 'led 0'), (2003, 'led 1'), (2525, 'led 0'), (2553, 'led 1'),
              (3253, 'led 0')]
    assert [line for _, line in led] == [line for _, line in wanted]
    assert all(abs(ms - at) <= 4 for (ms, _), (at, _) in zip(led, wanted, strict=True)), led
    reports = [report for _, line in said if (report := parse_report(line))]
    assert len(reports) == len(said) - len(led) - 1
    assert max(report.refused for report in reports) == 20
    assert reports[-1] == McuReport(1, 'stopped', 9, 0, 0, 1)


class Arduino:
    """The sketch in real time, on a pty: `path`."""

    def __init__(self, simulator, image):
        self._process = subprocess.Popen([simulator, image, 'pty'], text=True, bufsize=1,
                                         stdin=subprocess.PIPE, stdout=subprocess.PIPE)
        lines = (line.split() for line in self._process.stdout)
        self.path = next(words[2] for words in lines if words[1] == 'pty')
        self.is_driving = False
        threading.Thread(target=self._watch, args=[lines], daemon=True).start()

    def _watch(self, lines):
        for _, what, *words in lines:
            if what == 'led':
                self.is_driving = words == ['1']

    def __enter__(self):
        return self

    def __exit__(self, *_):
        self._process.stdin.close()
        self._process.wait()

    def reset(self):
        self._process.stdin.write('reset\n')


@pytest.mark.ros
@pytest.mark.realtime(bears=0.1)
def test_the_link_comes_back(ros, graph, cmd_vel, simulator, sketch, tmp_path):
    """The bridge drives it, also after a reset that the port does not show, and a new plug."""
    link = 'vel2d_bridge: link'
    with Arduino(simulator, sketch) as arduino, Cable(arduino.path, tmp_path / 'mcu') as cable, \
            bridge(cable), ros.Teleop(cmd_vel, lambda: ros.twist(0.3), 20):
        wait(lambda: arduino.is_driving)
        graph.wait_status(link, 'MCU state=running', 'MCU watchdog stops=0', level=0)
        for lose, regain in ((arduino.reset, bool), (cable.cut, cable.reopen)):
            lose()
            wait(lambda: not arduino.is_driving)
            regain()
            wait(lambda: arduino.is_driving)
        graph.wait_status(link, 'MCU state=running', 'Reopenings=1', 'MCU watchdog stops=1')
