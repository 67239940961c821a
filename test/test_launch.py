# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""
The launch files as `colcon test` runs them: launch_testing, fake ports, clean exit codes.

Under a pytest without launch_testing's plugin (it does not start with pytest 9) each case is run
by `launch_test` in a process of its own. Skipped by a mark, never by a module-level skip:
launch_testing's plugin would drop every other test of the run with it.
"""
import os
import subprocess
import sys
import tempfile
import unittest

from harness import installed_share
from harness import ROOT
import pytest
from scenarios import CASTS
from scenarios import play

SHARE, WHY = installed_share('rclpy', 'launch_ros', 'launch_testing', 'ament_index_python')
CASE = os.environ.get('LAUNCH_CASE')        # set for launch_test: play this one

if WHY:
    @pytest.mark.ros
    @pytest.mark.realtime(bears=0.1)
    @pytest.mark.skip(reason=WHY)
    @pytest.mark.parametrize('name', CASTS)
    def test_launch(name):
        """Stand in for the launch test."""
elif not CASE and not os.environ.get('LAUNCH_TESTING_PLUGIN'):
    @pytest.mark.ros
    @pytest.mark.realtime(bears=0.1)
    @pytest.mark.slow
    @pytest.mark.parametrize('name', CASTS)
    def test_launch(name):
        path = os.pathsep.join([str(ROOT), str(ROOT / 'test'), os.environ.get('PYTHONPATH', '')])
        done = subprocess.run(
            [sys.executable, '-m', 'launch_testing.launch_test', __file__], text=True,
            env={**os.environ, 'LAUNCH_CASE': name, 'PYTHONPATH': path}, timeout=300,
            stdout=subprocess.PIPE, stderr=subprocess.STDOUT)
        assert done.returncode == 0, done.stdout
        assert 'Ran 1 test' in done.stdout
        assert 'Ran 2 tests' in done.stdout     # after the shutdown
else:
    from launch import LaunchDescription
    from launch.actions import ExecuteProcess
    from launch.actions import IncludeLaunchDescription
    from launch.launch_description_sources import PythonLaunchDescriptionSource
    import launch_testing
    import launch_testing.actions
    import launch_testing.asserts
    import ros_side

    @pytest.mark.launch_test
    @launch_testing.parametrize('name', [CASE] if CASE else list(CASTS))
    def generate_test_description(name):
        folder = tempfile.mkdtemp(prefix='launch_test_')
        arguments = CASTS[name]['launch']
        return LaunchDescription([
            *(ExecuteProcess(cmd=[sys.executable, '-m', module, *(
                word.format(folder=folder) for word in words)])
              for module, *words in CASTS[name]['fakes']),
            IncludeLaunchDescription(
                PythonLaunchDescriptionSource(f'{SHARE}/launch/{name}.launch.py'),
                launch_arguments=[(key, value.format(folder=folder))
                                  for key, value in arguments.items()]),
            launch_testing.actions.ReadyToTest(),
        ])

    class TestRunning(unittest.TestCase):
        def test_scenarios(self, name):
            with ros_side.Graph('operator') as graph:
                play(name, graph, ros_side)

    @launch_testing.post_shutdown_test()
    class TestShutdown(unittest.TestCase):
        def test_exit_codes(self, proc_info):
            launch_testing.asserts.assertExitCodes(proc_info)

        def test_no_traceback(self, proc_output):
            text = ''.join(line.text.decode(errors='replace') for line in proc_output)
            self.assertNotIn('Traceback', text)
