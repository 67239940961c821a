# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""What Prometheus gets, read by the client's own parser and by a real Prometheus."""
from importlib import util
import json
from pathlib import Path
import shutil
import socket
import subprocess
from urllib.request import Request
from urllib.request import urlopen

from dashboard_page import Dashboard
from harness import wait
import pytest
from synthetic_robot import FINDINGS
from synthetic_robot import MANY
from synthetic_robot import SyntheticRobot

from mecarover_dashboard.state import State

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
        for topic, message in robot.messages(100.0):
            state.take(topic, message, 100.0)
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


def test_what_is_not_reported_has_no_values():
    state = told(SyntheticRobot())
    state.expire(200.0)
    found = samples(state)
    assert found[key('device_level', **KNEE)] == 3
    assert not any(name == 'mecarover_device_temperature_celsius' for name, _ in found)


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


@pytest.mark.skipif(not shutil.which('prometheus'),
                    reason='skipped: no prometheus; sudo apt install prometheus')
def test_a_real_prometheus(tmp_path):
    """Prometheus scrapes the page with the example and evaluates the alert rules of deploy/."""
    robot = SyntheticRobot()
    robot.faulty = {7}
    for name in ('prometheus.yml', 'alerts.yml'):
        shutil.copy(DEPLOY / name, tmp_path)
    subprocess.run(['promtool', 'check', 'config', tmp_path / 'prometheus.yml'], check=True)
    with socket.create_server(('127.0.0.1', 0)) as free:
        port = free.getsockname()[1]
    messages = robot.messages(100.0)
    with Dashboard() as dashboard:
        config = (tmp_path / 'prometheus.yml').read_text()
        config = config.replace('rover1.local:8420', f'127.0.0.1:{dashboard.port}')
        config = config.replace('          - rover2.local:8420\n', '').replace('15s', '1s')
        (tmp_path / 'prometheus.yml').write_text(config)
        with subprocess.Popen(
                ['prometheus', f'--config.file={tmp_path}/prometheus.yml',
                 f'--storage.tsdb.path={tmp_path}/data', f'--web.listen-address=127.0.0.1:{port}'],
                stderr=subprocess.DEVNULL) as process:
            try:
                ask = f'http://127.0.0.1:{port}/api/v1/alerts'
                wait(lambda: dashboard.take(messages) or 'DeviceError' in names(ask),
                     60)
            finally:
                process.terminate()


def names(address):
    try:
        with urlopen(address, timeout=5) as answer:
            return {one['labels']['alertname']
                    for one in json.loads(answer.read())['data']['alerts']}
    except OSError:
        return set()                            # it is still starting
