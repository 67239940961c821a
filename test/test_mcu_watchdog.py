# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""The watchdog of docs/frame.md, compiled for the host, on the stream of the bridge."""
import math
from pathlib import Path
import re
import shutil
import subprocess

import pytest

from msg_defs.vel2d import encode
from msg_defs.vel2d import STOP
from msg_defs.vel2d import Vel2d
from vel2d_bridge.gate import Gate
from vel2d_bridge.gate import GateSettings
from vel2d_bridge.gate import MILLISECOND as MS
from vel2d_bridge.pacer import Pacer

pytestmark = pytest.mark.skipif(shutil.which('cc') is None, reason='skipped: no C compiler')
HERE = Path(__file__).parent
DRIVE = Vel2d(0.5, -0.25, 1.0)
LATEST_MS = 300 + 30 + 1            # its time, a turn of the pose loop, and rounding


@pytest.fixture(scope='module')
def mcu(tmp_path_factory):
    """Return what runs the MCU on lines of input: [(ms, velocity)] as its wheels are told."""
    folder = tmp_path_factory.mktemp('mcu')
    [code] = re.findall(r'```c\n(.*?)```', (HERE.parent / 'docs/frame.md').read_text(), re.S)
    (folder / 'watchdog.c').write_text(code)
    subprocess.run(['cc', '-Wall', '-Wextra', '-Werror', '-Wno-unused-parameter', '-I', folder,
                    HERE / 'host_hal.c', '-o', folder / 'mcu', '-lm'], check=True)

    def run(lines):
        done = subprocess.run([folder / 'mcu'], input='\n'.join(lines), text=True, check=True,
                              capture_output=True)
        words = [line.split() for line in done.stdout.splitlines()]
        return [(int(ms), Vel2d(*map(float, values))) for ms, *values in words]

    return run


class Wire:
    """Takes each frame and keeps it as a line of input."""

    def __init__(self):
        self.now = 0
        self.lines = []

    def write(self, data):
        self.lines.append(f'{self.now // MS} {data.hex()}')
        return len(data)

    def pending(self):
        return 0

    def drop_output(self):
        raise AssertionError('nothing waits here')


def stream(end_ms, commands_until_ms=0):
    """Return what the bridge sends until then, a command each 20 ms for the first part."""
    wire = Wire()
    pacer = Pacer(Gate(GateSettings()), lambda: wire.now)
    pacer.attach(wire, 0)
    for ms in range(end_ms):
        wire.now = ms * MS
        if ms < commands_until_ms and ms % 20 == 0:
            pacer.offer(DRIVE, wire.now)
        pacer.turn(wire.now)
    return wire.lines


def stopped_ms(told):
    """Return when the wheels were told to stand for good."""
    moving = [ms for ms, velocity in told if velocity != STOP]
    return next(ms for ms, velocity in told if ms > moving[-1] and velocity == STOP)


def test_it_follows_the_bridge_and_does_not_interfere(mcu):
    told = mcu(stream(5000, 3000))
    sent = [line.split() for line in stream(5000, 3000)]
    assert [ms for ms, velocity in told if velocity == DRIVE] == [
        int(ms) for ms, data in sent if data == encode(DRIVE).hex()]
    assert 3000 + 400 < stopped_ms(told) <= 3000 + 510       # cmd_vel_timeout, the bridge's own


def test_a_host_that_is_gone_is_noticed(mcu):
    told = mcu([*stream(2000, 2000), '9000 end'])
    last = max(ms for ms, velocity in told if velocity == DRIVE)
    assert stopped_ms(told) <= last + LATEST_MS
    assert told[-1] == (9000, STOP)


@pytest.mark.parametrize('damage', [
    lambda data: data[:-1], lambda data: data[:10] + b'!' + data[11:],
    lambda data: encode(DRIVE._replace(x=math.nan)),
    lambda data: encode(DRIVE._replace(y=math.inf)),
], ids=['short', 'a byte wrong', 'NaN', 'infinity'])
def test_frames_that_are_not_good_do_not_keep_it_driving(mcu, damage):
    good, rest = stream(1000, 1000), stream(3000, 3000)[len(stream(1000, 1000)):]
    bad = []
    for line in rest:
        ms, data = line.split()
        bad.append(f'{ms} {damage(bytes.fromhex(data)).hex()}')
    told = mcu([*good, *bad])
    last = max(ms for ms, velocity in told if velocity == DRIVE)
    assert last < 1000
    assert stopped_ms(told) <= last + LATEST_MS


def test_after_an_overrun_it_hears_again(mcu):
    lines = stream(2000, 2000)
    half = len(lines) // 2
    ms = lines[half].split()[0]
    told = mcu([*lines[:half], f'{ms} error', *lines[half:]])
    assert max(ms for ms, velocity in told if velocity == DRIVE) > 1900
    assert [ms for ms, velocity in told if velocity == DRIVE] == [
        ms for ms, velocity in mcu(lines) if velocity == DRIVE]
