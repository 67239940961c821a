# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""The history of the dashboard: what is kept, for how long, and what a file survives."""
from contextlib import closing
from contextlib import suppress
from datetime import datetime
from datetime import timedelta
from datetime import timezone
import json
import os
from pathlib import Path
import re
import socket
import sqlite3
import subprocess
import sys
import tempfile
import threading
import time
from urllib.error import HTTPError
from urllib.parse import urlencode
from urllib.request import urlopen

from dashboard_page import Dashboard
import pytest
from recorded_night import record
from recorded_night import SERVOS
from recorded_night import SICK
from synthetic_robot import FINDINGS
from synthetic_robot import serialise
from synthetic_robot import SyntheticRobot

from mecarover_dashboard import history
from mecarover_dashboard.history import DamagedError
from mecarover_dashboard.history import Event
from mecarover_dashboard.history import HistoryReader
from mecarover_dashboard.history import HistoryWriter
from mecarover_dashboard.history import Question
from mecarover_dashboard.history import Subject
from mecarover_dashboard.history import VALUES
from mecarover_dashboard.history import Window
from mecarover_dashboard.history import WINDOW_S
from mecarover_dashboard.history_recorder import default_path
from mecarover_dashboard.history_recorder import HistoryError
from mecarover_dashboard.history_recorder import HistoryRecorder
from mecarover_dashboard.history_recorder import HistorySampler
from mecarover_dashboard.history_recorder import MOST_ERRORS
from mecarover_dashboard.ros_server import open_history
from mecarover_dashboard.state import State
from mecarover_dashboard.state import TABLES
from mecarover_dashboard.written_time import unix_time
from msg_defs.diagnostics import Level
from msg_defs.diagnostics import Status

NIGHT = 1_790_000_000               # Unix s, when the recorded nights begin
KNEE = Subject('dxl_monitor: 007 left_knee', 'devices', '', 'A')
HOURS = 3600


@pytest.fixture
def path(tmp_path):
    return tmp_path / 'history.sqlite'


@pytest.fixture
def writer(path):
    writer = HistoryWriter(path)
    yield writer
    writer.close()


def window(at, *values, source=KNEE, level=0):
    values = (*values, *[None] * (6 - len(values)))
    return Window(at, source, level, tuple(
        None if value is None else (value, value) for value in values))


def read(path, from_s=0, to_s=NIGHT * 2, of=()):
    reader = HistoryReader(path)
    try:
        question = Question(from_s, to_s, of)
        return list(reader.windows(question)), reader.events(question)
    finally:
        reader.close()


def looked_at(robot, seconds, recorder=None):
    recorder, state = recorder or HistorySampler(), State()
    for second in seconds:
        robot.tell(state, second)
        recorder.sample_state(state, second, NIGHT + second)
    return recorder.take_batch()


def test_what_is_kept_of_a_window():
    windows, events = looked_at(SyntheticRobot(), [100.0, 101.0, 102.0, 110.0])
    knee = [one for one in windows if one.source.name.endswith('007 left_knee')]
    assert [one.at - NIGHT for one in knee] == [100, 110]
    ranges = dict(zip(VALUES['devices'], knee[0].ranges, strict=True))
    assert ranges['temperature'][0] == 41
    assert ranges['position'][0] < ranges['position'][1]
    assert (ranges['loss'][0], knee[0].source.unit) == (0, 'A')
    bus = next(one for one in windows if one.source.kind == 'buses')
    assert 30 < bus.ranges[0][0] < 50
    assert events == []


def test_a_position_in_metres_is_recorded_as_that(path, writer):
    """Also in a file of before, which has no unit of positions."""
    status = Status('dxl_monitor: 004 gripper', Level.OK, 'connected', '4', [
        ('Model', 'Gripper'), ('Firmware Version', '1'), ('State', 'connected'),
        ('Present Position (m)', '0.0532')])
    state, sampler = State(), HistorySampler()
    state.store_message(TABLES, serialise([status]), 100.0)
    sampler.sample_state(state, 100.0, NIGHT + 100)
    windows, _ = sampler.take_batch()
    writer.write([window(NIGHT, 0.05, source=windows[0].source._replace(position_unit=''))], [])
    writer.close()
    with closing(sqlite3.connect(path)) as database:
        database.execute('ALTER TABLE sources DROP COLUMN position_unit')
    assert [one.source.position_unit for one in read(path)[0]] == ['']
    with closing(HistoryWriter(path)) as again:
        again.write(windows, [])
    assert [one.source.position_unit for one in read(path)[0]] == ['m', 'm']


def test_a_window_is_written_once_and_an_event_soon():
    """An SD card wears out by each transaction; a power failure costs the window that runs."""
    robot, state, sampler, batches = SyntheticRobot(), State(), HistorySampler(), []
    for second in (*range(26), 300):
        robot.lost = {7} if second >= 17 else set()
        if second < 300:
            robot.tell(state, 100.0 + second)
        sampler.sample_state(state, 100.0 + second, NIGHT + second)
        if sampler.is_due(100.0 + second, NIGHT + second):
            windows, events = sampler.take_batch(NIGHT + second)
            assert len(windows) in (0, 24 + 1 + 2)          # each source once
            batches.append((second, {one.at - NIGHT for one in windows}, len(events)))
    assert batches == [(0, set(), 0), (10, {0}, 0), (17, set(), 1), (20, {10}, 0), (300, {20}, 0)]
    assert sampler.take_batch() == ([], [])


class Watched:
    """A state and the sampler that looks at it."""

    def __init__(self):
        self._state, self._sampler = State(), HistorySampler()

    def events(self, second, robot=None):
        """Return the events of a second; robot: who reports in it."""
        if robot:
            robot.tell(self._state, second)
        self._state.expire(second)
        self._sampler.sample_state(self._state, second, NIGHT + second)
        return [(event.kind, event.level, event.source.name.rpartition(': ')[2], event.text)
                for event in self._sampler.take_batch()[1]]


def test_events():
    robot, watched = SyntheticRobot(), Watched()
    assert watched.events(100.0, robot) == []
    robot.lost, robot.findings = {7}, FINDINGS[:1]
    found = watched.events(101.0, robot)
    assert ('state', 2, '007 left_knee', 'disconnected: 7 answers missed') in found
    assert ('finding', 1, 'bus', f'missing termination: {FINDINGS[0].message}') in found
    assert len(found) == 2                      # nothing of the answers that it missed
    assert watched.events(101.0, robot) == []
    robot.lost, robot.findings = set(), ()
    found = watched.events(102.0, robot)
    assert ('state', 0, '007 left_knee', 'connected') in found
    assert ('over', 0, 'bus', 'missing termination') in found
    assert {(level, text) for _, level, _, text in watched.events(200.0)} == {
        (Level.STALE, 'No report from dxl_monitor: nothing is known of its 24 '
         'devices; start it again'),
        (Level.ERROR, 'No report from vel2d_bridge, and the rover was driving: it may be driving '
                      'on; look at it, switch its motors off, restart the bridge')}
    assert {one[2:] for one in watched.events(201.0, robot)} == {
        ('link', 'driving'), ('bus', 'All 24 devices connected')}


def written(*reports):
    """Return the events of reports (second, robot or None)."""
    watched = Watched()
    return [event for report in reports for event in watched.events(*report)]


def test_one_loss_is_one_event():
    """A servo is lost, a second later the doctor names the cause, then it is back."""
    well, lost, named = SyntheticRobot(), SyntheticRobot(), SyntheticRobot()
    lost.lost = named.lost = {7}
    named.findings = [FINDINGS[1]._replace(rule='no_answer', device=7, level=Level.ERROR)]
    assert written((100.0, well), (100.5, lost), (101.0, lost), (101.5, named), (102.0, named),
                   (102.5, well)) == [
        ('state', 2, '007 left_knee', 'disconnected: 7 answers missed'),
        ('state', 0, '007 left_knee', 'connected')]


def test_a_restart_of_the_monitor_is_two_events_whatever_it_finds():
    robot = SyntheticRobot()
    robot.lost, robot.bridge = {7}, lambda time_s: []
    gone = SyntheticRobot()
    gone.lost, gone.bridge, gone.port_problem = {7}, lambda time_s: [], '/dev/ttyUSB0: gone'
    assert written((100.0, robot), (106.0, None), (110.0, robot), (111.0, gone),
                   (112.0, robot)) == [
        ('state', 2, '007 left_knee', 'disconnected: 7 answers missed'),
        ('state', 3, 'bus', 'No report from dxl_monitor: nothing is known of its 24 '
         'devices; start it again'),
        ('state', 2, 'bus', '23 of 24 devices answer'),
        ('state', 2, 'bus', '/dev/ttyUSB0: gone'),
        ('state', 2, 'bus', '23 of 24 devices answer')]


def test_a_finding_is_over_only_where_the_monitor_that_had_it_says_so():
    """A new monitor has read nothing yet: what it does not report is not cleared."""
    hot, well, restarted = SyntheticRobot(), SyntheticRobot(), SyntheticRobot()
    hot.findings = [FINDINGS[1]._replace(rule='too_hot', device=7, message='82 \u00b0C')]
    old = SyntheticRobot()
    old.findings = [hot.findings[0]._replace(message='82 \u00b0C, last read at 20:46:30')]
    old.silent = {7}
    restarted.started_s = 104.0
    begun = ('finding', 1, '007 left_knee', 'too hot: 82 \u00b0C')
    assert written((100.0, hot), (101.0, well)) == [begun, ('over', 0, '007 left_knee', 'too hot')]
    assert written((100.0, hot), (101.0, old))[1:] == [
        ('state', 3, '007 left_knee', 'silent: not asked for 9 s')]
    assert written((100.0, hot), (105.0, restarted), (106.0, restarted)) == [
        begun, ('finding', 3, '007 left_knee',
                'too hot: not known since the monitor was started again')]


@pytest.mark.parametrize('problem', ['lost', 'port'])
def test_what_a_device_does_not_say_any_more_is_not_kept(problem):
    robot = SyntheticRobot()
    if problem == 'lost':
        robot.lost = {7}
    else:
        robot.port_problem = '/dev/ttyUSB0: gone'
    windows = {one.source.name.rpartition(': ')[2]: one
               for one in looked_at(robot, [100.0, 101.0])[0]}
    assert windows['007 left_knee'].ranges[:4] == (None,) * 4
    assert (windows['008 right_knee'].ranges[1] is None) is (problem == 'port')
    assert (windows['bus'].ranges[0] is None) is (problem == 'port')


def test_what_was_not_recorded_is_said(writer, path):
    begin = NIGHT // 10 * 10
    writer.write([window(begin + at, 1.0) for at in (100, 110, 120, 300, 310)], [])
    with Dashboard(history=path) as dashboard:
        gaps = [json.loads(ask(dashboard, 'events', **{
            'from': begin + begins, 'to': begin + ends}))['gaps']
                for begins, ends in ((0, 400), (105, 130), (300, 320), (1000, 2000))]
    assert [[[begins - begin, ends - begin] for begins, ends in some] for some in gaps] == [
        [[0, 100], [130, 300], [320, 400]], [], [], [[1000, 2000]]]


def test_noise_does_not_fill_the_file():
    robot, recorder, state = SyntheticRobot(), HistorySampler(), State()
    robot.tell(state, 100.0)
    row = next(state.reports('buses')).row
    row['errors'] = [(100.0 + at / 100, 'noise') for at in range(200)]
    recorder.sample_state(state, 102.0, NIGHT + 102.0)
    errors = [event for event in recorder.take_batch()[1] if event.kind == 'error']
    assert len(errors) == MOST_ERRORS
    assert errors[-1].text == 'noise; more errors in these 10 s are not listed'


def test_values_come_back_also_where_they_did_not_change(writer, path):
    at = NIGHT // 600 * 600
    sent = [window(at, 1.5, 41, 12.1), window(at + 10, 1.5, 41, 12.1),
            window(at + 20, 1.5, None, 12.1), window(at + 30, 1.5, None, 12.2),
            window(at + 40, -2.25, 43, 12.2, level=2), window(at + 600, -2.25, 43, 12.2)]
    writer.write(sent[:3], [])
    writer.write(sent[2:], [])                  # one that still ran is written again
    assert read(path, at - 5)[0] == sent
    assert read(path, at + 25)[0] == sent[2:]
    assert read(path, at + 35, of=[KNEE.name])[0] == sent[3:]
    assert read(path, at - 500, at - 100, of=[KNEE.name])[0] == []


def test_a_clock_that_is_set_back(writer, path):
    at = NIGHT // 600 * 600
    writer.write([window(at + 10, 1.0), window(at + 20, 1.0), window(at + 600, 3.0)], [])
    writer.write([window(at, 2.0), window(at + 10, 2.0)], [])
    assert [one.ranges[0][0] for one in read(path, at)[0]] == [2.0, 2.0, 3.0]


def test_a_source_that_could_not_be_written_is_new_once_more(writer, path):
    with pytest.raises(sqlite3.Error):
        writer.write([window(NIGHT, 1.0)], [Event(NIGHT, KNEE, 'state', 0, None)])
    sent = [window(NIGHT, 2.0, source=KNEE._replace(name='dxl_monitor: 008')), window(NIGHT, 3.0)]
    writer.write(sent, [])
    assert read(path)[0] == sent


def test_impossible_values_are_unknown(writer, path):
    writer.write([window(NIGHT, 1e300, -1e13, 12.0)], [])
    [one] = read(path, NIGHT)[0]
    assert one.ranges[:3] == (None, None, (12.0, 12.0))


def test_a_restart_records_no_error_twice(writer, path):
    robot = SyntheticRobot()
    robot.stumbles = {7}
    for recorder in (HistorySampler(), HistorySampler(writer.errors_until())):
        writer.write(*looked_at(robot, [100.0], recorder))
    again = HistorySampler(writer.errors_until())
    assert not [event for event in looked_at(robot, [100.0], again)[1] if event.kind == 'error']


def test_no_error_is_noted_twice_where_the_two_clocks_are_read_late():
    robot, state, recorder = SyntheticRobot(), State(), HistorySampler()
    robot.stumbles = {7}
    noted = []
    for second, late in ((100.0, 0.0), (100.1, 0.4), (100.15, -0.2), (100.2, 2.0)):
        robot.tell(state, 100.0, second)
        recorder.sample_state(state, second, NIGHT + second + late)
        noted.append([event.text for event in recorder.take_batch()[1] if event.kind == 'error'])
    assert noted[0] and noted[1:] == [[], [], []]


def test_a_day_is_kept_and_no_more(writer, path, monkeypatch):
    day = [window(NIGHT + hour * HOURS, 1.0) for hour in range(30)]
    writer.write(day, [Event(one.at, KNEE, 'state', 2, 'lost') for one in day])
    writer.limit(NIGHT + 30 * HOURS)
    windows, events = read(path, NIGHT, NIGHT + 40 * HOURS)
    assert len(windows) == len(events) == 24
    monkeypatch.setattr(history, 'MOST_BYTES', 0)
    writer.limit(NIGHT + 30 * HOURS)
    assert len(read(path, NIGHT, NIGHT + 40 * HOURS)[0]) == 21


def test_how_large_a_day_is(writer):
    """An hour of 60 servos that move, with every value different each time, counted up to 253."""
    sources = [Subject(f'dxl_monitor: {n:03}', 'devices', '', 'A') for n in range(60)]
    for at in range(NIGHT // 600 * 600, NIGHT // 600 * 600 + HOURS, WINDOW_S):
        low = (at % 6280) / 1000
        writer.write([Window(at, one, 0, (
            (low, low + 1), (40.0, 41.0), (11.8, 12.1), (low / 10, low / 10 + 0.2), (0.0, 0.0),
            (0.11, 0.12))) for one in sources], [])
    assert writer.bytes() / 60 * 253 * 24 < history.MOST_BYTES


@pytest.mark.parametrize('content', [b'no database at all', b'SQLite format 3\0' + b'\7' * 5000])
def test_a_damaged_file_is_set_aside(path, content):
    path.write_bytes(content)
    with pytest.raises(DamagedError):
        HistoryWriter(path)
    recording = HistoryRecorder(path)
    recording.close()
    assert recording.notice.startswith(f'{path}: this history cannot be read (')
    [aside] = path.parent.glob('*.damaged-*')
    assert aside.read_bytes() == content


def test_the_end_does_not_wait_for_a_disk_that_stands_still(path, monkeypatch):
    monkeypatch.setattr('mecarover_dashboard.history_recorder.END_S', 0.1)
    goes_on = threading.Event()
    monkeypatch.setattr(HistoryWriter, 'write', lambda *_: goes_on.wait())
    recording = HistoryRecorder(path)
    while not recording.problem:
        recording._hand_over()
    end = threading.Thread(target=recording.close, daemon=True)
    end.start()
    end.join(5.0)
    is_over = not end.is_alive()
    goes_on.set()
    assert is_over


def test_a_file_of_a_later_version_is_set_aside(path):
    HistoryWriter(path).close()
    database = sqlite3.connect(path)
    database.execute(f'PRAGMA user_version = {history.VERSION + 1}')
    database.close()
    with pytest.raises(DamagedError, match='version 2 of the format is not known here'):
        HistoryWriter(path)


def test_a_link_in_place_of_the_lock_is_refused_and_its_target_left_alone(path):
    precious = path.with_name('precious')
    precious.write_text('kept')
    path.with_name(f'{path.name}.lock').symlink_to(precious)
    with pytest.raises(HistoryError, match=r'\.lock: too many levels'):
        HistoryRecorder(path)
    assert precious.read_text() == 'kept'


def test_two_robots_on_one_machine(monkeypatch, tmp_path, capsys):
    monkeypatch.setenv('XDG_STATE_HOME', str(tmp_path))
    monkeypatch.delenv('STATE_DIRECTORY', raising=False)
    first, _ = open_history(None)
    second, without = open_history(None)
    assert second is None
    words = capsys.readouterr().err.splitlines()
    assert words == [f'dxl_dashboard: no history: {without}']
    assert without == (f'{default_path()}: another dashboard writes to it; give another file '
                       'with --history FILE, or --history none')
    second, without = open_history(str(tmp_path / 'rover2.sqlite'))
    assert (second.path.name, without) == ('rover2.sqlite', '')
    first.close()
    second.close()
    HistoryRecorder(first.path).close()


@pytest.fixture
def read_only_path():
    """Yield a history that other users may read, in a folder without write access."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / 'history.sqlite'
        writer = HistoryWriter(path)
        writer.write([], [Event(NIGHT, KNEE, 'state', 0, 'connected')])
        writer.close()
        os.chmod(folder, 0o555)
        yield path
        os.chmod(folder, 0o755)


def test_in_a_folder_that_one_may_only_read_it_opens(read_only_path, capfd):
    child = os.fork()
    if child == 0:                      # root may write anywhere
        with suppress(Exception):
            if os.geteuid() == 0:
                os.setuid(65534)
            recording, without = open_history(str(read_only_path))
            [event] = read(recording.path)[1]
            recording.close()
            os.write(1, f'{event.text}{without}'.encode())
        os._exit(0)
    os.waitpid(child, 0)
    out, err = capfd.readouterr()
    assert out == 'connected'
    assert err == (f'dxl_dashboard: {read_only_path}: its folder may only be read, so nothing is '
                   'recorded\n')
    assert [name.name for name in read_only_path.parent.iterdir()] == ['history.sqlite']


def test_where_it_is(monkeypatch, tmp_path):
    monkeypatch.setenv('XDG_STATE_HOME', str(tmp_path))
    monkeypatch.delenv('STATE_DIRECTORY', raising=False)
    assert default_path() == tmp_path / 'mecarover_serial/history.sqlite'
    monkeypatch.setenv('STATE_DIRECTORY', '/var/lib/mecarover_dashboard')
    assert default_path() == Path('/var/lib/mecarover_dashboard/history.sqlite')


@pytest.mark.slow
def test_kill_9(path):
    """Twenty times in a row, in the middle of the work: it opens, and at most 10 s are missing."""
    begin, program = NIGHT, Path(__file__).with_name('recorded_night.py')
    for round_ in range(20):
        with subprocess.Popen([sys.executable, program, path, str(begin)],
                              stdout=subprocess.PIPE, text=True) as process:
            reached = [int(process.stdout.readline()) for _ in range(17 + 3 * round_)][-1]
            process.kill()
        windows, _ = read(path, begin, begin + 100_000)
        assert max(one.at for one in windows) + WINDOW_S > reached - 10
        assert {len([one for one in windows if one.at == at]) for at in {
            one.at for one in windows}} == {SERVOS + 1}
        begin = reached + 1000


def ask(dashboard, what, **query):
    with urlopen(f'{dashboard.address}history/{what}?{urlencode(query, doseq=True)}',
                 timeout=20) as answer:
        return answer.read().decode()


@pytest.mark.slow
def test_a_robot_that_failed_at_night(path):
    """Eight hours in simulated time: when, which device, how warm and at what voltage before."""
    writer = HistoryWriter(path)
    lost_at = 5 * HOURS + 1234
    record(writer, NIGHT, 8 * HOURS, lost_at)
    assert writer.bytes() < 2_000_000
    writer.close()
    night = {'from': NIGHT, 'to': NIGHT + 8 * HOURS}
    with Dashboard(history=path) as dashboard:
        [event] = [one for one in json.loads(ask(dashboard, 'events', **night))['events']
                   if one[3] == 'state']
        assert event == [NIGHT + lost_at, SICK, '', 'state', 2, 'disconnected: 7 answers missed']
        before = json.loads(ask(dashboard, 'values', of=SICK, **{
            'from': NIGHT + lost_at - 600, 'to': NIGHT + lost_at - 10}))['sources'][SICK]
        assert before['values']['temperature'][-1][2] == 80
        assert before['values']['voltage'][-1][1:] == [11.3, 11.4]
        assert {level for _, level in before['levels']} == {0}
        whole = json.loads(ask(dashboard, 'values', of=SICK, **night))['sources'][SICK]
        at, _, _ = whole['values']['temperature'][-1]        # none of a servo that is lost
        assert NIGHT + lost_at - 60 < at < NIGHT + lost_at
        assert next(at for at, level in whole['levels'] if level == 2) \
            == pytest.approx(NIGHT + lost_at, abs=60)
        lines = ask(dashboard, 'values', of=SICK, format='csv', **night).splitlines()
        assert len(lines) == 1 + 8 * HOURS / WINDOW_S
        assert re.fullmatch(r'[\d-]{10}T[\d:]{8}\+00:00,,[^,]+,OK,.?(,(-?\d+\.\d{3})?){18},\w*',
                            lines[1])
        assert lines[0].startswith('time,robot,name,level,load unit,position min,position max')
        assert SICK in ask(dashboard, 'events', format='csv', **night)


def test_many_sources_share_the_points_of_an_answer(path, monkeypatch):
    monkeypatch.setattr('mecarover_dashboard.history_requests._MOST_POINTS', 100)
    writer = HistoryWriter(path)
    sources = [KNEE._replace(name=f'dxl_monitor: {n:03}') for n in range(10)]
    for at in range(NIGHT, NIGHT + HOURS, WINDOW_S):
        writer.write([window(at, 1.0 + n, source=one) for n, one in enumerate(sources)], [])
    writer.close()
    hour = {'from': NIGHT, 'to': NIGHT + HOURS}
    with Dashboard(history=path) as dashboard:
        of_all = json.loads(ask(dashboard, 'values', **hour))['sources']
        of_one = json.loads(ask(dashboard, 'values', of=sources[3].name, **hour))['sources']
    assert {len(one['values']['position']) for one in of_all.values()} <= {10, 11}
    assert len(of_all) == 10
    [one] = of_one.values()
    assert 90 <= len(one['values']['position']) <= 101
    assert one['values']['position'][0][1:] == [4.0, 4.0]


@pytest.mark.parametrize(('query', 'words'), [
    ({'from': 'noon'}, "from: 'noon' is not a time; write -10 min, 14:05, yesterday 9:00, "
                       '2026-11-28T14:05 or Unix seconds\n'),
    ({'to': '-1'}, "to: '-1' is not a time"), ({'to': 'nan'}, "to: 'nan' is not a time"),
    ({'to': ''}, "to: '' is not a time"),
    ({'zone': 'CET'}, "zone: 'CET' is not an offset; write +01:00"),
    ({'from': 5, 'to': 4}, 'from: is later than to; swap them'),
    ({'format': 'xml'}, 'format: not known; give json or csv'),
    ({'points': '0'}, 'points: not a number from 1 to 10000; correct it')])
def test_questions_that_make_no_sense(path, query, words):
    with Dashboard(history=path) as dashboard, pytest.raises(HTTPError) as caught:
        ask(dashboard, 'values', **query)
    assert (caught.value.code, caught.value.read().decode()[:len(words)]) == (400, words)


BERLIN = timezone(timedelta(hours=1))
NOW = datetime(2026, 11, 28, 14, 30, 0, 500_000, BERLIN)


@pytest.mark.parametrize(('texts', 'meant'), [
    (('-10 min', '-10m', '\u221210 minutes', ' - 10min ', '-600 s', '-600 seconds'),
     NOW - timedelta(minutes=10)),
    (('-1.5 h', '-1.5 hours', '-90 min'), NOW - timedelta(hours=1.5)),
    (('-1 d', '-1 day', '-24h'), NOW - timedelta(days=1)),
    (('now', 'NOW'), NOW),
    (('14:05', '14:05:00', 'today 14:05', '2026-11-28T14:05', '2026-11-28 14:05:00',
      '2026-11-28T13:05:00Z', '2026-11-28T15:05:00+02:00', '2026-11-28T15:05:00 02:00',
      '1795871100'), datetime(2026, 11, 28, 14, 5, tzinfo=BERLIN)),
    (('15:00', 'yesterday 15:00'), datetime(2026, 11, 27, 15, tzinfo=BERLIN)),
    (('yesterday 9:00', 'Yesterday  9:00:00'), datetime(2026, 11, 27, 9, tzinfo=BERLIN)),
    (('yesterday', '2026-11-27'), datetime(2026, 11, 27, tzinfo=BERLIN)),
    (('', ' ', 'noon', '25:00', '9:5', '14:05 pm', '-10', '-1', '-10 months', '10 min',
      '0001-01-01', '-99999999999999 d', '1e400', 'nan', '-5 min ago'), None)])
def test_times_as_people_write_them(texts, meant):
    for text in texts:
        assert unix_time(text, NOW.timestamp(), BERLIN) == (meant and meant.timestamp()), text


def test_a_time_without_a_zone_is_of_this_machine(monkeypatch):
    monkeypatch.setenv('TZ', 'Europe/Berlin')
    time.tzset()
    try:
        noon = unix_time('2026-07-01 12:00', NOW.timestamp(), None)    # summer, asked in winter
        assert noon == datetime(2026, 7, 1, 10, tzinfo=timezone.utc).timestamp()
    finally:
        monkeypatch.undo()
        time.tzset()


@pytest.mark.parametrize(('zone', 'hour'), [
    ('+01:00 Europe/Berlin', 10), ('+01:00 Nowhere/Berlin', 11), ('+01:00 ../localtime', 11)])
def test_a_time_before_a_change_of_summer_time_is_that_of_its_day(path, writer, zone, hour):
    """What is written has the offset of its own day, not that of today."""
    with Dashboard(history=path) as dashboard:
        answer = json.loads(ask(dashboard, 'events', zone=zone, **{
            'from': '2026-07-01T12:00', 'to': '2026-07-01T12:30'}))
        assert answer['from'] == datetime(2026, 7, 1, hour, tzinfo=timezone.utc).timestamp()


def test_a_question_has_the_time_zone_of_who_asks(path, writer):
    at = int(time.time()) // 60 * 60
    asked = datetime.fromtimestamp(at, timezone(timedelta(hours=-9, minutes=-30)))
    with Dashboard(history=path) as dashboard:
        answer = json.loads(ask(dashboard, 'events', zone='-09:30', to='now', **{
            'from': asked.isoformat()[:16]}))
    assert answer['from'] == at <= answer['to'] <= time.time()


def last_hour():
    """Return the beginning of an hour that is kept: older windows go while a page is served."""
    return int(time.time()) // 600 * 600 - HOURS


@pytest.mark.parametrize('damage', [
    "UPDATE windows SET level = 'much'", "UPDATE windows SET low0 = 'cold'",
    'UPDATE windows SET level = 99', "UPDATE sources SET kind = 'unknown'",
    "UPDATE windows SET at = 'noon' WHERE at = (SELECT max(at) FROM windows)"])
def test_values_of_a_wrong_type_are_one_line(path, writer, damage, caplog):
    begin = last_hour()
    writer.write([window(begin + at, 1.0) for at in (0, 10)], [])
    writer._database.execute(damage)
    with Dashboard(history=path) as dashboard:
        for form in ('json', 'csv'):
            with pytest.raises(HTTPError) as caught:
                ask(dashboard, 'values', format=form, **{'from': begin, 'to': begin + HOURS})
            said = caught.value.read().decode()
            assert (caught.value.code, said.count('\n')) == (503, 1)
            assert said.startswith('history.sqlite: a value is not of its type')
    assert caplog.records == []


def test_an_error_whose_time_is_a_word_does_not_count(path, writer):
    name = 'dxl_monitor: bus'
    writer.write([], [Event(NIGHT, KNEE._replace(name=name, kind='buses'), 'error', 1, '')])
    writer._database.execute("UPDATE events SET at = 'noon'")
    assert writer.errors_until() == {}


def test_a_download_that_is_broken_off_says_nothing(path, writer, caplog):
    begin = last_hour()
    sources = [KNEE._replace(name=f'dxl_monitor: {n:03}') for n in range(50)]
    writer.write([window(at, 1.0, 2.0, source=one) for one in sources
                  for at in range(begin, begin + HOURS, WINDOW_S)], [])
    with Dashboard(history=path) as dashboard:
        for _ in range(5):
            with socket.create_connection(('127.0.0.1', dashboard.port), timeout=20) as client:
                client.sendall(f'GET /history/values?format=csv&from={begin}&to={begin + HOURS} '
                               'HTTP/1.1\r\nHost: localhost\r\n\r\n'.encode())
                assert client.recv(12) == b'HTTP/1.1 200'
        for _ in range(2):                     # the others end meanwhile
            whole = ask(dashboard, 'values', format='csv', **{'from': begin, 'to': begin + HOURS})
            assert whole.count('\n') == 1 + 50 * HOURS / WINDOW_S
    assert caplog.records == []


def test_the_head_of_a_download_has_no_body_behind_it(path, writer):
    writer.write([window(last_hour(), 1.0)], [])
    with Dashboard(history=path) as dashboard, \
            socket.create_connection(('127.0.0.1', dashboard.port), timeout=20) as client:
        for target in ('/history/values?format=csv', '/history/events?format=csv', '/'):
            client.sendall(f'HEAD {target} HTTP/1.1\r\nHost: localhost\r\n\r\n'.encode())
            answer = b''
            while b'\r\n\r\n' not in answer:
                answer += client.recv(65536)
            head, _, body = answer.partition(b'\r\n\r\n')
            assert (head[:12], body) == (b'HTTP/1.1 200', b''), target


def test_without_a_history():
    with Dashboard() as dashboard, pytest.raises(HTTPError) as caught:
        ask(dashboard, 'events')
    assert caught.value.code == 404


def test_it_is_recorded_while_it_is_served(path):
    with Dashboard(history=path) as dashboard:
        dashboard.take(SyntheticRobot().messages(100.0))
        assert json.loads(ask(dashboard, 'values'))['sources'] == {}
        dashboard.server._loop.call_soon_threadsafe(dashboard.server._push)
    assert len({one.source.name for one in _all(path)}) == 24 + 1 + 2
    assert os.stat(path).st_size < 1_000_000


def _all(path):
    reader = HistoryReader(path)
    found = list(reader.windows(Question(1_700_000_000, 4_000_000_000)))
    reader.close()
    return found
