# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""
What a user types after `ros2 launch`: it wins over the file, or is refused in one line.

And Ctrl-C, which a terminal sends to all processes at once.
"""
import os
import re
import signal

from launched import launched
from launched import pids
from launched import WHY
import pytest

from servobus.port.pty import Pty

pytestmark = [pytest.mark.ros, pytest.mark.realtime(bears=0.5), pytest.mark.slow,
              pytest.mark.skipif(bool(WHY), reason=WHY)]


@pytest.mark.parametrize(('name', 'argument', 'words'), [
    ('bridge', 'prot:=/dev/ttyUSB0', 'there is no argument prot; did you mean port?'),
    ('suite', 'config:=here.yaml', 'there is no argument config; did you mean bridge_config?'),
    ('demo', 'colour:=red', 'there is no argument colour; there are: folder, '),
    ('bridge', 'config:=/nope.yaml', 'config: /nope.yaml: No such file or directory; give a file'),
    ('monitor', 'respawn:=maybe', 'Argument "respawn" provided value "maybe" is not valid'),
    ('bridge', 'log_level:=loud', 'Argument "log_level" provided value "loud" is not valid'),
])
def test_a_mistake_starts_nothing_and_says_so(name, argument, words):
    with launched(name, argument) as launch:
        assert launch.exit_code() == 1
    assert launch.said('Caught exception', words), launch.text
    assert pids(launch) == []


def test_a_value_of_a_wrong_type_is_not_replaced_by_the_file(tmp_path):
    with launched('bridge', 'baud:=abc', f'port:={tmp_path}/mcu') as launch:
        launch.exit_code()
    assert launch.said('exit code 2')
    assert launch.said("baud: 'abc' is not possible")


def test_lists_win_over_scalars_of_the_file(tmp_path):
    settings = tmp_path / 'monitor.yaml'
    settings.write_text('/**:\n  ros__parameters:\n    ports: /dev/ttyUSB0\n    bauds: 1000000\n'
                        '    warn_loss: 2e1\n')
    with Pty(str(tmp_path / 'a')) as a, Pty(str(tmp_path / 'b')) as b, launched(
            'monitor', f'config:={settings}', f"ports:=['{a.path}','{b.path}']",
            'bauds:=[57600,115200]') as launch:
        launch.wait_for(f'{a.path}: open at 57600 baud')
        launch.wait_for(f'{b.path}: open at 115200 baud')
    assert not launch.said('/dev/ttyUSB0')


@pytest.mark.smoke
def test_the_node_gets_name_topic_and_namespace(tmp_path):
    with launched('bridge', 'name:=drive', 'cmd_vel:=/joy/cmd_vel', 'namespace:=rover1',
                  f'port:={tmp_path}/mcu') as launch:
        launch.wait_for('[rover1.drive]', '/joy/cmd_vel: ')


def test_an_enclave_that_does_not_exist_is_one_line(tmp_path, monkeypatch):
    """Not a traceback, and not started again."""
    (tmp_path / 'enclaves').mkdir()
    monkeypatch.setenv('ROS_SECURITY_ENABLE', 'true')
    monkeypatch.setenv('ROS_SECURITY_STRATEGY', 'Enforce')
    monkeypatch.setenv('ROS_SECURITY_KEYSTORE', str(tmp_path))
    with launched('bridge', 'enclave:=/rover1/drive') as launch:
        launch.exit_code()
    [line] = launch.said('vel2d_bridge: ', '/enclaves/rover1/drive')
    assert re.search('; ROS_SECURITY_ENABLE is true: .*no security', line)
    assert len(launch.said('exit code 2')) == len(pids(launch)) == 1


def test_ctrl_c_in_the_demo_is_no_fault():
    """The fakes end last: no cable is pulled out, and the stop of the bridge arrives."""
    with launched('demo', 'dashboard:=false') as launch:
        launch.wait_for('vel2d_bridge', 'open at')
        launch.wait_for('dxl_monitor', 'open at')
        for pid in pids(launch):
            os.kill(pid, signal.SIGINT)
        launch.signal(signal.SIGINT)
        assert launch.exit_code() == 0
    assert len(launch.said('process has finished cleanly')) == 4, launch.text
    for words in ('lost', 'no stop could be sent', 'ERROR'):
        assert launch.said(words) == [], launch.text
