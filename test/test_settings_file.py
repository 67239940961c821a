# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""Parameters taken out of a settings file, and launch arguments that no launch file knows."""
import pytest
import yaml

from mecarover_serial.launch_arguments import refuse_unknown
from mecarover_serial.launch_arguments import UnknownArgument
from mecarover_serial.settings_file import SettingsError
from mecarover_serial.settings_file import without

FILE = """\
/**:
  ros__parameters:
    port: /dev/ttyAMA0      # a comment
    max_rate: 3e1
    name: '3e1'
    flag: on
/rover1/vel2d_bridge:
  ros__parameters:
    port: [a, b]
    port_of_mine: 1
port: outside
"""


def test_what_is_overridden_goes_and_all_else_stays_as_it_is_written():
    rest = without(FILE, ['port', 'baud'])
    assert yaml.safe_load(rest) == {
        '/**': {'ros__parameters': {'max_rate': '3e1', 'name': '3e1', 'flag': True}},
        '/rover1/vel2d_bridge': {'ros__parameters': {'port_of_mine': 1}}, 'port': 'outside'}
    assert 'max_rate: 3e1\n' in rest        # for rcl a number, for PyYAML a text
    assert "name: '3e1'\n" in rest          # for both a text


@pytest.mark.parametrize('text', ['', '# nothing\n', FILE])
def test_a_file_without_them_is_left_alone(text):
    assert without(text, ['baud']) == text


@pytest.mark.parametrize(('text', 'words'), [
    ('a: [1\n', 'line 2'), ('just words', 'not a file with param'), ('- a\n- b', 'not a file'),
    ('[' * 100_000, 'brackets'), ('a: \0', 'special characters')])
def test_what_is_no_settings_file_is_said(text, words):
    with pytest.raises(SettingsError, match=words):
        without(text, ['port'])


NAMES = ['port', 'baud', 'config']


def test_a_misspelt_argument_is_refused():
    words = ['/opt/ros2', 'launch', 'mecarover_serial', 'bridge.launch.py', 'port:=/dev/x']
    refuse_unknown('bridge.launch.py', NAMES, words)
    with pytest.raises(UnknownArgument, match=r'no argument prot; did you mean port\?'):
        refuse_unknown('bridge.launch.py', NAMES, [*words, 'prot:=/dev/y'])
    with pytest.raises(UnknownArgument, match='no argument x; there are: port, baud, config'):
        refuse_unknown('bridge.launch.py', NAMES, [*words, 'x:='])


def test_a_launch_file_that_includes_ours_has_arguments_of_its_own():
    words = ['ros2', 'launch', 'mine', 'robot.launch.py', 'prot:=1']
    refuse_unknown('bridge.launch.py', NAMES, words)
