# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""
Our launch files included by one of the user: each node gets its own arguments and parameters.

What is not in force would be so in silence: a limit, a name, that a node is started again.
"""
import os
import signal

from harness import wait
from launched import launched
from launched import pids
from launched import SHARE
from launched import WHY
import pytest

from servobus.port.pty import Pty

pytestmark = [pytest.mark.ros, pytest.mark.realtime(bears=0.5), pytest.mark.slow,
              pytest.mark.skipif(bool(WHY), reason=WHY)]
PARENT = """
from launch import LaunchDescription
from launch.actions import DeclareLaunchArgument
from launch.actions import IncludeLaunchDescription
from launch.launch_description_sources import PythonLaunchDescriptionSource
from launch.substitutions import LaunchConfiguration
from launch_ros.actions import PushRosNamespace
from launch_ros.actions import SetParameter
from launch_ros.actions import SetParametersFromFile
from launch_ros.actions import SetRemap


def include(file, /, **arguments):
    return IncludeLaunchDescription(
        PythonLaunchDescriptionSource(f'{SHARE}/launch/{{file}}.launch.py'),
        launch_arguments=list(arguments.items()))


def generate_launch_description():
    return LaunchDescription([{actions}])
"""
BRIDGE = '/vel2d_bridge'


@pytest.fixture
def parent(tmp_path):
    """Return what writes a launch file of the user and returns its path."""
    def write(*actions, name='robot'):
        file = tmp_path / f'{name}.launch.py'
        file.write_text(PARENT.format(SHARE=SHARE, actions=', '.join(actions)))
        return str(file)
    return write


def settings(folder, name, header, **values):
    """Write a settings file and return its path."""
    file = folder / name
    lines = [f'    {key}: {value}' for key, value in values.items()]
    file.write_text('\n'.join([f'{header}:', '  ros__parameters:', *lines, '']))
    return str(file)


@pytest.mark.parametrize('given', [
    "SetParameter('max_linear_x', 0.25)", "SetParametersFromFile('{file}')"])
def test_a_limit_that_the_user_sets_is_in_force(graph, parent, tmp_path, given):
    """Over our settings file, which has every default; the user's own file wins over it."""
    given = given.format(file=settings(tmp_path, 'limits.yaml', '/**', max_linear_x=0.25))
    mine = settings(tmp_path, 'mine.yaml', '/**', max_linear_y=0.5)
    narrow = settings(tmp_path, 'narrow.yaml', 'vel2d_bridge', max_linear_x=0.125)
    for config, limits in (('', [0.25, 0.0]), (f', config={mine!r}', [0.25, 0.5]),
                           (f', config={narrow!r}', [0.125, 0.0])):
        file = parent(given, f"include('bridge', port='{tmp_path}/mcu'{config})")
        with launched(file) as launch:
            launch.wait_for('is not there')
            assert graph.get(BRIDGE, ['max_linear_x', 'max_linear_y']) == limits, config
            assert graph.get(BRIDGE, ['port']) == [f'{tmp_path}/mcu']


@pytest.mark.parametrize('second', ['', ", name='second', respawn='false', config='{config}'"])
def test_two_includes_have_arguments_of_their_own(graph, parent, tmp_path, second):
    """The second one takes nothing of the first: no name, no settings, no respawn."""
    config = settings(tmp_path, 'second.yaml', '/**', warn_loss=5.0, cmd_vel_timeout=9.0)
    file = parent(f"include('monitor', ports='{tmp_path}/bus'{second.format(config=config)})",
                  f"include('bridge', port='{tmp_path}/mcu')")
    with launched(file) as launch:
        for node in ('dxl_monitor', 'vel2d_bridge'):
            launch.wait_for(f'[{node}-', 'is not there')
        name = '/second' if second else '/dxl_monitor'
        assert graph.get(name, ['warn_loss']) == [5.0 if second else 1.0]
        assert graph.get(BRIDGE, ['cmd_vel_timeout']) == [0.5]
        assert bool(launch.said('bridge.launch.py', f'config:={config} was given to another '
                                'include, so this one takes its default')) == bool(second)
        [bridge] = [pid for pid in pids(launch) if launch.said('vel2d_bridge', f'[{pid}]')]
        os.kill(bridge, signal.SIGKILL)
        wait(lambda: len(launch.said('vel2d_bridge', 'is not there')) == 2)


def test_what_the_user_gives_both_and_all_around_them_holds(graph, parent, tmp_path):
    """Arguments, also of the user's own launch file; its namespace, remapping and parameter."""
    both = tmp_path / 'both.yaml'
    both.write_text('/rover1/hands:\n  ros__parameters: {max_linear_x: 0.25}\n'
                    '/rover1/second:\n  ros__parameters: {warn_loss: 5.0}\n')
    file = parent(
        "DeclareLaunchArgument('config')", "PushRosNamespace('rover1')",
        "SetRemap('/rover1/cmd_vel', '/joy')", "SetParameter('timing_topics', 'all')",
        f"include('monitor', name='second', ports='{tmp_path}/bus')",
        "include('bridge', name='hands', port='/dev/nope', config=LaunchConfiguration('config'))")
    with launched(file, f'config:={both}') as launch:
        names = ['config:=', 'warn_loss', 'timing_topics']
        assert graph.get('/rover1/second', names[1:]) == [5.0, 'all']
        assert graph.get('/rover1/hands', ['max_linear_x', *names[2:]]) == [0.25, 'all']
        graph.wait_status('rover1/hands: commands', 'Topic=/joy')
        assert not launch.said('was given to another include')


def test_a_launch_file_of_the_user_may_have_the_name_of_ours(parent, tmp_path):
    file = parent("DeclareLaunchArgument('colour')", f"include('bridge', port='{tmp_path}/mcu')",
                  name='bridge')
    with launched(file, 'colour:=red') as launch:
        launch.wait_for('is not there')


@pytest.mark.parametrize('header', ['vel2d_brigde', '/rover1/vel2d_bridge', 'dxl_monitor'])
def test_settings_for_another_node_start_nothing(tmp_path, header):
    config = settings(tmp_path, 'mine.yaml', header, max_linear_x=0.25)
    with launched('bridge', f'config:={config}', f'port:={tmp_path}/mcu') as launch:
        assert launch.exit_code() == 1
    full = header if header.startswith('/') else f'/{header}'
    assert launch.said('Caught exception', f'config: {config}: has no parameters for the node '
                       f'/vel2d_bridge, it is for {full}; put them below')
    assert pids(launch) == []


def test_settings_for_a_node_in_a_namespace(graph, tmp_path):
    config = settings(tmp_path, 'mine.yaml', '/rover1/drive', max_linear_x=0.25, baud="'fast'")
    with Pty(str(tmp_path / 'mcu')) as pty, launched(
            'bridge', f'config:={config}', f'port:={pty.path}', 'namespace:=rover1',
            'name:=drive', 'baud:=9600', 'log_level:=debug') as launch:
        assert graph.get('/rover1/drive', ['max_linear_x', 'baud']) == [0.25, 9600]
        launch.wait_for('[DEBUG]', '[rover1.drive]')


def test_no_file_is_left_in_tmp(monkeypatch, tmp_path):
    folder = tmp_path / 'tmp'
    folder.mkdir()
    monkeypatch.setenv('TMPDIR', str(folder))
    config = settings(tmp_path, 'mine.yaml', '/**', port='/dev/nope')
    with launched('bridge', f'config:={config}', f'port:={tmp_path}/mcu') as launch:
        launch.wait_for(f'{tmp_path}/mcu: is not there')
        assert len(list(folder.glob('*/*.yaml'))) == 2
    assert list(folder.iterdir()) == []
