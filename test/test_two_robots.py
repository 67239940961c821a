# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""Two robots in one ROS domain, one of them sick: neither is taken for the other."""
from contextlib import ExitStack
from importlib import util
import signal
import time

from harness import Program
from harness import wait
import pytest
from running_bridge import bridge
from test_dashboard_ros import Running
from test_dashboard_server import Stream

from mecarover_serial.namesakes import DISCOVERED_NS

pytestmark = [pytest.mark.ros, pytest.mark.realtime(bears=0.1), pytest.mark.slow]
LOST = 2
WATCH_S = 3.0                   # three reports of each robot


@pytest.fixture(scope='module')
def robots(ros, tmp_path_factory):
    """Run a monitor and a bridge in each of two namespaces; rover2 has lost a device."""
    folder = tmp_path_factory.mktemp('robots')
    with ExitStack() as stack:
        for name, fault in (('rover1', ()), ('rover2', ('--fault', f'silent:{LOST}:0:9999'))):
            bus, mcu, namespace = folder / name, folder / f'mcu_{name}', ('-r', f'__ns:=/{name}')
            for part in (
                    ('mecarover_fakes.fake_bus', '--link', str(bus), '--devices', '1-3:MX-64',
                     *fault),
                    ('dxl_monitor.start', '--ros-args', *namespace, '-p', f'ports:={bus}', '-p',
                     "devices:=['1-3:MX-64']"),
                    ('vel2d_bridge.main', '--ros-args', *namespace, '-p', f'port:={mcu}')):
                stack.enter_context(Program(*part))
        yield folder


def test_each_status_is_of_one_robot(robots, graph):
    """Name and hardware_id never serve two devices: no level, message or port flaps."""
    for name, level in (('rover1', 0), ('rover2', 2)):
        graph.wait_status(f'{name}/dxl_monitor: 002', level=level)
        graph.wait_status(f'{name}/vel2d_bridge: commands', 'no stop has been sent', level=1)
    begin = len(graph.heard['/diagnostics'])
    end_s = time.monotonic() + WATCH_S
    wait(lambda: time.monotonic() > end_s)
    seen = {}
    for message in graph.heard['/diagnostics'][begin:]:
        for status in message.status:
            port = [pair.value for pair in status.values if pair.key == 'Port']
            seen.setdefault((status.name, status.hardware_id), set()).add(
                (status.level, *port))
    ours = {key: kinds for key, kinds in seen.items() if key[0].startswith('rover')}
    assert len(ours) == 2 * (3 + 1 + 2)
    assert {key for key, kinds in ours.items() if len(kinds) > 1} == set()
    assert len({hardware_id for _, hardware_id in ours}) == 2 * (3 + 2)
    assert ours['rover2/dxl_monitor: 002', 'rover2/servo bus rover2/ID 2'] == {(b'\2',)}
    [[_, port]] = ours['rover1/vel2d_bridge: link', f'rover1{robots}/mcu_rover1']
    assert port == f'{robots}/mcu_rover1'


def test_one_teleop_for_two_rovers_is_said_by_both_bridges(graph, tmp_path):
    """Each is well, so nothing else would say it; in the log it stands once."""
    names = ['left', 'right']
    with ExitStack() as stack:
        bridges = [stack.enter_context(bridge(
            str(tmp_path / name), '-r', f'__node:={name}', '-r', 'cmd_vel:=/both/cmd_vel'))
            for name in names]
        for one, name, other in zip(bridges, names, reversed(names), strict=True):
            words = f'/both/cmd_vel: /{other} subscribes it too, so one teleop drives 2 rovers; '
            graph.wait_status(f'{name}: commands', words, level=1)
            one.wait_for('WARN', words)
            assert len(one.said(words)) == 1
        bridges.pop().signal(signal.SIGTERM)
        wait(lambda: 'subscribes it too' not in str(graph.statuses['left: commands']))


@pytest.mark.parametrize(('module', 'status', 'port'), [
    ('vel2d_bridge.main', 'vel2d_bridge: commands', 'port'),
    ('dxl_monitor.start', 'dxl_monitor: bus', 'ports')])
def test_two_nodes_of_one_name_are_said(graph, tmp_path, module, status, port):
    """By the older one at once: what it finds after its start was not killed before."""
    words = ['--ros-args', '-r', '__ns:=/twins', '-p', f'{port}:={tmp_path}/none']
    name = '/twins/' + status.partition(':')[0]
    with Program(module, *words) as first:
        graph.wait_status(f'twins/{status}', level=None)
        wait(lambda: 'nodes have' not in str(graph.statuses[f'twins/{status}']))
        began_s = time.monotonic()
        wait(lambda: time.monotonic() > began_s + DISCOVERED_NS / 1e9)
        with Program(module, *words):
            line = f'{name}: 2 nodes have this name, so their statuses and services are mixed up; '
            graph.wait_status(f'twins/{status}', line)
            first.wait_for('WARN', line)
            assert len(first.said(line)) == 1


@pytest.mark.skipif(util.find_spec('aiohttp') is None, reason='skipped: no aiohttp')
@pytest.mark.parametrize(('namespace', 'shown'), [
    ('/', {'rover1', 'rover2'}), ('/rover1', {'rover1'}), ('/rover2', {'rover2'})])
def test_a_dashboard_shows_the_robots_of_its_namespace(robots, namespace, shown):
    with Running('--ros-args', '-r', f'__ns:={namespace}') as dashboard:
        stream, rows, states = Stream(dashboard), {}, set()

        def take():
            for section, changed in stream.next().items():
                if section in ('devices', 'buses', 'bridge', 'timing'):
                    rows.setdefault(section, {}).update(changed)

        def everything():
            take()
            wanted = {'devices': 3, 'buses': 1, 'bridge': 2, 'timing': 14}
            found = {section: len(some) for section, some in rows.items()}
            return found == {name: count * len(shown) for name, count in wanted.items()}
        wait(everything)
        end_s = time.monotonic() + WATCH_S
        while time.monotonic() < end_s:
            take()
            states |= {(name, row['state'])
                       for name, row in rows['devices'].items() if row['id'] == LOST}
        stream.close()
    assert {row['robot'] for some in rows.values() for row in some.values()} == shown
    words = {'rover1': 'connected', 'rover2': 'disconnected'}
    assert states == {(f'{robot}/dxl_monitor: 002', words[robot]) for robot in shown}
