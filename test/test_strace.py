# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""
Programs heard through strace: what it prints, read; real programs, heard to the byte.

strace_6.1.txt was recorded from a program that reads, writes, sets rates (57600, then a free one),
flushes, blocks in a thread, forks and copies its descriptor.
"""

from operator import itemgetter
import os
from pathlib import Path
import shutil
import signal
import subprocess
import sys
import textwrap
import time
from types import SimpleNamespace

from hypothesis import given
from hypothesis import settings
from hypothesis import strategies as st
import pytest
from test_tap import closed
from test_tap import DEADLINE_S
from test_tap import heard
from test_tap import listen
from test_tap import peers
from test_tap import PLAIN
from test_tap import ROOT
from test_tap import tap
import yaml

from msg_defs.event import AWAY
from msg_defs.event import BAUD
from msg_defs.event import CLOSED
from msg_defs.event import GAVE_UP
from msg_defs.event import IN
from msg_defs.event import OUT
from msg_defs.event import PURGED
from msg_defs.event import TRACED
from servobus.sources import strace
from servobus.sources.strace_parser import OPENED
from servobus.sources.strace_parser import StraceParser
from servobus.sources.tap_reader import TapReader
from servobus.tools.start_program import StartedProgram

RECORDED = Path(__file__).with_name('strace_6.1.txt').read_bytes()
FIRST = 1795438179_000000000              # the second in which it was recorded
MAIN, BLOCKED = (int(RECORDED.splitlines()[at].split()[0]) for at in (0, 23))   # threads
needs_strace = pytest.mark.skipif(shutil.which('strace') is None or bool(strace.why_not()),
                                  reason='skipped: no strace here that may trace')
needs_cc = pytest.mark.skipif(shutil.which('cc') is None, reason='skipped: no C compiler')


@pytest.fixture(autouse=True)
def _environment(monkeypatch, meeting_place):
    monkeypatch.delenv('PYTHONPATH', raising=False)
    monkeypatch.setenv('XDG_RUNTIME_DIR', meeting_place)


def process_of(thread):
    return MAIN if thread == BLOCKED else thread


def events(*pieces, ahead=0, of=process_of):
    parser = StraceParser(of)
    return [one for piece in pieces for one in parser.feed(piece, ahead)]


def hexed(text):
    return ''.join(f'\\x{one:02x}' for one in text.encode('latin-1'))


PORT = hexed('/dev/ttyUSB0')


def said(*calls, every='0.001000000'):
    """Return what is said of calls; 'P' is the port, `text` is written in hex."""
    lines = []
    for call in calls:
        thread, _, text = call.partition(' ')
        parts = text.replace('<P>', f'<{PORT}>').split('`')
        parts[1::2] = [f'"{hexed(part)}"' for part in parts[1::2]]
        lines.append(f'{thread} 100.000000000 (+     {every}) {"".join(parts)}\n')
    return [(one.what, one.data or one.value) for one in events(
        ''.join(lines).encode(), of=lambda thread: thread // 10 * 10)]


def test_a_recorded_program():
    found = events(RECORDED, ahead=-FIRST)
    assert {one.port for one in found} == {'/dev/pts/0'}
    assert [(one.what, one.data or one.value) for one in found] == [
        (OPENED, 0), (BAUD, 38400), (PURGED, 1), (BAUD, 57600), (BAUD, 1500000), (GAVE_UP, 626),
        (OUT, b'hello'), (IN, b'hello'), (OUT, b'ab\xff\xfe'), (AWAY, 53637), (IN, b'ab\xff\xfe'),
        (PURGED, 1),
        (TRACED, 563), (OUT, b'more'), (IN, b'more'),
        (OUT, b'child'), (IN, b'child'), (OUT, b'x'), (CLOSED, 0)]
    stamps = [one.stamp for one in found]
    assert stamps == sorted(stamps)
    assert 0 < stamps[0] < stamps[-1] < 1e9
    out, back = (one.stamp for one in found if one.data == b'more')
    assert 0 < back - out < 1e6                # not when the reading began, 20 ms before


def test_any_pieces_and_a_stepped_clock_change_nothing():
    whole = events(RECORDED, ahead=-FIRST)
    assert events(*(RECORDED[at:at + 1] for at in range(len(RECORDED))), ahead=-FIRST) == whole
    parser = StraceParser(process_of)
    again = [one for line in RECORDED.splitlines(True) for one in parser.feed(
        line.replace(b' 17954381', b' 99' if parser._now else b' 17954381'), -FIRST)]
    assert again == whole


@settings(max_examples=100)
@given(st.lists(st.tuples(st.integers(0, len(RECORDED) - 1), st.binary(max_size=5),
                          st.integers(0, 30)), max_size=30))
def test_nothing_that_strace_may_print_raises(changes):
    text = RECORDED
    for at, new, size in changes:
        text = text[:at] + new + text[at + size:]
    for one in events(text):
        assert one.what in (OUT, IN) or not one.data


@pytest.mark.parametrize('case', yaml.safe_load(
    Path(__file__).with_name('strace_calls.yaml').read_text()), ids=itemgetter('calls'))
def test_single_calls(case):
    found = said('10 openat(-100<\\x2f>, `/dev/ttyUSB0`, 0x2) = 3<P>', *case['calls'].splitlines())
    assert '; '.join(f'{what} {value.decode() if what in (OUT, IN) else value}'
                     for what, value in found) == f'{OPENED} 0; {case["said"]}'.removesuffix('; ')


def test_who_reads_and_writes_is_known():
    child = 30898
    assert {one.process for one in events(RECORDED) if one.what in (OUT, IN)} == {MAIN, child}


def test_a_child_of_a_program_that_has_ended_is_no_other_program():
    child, ended = subprocess.Popen(['sleep', '60']), subprocess.Popen(['true'])
    ended.wait()
    started = SimpleNamespace(child=child)
    own = [StartedProgram.has_started(started, one) for one in (child.pid, ended.pid, os.getpid())]
    child.kill()
    child.wait()
    assert own == [True, True, False]


def test_a_long_write_has_a_time_near_its_end():
    [_, one] = events(f'10 5.0 (+ 0.0) write(3<{PORT}>, "", 0) = 0 <1.0>\n'.replace(
        '.0', '.000000000').encode(), f'10 5.000000000 (+ 1.000000000) write(3<{PORT}>, "\\x61", '
        '1) = 1 <1.000000000>\n'.encode())
    assert one.stamp == int(6.98e9)


def test_what_strace_takes_of_an_exchange_is_neither_the_device_nor_the_program():
    short, pause, wait = 60_000, 100_000, 500_000                  # ns
    lines, now, before = [], 5 * 10**9, 0
    for call, took in 40 * ((f'write(3<{PORT}>, "\\x61", 1) = 1', short),
                            (f'ppoll([{{fd=3<{PORT}>, events=0x1}}], 1) = 1', wait),
                            (f'read(3<{PORT}>, "\\x62", 9) = 1', short)):
        now += pause
        lines.append(f'10 {now // 10**9}.{now % 10**9:09} (+ 0.{before + pause:09}) {call} '
                     f'<0.{took:09}>\n')
        now, before = now + took, took
    found = events(''.join(lines).encode())
    out, back = ([one.stamp for one in found if one.what == side] for side in (OUT, IN))
    assert back[-1] - out[-1] == pytest.approx(pause + wait - short / 2, rel=0.01)
    assert sum(one.value for one in found if one.what == TRACED) * 1000 == pytest.approx(
        39 * (short / 2 + pause + short + pause + short), rel=0.05)


@pytest.fixture(scope='session')
def program_in_c(tmp_path_factory):
    program = tmp_path_factory.mktemp('c') / 'serial_program'
    subprocess.run(['cc', '-o', program, Path(__file__).with_name('serial_program.c'), '-pthread'],
                   check=True)
    return program


SHELL = """
    stty -F "$0" 57600 raw -echo
    exec 3<>"$0"
    for at in 1 2 3; do printf '\\377%s' $at >&3; head -c 2 <&3 >/dev/null; done
    exit 7"""


@needs_strace
@needs_cc
@pytest.mark.realtime(bears=0.02)
@pytest.mark.parametrize('kind', ['C', 'shell', 'Python'])
def test_every_byte_of_a_program(kind, request):
    with peers(lambda data: data) as (far,), TapReader('robot') as reader:
        path = far.pty.path
        code, options, command = 7, (), ()
        if kind == 'C':
            command = request.getfixturevalue('program_in_c'), path, '30'
        elif kind == 'shell':
            command = 'sh', '-c', textwrap.dedent(SHELL), path
        else:
            code, options = 0, ('--by', 'strace')
            command = sys.executable, '-c', textwrap.dedent(PLAIN.format(path=path, times=20))
        done = tap('robot', *options, '--', *map(str, command))
        assert done.returncode == code
        assert done.stderr.count('\n') == 1
        assert 'is heard through strace' in done.stderr
        told = listen(reader, lambda told: not reader.programs and closed(1)(told))
        told += reader.rest()
        assert heard(told, OUT, path) == far.got != b''
        assert heard(told, IN, path) == far.sent
        rates = [one.value for one in told if one.kind == BAUD]
        assert list(dict.fromkeys(rates)) == {'C': [1000000, 57600], 'shell': [57600],
                                       'Python': [1000000]}[kind]


@needs_strace
@pytest.mark.realtime(bears=0.02)
@pytest.mark.parametrize('has_strace', [True, False])
def test_a_library_that_opens_ports_by_itself_is_heard(has_strace, tmp_path):
    """Strace joins at its import; pyserial is not heard twice then, and as before without."""
    (tmp_path / 'rustypot.py').touch()
    script = 'import rustypot\n' + textwrap.dedent(PLAIN)
    more = {'PYTHONPATH': str(tmp_path), **({} if has_strace else {'PATH': str(tmp_path)})}
    silent = tap('robot', '--', sys.executable, '-c', 'import rustypot', **more)
    assert ('opened no serial port' if has_strace else 'through pyserial; to') in silent.stderr
    with peers(lambda data: data) as (far,), TapReader('robot') as reader:
        done = tap('robot', '--', sys.executable, '-c', script.format(path=far.pty.path, times=20),
                   **more)
        assert (done.returncode, done.stdout) == (0, 'done\n')
        assert ('is heard through strace' if has_strace else
                'is not heard: strace is not installed') in done.stderr
        told = listen(reader, lambda told: not reader.programs and closed(1)(told))
        told += reader.rest()
        assert heard(told, OUT, far.pty.path) == far.got != b''
        assert heard(told, IN, far.pty.path) == far.sent


LASTING = """
    import os, select, sys
    port = os.open({path!r}, os.O_RDWR | os.O_NOCTTY)
    print(sorted(map(int, os.listdir('/proc/self/fd'))), flush=True)
    while not select.select([0], [], [], 0.001)[0]:
        os.write(port, b'x')
    sys.exit(5)"""
READING = """
from servobus.sources.tap_reader import TapReader
from servobus.tools.start_program import StartedProgram
reader = TapReader('robot')
print('ready', flush=True)
while not reader.wait(1.0): pass
print('heard', flush=True)
while True: reader.wait(1.0)"""


@needs_strace
@pytest.mark.realtime(bears=0.02)
@pytest.mark.parametrize('victim', ['strace', 'relay', 'reader', 'stopped reader'])
def test_the_program_goes_on_when_others_are_killed(victim, again):
    with peers(lambda data: b'') as (far,), subprocess.Popen(
            [sys.executable, '-c', READING], cwd=ROOT, stdout=subprocess.PIPE, text=True
    ) as reader, subprocess.Popen(
            [sys.executable, '-m', 'servobus.tools.tap', 'robot', '--by', 'strace', '--',
             sys.executable, '-c', textwrap.dedent(LASTING.format(path=far.pty.path))], cwd=ROOT,
            stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.PIPE,
            text=True) as tool:
        try:
            assert tool.stdout.readline() == '[0, 1, 2, 3, 4]\n'       # it has no more than else
            assert [reader.stdout.readline(), reader.stdout.readline()] == ['ready\n', 'heard\n']
            children = Path(f'/proc/{tool.pid}/task/{tool.pid}/children').read_text().split()
            [child] = [int(one) for one in children if strace.tracer(one)]
            [relay] = [int(one) for one in children if int(one) != child]
            os.kill({'strace': strace.tracer(child), 'relay': relay}.get(victim, reader.pid),
                    signal.SIGSTOP if victim == 'stopped reader' else signal.SIGKILL)
            for _ in range(5):
                before, until = len(far.got), time.monotonic() + DEADLINE_S
                while len(far.got) < before + 20:
                    assert time.monotonic() < until
                    time.sleep(0.01)
            assert 'is heard through strace' in tool.stderr.readline()
            if victim in ('strace', 'relay'):
                assert 'strace was ended; the program goes on' in tool.stderr.readline()
            tool.communicate('\n', timeout=DEADLINE_S)
            assert tool.returncode == 5
        finally:
            reader.kill()
            tool.kill()


@needs_strace
@pytest.mark.realtime(bears=0.02)
@pytest.mark.parametrize('how', ['os.open(path, os.O_RDWR)', 'open(path, "r+b", buffering=0)'])
def test_a_port_that_python_opens_without_pyserial_is_heard(how):
    with peers(lambda data: data) as (far,), TapReader('robot') as reader:
        script = f'import os, serial, termios; path = {far.pty.path!r}; port = {how}; os.write(' \
            'getattr(port, "fileno", lambda: port)(), b"x")'
        done = tap('robot', '--', sys.executable, '-c', script)
        assert (done.returncode, done.stdout) == (0, '')
        told = listen(reader, lambda told: not reader.programs and closed(1)(told))
        assert heard(told, OUT, far.pty.path) == b'x'


@needs_strace
@pytest.mark.realtime(bears=0.02)
def test_a_program_that_python_becomes_is_heard():
    with peers(lambda data: data) as (far,), TapReader('robot') as reader:
        done = tap('robot', '--', sys.executable, '-c', 'import os; os.execlp('
                   f'"sh", "sh", "-c", "exec 3<>$0; printf x >&3", {far.pty.path!r})')
        assert (done.returncode, done.stdout) == (0, '')
        told = listen(reader, lambda told: not reader.programs and closed(1)(told))
        assert heard(told, OUT, far.pty.path) == b'x'


@needs_strace
@pytest.mark.realtime(bears=0.02)
def test_a_port_that_only_a_child_opens_is_named():
    code = """
        import subprocess
        subprocess.run(['sh', '-c', 'exec 3<>"$0"; head -n 1 >/dev/null', {path!r}])"""
    code = textwrap.dedent(code)
    with peers(lambda data: data) as (far,), subprocess.Popen(
            [sys.executable, '-m', 'servobus.tools.tap', 'robot', '--', sys.executable, '-c',
             code.format(path=far.pty.path)], cwd=ROOT, stdin=subprocess.PIPE, text=True,
            stdout=subprocess.DEVNULL, stderr=subprocess.PIPE) as tool:
        assert 'through pyserial' in tool.stderr.readline()
        assert f'{far.pty.path} is open, but not through pyserial, and is not heard; write --by ' \
            'strace' in tool.stderr.readline()
        tool.communicate('\n', timeout=DEADLINE_S)


@pytest.mark.parametrize(('script', 'words'), [
    (None, 'strace is not installed; sudo apt install strace'),
    ('echo "strace: PTRACE_TRACEME: Operation not permitted" >&2; exit 1',
     'PTRACE_TRACEME: Operation not permitted; a container needs --cap-add SYS_PTRACE')])
def test_what_keeps_strace_away_is_said_before_the_start(tmp_path, script, words):
    if script:
        (tmp_path / 'strace').write_text(f'#!/bin/sh\n{script}\n')
        (tmp_path / 'strace').chmod(0o755)
    done = tap('robot', '--', '/bin/echo', 'started', PATH=str(tmp_path))
    assert (done.returncode, done.stdout, done.stderr.count('\n')) == (1, '', 1)
    assert words in done.stderr


@pytest.mark.realtime(bears=0.02)
@pytest.mark.parametrize('chosen', ['user', 'tool'])
def test_python_is_that_of_the_user_unless_the_tool_shares_it(tmp_path, chosen):
    for name in ('tool', 'user'):
        subprocess.run([sys.executable, '-m', 'venv', '--without-pip', tmp_path / name],
                       check=True)
    [place] = (tmp_path / chosen / 'lib').glob('*/site-packages')
    (place / 'only_here.py').touch()
    (place / 'only_here.dist-info').mkdir()
    (place / 'only_here.dist-info/METADATA').write_text('Name: only_here')
    path = os.pathsep.join((str(tmp_path / 'tool/bin'), str(tmp_path / 'user/bin')))
    done = subprocess.run(
        [tmp_path / 'tool/bin/python', '-m', 'servobus.tools.tap', 'robot', '--', 'python',
         '-c', 'import only_here; print("found")'], cwd=ROOT, capture_output=True, text=True,
        env={**os.environ, 'PATH': path, 'VIRTUAL_ENV': str(tmp_path / 'tool')})
    assert done.stdout == 'found\n', done.stderr
    assert f'{tmp_path}/{chosen}/bin/python is heard' in done.stderr
