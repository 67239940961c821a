# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""Commands switched off: by service, parameter and file, over a restart, and without a cable."""
from pathlib import Path
import shlex
import signal

from harness import wait
import pytest
from running_bridge import bridge

pytestmark = [pytest.mark.ros, pytest.mark.realtime(bears=0.1)]
NODE = '/vel2d_bridge'
COMMANDS = 'vel2d_bridge: commands'
ROOT = Path(__file__).parents[1]


def enable(graph, ros, on):
    return graph.call(ros.SetBool, f'{NODE}/enable', data=on)


def end(running):
    running.signal(signal.SIGTERM)
    assert running.exit_code() == 0, running.text


def test_without_a_cable_it_does_not_say_that_the_rover_has_stopped(ros, graph, mcu, cmd_vel):
    with bridge(mcu) as running:
        with ros.Teleop(cmd_vel, lambda: ros.twist(0.3), rate=50):
            wait(lambda: mcu.receiver.wheels.x == 300.0)
            mcu.vanish()
            running.wait_for('lost')
        answer = enable(graph, ros, False)
        assert not answer.success
        assert answer.message == 'no stop could be sent, the rover may be driving'
        graph.wait_status(COMMANDS, answer.message, 'State=unknown', level=2)
        mcu.come_back()
        wait(lambda: mcu.receiver.wheels.is_stop)
        graph.wait_status(COMMANDS, 'State=disabled', level=1)
        assert enable(graph, ros, False).success
        end(running)


def test_switched_off_by_the_file_it_waits_for_no_command(mcu):
    with bridge(mcu, enabled='false') as running:
        line = running.wait_for('open at 115200 baud')
        assert line.endswith('; the bridge sends stop frames until commands are enabled')
        end(running)


def test_started_without_a_cable_it_does_not_say_that_the_rover_stands(graph, mcu, tmp_path):
    """The bridge before it may have been killed while it drove."""
    link = tmp_path / 'mcu'
    with bridge(link) as running:
        graph.wait_status(COMMANDS, 'no stop has been sent since the start, the rover may be '
                          'driving; plug its port in', 'State=unknown', level=1)
        link.symlink_to(mcu.path)
        graph.wait_status(COMMANDS, 'State=stopped')
        assert 'may be driving' not in str(graph.statuses[COMMANDS])
        end(running)


def of_the_service(folder, mcu):
    """Return the arguments that systemd gives the bridge, with the file that is installed."""
    [line] = [one for one in (ROOT / 'deploy/vel2d_bridge.service').read_text().splitlines()
              if one.startswith('ExecStart=')]
    given = line.partition('--ros-args ')[2].replace('%S/mecarover_serial', str(folder)).replace(
        '/etc/mecarover_serial', str(ROOT / 'config'))
    return [*shlex.split(given)[:-1], '-p', f'port:={mcu.path}']     # the last: more of a user


@pytest.mark.parametrize('is_service', [False, True])
def test_switched_off_it_stays_off_over_a_restart(ros, graph, mcu, cmd_vel, tmp_path, is_service):
    path = tmp_path / ('bridge_disabled' if is_service else 'disabled')
    arguments = of_the_service(tmp_path, mcu) if is_service else ('-p', f'disabled_file:={path}')
    with bridge(mcu, *arguments) as running:
        running.wait_for('open at')
        assert enable(graph, ros, False).success
        assert path.exists()
        running.signal(signal.SIGKILL)
        running.exit_code()
    with bridge(mcu, *arguments) as running, \
            ros.Teleop(cmd_vel, lambda: ros.twist(0.3), rate=50):
        running.wait_for(f'{path}: exists because')
        running.wait_for('refused: disabled')
        assert graph.get(NODE, ['enabled']) == [False]
        assert mcu.receiver.wheels.is_stop
        assert enable(graph, ros, True).success
        assert not path.exists()
        wait(lambda: mcu.receiver.wheels.x == 300.0)
        end(running)


def test_a_file_that_cannot_be_made_is_said_at_the_start(mcu, tmp_path):
    with bridge(mcu, disabled_file=tmp_path / 'no' / 'disabled') as running:
        running.wait_for('commands that are switched off will be accepted after a restart')
        end(running)


def test_the_parameter_is_the_same_switch(ros, graph, mcu, cmd_vel):
    with bridge(mcu, enabled='false') as running, \
            ros.Teleop(cmd_vel, lambda: ros.twist(0.3), rate=50):
        running.wait_for('refused: disabled')
        assert graph.set(NODE, enabled=True) == ['']
        wait(lambda: mcu.receiver.wheels.x == 300.0)
        assert enable(graph, ros, False).success
        assert graph.get(NODE, ['enabled']) == [False]
        wait(lambda: mcu.receiver.wheels.is_stop)
        end(running)


def test_what_cannot_be_kept_is_said_and_the_rover_stops_all_the_same(ros, graph, mcu, cmd_vel):
    with bridge(mcu, disabled_file='/proc/disabled') as running, \
            ros.Teleop(cmd_vel, lambda: ros.twist(0.3), rate=50):
        wait(lambda: mcu.receiver.wheels.x == 300.0)
        answer = enable(graph, ros, False)
        assert not answer.success
        assert answer.message.startswith('stopped; commands are refused until enabled; /proc/')
        assert 'commands will be accepted after a restart' in answer.message
        wait(lambda: mcu.receiver.wheels.is_stop)
        end(running)
