# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""The scenarios of the launch files against plain processes: runs wherever rclpy does."""
import signal

from harness import Program
import pytest
from scenarios import CASTS
from scenarios import CONFIG
from scenarios import play

pytestmark = [pytest.mark.ros, pytest.mark.realtime(bears=0.1), pytest.mark.slow]


def start(part, folder):
    """Start one of a cast: a fake as it is, a node with its settings file and port."""
    module, *words = (word.format(folder=folder) for word in part)
    if module.startswith('mecarover_fakes'):
        return Program(module, *words)
    settings, *given = words
    options = [option for one in given
               for option in ('-r' if one.startswith('__') else '-p', one)]
    return Program(module, '--ros-args', '--params-file', str(CONFIG / settings), *options)


@pytest.mark.parametrize('name', CASTS)
def test_scenarios(name, ros, tmp_path):
    cast = [start(part, tmp_path) for part in (*CASTS[name]['fakes'], *CASTS[name]['nodes'])]
    try:
        with ros.Graph('operator') as graph:
            play(name, graph, ros)
        for program in reversed(cast):
            program.signal(signal.SIGINT)
            assert program.exit_code() == 0, program.text
        assert [program.text for program in cast if 'Traceback' in program.text] == []
    finally:
        for program in cast:
            program.__exit__()
