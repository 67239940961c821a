# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""What nodes and tools do with their command line, before ROS or a port is even looked at."""
from argparse import ArgumentTypeError
import os
from pathlib import Path
import re
import signal
import subprocess
import sys

import forked
from harness import later
from harness import Program
import pytest

from mecarover_serial.command import COMMANDS
from mecarover_serial.parameters import split_ros_args
from servobus.tools.bus_options import BAUD

EXECUTABLES = Path(__file__).parents[1] / 'resource/executables'

BRIDGE, MONITOR = 'vel2d_bridge.main', 'dxl_monitor.start'


@pytest.mark.parametrize(('arguments', 'outside'), [
    (['--port', '0', '--ros-args', '-r', '__ns:=/a', '--', '--host', '::1'],
     ['--port', '0', '--host', '::1']),
    (['--ros-args', '-p', 'a:=1', '--ros-args', '-p', 'b:=2'], []),
    (['--', 'x'], ['--', 'x']),
    ([], []),
])
def test_arguments_that_are_not_for_ros(arguments, outside):
    assert split_ros_args(arguments)[1] == outside


@pytest.mark.parametrize(('module', 'arguments', 'thing', 'remedy'), [
    (BRIDGE, ['--port', '/dev/x'], '--port', '-p port:=/dev/x'),
    (BRIDGE, ['--max-rate=20'], '--max-rate=20', '-p max_rate:=20'),
    (BRIDGE, ['-p', 'port:=/dev/x'], '-p', '-p port:=VALUE'),
    (BRIDGE, ['--ros-args', '-p', 'port:=/dev/x', '--', '--baud'], '--baud', '-p baud:=VALUE'),
    (MONITOR, ['foo'], 'foo', '-p ports:=VALUE'),
    (MONITOR, ['--devices', '1 2'], '--devices', "-p 'devices:=1 2'"),
])
def test_what_stands_outside_ros_args_is_one_line(module, arguments, thing, remedy):
    """It was ignored, and the node went on with its defaults: on another port than was meant."""
    with Program(module, *arguments) as program:
        assert program.exit_code() == 2
    assert program.lines == [f'{module.partition(".")[0]}: {thing}: has no effect outside '
                             f'--ros-args; write e.g. --ros-args {remedy}, or see --help']


@pytest.mark.skipif(sys.platform != 'linux', reason='skipped: ulimit is of Linux')
@pytest.mark.parametrize('files', later([6, 8, 12], 1))
@pytest.mark.parametrize('words', [
    [BRIDGE], [MONITOR], ['mecarover_dashboard.ros_server', '--port', '0'],
    ['mecarover_dashboard.terminal', '--once']])
def test_too_few_files_are_one_line(files, words):
    with Program(*words, prefix=['sh', '-c', f'ulimit -n {files}; exec "$@"', 'sh']) as tool:
        assert tool.exit_code() == 1
    [line] = tool.lines
    assert line.endswith(f': only {files} files may be open; raise the limit to 64 or more '
                         '(ulimit -n, LimitNOFILE=)')


def test_a_process_that_is_refused_is_one_line():
    script = ('import os\ndef refuse(): raise BlockingIOError(11, "Resource temporarily '
              'unavailable")\nos.fork = refuse\nimport sys; from vel2d_bridge import main\n'
              'sys.exit(main.main())')
    with Program('', script=script) as bridge:
        assert bridge.exit_code() == 1
    assert bridge.lines == [
        'vel2d_bridge: cannot start a process: Resource temporarily unavailable; raise the limit '
        'of tasks (ulimit -u, TasksMax=) or end some']


@pytest.mark.parametrize('tool', ['dxl_dump', 'dxl_monitor'])
def test_version_with_the_commit(tool):
    done = subprocess.run([sys.executable, '-m', COMMANDS[tool], '--version'],
                          capture_output=True, text=True, check=True)
    root = Path(__file__).parents[1]
    failed, commit = subprocess.getstatusoutput(f'git -C {root} rev-parse --short HEAD')
    known = '' if failed or not (root / '.git').exists() else f', commit {commit}'
    assert re.fullmatch(rf'{tool} \(mecarover_serial\) [\d.]+{known}\n', done.stdout)


@pytest.mark.parametrize(('arguments', 'remedy'), [
    (['--check-model', 'models'], 'did you mean --check-models?'),
    (['x', '--sumary'], 'did you mean --summary?'),
    (['x', '--secs=3'], 'did you mean --seconds?'),
    (['x', '--zzzz'], 'see dxl_dump --help'),
    (['x', '--instruction', 'wirte'], 'did you mean write?; or give a code like 0x83')])
def test_a_word_that_is_nearly_right(arguments, remedy):
    """No option is accepted by its first letters: what they mean changes with each new option."""
    done = forked.run_text('servobus.tools.dxl_dump', *arguments)
    assert (done.returncode, done.stdout, done.stderr.count('\n')) == (2, '', 1)
    assert done.stderr.endswith(f'; {remedy}\n')


@pytest.mark.parametrize(('text', 'rate'), [
    ('115200', 115_200), ('1M', 1_000_000), ('1m', 1_000_000), ('57.6k', 57_600),
    ('115.2K', 115_200), ('1.152M', 1_152_000), ('4.5M', 4_500_000)])
def test_a_baud_rate_as_people_write_it(text, rate):
    assert BAUD(text) == rate


@pytest.mark.parametrize('text', ['', 'M', '1G', '0', '0k', '-1M', '57.66666k', 'infM', 'nank',
                                  '1e99M', '115200.5', '99999M'])
def test_what_is_no_baud_rate(text):
    with pytest.raises(ArgumentTypeError, match=': not possible; give a whole number from 1 to '):
        BAUD(text)


def test_a_library_that_went_is_one_line():
    done = subprocess.run(
        [sys.executable, '-c', 'import sys; sys.modules["crcmod.crcmod"] = None\n'
         'from mecarover_serial.command import dxl_dump'], capture_output=True, text=True)
    [line] = done.stderr.splitlines()
    assert line.startswith('dxl_dump: ')
    assert '; pip install --force-reinstall crcmod-plus ' in line
    assert done.returncode == 1


@pytest.mark.parametrize('tool', COMMANDS)
def test_help_on_a_terminal_of_one_column(tool):
    done = subprocess.run(
        [sys.executable, '-c', f'from mecarover_serial.command import {tool}; {tool}()', '--help'],
        env={**os.environ, 'COLUMNS': '1'}, capture_output=True, text=True, timeout=60)
    assert (done.returncode, done.stderr) == (0, '')
    assert f'usage: {tool}' in done.stdout or f'run mecarover_serial {tool}' in ' '.join(
        done.stdout.split())


@pytest.mark.parametrize('tool', later(
    ['dxl_dump', 'dxl_dashboard', 'fake_mcu', 'vel2d_bridge'], ['dxl_dump', 'vel2d_bridge']))
@pytest.mark.parametrize('module', ['contextlib', 'argparse'])
def test_ctrl_c_while_modules_are_imported_shows_no_traceback(tmp_path, tool, module):
    """An import of it takes for ever; contextlib is among the first, argparse among the last."""
    (tmp_path / 'sitecustomize.py').write_text(
        'import sys, time\n'
        'class Wait:\n'
        '    def find_spec(self, name, path, target=None):\n'
        f'        if name == {module!r} and "servobus.tools.command" in sys.modules:\n'
        '            print("waits", flush=True)\n'
        '            for _ in range(600): time.sleep(0.1)   # a signal just before one is late\n'
        f'sys.modules.pop({module!r}, None)\n'
        'sys.meta_path.insert(0, Wait())\n')
    places = {'PYTHONPATH': os.pathsep.join((str(tmp_path), str(EXECUTABLES.parents[1])))}
    with subprocess.Popen(
            [sys.executable, EXECUTABLES / tool, '--help'], env={**os.environ, **places},
            text=True, stdout=subprocess.PIPE, stderr=subprocess.PIPE) as process:
        assert process.stdout.readline() == 'waits\n'
        process.send_signal(signal.SIGINT)
        assert process.communicate(timeout=30) == ('', '')
        assert process.returncode == 0
