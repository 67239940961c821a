# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""What a user types wrong: one line on stderr with the thing, the reason and the remedy."""
import gzip
import os
from pathlib import Path
import shlex

import forked
import pytest

from mecarover_serial.command import COMMANDS
from rigs.tables import rows_of

CAPTURE = '# dxl_capture 2 began 2026-09-21T14:13:20.000000Z at 1.000000000\n'
ROWS = rows_of(Path(__file__).with_name('mistakes.tsv'))


@pytest.fixture
def names(tmp_path):
    """Return what the words in braces in mistakes.tsv are."""
    (tmp_path / 'packed').write_bytes(gzip.compress(b'# dxl_capture 1 '))
    (tmp_path / 'empty').write_text(CAPTURE)
    (tmp_path / 'capture').write_text(
        f'{CAPTURE}# bus bus baud 2000000 latency_timer_ms 0 port \n(1.000000000) bus ff\n')
    (tmp_path / 'header').write_text(f'{CAPTURE}# bus bus baud 9600 latency_timer_ms 0 port \n')
    (tmp_path / 'report').write_text('# dxl_doctor report 1\n')
    os.mkfifo(tmp_path / 'pipe')
    return {'long': '9' * 4000, 'escape': '\x1b', **{
        name: tmp_path / name
        for name in ('packed', 'empty', 'capture', 'pipe', 'report', 'header')}}


@pytest.mark.parametrize(('program', 'typed', 'code', 'said'), ROWS)
def test_a_mistake_is_one_line(program, typed, code, said, names):
    before = names['capture'].read_bytes()
    done = forked.run(COMMANDS[program],
                      *(word.format(**names) for word in shlex.split(typed)))
    assert (done.returncode, done.stdout) == (int(code), b'')
    [line] = done.stderr.decode().splitlines()
    assert line.startswith(f'{program}: {said.format(**names)}')
    assert names['capture'].read_bytes() == before
