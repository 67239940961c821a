# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""Settings files: what they are for, without some parameters; and unknown launch arguments."""
from contextlib import nullcontext
from pathlib import Path

from harness import ROOT
import pytest
import yaml

from mecarover_serial.launch_arguments import refuse_unknown
from mecarover_serial.launch_arguments import UnknownArgument
from mecarover_serial.settings_text import check_sections
from mecarover_serial.settings_text import SettingsError
from mecarover_serial.settings_text import without_parameters

ROWS = yaml.safe_load(
    Path(__file__).with_name('settings_headers.yaml').read_text(encoding='utf-8'))

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


@pytest.fixture
def file(tmp_path):
    """Return what makes a file of a text."""
    def make(text):
        path = tmp_path / f'{len(list(tmp_path.iterdir()))}.yaml'
        path.write_text(text)
        return str(path)
    return make


def test_what_is_overridden_goes_and_all_else_stays_as_it_is_written(file):
    rest = without_parameters(file(FILE), ['port', 'baud'])
    assert yaml.safe_load(rest) == {
        '/**': {'ros__parameters': {'max_rate': '3e1', 'name': '3e1', 'flag': True}},
        '/rover1/vel2d_bridge': {'ros__parameters': {'port_of_mine': 1}}, 'port': 'outside'}
    assert 'max_rate: 3e1\n' in rest        # for rcl a number, for PyYAML a text
    assert "name: '3e1'\n" in rest          # for both a text


@pytest.mark.parametrize('text', ['', '# nothing\n', FILE])
def test_a_file_without_them_needs_no_copy(text, file):
    assert without_parameters(file(text), ['baud']) == ''


@pytest.mark.parametrize(('text', 'words'), [
    ('a: [1\n', 'line 2'), ('just words', 'not a file with param'), ('- a\n- b', 'not a file'),
    ('[' * 100_000, 'brackets'), ('a: \0', 'special characters'),
    ('a: "\\U99999999"', 'too large'), ('a: "\\U00999999"', 'not in range')])
def test_what_is_no_settings_file_is_said(text, words, file):
    with pytest.raises(SettingsError, match=words):
        without_parameters(file(text), ['port'])


# A header, and the nodes it is for, of these two.
NODES = ['/vel2d_bridge', '/rover1/vel2d_bridge']


@pytest.mark.parametrize(('header', 'ours'), ROWS['headers'])
def test_a_file_with_nothing_for_a_node_is_refused(header, ours, file):
    of_another = file('dxl_monitor:\n  ros__parameters: {a: 1}\n')
    path = file(f'{header}:\n    ros__parameters: {{a: 1}}\n')
    for node in NODES:
        expected = nullcontext() if node in ours else pytest.raises(
            SettingsError, match=f'{path}: has no parameters for the node {node}, it is for ')
        with expected:
            check_sections([of_another, path], node)


@pytest.mark.ros
@pytest.mark.parametrize(('header', 'ours'), ROWS['headers'])
def test_rclpy_takes_a_header_alike(header, ours, file, ros):
    path = file(f'{header}:\n    ros__parameters: {{a: 1}}\n')
    for node in NODES:
        assert ros.overrides(node, '--params-file', path) == ({'a': 1} if node in ours else {})


@pytest.mark.parametrize('text', ['', '# nothing', 'vel2d_bridge: {max_linear_x: 1}'])
def test_a_file_without_parameters_is_refused(text, file):
    with pytest.raises(SettingsError, match=r'has no param.*, it has no ros__parameters; put'):
        check_sections([file(text)], NODES[0])
    check_sections([], NODES[0])


NAMES = ['port', 'baud', 'config']
OURS = str(ROOT / 'launch/bridge.launch.py')


@pytest.mark.parametrize('words', [
    ['mecarover_serial', 'bridge.launch.py'], [str(ROOT / 'launch/../launch/bridge.launch.py')]])
def test_a_misspelt_argument_is_refused(words):
    refuse_unknown(OURS, NAMES, ['ros2', 'launch', *words, 'port:=/dev/x'])
    with pytest.raises(UnknownArgument, match=r'^bridge.*: .*no argument prot; did you mean port'):
        refuse_unknown(OURS, NAMES, ['ros2', 'launch', *words, 'port:=/dev/x', 'prot:=/dev/y'])
    with pytest.raises(UnknownArgument, match='no argument x; there are: port, baud, config'):
        refuse_unknown(OURS, NAMES, ['ros2', 'launch', *words, 'x:='])


def test_a_launch_file_that_includes_ours_has_arguments_of_its_own(tmp_path):
    """Also one of the same name."""
    theirs = tmp_path / 'bridge.launch.py'
    theirs.touch()
    for words in (['mine', 'robot.launch.py'], ['mine', 'bridge.launch.py'], [str(theirs)]):
        refuse_unknown(OURS, NAMES, ['ros2', 'launch', *words, 'prot:=1'])
