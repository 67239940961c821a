# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""The relay of stdout and stderr, in processes with output read late, never, or no more."""
import os
import pty
import subprocess
import sys
import termios
import time

import pytest

START = """
import os, sys, time
from mecarover_serial.standard_streams import StandardStreams
with StandardStreams('node'):
"""
WRITES = START + """
    for number in range(int(sys.argv[1])):
        os.write(2, b'%099d\\n' % number)
        if not number % 100:
            time.sleep(0.001)
    print('all are out', file=sys.stderr, flush=True)
"""
HOLDS_ON = START + """
    for number in range(12_000):
        try:
            os.write(2, b'%099d\\n' % number)
        except BlockingIOError:
            pass
        if not number % 100:
            time.sleep(0.001)
    os.write(int(sys.argv[1]), b'.')
    sys.stdin.read()
"""


def start(script, *arguments, **options):
    return subprocess.Popen([sys.executable, '-c', script, *map(str, arguments)],
                            stdin=subprocess.PIPE, **options)


def test_what_is_written_comes_out_in_order_on_both():
    done = subprocess.run(
        [sys.executable, '-c', START + "    print('a', flush=True); os.write(2, b'b')\n"
         "    os.write(1, b'c')\n    print('d')"], capture_output=True, text=True, check=True)
    assert (done.stdout, done.stderr) == ('a\ncd\n', 'b')


def test_one_file_for_both_keeps_their_order():
    script = START + '    for number in range(100): os.write(1 + number % 2, b"%d " % number)'
    done = subprocess.run([sys.executable, '-c', script], text=True, check=True,
                          stdout=subprocess.PIPE, stderr=subprocess.STDOUT)
    assert done.stdout.split() == [str(number) for number in range(100)]


def test_a_file_is_left_as_it_is(tmp_path):
    with (tmp_path / 'log').open('w') as log:
        subprocess.run([sys.executable, '-c', START + "    os.write(2, b'x')\n    os._exit(3)"],
                       stderr=log, check=False)
    assert (tmp_path / 'log').read_text() == 'x'


@pytest.mark.parametrize('kind', ['pipe', 'terminal'])
def test_nothing_blocks_where_nothing_is_read(kind):
    master, target = pty.openpty() if kind == 'terminal' else os.pipe()
    if kind == 'terminal':
        termios.tcflow(target, termios.TCOOFF)           # as Ctrl-S does
    with start(WRITES, 20_000, stderr=target) as process:
        assert process.wait(20) == 0                     # not for ever
    os.close(master)
    os.close(target)


def test_lost_lines_are_counted_and_told():
    told, tell = os.pipe()
    with start(HOLDS_ON, tell, stderr=subprocess.PIPE, text=True, pass_fds=[tell]) as process:
        os.read(told, 1)                                 # all is written, nothing was read
        process.stdin.close()
        lines = process.stderr.read().splitlines()
        assert process.wait(20) == 0
    [report] = [line for line in lines if line.startswith('node: ')]
    lost = int(report.split()[1])
    assert lost == 12_000 - (len(lines) - 1)
    assert lost > 1000
    assert report == f'node: {lost} lines of this log are lost, as nothing read it'
    os.close(told)
    os.close(tell)


def test_a_reader_that_has_left_is_no_error():
    with start(WRITES, 100, stderr=subprocess.PIPE) as process:
        process.stderr.close()
        assert process.wait(20) == 0


def test_a_crash_says_where():
    script = START + '    import faulthandler; faulthandler._sigsegv()'
    done = subprocess.run([sys.executable, '-X', 'faulthandler', '-c', script],
                          capture_output=True, text=True, check=False)
    assert 'Segmentation fault' in done.stderr


def test_it_sleeps_while_nothing_is_written():
    script = START + '    time.sleep(0.1); t = time.process_time(); time.sleep(0.5)\n' \
        '    print(time.process_time() - t)'
    before = time.monotonic()
    done = subprocess.run([sys.executable, '-c', script], capture_output=True, text=True,
                          check=True)
    assert float(done.stdout) < 0.1 * (time.monotonic() - before)
