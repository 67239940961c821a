# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""firmware/ on this machine, with sanitizers: the receiver and its examples."""
import math
import shutil
import subprocess

from harness import output_of
import pytest

from msg_defs.crc import CRC_INPUTS
from msg_defs.mcu_report import parse_report
from msg_defs.vel2d import encode
from msg_defs.vel2d import STOP
from msg_defs.vel2d import Vel2d
from rigs.mcu.host import compiled
from rigs.mcu.host import FIRMWARE
from rigs.mcu.host import HERE as RIG
from rigs.mcu.host import SANITIZERS

pytestmark = pytest.mark.skipif(shutil.which('cc') is None, reason='skipped: no C compiler')
DRIVE = Vel2d(0.5, -0.25, 1.0)
EXAMPLES = {'stm32_hal': 'words', 'pico': 'bytes'}              # and its crc_input


def test_sizes_that_are_promised():
    lines = {path: path.read_text().count('\n') for path in FIRMWARE.rglob('*.[ch]')}
    examples = [lines.pop(FIRMWARE / f'examples/{name}.c') for name in EXAMPLES]
    assert sum(lines.values()) < 300
    assert max(examples) < 80


@pytest.mark.parametrize('options', [SANITIZERS, ['-Ofast']], ids=['sanitizers', 'fast math'])
def test_the_receiver(tmp_path, options):
    subprocess.run([compiled(tmp_path, RIG / 'unit.c', *options)], check=True)


def test_the_same_verdict_as_the_reader_in_python():
    """On each of 10^6 bytes; docs/firmware.md has the figures of 10^8."""
    assert ' 0 wrong' in output_of('fuzz.firmware', '--bytes', '1000000')


@pytest.mark.parametrize('name', EXAMPLES)
def test_examples(tmp_path, name):
    """It drives, also after overruns; bad frames and silence stop it; it drives again."""
    for header in ('main.h', 'pico/stdlib.h', *(
            f'hardware/{one}.h' for one in ('irq', 'sync', 'uart', 'watchdog'))):
        (tmp_path / header).parent.mkdir(exist_ok=True)
        (tmp_path / header).touch()
    shutil.copy(FIRMWARE / f'examples/{name}.c', tmp_path / 'the_example.c')
    program = compiled(tmp_path, RIG / 'example.c', *SANITIZERS, f'-I{tmp_path}', f'-D{name}')
    crc = CRC_INPUTS[EXAMPLES[name]]
    good = encode(DRIVE, crc)
    bad = [good[:-1], good[:10] + b'!' + good[11:], *(
        encode(DRIVE._replace(x=value), crc) for value in (math.nan, math.inf, 2e6))]
    what = {ms: good.hex() for ms in range(0, 4000, 50)}
    what |= {ms: bad[ms // 50 % len(bad)].hex() for ms in range(1000, 2000, 50)}
    what |= dict.fromkeys(range(2000, 3000, 50), '!')               # nothing
    what |= {505: 'error', 705: 'busy', 4500: 'end'}
    done = subprocess.run([program], text=True, check=True, capture_output=True, input='\n'.join(
        f'{ms} {said}' for ms, said in sorted(what.items())))
    said = done.stdout.splitlines()
    wheels = [[float(word) for word in line.split()] for line in said if line[0].isdigit()]

    def between(begin, end):
        return {Vel2d(*velocity) for ms, *velocity in wheels if begin <= ms <= end}
    assert between(30, 1250) == between(3030, 4230) == {DRIVE}
    assert between(1331, 2999) == between(4290, 4470) == {STOP}
    *_, last = filter(None, map(parse_report, said))
    assert last.good >= 39 and last.bad             # an overrun may cost a frame
    assert last[4:] == (12, 2) and last.state == 'stopped'
