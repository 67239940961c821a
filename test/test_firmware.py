# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""firmware/ on this machine, with sanitizers: the receiver and its examples."""
import math
from pathlib import Path
import re
import shutil
import struct
import subprocess

from harness import output_of
import pytest

from msg_defs.crc import CRC_BY_INPUT
from msg_defs.mcu_report import parse_report
from msg_defs.vel2d import encode
from msg_defs.vel2d import STOP
from msg_defs.vel2d import Vel2d
from rigs.mcu.host import compiled
from rigs.mcu.host import FIRMWARE
from rigs.mcu.host import HERE as RIG
from rigs.mcu.host import SANITIZERS
from rigs.mcu.values import as_float
from rigs.mcu.values import doubles

pytestmark = pytest.mark.skipif(shutil.which('cc') is None, reason='skipped: no C compiler')
DRIVE = Vel2d(0.5, -0.25, 1.0)
# Each example and its crc_input.
EXAMPLES = {'stm32_hal.c': 'words', 'pico.c': 'bytes', 'arduino/arduino.ino': 'bytes'}


def test_sizes_that_are_promised():
    lines = {path: path.read_text().count('\n') for path in FIRMWARE.rglob('*.[chi]*')}
    examples = [lines.pop(FIRMWARE / f'examples/{name}') for name in EXAMPLES]
    assert sum(lines.values()) < 300
    assert max(examples) < 80


@pytest.mark.parametrize('options', [SANITIZERS, ['-Ofast']], ids=['sanitizers', 'fast math'])
def test_the_receiver(tmp_path, options):
    subprocess.run([compiled(tmp_path, RIG / 'unit.c', *options)], check=True)


def test_the_same_verdict_as_the_reader_in_python():
    """On each of 10^6 bytes; docs/firmware.md has the figures of 10^8."""
    assert ' 0 wrong' in output_of('fuzz.firmware', '--bytes', '1000000')


def as_sent(value):
    return value if math.isfinite(value) else math.nan


@pytest.mark.parametrize(('is_float', 'expected'), [(0, as_sent), (1, as_float)])
def test_a_double_of_8_bytes_and_of_4(tmp_path, is_float, expected):
    """The double of an AVR is a float: the receiver makes one out of the frame's bits."""
    sent = doubles(20_000)
    assert all(struct.unpack('<f', struct.pack('<f', as_float(value)))[0] == as_float(value)
               for value in sent if abs(value) < 2.0 ** 128)
    program = compiled(tmp_path, RIG / 'values.c', *SANITIZERS, f'-DVEL2D_FLOAT={is_float}')
    done = subprocess.run([program], check=True, capture_output=True, input=b''.join(
        encode(Vel2d(value, 0.0, value), CRC_BY_INPUT['bytes']) for value in sent))
    read = struct.iter_unpack('<3d', bytes.fromhex(done.stdout.decode()))
    assert [f'{one} {two}' for one, _, two in read] == [
        f'{value} {value}' for value in map(expected, sent)]


def example(folder, name):
    """Compile an example, on a simulated HAL, SDK or Arduino."""
    for header in ('main.h', 'pico/stdlib.h', *(
            f'hardware/{one}.h' for one in ('irq', 'sync', 'uart', 'watchdog'))):
        (folder / header).parent.mkdir(exist_ok=True)
        (folder / header).touch()
    text = (FIRMWARE / 'examples' / name).read_text()
    (folder / 'the_example.c').write_text(
        re.sub(r'(void drive\(.*\n\{\n)', r'\1    set_velocity(x, y, omega);\n', text))
    return compiled(folder, RIG / 'example.c', *SANITIZERS, f'-I{folder}',
                    f'-D{Path(name).stem}', is_cpp=name.endswith('.ino'))


def run(program, what):
    """Return the velocities that it sets, and its lines for the host."""
    done = subprocess.run([program], text=True, check=True, capture_output=True, input='\n'.join(
        f'{ms} {said}' for ms, said in sorted(what.items())))
    said = done.stdout.splitlines()
    wheels = [[float(word) for word in line.split()] for line in said if line[0].isdigit()]

    def between(begin, end):
        return {Vel2d(*velocity) for ms, *velocity in wheels if begin <= ms <= end}
    return between, said


@pytest.mark.parametrize('name', EXAMPLES)
def test_examples(tmp_path, name):
    """It drives, also after overruns; bad frames and silence stop it; it drives again."""
    crc = CRC_BY_INPUT[EXAMPLES[name]]
    good = encode(DRIVE, crc)
    bad = [good[:-1], good[:10] + b'!' + good[11:], *(
        encode(DRIVE._replace(x=value), crc) for value in (math.nan, math.inf, 2e6))]
    what = {ms: good.hex() for ms in range(0, 4000, 50)}
    what |= {ms: bad[ms // 50 % len(bad)].hex() for ms in range(1000, 2000, 50)}
    what |= dict.fromkeys(range(2000, 3000, 50), '!')               # nothing
    what |= {505: 'error', 705: 'busy', 4500: 'end'}
    between, said = run(example(tmp_path, name), what)
    assert between(30, 1240) == between(3030, 4230) == {DRIVE}
    assert between(1331, 2999) == between(4290, 4470) == {STOP}
    *_, last = filter(None, map(parse_report, said))
    assert last.good >= 39 and last.bad             # an overrun may cost a frame
    assert last[4:] == (12, 2) and last.state == 'stopped'


@pytest.mark.parametrize('name', EXAMPLES)
def test_after_a_reset_it_drives_with_the_first_whole_frame(tmp_path, name):
    """An Arduino resets where its port is opened: what comes before it listens is lost."""
    good = encode(DRIVE, CRC_BY_INPUT[EXAMPLES[name]]).hex()
    between, _ = run(example(tmp_path, name), {20: good[30:], 70: good, 120: good, 200: 'end'})
    assert between(0, 69) == {STOP} and between(90, 190) == {DRIVE}
