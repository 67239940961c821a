# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""What rcl refuses when a node is made: one line and exit code 2, for each of them."""
from harness import Program
from harness import wait
import pytest

pytestmark = [pytest.mark.ros, pytest.mark.realtime(bears=0.5)]


def test_a_list_on_the_command_line_wins_over_a_list_of_another_type(ros, tmp_path):
    settings = tmp_path / 'monitor.yaml'
    settings.write_text("/**:\n  ros__parameters:\n    devices: ['1:MX-64']\n")
    with Program('dxl_monitor.start', '--ros-args', '--params-file', str(settings), '-p',
                 'devices:=[300]') as node:
        assert node.exit_code() == 2
    assert 'devices: ' in node.lines[-1]
    assert '300' in node.lines[-1]


def test_joint_states_can_be_reliable(ros, tmp_path, graph):
    topic, option = '/dxl/joint_states', 'qos_overrides./dxl/joint_states.publisher.reliability'
    words = ['--ros-args', '-p', f'ports:={tmp_path}/bus', '-p', 'joint_state_rate:=10.0', '-p']
    with Program('dxl_monitor.start', *words, f'{option}:=sometimes') as node:
        assert node.exit_code() == 2
    assert node.lines[-1].startswith(f'dxl_monitor: qos_overrides.{topic}.publisher: ')
    with Program('dxl_monitor.start', *words, f'{option}:=reliable', '-p',
                 'qos_overrides./dxl/joint_state.publisher.reliability:=reliable') as node:
        node.wait_for('joint_state.publisher.reliability: no such parameter, ignored; did you '
                      f'mean {option}?')
        wait(lambda: graph.publishers(topic))
        [publisher] = graph.node.get_publishers_info_by_topic(topic)
        assert publisher.qos_profile.reliability == ros.qos().reliability
