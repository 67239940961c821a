# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""What Prometheus gets, read by the client's own parser and by a real Prometheus."""
from importlib import util
import json
from pathlib import Path
import re
import shutil
import socket
import subprocess
from urllib.request import Request
from urllib.request import urlopen

from dashboard_page import Dashboard
from harness import wait
import pytest
from synthetic_robot import FINDINGS
from synthetic_robot import HUMANOID
from synthetic_robot import MANY
from synthetic_robot import SyntheticRobot

from mecarover_dashboard.state import State
from servobus.doctor import RULES

HAS_CLIENT = util.find_spec('prometheus_client') is not None
if HAS_CLIENT:
    from prometheus_client.openmetrics.parser import text_string_to_metric_families
    from prometheus_client.parser import text_string_to_metric_families as plain_families

    from mecarover_dashboard.metrics import exposition
pytestmark = pytest.mark.skipif(not HAS_CLIENT, reason='skipped: no prometheus_client; '
                                'pip install prometheus-client')

DEPLOY = Path(__file__).parents[1] / 'deploy'
OPEN = 'application/openmetrics-text; version=1.0.0'
KNEE = {'robot': '', 'bus': '', 'id': '7', 'model': 'MX-106', 'joint': 'left_knee'}


def samples(state):
    """Return {(name, labels): value} as the client's own parser reads them."""
    text, content_type = exposition(state, OPEN)
    assert content_type.startswith('application/openmetrics-text')
    return {(sample.name, tuple(sorted(sample.labels.items()))): sample.value
            for family in text_string_to_metric_families(text.decode())
            for sample in family.samples}


def told(*robots):
    state = State()
    for robot in robots:
        robot.tell(state, 100.0)
    return state


def key(name, **labels):
    return f'mecarover_{name}', tuple(sorted(labels.items()))


def test_values():
    robot = SyntheticRobot()
    robot.warned, robot.findings = {7}, FINDINGS
    found = samples(told(robot))
    assert found[key('device_level', **KNEE)] == 1
    assert found[key('device_connected', **KNEE)] == 1
    assert found[key('device_temperature_celsius', **KNEE)] == 41
    assert found[key('device_loss_ratio', **KNEE)] == pytest.approx(0.0387, abs=0.001)
    assert found[key('device_answers_total', **KNEE)] > 0
    assert 0.3 < found[key('bus_load_ratio', robot='', bus='')] < 0.5
    assert found[key('bus_packets_total', robot='', bus='')] == 390_000
    assert found[key('bridge_frames_total', robot='')] == 2000
    assert found[key('bridge_level', robot='', part='link')] == 0
    assert found[key('finding', robot='', bus='', id='', rule='missing_termination',
                     severity='warn')] == 1


def test_robots_and_buses_have_labels():
    found = samples(told(SyntheticRobot({'left': MANY[:2]}, namespace='rover1'),
                         SyntheticRobot({'left': MANY[:2]}, namespace='rover2')))
    assert {dict(labels)['robot'] for name, labels in found if name == 'mecarover_bus_level'} \
        == {'rover1', 'rover2'}
    assert {dict(labels)['bus'] for name, labels in found if name == 'mecarover_device_level'} \
        == {'left'}


def test_what_a_servo_said_before_it_was_lost_is_no_value_of_now():
    robot = SyntheticRobot()
    robot.lost = {7}
    found = samples(told(robot))
    assert found[key('device_level', **KNEE)] == 2
    assert found[key('device_connected', **KNEE)] == 0
    assert found[key('device_loss_ratio', **KNEE)] == 1
    assert found[key('problem', robot='', part='bus', problem='lost')] == 2
    assert {dict(labels)['id'] for name, labels in found
            if name == 'mecarover_device_temperature_celsius'} == {
                str(number) for number, _, _ in HUMANOID if number < 100 and number != 7}
    robot.port_problem = '/dev/ttyUSB0: there is no such device; plug it in'
    found = samples(told(robot))
    assert not any('celsius' in name or 'bus_load' in name or 'connected' in name
                   or ('loss' in name and 'device' in name) or name.endswith('finding')
                   for name, _ in found)
    assert found[key('problem', robot='', part='bus', problem='port closed')] == 2


def test_every_finding_of_a_device_counts_and_what_has_no_room_is_said(monkeypatch):
    robot = SyntheticRobot()
    robot.findings = [FINDINGS[1]._replace(rule=f'rule_{number:02}') for number in range(40)]
    found = samples(told(robot))
    assert len([1 for name, _ in found if name == 'mecarover_finding']) == 40
    assert found[key('findings_left_out')] == 0
    monkeypatch.setattr('mecarover_dashboard.metrics.MOST_FINDINGS', 25)
    assert samples(told(robot))[key('findings_left_out')] == 15


def test_how_many_series_a_full_bus_has():
    assert len(samples(told(SyntheticRobot({'': MANY})))) < 12 * len(MANY)


def test_an_old_scraper_gets_the_old_format():
    text, content_type = exposition(told(SyntheticRobot()), 'text/plain')
    assert content_type.startswith('text/plain')
    assert any(family.name == 'mecarover_device_level' for family in plain_families(text.decode()))


def test_over_http():
    with Dashboard() as dashboard:
        dashboard.take(SyntheticRobot().messages(100.0))

        def get():
            request = Request(f'{dashboard.address}metrics', headers={'Accept': OPEN})
            with urlopen(request, timeout=10) as answer:
                assert answer.headers['Content-Type'].startswith('application/openmetrics-text')
                return answer.read()
        wait(lambda: b'left_knee' in get())


def test_the_alerts_name_findings_that_exist():
    named = re.findall('rule="(.*?)"', (DEPLOY / 'alerts.yml').read_text())
    assert named and set(named) <= {rule.name for rule in RULES}


@pytest.mark.skipif(not shutil.which('prometheus'),
                    reason='skipped: no prometheus; sudo apt install prometheus')
def test_a_real_prometheus(tmp_path):
    """Prometheus scrapes the page with the example and evaluates the alert rules of deploy/."""
    robot = SyntheticRobot()
    for name in ('prometheus.yml', 'alerts.yml'):
        shutil.copy(DEPLOY / name, tmp_path)
    subprocess.run(['promtool', 'check', 'config', tmp_path / 'prometheus.yml'], check=True)
    with socket.create_server(('127.0.0.1', 0)) as free:
        port = free.getsockname()[1]
    with Dashboard() as dashboard:
        config = (tmp_path / 'prometheus.yml').read_text()
        here = f'127.0.0.1:{dashboard.port}'
        config = config.replace('rover1.local:8420', here)
        config = config.replace('          - rover2.local:8420\n', '').replace('15s', '1s')
        (tmp_path / 'prometheus.yml').write_text(config)
        with subprocess.Popen(
                ['prometheus', f'--config.file={tmp_path}/prometheus.yml',
                 f'--storage.tsdb.path={tmp_path}/data', f'--web.listen-address=127.0.0.1:{port}'],
                stderr=subprocess.DEVNULL) as process:
            def alerts():
                if robot is not None:
                    dashboard.take(robot.messages(100.0))
                return said(f'http://127.0.0.1:{port}/api/v1/alerts')
            try:
                robot.faulty = {7}
                wait(lambda: f'{here}: device 7 left_knee: error' in alerts(), 60)
                robot.port_problem = '/dev/ttyUSB0: there is no such device; plug it in'
                wait(lambda: f'{here}: bus: port closed' in alerts(), 60)
                robot = None                        # its nodes are killed
                wait(lambda: {f'{here}: bus: no report', f'{here}: bridge: no report'}
                     <= alerts(), 60)
                wait(lambda: not any('device' in one for one in alerts()), 60)
            finally:
                process.terminate()


def said(address):
    """Return what the alerts say that are pending or firing."""
    try:
        with urlopen(address, timeout=5) as answer:
            return {one['annotations']['summary'] for one in json.loads(answer.read())['data'][
                'alerts']}
    except OSError:
        return set()                            # it is still starting
