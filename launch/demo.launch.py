# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""
Starts suite and dashboard against simulated hardware: a fake MCU and a fake Dynamixel bus.

Then drive: `ros2 run teleop_twist_keyboard teleop_twist_keyboard`; the fake MCU prints what it
understands.
"""
import atexit
import os
import shutil
import tempfile

from ament_index_python.packages import get_package_share_directory
from launch.actions import ExecuteProcess
from launch.actions import IncludeLaunchDescription
from launch.actions import OpaqueFunction
from launch.launch_description_sources import PythonLaunchDescriptionSource
from launch_ros.actions import Node
from launch_ros.substitutions import ExecutableInPackage

from mecarover_serial.launch import describe_launch_file
from mecarover_serial.launch_arguments import Argument
from mecarover_serial.launch_arguments import NO
from mecarover_serial.launch_arguments import PACKAGE
from mecarover_serial.launch_arguments import SHARED
from mecarover_serial.launch_arguments import YES

SHARE = get_package_share_directory(PACKAGE)
# A monitor that starts in the middle of traffic needs the models in `devices`, or a Ping.
DEVICES = ['1-4:MX-106', '5-12:MX-64', '13-15:Rhoban DXL board', '16-18:BitFoot',
           '19-20:Bit-Bots IMU']
ARGUMENTS = (
    Argument('folder', '', 'folder for the links to the fake ports; default: a new one, removed '
             'at the end'),
    Argument('fault', '', 'faults of the fake bus, e.g. silent:7:10:5; see fake_bus '
                          '--list-faults'),
    Argument('dashboard', 'true', 'start the web page too', YES + NO),
    Argument('dashboard_port', '8420', 'port of the web page; 0 = any free port'),
    *SHARED,
)


def generate_launch_description():
    return describe_launch_file(__file__, ARGUMENTS, [OpaqueFunction(function=_start)])


def _start(context):
    given = dict(context.launch_configurations)
    folder = given['folder'] or tempfile.mkdtemp(prefix='mecarover-')
    mcu, bus = os.path.join(folder, 'mcu'), os.path.join(folder, 'bus')
    fault = ['--fault', given['fault']] if given['fault'] else []
    actions = [
        _fake('fake_mcu', '--outlive', '--link', mcu),
        _fake('fake_bus', '--outlive', '--link', bus, '--devices', *DEVICES, *fault),
        IncludeLaunchDescription(
            PythonLaunchDescriptionSource(os.path.join(SHARE, 'launch', 'suite.launch.py')),
            launch_arguments=[
                ('port', mcu), ('ports', bus), ('devices', str(DEVICES)),
                ('namespace', given['namespace']),
                ('log_level', given['log_level'])]),
    ]
    if given['dashboard'] in YES:
        actions.append(Node(
            package=PACKAGE, executable='dxl_dashboard', namespace=given['namespace'],
            arguments=['--port', given['dashboard_port'], '--history', 'none'],
            output='screen'))
    if not given['folder']:
        # Not at the event of the shutdown: the nodes still need their ports then.
        atexit.register(shutil.rmtree, folder, True)
    return actions


def _fake(name, *arguments):
    """Not a Node action: the fakes know nothing of ROS, and ignore the --ros-args that it adds."""
    return ExecuteProcess(cmd=[ExecutableInPackage(name, PACKAGE), *arguments],
                          name=name, output='screen')
