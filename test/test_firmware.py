# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""firmware/ on this machine, with sanitizers: the receiver, and its examples on the bridge."""
import math
from pathlib import Path
import re
import shutil
import struct
import subprocess
import sys

import pytest

from msg_defs.crc import CRC_INPUTS
from msg_defs.mcu_report import McuReport
from msg_defs.mcu_report import parse_report
from msg_defs.mcu_report import VERSION
from msg_defs.vel2d import encode
from msg_defs.vel2d import STOP
from msg_defs.vel2d import Vel2d
from rigs.mcu.host import compiled
from rigs.mcu.host import FIRMWARE
from rigs.mcu.host import Host
from rigs.mcu.host import SANITIZERS
from vel2d_bridge.gate import Gate
from vel2d_bridge.gate import GateSettings
from vel2d_bridge.gate import MILLISECOND as MS
from vel2d_bridge.pacer import Pacer

pytestmark = pytest.mark.skipif(shutil.which('cc') is None, reason='skipped: no C compiler')
HERE = Path(__file__).parent
DRIVE = Vel2d(0.5, -0.25, 1.0)
FRAME = encode(DRIVE)
LATEST_MS = 300 + 30 + 1            # its watchdog, a turn of the control loop, and rounding
EXAMPLES = {'stm32_hal': 'words', 'pico': 'bytes'}              # and its crc_input


@pytest.fixture(scope='module')
def receiver(tmp_path_factory):
    return compiled(tmp_path_factory.mktemp('receiver'))


def wheels(velocity, state, stops):
    return (struct.pack('<3d', *velocity), state, stops)


# The receiver

def test_sizes_that_are_promised():
    source = [*(FIRMWARE / 'vel2d_receiver.h').open(), *(FIRMWARE / 'vel2d_receiver.c').open()]
    assert len(source) < 300
    assert f'#define VEL2D_VERSION {VERSION}\n' in source
    assert '#include <stddef.h>\n#include <stdint.h>' in ''.join(source)
    assert {line for line in source if line.startswith('#include <')} == {
        '#include <stddef.h>\n', '#include <stdint.h>\n'}
    assert {path.stem for path in (FIRMWARE / 'examples').iterdir()} == set(EXAMPLES)
    for name in EXAMPLES:
        assert len((FIRMWARE / f'examples/{name}.c').read_text().splitlines()) < 80


@pytest.mark.parametrize('start', [0, 2**32 - 100])
def test_watchdog_and_ramp(receiver, start):
    """It stops at its time, by the ramp, for good, also when the clock wraps around."""
    host = Host(watchdog_ms=200, ramp_ms=100)
    host.turn(start)
    host.feed(FRAME, start)
    times = (start - 3, start + 199, start + 200, start + 250, start + 300, start + 2**31,
             start + 2**32 + 10, start + 2**32 + 250)
    for ms in times:
        host.turn(ms)
    host.feed(FRAME, start + 2**32 + 260)
    host.turn(start + 2**32 + 260)
    waiting, _, *turns, fed, again = host.run(receiver)
    assert waiting == wheels(STOP, 'waiting', 0)
    half = wheels((one / 2 for one in DRIVE), 'stopped', 1)
    stopped = wheels(STOP, 'stopped', 1)
    assert turns == [wheels(DRIVE, 'running', 0), wheels(DRIVE, 'running', 0),
                     wheels(DRIVE, 'stopped', 1), half, *4 * [stopped]]
    assert fed.frames == [(27, FRAME[:24])]
    assert again == wheels(DRIVE, 'running', 1)


def test_a_stop_without_a_ramp_is_at_once(receiver):
    host = Host()
    host.feed(FRAME, 0)
    for ms in (299, 300):
        host.turn(ms)
    assert host.run(receiver)[1:] == [wheels(DRIVE, 'running', 0), wheels(STOP, 'stopped', 1)]


def test_halves_of_a_frame_are_none(receiver):
    """Unless they come within `gap_ms`: a frame that a stopped host ends later would be old."""
    host = Host(gap_ms=5)
    for ms, part in ((0, FRAME[:14]), (5, FRAME[14:]), (20, FRAME[:14]), (26, FRAME[14:])):
        host.feed(part, ms)
    host.feed(FRAME[:14], 40)
    host.idle()
    host.feed(FRAME[14:], 40)
    answers = host.run(receiver)
    assert [len(one.frames) for one in answers] == [0, 1, 0, 0, 0, 0]
    assert answers[-1].bad == 3         # the last half is not over yet


def test_without_pauses_damage_costs_the_frame_that_it_hits(receiver):
    host = Host()
    host.feed(FRAME + FRAME[1:] + FRAME + b'?' + FRAME + FRAME[:9] + b'!' + FRAME[10:] + FRAME, 0)
    [taken] = host.run(receiver)
    assert [place for place, _ in taken.frames] == [27, 82, 111, 167]
    assert (taken.bad, taken.refused) == (3, 0)


@pytest.mark.parametrize('options', [SANITIZERS, ['-Ofast']], ids=['sanitizers', 'fast math'])
def test_only_finite_values_within_limits(tmp_path, receiver, options):
    program = receiver if options is SANITIZERS else compiled(tmp_path, *options)
    host = Host(most=(1, 2, 3))
    odd = (math.nan, math.inf, -math.inf, 3.0001, -3.0001)
    for name in Vel2d._fields:
        for value in odd:
            host.feed(encode(STOP._replace(**{name: value})), 0)
    host.feed(encode(Vel2d(-1, 2, -3)), 0)
    *refused, taken = host.run(program)
    assert [(one.frames, one.refused) for one in refused] == [
        ([], number) for number in range(1, 3 * len(odd) + 1)]
    assert len(taken.frames) == 1


@pytest.mark.parametrize('crc_input', CRC_INPUTS)
def test_both_feeds_of_the_crc(receiver, crc_input):
    host = Host(words=crc_input == 'words')
    for crc in CRC_INPUTS.values():
        host.feed(encode(DRIVE, crc), 0)
        host.idle()
    assert [len(one.frames) for one in host.run(receiver)] == [
        name == crc_input for name in CRC_INPUTS]


def test_reports(receiver):
    """Once a second and at a change; the bridge reads them."""
    host = Host()
    host.report(0)
    host.report(999)
    host.feed(b'?' + FRAME + encode(Vel2d(math.inf, 0, 0)), 999)
    host.report(999)
    host.report(1998)
    host.report(1999)
    host.turn(1999)
    host.report(1999)
    texts = [one for one in host.run(receiver) if isinstance(one, str)]
    assert [text and parse_report(text.rstrip('\r\n')) for text in texts] == [
        McuReport(), '', McuReport(VERSION, 'running', 1, 1, 1, 0), '',
        McuReport(VERSION, 'running', 1, 1, 1, 0), McuReport(VERSION, 'stopped', 1, 1, 1, 1)]
    assert all(text.endswith('\r\n') for text in texts if text)


# The examples, on the stream of the bridge

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


class Board:
    """An example on a simulated board."""

    def __init__(self, name, folder):
        self.crc = CRC_INPUTS[EXAMPLES[name]]
        for header in ('main.h', 'pico/stdlib.h', *(
                f'hardware/{one}.h' for one in ('irq', 'sync', 'uart', 'watchdog'))):
            (folder / header).parent.mkdir(exist_ok=True)
            (folder / header).touch()
        shutil.copy(FIRMWARE / f'examples/{name}.c', folder / 'example.c')
        self._program = compiled(folder, *SANITIZERS, f'-I{folder}',
                                 *(['-DHAL'] if name == 'stm32_hal' else []),
                                 sources=[HERE / 'example_board.c'])

    def stream(self, end_ms, commands_until_ms=0):
        """Return what the bridge sends until then, a command each 20 ms for the first part."""
        wire = Wire()
        pacer = Pacer(Gate(GateSettings()), lambda: wire.now, crc=self.crc)
        pacer.attach(wire, 0)
        for ms in range(end_ms):
            wire.now = ms * MS
            if ms < commands_until_ms and ms % 20 == 0:
                pacer.offer(DRIVE, wire.now)
            pacer.turn(wire.now)
        return wire.lines

    def run(self, lines):
        """Return [(ms, velocity)] as its wheels are set, and what it reports."""
        done = subprocess.run([self._program], input='\n'.join(lines), text=True, check=True,
                              capture_output=True)
        said = done.stdout.splitlines()
        words = [line.split() for line in said if line[0].isdigit()]
        return ([(int(ms), Vel2d(*map(float, values))) for ms, *values in words],
                list(filter(None, map(parse_report, said))))


@pytest.fixture(scope='module', params=EXAMPLES)
def board(request, tmp_path_factory):
    return Board(request.param, tmp_path_factory.mktemp('board'))


def stopped_ms(done):
    """Return when the wheels were stopped for good."""
    moving = [ms for ms, velocity in done if velocity != STOP]
    return next(ms for ms, velocity in done if ms > moving[-1] and velocity == STOP)


def test_it_follows_the_bridge_and_does_not_interfere(board):
    sent = board.stream(5000, 3000)
    done, reports = board.run(sent)
    drive = encode(DRIVE, board.crc).hex()
    first = next(int(ms) for ms, data in map(str.split, sent) if data == drive)
    moving = [ms for ms, velocity in done if velocity == DRIVE]
    assert first <= moving[0] <= first + 30
    assert moving == list(range(moving[0], moving[-1] + 30, 30))
    assert 3000 + 400 < stopped_ms(done) <= 3000 + 540       # cmd_vel_timeout, the bridge's own
    assert {one.stops for one in reports} == {0}
    assert {one.bad + one.refused for one in reports} == {0}
    assert 5 <= len(reports) <= 7


def test_a_host_that_is_gone_is_noticed(board):
    sent = board.stream(2000, 2000)
    done, reports = board.run([*sent, '9000 end'])
    last = int(sent[-1].split()[0])
    assert stopped_ms(done) <= last + LATEST_MS
    assert done[-1] == (8970, STOP)
    assert reports[-1] == McuReport(VERSION, 'stopped', len(sent), 0, 0, 1)


@pytest.mark.parametrize('damage', [
    lambda data, crc: data[:-1], lambda data, crc: data[:10] + b'!' + data[11:],
    lambda data, crc: encode(DRIVE._replace(x=math.nan), crc),
    lambda data, crc: encode(DRIVE._replace(y=math.inf), crc),
], ids=['short', 'a byte wrong', 'NaN', 'infinity'])
def test_frames_that_are_not_good_do_not_keep_it_driving(board, damage):
    good, rest = board.stream(1000, 1000), board.stream(3000, 3000)[len(board.stream(1000, 1000)):]
    bad = []
    for line in rest:
        ms, data = line.split()
        bad.append(f'{ms} {damage(bytes.fromhex(data), board.crc).hex()}')
    done, reports = board.run([*good, *bad])
    last = int(good[-1].split()[0])
    assert stopped_ms(done) <= last + LATEST_MS
    assert reports[-1].bad + reports[-1].refused > 0


@pytest.mark.parametrize('what', ['error', 'busy'])
def test_after_an_overrun_it_hears_again(board, what):
    """Also when HAL could not begin a reception in the callback."""
    lines = board.stream(2000, 2000)
    half = len(lines) // 2
    ms = lines[half].split()[0]
    done, reports = board.run([*lines[:half], f'{ms} {what}', *lines[half:]])
    assert max(ms for ms, velocity in done if velocity == DRIVE) > 1900
    assert reports[-1].stops == 0


def test_a_little_of_what_the_fuzzer_does():
    """The same verdict as the reader in Python on each of 10^6 bytes."""
    done = subprocess.run([sys.executable, '-m', 'fuzz.firmware', '--bytes', '1000000'],
                          capture_output=True, text=True, cwd=HERE.parent)
    assert done.returncode == 0, done.stdout + done.stderr
    assert re.match(r'1,0\d\d,\d{3} B, .* [1-9][0-9,]* frames, 0 wrong', done.stdout), done.stdout
