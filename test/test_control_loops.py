# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""A cycle is that of the program's control loop, by the program's own log."""

import json
import os
from pathlib import Path
import subprocess
import sys
import textwrap

from control_loops import Program
from control_loops import PROGRAMS
from harness import later
from harness import wait
import pytest

from servobus.model.models import Models
from servobus.monitor import Monitor
from servobus.monitor import Settings

MODELS = Models()
S, MS = 1_000_000_000, 1_000_000
WINDOW_NS = 10 * S


def heard(row, has_sides, seconds=7):
    """Return the report of a program that ran, the findings on the way, and its recent log."""
    bus = Monitor('bus', MODELS, Settings(baud=1_000_000, protocol=row.get('protocol', 'auto')))
    found, seen = {}, [0]

    def feed(data, stamp, side):
        bus.feed(data, stamp, side)
        if stamp - seen[0] > S // 2:
            seen[0] = stamp
            found.update({(one.rule, one.device): one for one in bus.report(stamp).findings})

    program = Program(row, feed, bus.change, has_sides)
    log = [stamp for stamp in program.run(seconds)[0] if stamp > program.now - WINDOW_NS]
    report = bus.report(program.now)
    found.update({(one.rule, one.device): one for one in report.findings})
    return report, found, log


def mean_of(log):
    """Return the mean cycle (ms) of a program, from when its cycles began (ns)."""
    return (log[-1] - log[0]) / (len(log) - 1) / MS


@pytest.mark.parametrize('name', later(PROGRAMS, [*PROGRAMS][::2]))
def test_a_cycle_is_that_of_the_control_loop(name):
    """Who sleeps is not asked to do less, who works for most of the cycle is."""
    report, found, log = heard(PROGRAMS[name], True)
    assert not report.cycle.unknown
    assert report.cycle.cycle == pytest.approx(mean_of(log), rel=0.05)
    assert any('do less' in one.message for one in found.values()) \
        == name.startswith('a program that takes')


@pytest.mark.parametrize('name', later(PROGRAMS, [*PROGRAMS][::3]))
def test_a_cycle_is_that_of_the_control_loop_where_the_sides_are_unknown(name):
    """There a cycle is the mean of 64, when the clock chose last: once a second."""
    report, _, log = heard(PROGRAMS[name], False)
    assert report.cycle.unknown
    ends = [at for at in range(65, 1 + len(log)) if log[-1] - log[at - 1] <= S] or [len(log)]
    assert any(report.cycle.cycle == pytest.approx(mean_of(log[max(0, end - 65):end]), rel=0.05)
               for end in ends)


# Programs of their own, with pyserial; each notes when its control loop begins.
COMMON = """
    import sys, threading, time
    import serial
    from msg_defs.dxl_packet import encode
    port = serial.Serial(sys.argv[1], 1000000, timeout=0.3)
    log, lock, end = [], threading.Lock(), time.monotonic() + 6

    def ask(number, code, params, size):
        with lock:
            port.write(encode(number, code, params))
            return port.read(size) if size else b''

    def read(number, at, size):
        return ask(number, 2, bytes((at, 0, size, 0)), 11 + size)

    def sync_read():
        return ask(0xFE, 0x82, bytes((132, 0, 4, 0, 1, 2, 3, 4, 5, 6)), 90)

    def sync_write():
        ask(0xFE, 0x83, bytes((116, 0, 4, 0)) + b''.join(
            bytes((one, 0, 8, 0, 0)) for one in range(1, 7)), 0)

    def temperatures():
        for number in range(1, 7):
            read(number, 146, 1)

    def every(period, turn):
        due = time.monotonic()
        while due < end:
            turn()
            due = max(due + period, time.monotonic() - period)
            time.sleep(max(0, due - time.monotonic()))
"""
THEIRS = {
    'temperatures': """
        seldom = 0
        def turn():
            global seldom
            log.append(time.monotonic_ns())
            sync_read()
            sync_write()
            if time.monotonic() > seldom:
                seldom = time.monotonic() + 0.5
                temperatures()
        every(0.02, turn)
    """,
    'two threads': """
        def turn():
            log.append(time.monotonic_ns())
            sync_read()
            sync_write()
        other = threading.Thread(target=every, args=(0.3, temperatures))
        other.start()
        every(0.1, turn)
        other.join()
    """,
    'sleeps': """
        while time.monotonic() < end:
            log.append(time.monotonic_ns())
            sync_read()
            sync_write()
            if len(log) % 25 == 0: temperatures()
            time.sleep(0.04)
    """,
    'one dead': """
        seldom = 0
        while time.monotonic() < end:
            log.append(time.monotonic_ns())
            for number in range(1, 8):
                read(number, 132, 4)           # 7 is not there: 0.3 s
            if time.monotonic() > seldom:
                seldom = time.monotonic() + 0.5
                temperatures()
    """,
    'reads too much': """
        while time.monotonic() < end:
            log.append(time.monotonic_ns())
            ask(1, 2, bytes((132, 0, 4, 0)), 32)
    """}
ROOT = Path(__file__).parents[1]
START_S = 1.5                      # until the loop is recognised


@pytest.fixture
def servos(tmp_path):
    """Yield the port of six simulated servos that no master asks."""
    link = tmp_path / 'bus'
    with subprocess.Popen([
            sys.executable, '-m', 'mecarover_fakes.fake_bus', '--link', str(link), '--pattern',
            'none', '-b', '1000000', '--devices', '1-6:XL430-W250'], cwd=ROOT,
            stdout=subprocess.DEVNULL) as bus:
        wait(link.exists)
        yield str(link)
        bus.terminate()


@pytest.mark.realtime(bears=0.02)
@pytest.mark.parametrize('name', THEIRS)
def test_the_cycle_of_a_real_program_is_that_of_its_log(name, servos, tmp_path, meeting_place):
    script = tmp_path / 'program.py'
    script.write_text(textwrap.dedent(COMMON) + textwrap.dedent(THEIRS[name]) + textwrap.dedent("""
        import json
        json.dump(log, open(sys.argv[2], 'w'))
    """))
    done = subprocess.run(
        [sys.executable, '-m', 'servobus.tools.dxl_doctor', '--json', 'run', '--',
         sys.executable, str(script), servos, str(tmp_path / 'log')], capture_output=True,
        text=True, check=False, cwd=ROOT, timeout=60,
        env=os.environ | {'XDG_RUNTIME_DIR': str(meeting_place), 'PYTHONPATH': str(ROOT)})
    assert (tmp_path / 'log').exists(), done.stderr
    log = json.loads((tmp_path / 'log').read_text())
    bus = json.loads(done.stdout)['buses'][0]
    cycle = bus['cycle']
    log = [one for one in log if one > log[0] + START_S * S]
    assert cycle['cycle'] == pytest.approx(mean_of(log), rel=0.05)
    advice = [one['message'] for one in bus['findings'] if one['rule'] == 'cycle_time']
    if name == 'reads too much':
        assert cycle['device'] < 5 < cycle['asleep']
        assert any('more bytes than an answer has' in one for one in advice)
    elif name == 'one dead':
        [[number, ms]] = cycle['waiting']
        assert number == 7
        assert ms == pytest.approx(300, rel=0.1)
    else:
        assert 2 * cycle['busy'] < cycle['program']
        assert not [one for one in advice if 'do less' in one]
