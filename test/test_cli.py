# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""What a node does with its command line before ROS is even looked at."""
import sys

from harness import Program
import pytest

from mecarover_serial.parameters import split_ros_args

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
@pytest.mark.parametrize('files', [6, 8, 12])
@pytest.mark.parametrize('words', [
    [BRIDGE], [MONITOR], ['mecarover_dashboard.serve', '--port', '0'],
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
        'of processes (ulimit -u, TasksMax=) or end some']
