# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""The dashboard as users meet it: a process that hears the real monitor on a fake bus."""
from importlib import util
import json
import re
import signal

from harness import Program
from harness import wait
import pytest
from synthetic_robot import SyntheticRobot
from test_dashboard_server import signals
from test_dashboard_server import Stream

pytestmark = [pytest.mark.ros, pytest.mark.realtime(bears=0.1),
              pytest.mark.skipif(util.find_spec('aiohttp') is None, reason='skipped: no aiohttp')]

# Device 2 falls silent for 4 of 10 s, again and again: a late start sees it all the same.
NOW_AND_THEN = [part for begin in range(6, 120, 10) for part in ('--fault', f'silent:2:{begin}:4')]


class Running(Program):
    """A dashboard process on a free port."""

    def __init__(self, *arguments):
        super().__init__('mecarover_dashboard.ros_server', '--port', '0', '--history', 'none',
                         *arguments)

    def __enter__(self):
        self.line = self.wait_for('http://')
        self.port = int(re.search(r':(\d+)\b', self.line.partition('http://')[2])[1])
        wait(lambda: Stream(self).next())
        return self


def collect(stream, rows, condition):
    """Apply events to `rows` until the condition holds; return the last table seen."""
    table = {}
    for _ in range(300):
        event = stream.next()
        for section in ('devices', 'buses', 'bridge', 'timing'):
            rows.setdefault(section, {}).update(event.get(section, {}))
        table.update(event.get('table', {}))
        if condition():
            return table
    raise AssertionError(f'never came: {rows.keys()}')


@pytest.mark.ros
def test_the_real_monitor_on_a_fake_bus(ros, tmp_path):
    link = tmp_path / 'bus'
    with Program('mecarover_fakes.fake_bus', '--link', str(link), '--devices', '1-3:MX-106',
                 '4:BitFoot', *NOW_AND_THEN), Running() as dashboard:
        wait(link.exists)
        with Program('dxl_monitor.start', '--ros-args', '-p', f"ports:=['{link}']", '-p',
                     "devices:=['1-2:MX-106','3:MX-106:knee','4:BitFoot']"):
            stream, rows = Stream(dashboard, 'watch=dxl_monitor:%20003%20knee'), {}
            devices = rows.setdefault('devices', {})
            state = {}

            def lost():
                state.update({row['id']: row['state'] for row in devices.values()})
                return state.get(2) == 'disconnected'
            table = collect(stream, rows, lost)
            assert state[1] == 'connected'
            path = ('/signals?of=dxl_monitor:%20003%20knee&register=Present%20Position%20(rad)'
                    '&after=0')
            wait(lambda: len(signals(dashboard, 1, path)[1][0][2]) > 2)
            _, [(_, _, points)] = signals(dashboard, 1, path)
            assert points[2][0] - points[0][0] > 0.8                # as publish_rate has it
            collect(stream, rows, lambda: not lost())
            stream.close()
            again = Stream(dashboard, 'watch=dxl_monitor:%20003%20knee')
            table = collect(again, rows, lambda: True)
            again.close()
    knee = devices['dxl_monitor: 003 knee']
    assert (knee['model'], knee['joint'], knee['id']) == ('MX-106', 'knee', 3)
    fields = {field[0]: field for field in table['fields']}
    assert abs(float(fields['Present Position (rad)'][1])) < 3.2
    assert fields['Present Position (rad)'][4] == 'r'
    [bus] = rows['buses'].values()
    assert bus['errors']
    assert {'bus_load', 'time_per_buffer', 'time_between_buffers', 'resident_memory'} \
        <= {row['metric'] for row in rows['timing'].values()}


@pytest.mark.ros
def test_a_recording_shows_as_the_robot_did(ros, graph):
    """`ros2 bag play` publishes what was recorded: old stamps, no node of that name."""
    from rclpy.serialization import deserialize_message
    robot = SyntheticRobot()
    robot.lost = {7}
    publishers = {}
    with Running() as dashboard:
        for topic, data in robot.messages(100.0):
            if topic not in publishers:
                publishers[topic] = graph.publisher(f'/{topic.lstrip("/")}', ros.DiagnosticArray,
                                                    ros.qos(100))
            message = deserialize_message(data, ros.DiagnosticArray)
            message.header.stamp.sec = 1_500_000_000
            publishers[topic].publish(message)
        stream, rows = Stream(dashboard), {}
        expected = {'devices': 24, 'buses': 1, 'bridge': 2, 'timing': 14}
        collect(stream, rows,
                lambda: {name: len(found) for name, found in rows.items()} == expected)
        stream.close()
    assert rows['devices']['dxl_monitor: 007 left_knee']['state'] == 'disconnected'
    assert not any('quiet_since' in row for row in rows['devices'].values())
    for publisher in publishers.values():
        graph.node.destroy_publisher(publisher)


@pytest.mark.ros
@pytest.mark.parametrize('number', [signal.SIGINT, signal.SIGTERM, signal.SIGHUP])
def test_signals_end_it_with_code_0(ros, number):
    with Running() as dashboard:
        stream = Stream(dashboard)
        stream.next()
        dashboard.signal(number)
        assert dashboard.exit_code() == 0
        stream.close()
    assert 'Traceback' not in dashboard.text
    assert len(dashboard.lines) == 1


INTERRUPTED = """
import os, signal, sys
from mecarover_dashboard import ros_server

class Finder:
    def find_spec(name, *_):
        if name == 'IMPORTED':
            os.kill(os.getpid(), signal.SIGINT)

sys.meta_path.insert(0, Finder)
sys.exit(ros_server.main(['--port', '0']))
"""


@pytest.mark.ros
@pytest.mark.parametrize('imported', ['aiohttp', 'rclpy', 'diagnostic_msgs'])
def test_signal_while_it_starts(ros, imported):
    """The start is finished, then ended; the import of ROS takes longest."""
    with Program('', script=INTERRUPTED.replace('IMPORTED', imported)) as dashboard:
        assert dashboard.exit_code() == 0, dashboard.text
    assert 'Traceback' not in dashboard.text


def test_mecarover_status_once_for_scripts(ros, tmp_path):
    """Exit codes, with a real monitor: 1 nothing heard, 0 well, 4 a device is lost."""
    with Program('mecarover_dashboard.terminal', '--once', '--wait', '1') as status:
        assert status.exit_code() == 1
        assert 'no report on /diagnostics; start the nodes' in status.text
    bus = str(tmp_path / 'bus')
    for name, fault, code, line in (
            ('well', (), 0, r'ok +well +bus +All 3 devices connected'),
            ('sick', ('--fault', 'silent:2:0:9999'), 4,
             r'ERROR +sick +002 +(disconnected|expected|silent)')):
        with Program('mecarover_fakes.fake_bus', '--link', bus, '--devices', '1-3:MX-64',
                     *fault) as fake, \
                Program('dxl_monitor.start', '--ros-args', '-r', f'__ns:=/{name}', '-p',
                        f'ports:={bus}', '-p', "devices:=['1-3:MX-64']") as monitor:
            fake.wait_for('2000000 baud')
            monitor.wait_for('open at')
            with Program('mecarover_dashboard.terminal') as live:
                live.wait_for('002' if fault else 'All 3')
            with Program('mecarover_dashboard.terminal', '--once', '--ros-args', '-r',
                         f'__ns:=/{name}') as status:
                assert status.exit_code() == code, status.text
            assert re.search(line, status.text), status.text
            with Program('mecarover_dashboard.terminal', '--once', '--json') as status:
                assert status.exit_code() == code, status.text
            [found] = json.loads(status.text)['buses']
            assert (found['robot'], len(found['devices'])) == (name, 3)
            assert isinstance(found['devices'][0]['position'], float)
