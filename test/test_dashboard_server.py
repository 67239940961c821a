# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""The web server of the dashboard: what it serves, to whom, how its stream goes on."""
from collections import deque
import gzip
from http.client import HTTPConnection
from importlib import util
from itertools import islice
import json
from pathlib import Path
import socket
import struct
import time
from types import SimpleNamespace
from urllib.parse import urlencode
import zlib

from dashboard_page import Dashboard
from harness import Program
from harness import wait
import pytest
from synthetic_robot import SyntheticRobot

from mecarover_dashboard.cdr import HandedStatus
from mecarover_dashboard.inbox import Inbox
from mecarover_dashboard.inbox import MOST_BYTES
from mecarover_dashboard.inbox import MOST_MESSAGES
from mecarover_dashboard.request_guard import is_ours
from mecarover_dashboard.signal_requests import ReportedSignals
from rigs.tables import rows_of

pytestmark = pytest.mark.skipif(util.find_spec('aiohttp') is None, reason='skipped: no aiohttp')
KNEE = 'dxl_monitor:%20007%20left_knee'


@pytest.fixture
def dashboard():
    with Dashboard() as dashboard:
        yield dashboard


def ask(dashboard, path='/', method='GET', **headers):
    connection = HTTPConnection('127.0.0.1', dashboard.port, timeout=20)
    connection.request(method, path, headers=headers)
    response = connection.getresponse()
    body = response.read()
    connection.close()
    return response, body


def connect(dashboard, **options):
    return socket.create_connection(('127.0.0.1', dashboard.port), timeout=20, **options)


class Stream:
    """The events of one page; `id` is what it would resume with."""

    def __init__(self, dashboard, query='', **headers):
        self._connection = HTTPConnection('127.0.0.1', dashboard.port, timeout=20)
        self._connection.request('GET', f'/events?{query}', headers=headers)
        self.response = self._connection.getresponse()
        self.id = ''

    def next(self):
        while True:
            line = self.response.readline().decode()
            if line.startswith('id: '):
                self.id = line[4:].strip()
            elif line.startswith('data: '):
                return json.loads(line[6:])

    def until(self, condition):
        for _ in range(50):
            event = self.next()
            if condition(event):
                return event
        raise AssertionError('never came')

    def close(self):
        self._connection.close()


def test_page_and_headers(dashboard):
    response, body = ask(dashboard)
    assert response.status == 200
    assert b'<title>mecarover</title>' in body
    policy = response.headers['Content-Security-Policy']
    assert "default-src 'self'" in policy
    assert "frame-ancestors 'none'" in policy
    assert 'unsafe' not in policy
    assert response.headers['X-Content-Type-Options'] == 'nosniff'
    assert response.headers['Referrer-Policy'] == 'no-referrer'
    assert 'aiohttp' not in response.headers['Server']
    assert b'http://' not in body and b'https://' not in body, 'nothing from elsewhere'


@pytest.mark.parametrize('path', [
    '/../server.py', '/..%2fserver.py', '/%2e%2e/server.py', '/static/index.html', '/server.py',
    '//etc/passwd', '/etc/passwd', '/.git/config', '/index.html/..', '/main.js%00.html',
    '/x' * 999])
def test_no_path_leads_out(dashboard, path):
    response, body = ask(dashboard, path)
    assert response.status in (400, 403, 404)
    assert b'import' not in body


@pytest.mark.parametrize('method', ['POST', 'PUT', 'DELETE', 'PATCH', 'OPTIONS', 'TRACE'])
@pytest.mark.parametrize('path', ['/', '/events', '/nowhere'])
def test_it_only_reads(dashboard, method, path):
    response, _ = ask(dashboard, path, method)
    assert response.status == 405
    assert response.headers['X-Content-Type-Options'] == 'nosniff'


def test_head(dashboard):
    for path in ('/', '/events', '/main.js'):
        response, body = ask(dashboard, path, 'HEAD')
        assert (response.status, body) == (200, b'')


@pytest.mark.parametrize(('host', 'is_open', 'status'), [
    ('localhost:8420', False, 200), ('127.0.0.1', False, 200), ('[::1]:8420', False, 200),
    ('evil.example', False, 421), ('evil.example:8420', False, 421), ('', False, 421),
    ('localhost.evil.example', False, 421), ('192.168.1.7:8420', False, 421),
    ('192.168.1.7:8420', True, 200), ('[fe80::1]:8420', True, 200), ('evil.example', True, 421),
    (socket.gethostname(), True, 200), (f'{socket.gethostname()}.local:8420', True, 200)])
def test_only_names_of_this_machine(host, is_open, status):
    with Dashboard(is_open) as dashboard:
        assert ask(dashboard, Host=host)[0].status == status
        assert ask(dashboard, '/index.html', Host=host)[0].status == status


def test_files_are_compressed(dashboard):
    response, body = ask(dashboard, '/main.js', **{'Accept-Encoding': 'gzip'})
    assert response.headers['Content-Encoding'] == 'gzip'
    assert gzip.decompress(body) == ask(dashboard, '/main.js')[1]
    assert response.headers['Content-Type'].startswith('text/javascript')


def test_stream_tells_everything_then_changes(dashboard):
    robot = SyntheticRobot()
    dashboard.take(robot.messages(100.0))
    stream = Stream(dashboard)
    first = stream.until(lambda event: 'devices' in event)
    assert len(first['devices']) == 24
    assert (first.get('facts') or {}).get('open', False) is False
    robot.lost = {7}
    dashboard.take(robot.messages(100.0))
    change = stream.until(lambda event: 'devices' in event)
    assert set(change['devices']) == {'dxl_monitor: 007 left_knee'}
    stream.close()


def test_stream_goes_on_where_it_ended(dashboard):
    robot = SyntheticRobot()
    dashboard.take(robot.messages(100.0))
    stream = Stream(dashboard)
    stream.until(lambda event: 'devices' in event)
    stream.close()
    again = Stream(dashboard, f'since={stream.id}')
    event = again.next()
    assert 'facts' not in event and 'devices' not in event
    again.close()
    for since in ('', 'other.5', 'x', f'{stream.id}9x', '.', f'{stream.id.partition(".")[0]}.-1',
                  f'{stream.id.partition(".")[0]}.{"9" * 5000}'):
        second = Stream(dashboard, f'since={since}')
        assert 'facts' in second.next(), since
        second.close()


def test_stream_beats_while_nothing_happens(dashboard):
    stream = Stream(dashboard)
    stamps = [stream.next()['now'] for _ in range(3)]
    assert stamps == sorted(stamps)
    stream.close()


def test_the_table_of_one_device(dashboard):
    robot = SyntheticRobot()
    messages, begin = robot.messages(100.0), time.monotonic()
    dashboard.take(messages)
    stream = Stream(dashboard, f'watch={KNEE}')
    table = stream.until(lambda event: 'table' in event)['table']
    assert table['name'] == 'dxl_monitor: 007 left_knee'
    assert len(table['fields']) == 60
    while 'latency' not in table:       # one of the messages that are taken one by one
        table |= stream.until(lambda event: 'table' in event)['table']
    assert len(table['latency'][0]) == 4
    for _ in range(20):         # what is handed over late makes all ages other ones
        dashboard.take(robot.messages(100.0 + time.monotonic() - begin))
        change = stream.until(lambda event: 'table' in event)['table']
        assert 'fields' not in change
        changed = {table['fields'][int(at)][0] for at in change['some']}
        assert 'Present Position (rad)' in changed
        if len(changed) < 30:
            break
    assert len(changed) < 30
    stream.close()


def test_compressed_stream(dashboard):
    dashboard.take(SyntheticRobot().messages(100.0))
    stream = Stream(dashboard, **{'Accept-Encoding': 'gzip'})
    unzip = zlib.decompressobj(31)
    text = b''
    while b'left_knee' not in text:
        text += unzip.decompress(stream.response.read1(4096))
    stream.close()


def test_streams_are_limited(dashboard):
    from mecarover_dashboard.web_server import MOST_CLIENTS
    streams = [Stream(dashboard) for _ in range(MOST_CLIENTS)]
    assert ask(dashboard, '/events')[0].status == 503
    assert ask(dashboard, '/')[0].status == 200
    for stream in streams:
        stream.close()


def test_stop_ends_open_streams(dashboard):
    stream = Stream(dashboard)
    stream.next()
    dashboard.stop()
    assert not dashboard.server._thread.is_alive()
    stream.close()


def waiting(*sizes, restarted_at=None):
    """Return what an inbox says that got messages of so many bytes."""
    inbox = Inbox()
    for at, size in enumerate(sizes):
        if at == restarted_at:
            inbox.restart()
        inbox.put('/diagnostics', bytes(size), 1.0)
    is_restarted, messages = inbox.take()
    assert inbox.take() == (False, deque())
    return is_restarted, [len(message) for _, message, _ in messages]


def test_an_inbox_that_nobody_empties_is_bounded(monkeypatch):
    assert waiting(*[0] * 2 * MOST_MESSAGES) == (False, [0] * MOST_MESSAGES)
    monkeypatch.setattr('mecarover_dashboard.inbox.MOST_BYTES', 1000)
    assert waiting(*[300] * 20) == (False, [300] * 3)


def test_a_message_beyond_all_bounds_takes_no_room_of_others():
    assert waiting(300, MOST_BYTES + 1) == (False, [300, 0])


def test_a_restart_is_not_overtaken_by_what_comes_after_it():
    assert waiting(*[1] * 3 * MOST_MESSAGES, restarted_at=MOST_MESSAGES) \
        == (True, [1] * MOST_MESSAGES)


def test_versions_that_clients_claim_do_not_pile_up(dashboard):
    from mecarover_dashboard.web_server import MOST_CLIENTS
    for since in range(2 * MOST_CLIENTS):
        dashboard.server._text(since)
    assert len(dashboard.server._texts) <= MOST_CLIENTS


@pytest.mark.parametrize('request_', [
    b'\x16\x03\x01\x02\x00', b'GET / HTTP/1.1', b'GET / HTTP/9.9',
    b'GET /' + b'a' * 20_000 + b' HTTP/1.1',
    b'GET http://[::1 HTTP/1.1', b'GET / HTTP/1.1\r\nHost: localhost\r\nHost: b',
    b'POST / HTTP/1.1\r\nHost: localhost\r\nContent-Length: -5',
    b'GET / HTTP/1.1\r\nHost: localhost\r\nTransfer-Encoding: chunked\r\n\r\nzz'])
def test_what_is_no_request_is_answered_and_not_logged(dashboard, request_, caplog):
    with connect(dashboard) as client:
        client.sendall(request_ + b'\r\n\r\n')
        # aiohttp 3.9 of Ubuntu 24.04 leaves no Host to us, and takes the first of two.
        older = {b'GET / HTTP/1.1': b'421',
                 b'GET / HTTP/1.1\r\nHost: localhost\r\nHost: b': b'200'}
        assert client.recv(100)[9:12] in (b'400', older.get(request_))
    assert ask(dashboard)[0].status == 200
    assert not caplog.records


def test_connections_are_limited(dashboard, monkeypatch):
    """The files of the process are those of its ROS node too."""
    monkeypatch.setattr('mecarover_dashboard.connection_limit.MOST_CONNECTIONS', 3)
    idle = [connect(dashboard) for _ in range(9)]
    assert [_is_closed(client) for client in idle[3:]] == [True] * 6
    for client in idle:
        client.close()
    wait(lambda: _answers(dashboard))


def test_one_address_leaves_room_for_others(dashboard, monkeypatch):
    monkeypatch.setattr('mecarover_dashboard.connection_limit.MOST_OF_ADDRESS', 3)
    idle = [connect(dashboard) for _ in range(3)]
    wait(lambda: not _answers(dashboard))
    other = connect(dashboard, source_address=('127.0.0.2', 0))
    other.sendall(b'GET / HTTP/1.0\r\nHost: localhost\r\n\r\n')
    assert other.recv(12) == b'HTTP/1.0 200'
    for client in (*idle, other):
        client.close()


def test_a_head_that_does_not_come_is_not_waited_for(dashboard, monkeypatch):
    monkeypatch.setattr('mecarover_dashboard.connection_limit.HEAD_S', 0.3)
    client = connect(dashboard)
    client.sendall(b'GET / HTTP/1.1\r\nHost: loc')
    assert _is_closed(client)
    assert _answers(dashboard)


def test_a_second_head_that_does_not_come_is_not_waited_for(monkeypatch):
    monkeypatch.setattr('mecarover_dashboard.web_server.HEAD_S', 0.3)
    with Dashboard() as dashboard:
        client = connect(dashboard)
        client.sendall(b'GET /metrics HTTP/1.1\r\nHost: localhost\r\n\r\n')
        assert client.recv(12) == b'HTTP/1.1 200'
        client.sendall(b'GET / HTTP/1.1\r\nHost: loc')
        client.settimeout(10)
        while client.recv(65536):
            pass
        client.close()


@pytest.mark.parametrize(('host', 'kind'), rows_of(Path(__file__).with_name('page_hosts.tsv')))
def test_a_request_is_for_the_page_by_its_own_names_or_by_an_address(host, kind):
    names = frozenset(('localhost', 'rover.local'))
    assert is_ours(host, names, False) == (kind == 'own')
    assert is_ours(host, names, True) == (kind != 'other')


def test_what_to_do_without_a_name_of_its_own():
    with Dashboard() as dashboard:
        response, body = ask(dashboard, Host='evil.example')
        assert response.status == 421
        assert f'Use http://127.0.0.1:{dashboard.port}/, or start the dashboard with --name' \
            in body.decode()


def _is_closed(client):
    try:
        return client.recv(1) == b''
    except ConnectionResetError:
        return True


def _answers(dashboard):
    try:
        return ask(dashboard)[0].status == 200
    except OSError:
        return False


@pytest.mark.parametrize('more', [(), ('--no-browser',)])
def test_a_port_in_use_is_one_line_with_a_remedy(more):
    with Dashboard() as dashboard, Program(
            'mecarover_dashboard.ros_server', '--port', str(dashboard.port), *more) as program:
        assert program.exit_code() == 1
    assert program.lines == [f'dxl_dashboard: 127.0.0.1:{dashboard.port}: in use; stop the other '
                             'dashboard, or choose another port with --port']


def test_where_the_history_cannot_be_opened_no_address_is_announced(capsys, tmp_path):
    from mecarover_dashboard.ros_server import make_parser
    from mecarover_dashboard.ros_server import open_server
    (tmp_path / 'file').touch()
    history = str(tmp_path / 'file/history.sqlite')
    assert open_server(make_parser().parse_args(['--port', '0', '--history', history])) is None
    out, err = capsys.readouterr()
    assert out == ''
    assert err.startswith('dxl_dashboard: no history: ') and history in err


def test_opening_to_the_network_is_said():
    from mecarover_dashboard.ros_server import announcement
    assert 'this machine only' in announcement('127.0.0.1', 8420, False)
    text = announcement('0.0.0.0', 8420, True)
    assert 'OPEN TO THE NETWORK' in text
    assert socket.gethostname() in text
    assert 'no password' in text


def asked(**registers):
    return '/signals?' + urlencode([pair for name, after in registers.items() for pair in (
        ('of', 'dxl_monitor: 007 left_knee'), ('register', name.replace('_', ' ')),
        ('after', after))])


def signals(dashboard, count, path, **headers):
    """Return the clock, [how it is known, first, points] of each register."""
    response, body = ask(dashboard, path, **headers)
    assert response.status == 200, body
    assert response.headers['Cache-Control'] == 'no-store'
    numbers = struct.unpack(f'<{len(body) // 8}d', body)
    points = iter(zip(*2 * [iter(numbers[2 + 3 * count:])], strict=True))
    return numbers[:2], [(kind, int(first), list(islice(points, int(many))))
                         for kind, first, many in zip(*3 * [iter(numbers[2:2 + 3 * count])],
                                                      strict=True)]


POSITION, GOAL = 'Present Position (rad)', 'Goal Position (rad)'


def test_over_ros_a_signal_has_a_point_for_each_report(dashboard):
    """At the time when it was read."""
    robot = SyntheticRobot()
    path = asked(**{POSITION: 0, GOAL: 0, 'Nothing': 0})
    dashboard.take(robot.messages(100.5))           # before anybody asks
    wait(lambda: dashboard.server._reported._sampled)
    begun_s = time.monotonic()
    dashboard.take(robot.messages(101.0))
    wait(lambda: len(signals(dashboard, 3, path)[1][0][2]) == 2)
    (now_s, origin_s), ((kind, first, points), (goal, *_), nothing) = signals(dashboard, 3, path)
    assert (kind, goal, nothing[0], nothing[2]) == (1, 1, 0, [])    # samples, none is held
    assert begun_s - 1 < points[1][0] < now_s
    assert abs(now_s + origin_s - time.time()) < 1
    shown = SyntheticRobot().messages(101.0)
    assert f'{points[1][1]:.6g}'.encode() in shown[0][1]
    *_, ((_, later, rest), *_) = signals(dashboard, 1, asked(**{POSITION: first + 1}))
    assert (later, rest) == (first + 1, points[1:])


def sampled(*reports, is_chosen=True):
    """Return the points of a register that is reported as (arrived, seen, value, source)."""
    signals = ReportedSignals()
    if is_chosen:
        signals.signal('servo', POSITION, 0)
    for arrived_s, seen_s, value, source in reports:
        status = HandedStatus(0, 'servo', '', '', [
            ('Model', ''), ('Firmware Version', ''), ('State', ''),
            ('observed', json.dumps({'Present Position': [arrived_s - seen_s, source]})),
            (POSITION, value)])
        signals.sample_state(SimpleNamespace(whole=lambda now={'servo': (status, arrived_s)}: now))
    points = signals._sampled['servo'].rings[POSITION].after(0, 0.0)
    assert not points.is_written                # what was written in between is not known
    return [(pytest.approx(at_s), value) for at_s, value in
            struct.iter_unpack('<dd', points.data)]


def test_what_was_not_read_again_is_no_new_point():
    reports = [(10.0, 9.0, '0.5', 'r'), (11.0, 9.001, '0.5', 'r'), (12.0, 11.5, '0.5', 'r')]
    assert sampled(*reports) == [(9.0, 0.5), (11.5, 0.5)]


def test_what_no_page_shows_is_sampled_once_a_second():
    reports = [(10 + nth / 10, 10 + nth / 10 - 0.01, '0.5', 'r') for nth in range(21)]
    assert [len(sampled(*reports, is_chosen=one)) for one in (True, False)] == [21, 3]


def test_a_goal_is_sampled_and_holds_while_it_is_not_written_again():
    assert sampled((10.0, 9.99, '0.5', 'w'), (10.5, 10.49, '0.9', 'w'), (11.0, 10.5, '0.9', 'w'),
                   (11.5, 10.48, '0.9', 'w'), (12.0, 11.9, '0.1', 'w')) == [
        (9.99, 0.5), (10.49, 0.9), (11.0, 0.9), (11.5, 0.9), (11.9, 0.1)]


@pytest.mark.parametrize(('path', 'headers', 'status', 'words'), [
    ('/signals', {}, 400, 'Choose 1 to 8 registers'),
    (asked(**{f'Register {n}': 0 for n in range(9)}), {}, 400, 'Choose 1 to 8 registers'),
    (asked(A=0), {'Sec-Fetch-Site': 'cross-site'}, 403, 'Only a page of this dashboard'),
    ('/events', {'Sec-Fetch-Site': 'cross-site'}, 403, 'Only a page of this dashboard'),
    ('/events', {'Sec-Fetch-Site': 'same-site'}, 403, 'Only a page of this dashboard'),
    (asked(A=0), {'Host': 'evil.example'}, 421, 'does not know this name'),
    (asked(A='x' * 99, B='-1'), {'Sec-Fetch-Site': 'same-origin'}, 200, '')])
def test_who_may_ask_for_streams_and_signals(dashboard, path, headers, status, words):
    response, body = ask(dashboard, path, **headers)
    assert response.status == status
    if words:
        assert words in body.decode()


def test_signals_of_all_pages_are_bounded_and_end_after_the_last_page(dashboard, monkeypatch):
    for page in range(4):
        signals(dashboard, 8, asked(**{f'R {page} {n}': 0 for n in range(8)}))
    response, body = ask(dashboard, asked(One_more=0))
    assert (response.status, b'32 registers; close one' in body) == (503, True)
    monkeypatch.setattr('mecarover_dashboard.signal_requests.SPAN_S', 0.3)
    wait(lambda: ask(dashboard, asked(One_more=0))[0].status == 200)
    wait(lambda: not dashboard.server._reported._chosen)
