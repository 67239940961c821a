# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""A tool that is forked prints and ends as one that a new interpreter runs."""
import subprocess
import sys

import forked
import pytest

from msg_defs.dxl_instruction import Instruction
from msg_defs.dxl_packet import encode


@pytest.mark.parametrize(('tool', 'words', 'code'), [
    ('servobus.tools.dxl_dump', ['-', '--summary'], 0),
    ('servobus.tools.dxl_dump', ['--help'], 0),
    ('servobus.tools.dxl_doctor', ['no_such_file'], 1),
    ('mecarover_fakes.fake_bus', ['--devices', '1:MX-10\xf6'], 2)])
def test_it_prints_and_ends_as_in_a_new_interpreter(tool, words, code, tmp_path):
    said = tmp_path / 'bus.bin'
    said.write_bytes(encode(1, Instruction.PING))
    with said.open('rb') as stdin:
        new = subprocess.run([sys.executable, '-m', tool, *words], stdin=stdin,
                             cwd=forked.ROOT, capture_output=True, check=False)
    with said.open('rb') as stdin:
        fork = forked.run(tool, *words, stdin=stdin)
    assert fork.returncode == code
    assert (fork.returncode, fork.stdout, fork.stderr) == (new.returncode, new.stdout, new.stderr)
