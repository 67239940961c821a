# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""The dashboard in a real browser: every view, in four sizes, and what may go wrong around it."""
from contextlib import closing
from contextlib import contextmanager
from datetime import datetime
from datetime import timezone
from itertools import pairwise
from itertools import product
import math
import re
import time
from types import SimpleNamespace
from urllib.parse import parse_qs
from urllib.parse import urlencode

import dashboard_page
from dashboard_page import Dashboard
from dashboard_page import Feed
from dashboard_page import SIZES
from dashboard_page import VIEWS
from harness import wait
import pytest
from recorded_night import record
from recorded_night import second_of
from recorded_night import SICK
from synthetic_robot import FINDINGS
from synthetic_robot import MANY
from synthetic_robot import serialise
from synthetic_robot import SyntheticRobot

from mecarover_dashboard.history import Event
from mecarover_dashboard.history import HistoryWriter
from mecarover_dashboard.history import Subject
from mecarover_dashboard.history import Window
from msg_defs.diagnostics import Level
from msg_defs.diagnostics import Metric
from msg_defs.diagnostics import metric_status
from msg_defs.diagnostics import Status
from msg_defs.signal import PointRing
from servobus.bus.report import Finding
from servobus.doctor.rules import BY_NAME

WHY_NOT = dashboard_page.why_not()
pytestmark = [pytest.mark.realtime(bears=0.5),
              pytest.mark.skipif(bool(WHY_NOT), reason=WHY_NOT or 'runs')]
DEADLINE_MS = 20_000           # generous, the machine may be busy
BAR = '.buses .buses .bar'            # for a bus; the bridge has its own


@pytest.fixture(scope='module')
def chromium():
    with dashboard_page.browser() as started:
        yield started


@pytest.fixture(scope='module')
def dashboard():
    with Dashboard() as dashboard:
        yield dashboard


@pytest.fixture
def robot(dashboard):
    robot = SyntheticRobot()
    with Feed(dashboard, robot):
        yield robot


@pytest.fixture
def open_page(chromium):
    """Return a function that opens a page; a console error or exception fails the test."""
    complaints, contexts = [], []

    def open_page(address, size='desktop', **options):
        width, height = SIZES[size]
        context = chromium.new_context(viewport={'width': width, 'height': height},
                                       has_touch=size != 'desktop', is_mobile=size != 'desktop',
                                       **options)
        contexts.append(context)
        page = context.new_page()
        page.set_default_timeout(DEADLINE_MS)
        page.complaints = complaints
        page.on('console', lambda message: message.type in ('error', 'warning')
                and complaints.append(message.text))
        page.on('pageerror', lambda error: complaints.append(str(error)))
        page.on('dialog', lambda dialog: complaints.append(f'dialog {dialog.message}'))
        page.goto(address)
        return page
    yield open_page
    for context in contexts:
        context.close()
    assert complaints == []


@pytest.fixture
def page(dashboard, robot, open_page):
    page = open_page(dashboard.address)
    page.wait_for_selector('.tile')
    return page


def see(page, selector, text):
    """Wait until an element holds a text (a pattern)."""
    page.locator(selector).filter(has_text=re.compile(text)).first.wait_for()


def state_of(page, selector):
    return page.locator(selector).first.get_attribute('data-state')


def show(page, view):
    page.goto(page.url.partition('#')[0] + VIEWS[view])


@pytest.mark.smoke
def test_overview(page):
    see(page, BAR, 'All 24 devices connected.*24 of 24 devices answer')
    assert state_of(page, BAR) == 'ok'
    tiles = page.locator('.tile').all_inner_texts()
    assert [tile.split('\n')[0] for tile in tiles] \
        == ['MX-106', 'MX-64', 'BitFoot', 'Bit-Bots IMU', 'Rhoban DXL Board']
    assert page.locator('.cell').count() == page.locator('.servo').count() == 24
    see(page, '.servo', r'007\s*left_knee\s*Position\s*-?\d\.\d\d rad\s*Current\s*-?[\d.]+ A\s*'
        r'Temperature\s*\d+ \u00b0C\s*Voltage\s*[\d.]+ V')
    see(page, '.servo', r'101\s*left_foot\s*BitFoot \u00b7 0\.1\d? ms$')       # no empty bars


def test_a_tile_counts_what_is_connected_and_each_problem(page, robot):
    robot.faulty = {7}
    see(page, '.tile[data-state=error]', r'^MX-106\s*10\s*of 10 connected\s*1 error$')
    robot.lost, robot.warned = {8}, {9}
    see(page, '.tile[data-state=error]',
        r'^MX-106\s*9\s*of 10 connected\s*1 lost \u00b7 1 error \u00b7 1 warning$')
    headline = '2 problems: 008 silent; 007 hardware error'
    see(page, BAR, headline)
    assert page.title().startswith(f'\u2716 {headline} \u00b7 ')
    whole = page.locator('main').inner_text()
    for sentence in page.locator('.servo-text:visible, .alert p:visible').all_inner_texts():
        assert whole.count(sentence) == 1


def test_what_follows_from_a_silent_servo_is_one_line(page, robot):
    robot.waiting = {8, 9, 10}
    robot.lost = {7}
    see(page, '.alert:visible', '008, 009, 010.*asked but not served')
    [lost] = page.locator('.servo[data-state=error]').all_inner_texts()
    assert lost.split() == ['007', 'left_knee', 'disconnected:', '7', 'answers', 'missed']
    assert page.locator('.servo').count() == 24 - 3
    assert page.locator('.alert:visible').count() == 1


def test_what_is_after_a_broken_cable_is_one_line(page, robot):
    robot.lost = {7, 8, 9}
    robot.findings = (Finding('broken_cable', Level.ERROR, 7, 'the cable is unplugged'),)
    see(page, '.alert:visible', '008, 009.*silent too, after the broken cable: see 007')
    see(page, BAR, '^007 broken cable')
    assert page.locator('.servo[data-state=error]').count() == 1


def test_without_reports_no_card_says_what_was(open_page):
    robot = SyntheticRobot()
    robot.lost, robot.faulty = {7}, {8}
    with Dashboard() as dashboard:
        with Feed(dashboard, robot):
            page = open_page(dashboard.address)
            see(page, '.servo', '7 answers missed')
        see(page, '.alert', 'all 24 no report')
        assert not re.search('missed|overheating', page.locator('.buses .buses').inner_text())
        page.context.close()


def test_a_closed_port_is_no_silence_of_devices(page, robot):
    robot.port_problem = '/dev/ttyUSB0: there is no such device; plug it in'
    show(page, 'device')
    see(page, '.device-head .message', 'not listening: the port of its bus is closed')
    assert state_of(page, '.badge') == 'stale'


def test_errors_of_two_buses_are_merged_by_time(open_page):
    robot = SyntheticRobot({'left': MANY[:3], 'right': MANY[3:6]})
    robot.lost = {1, 4}
    with Dashboard() as dashboard:
        dashboard.take(robot.messages(100.0))
        page = open_page(dashboard.address)
        see(page, '.errors li', 'left: no answer')
        lines = page.locator('.errors li').all_inner_texts()
        assert sum('left:' in line for line in lines) == 3
        times = [line.split()[0][:8] for line in lines]
        assert times == sorted(times, reverse=True)
        page.context.close()


def test_what_a_status_says_of_a_device_that_is_well_is_shown(open_page):
    status = Status('dxl_monitor: 004', Level.OK, "connected; add '4:MODEL' to `devices`", '4', [
        ('Model', 'unknown'), ('Firmware Version', 'unknown'), ('State', 'connected'),
        ('Answers', '14331')])
    bus = Status('dxl_monitor: bus', Level.OK, '1 device', '', [('Port', '/dev/ttyUSB0')])
    robot = SimpleNamespace(
        messages=lambda time_s: [('dxl/diagnostics', serialise([status, bus]))])
    with Dashboard() as dashboard, Feed(dashboard, robot):
        page = open_page(dashboard.address)
        see(page, BAR, "004: connected; add '4:MODEL' to devices")
        assert page.locator(f'{BAR} code').all_inner_texts() == ['devices']
        assert state_of(page, BAR) == 'ok'
        show(page, 'devices')
        see(page, '.devices td.state', "add '4:MODEL' to devices$")
        page.goto(f'{dashboard.address}#/device/dxl_monitor: 004')
        see(page, '.device-head .message', "add '4:MODEL'")
        see(page, '.device-fields .message', 'No field observed yet.')
        page.context.close()


def test_a_card_has_the_colour_of_what_its_bus_has(page, robot):
    """Devices that the headline names because they restarted answer again: they are not well."""
    robot.findings = [Finding('brown_out', Level.ERROR, None, '001, 002 restarted together: x',
                              covers=(1, 2))]
    for number in ('001', '002'):
        see(page, '.servo[data-state=error]', f'{number}.*brown out')
    assert page.locator('.servo[data-state=error]').count() == 2
    assert page.locator('.cell[data-state=error]').count() == 2
    see(page, '.bus-line', ' 0 errors/s')
    robot.findings, robot.faulty = [], {7}
    see(page, '.bus-line', 'packets/s(Pause)?$')    # no errors now, beside a red bar
    wait(lambda: page.locator('.servo[data-state=error]').count() == 1)


def test_severity_and_age_of_findings(open_page):
    robot = SyntheticRobot()
    robot.findings = [FINDINGS[1]._replace(level=Level.ERROR, device=None), FINDINGS[0]]
    with Dashboard() as dashboard:
        with Feed(dashboard, robot):
            page = open_page(dashboard.address)
            see(page, '.findings li[data-state=error]', 'return delay')
            see(page, '.findings li[data-state=warn]', 'missing termination')
            assert page.locator('.findings li').first.get_attribute('data-state') == 'error'
            assert page.locator('.findings li[data-old=true]').count() == 0
        see(page, '.findings li[data-old=true]', 'at \\d+:\\d+:\\d+, no report since')
        page.context.close()


def test_no_data_is_no_data(open_page):
    robot = SyntheticRobot()
    robot.bridge_timing = lambda time_s: [
        metric_status('vel2d_bridge', one) for one in (
            Metric('callback_to_write', 'ms'), Metric('frame_rate', 'Hz', value=20.0))]
    with Dashboard() as dashboard, Feed(dashboard, robot):
        page = open_page(dashboard.address)
        show(page, 'bridge')
        see(page, '.legend', 'frame rate.*20 Hz')
        page.locator('.figures button', has_text='callback to write').click()
        see(page, '.legend', 'no data')
        assert 'null' not in page.locator('main').inner_text()
        page.context.close()


def test_what_was_refused_is_said(open_page):
    with Dashboard() as dashboard:
        filler = ('x' * 100, 'y' * 5_000_000)
        dashboard.take([('/diagnostics', serialise([Status('dxl_monitor: 004', Level.OK, '', '4', [
            ('Model', ''), ('State', ''), filler])]))] * 2)
        page = open_page(dashboard.address)
        see(page, '#refused', '^2 statuses left out')
        page.context.close()


def test_two_robots_have_a_card_each(open_page):
    robots = [SyntheticRobot(namespace=name) for name in ('rover1', 'rover2')]
    robots[1].lost = {7}
    with Dashboard() as dashboard, Feed(dashboard, robots[0]), Feed(dashboard, robots[1]):
        page = open_page(dashboard.address)
        see(page, '.robot[data-state=error]', 'rover2.*24 devices.*Lost: 007 left_knee')
        see(page, '.robot[data-state=ok]', 'rover1.*All 24 devices connected')
        see(page, '#headline', '^rover2: 007 silent')
        page.locator('.robot', has_text='rover1').click()
        page.locator('#headline').wait_for(state='hidden')
        see(page, BAR, 'All 24 devices connected')
        see(page, '#robot', 'rover1')
        assert page.locator(BAR).count() == 1
        page.keyboard.press('2')
        page.locator('.devices tbody tr').first.wait_for()
        assert page.locator('.devices tbody tr').count() == 24
        page.locator('.devices a', has_text='007').click()
        see(page, '.badge', '^connected$')
        page.locator('.brand').click()
        page.locator('.robot', has_text='rover2').click()
        see(page, BAR, '^007 silent')
        page.context.close()


def test_a_robot_without_a_namespace_has_a_name_among_others(open_page):
    robots = [SyntheticRobot(namespace=name) for name in ('', 'rover1')]
    robots[0].lost = robots[1].lost = {7}
    with Dashboard() as dashboard, Feed(dashboard, robots[0]), Feed(dashboard, robots[1]):
        page = open_page(dashboard.address)
        see(page, '#headline', '^2 problems: no namespace: 007 silent; rover1: 007 silent$')
        assert '2 problems: no namespace: 007 silent; rover1' in page.title()
        page.context.close()


def test_from_the_overview_to_a_register_and_back(page):
    page.locator('.tile', has_text='MX-64').click()
    see(page, 'h1', '^MX-64$')
    assert page.locator('.devices tbody tr').count() == 10
    assert page.evaluate('document.activeElement.tagName') == 'H1'
    page.locator('.devices a', has_text='017').click()
    see(page, 'h1', '017 left_elbow')
    see(page, '.fields tr', 'Present Position')
    page.go_back()
    see(page, 'h1', '^MX-64$')
    page.go_back()
    page.wait_for_selector('.tile')


def row(page, name):
    return page.locator('.device-fields tbody tr').filter(
        has=page.locator('th', has_text=re.compile(f'^{name}$')))


def test_device(page):
    show(page, 'device')
    see(page, 'h1', '007 left_knee')
    position = row(page, 'Present Position')
    position.wait_for()
    value, unit, age, source = position.locator('td').all_inner_texts()
    assert abs(float(value)) < 3.2
    assert (unit, age, source) == ('rad', 'now', 'read')
    assert row(page, 'Goal Position').locator('td').last.inner_text() == 'written'
    position.locator('[data-changed]').wait_for()
    assert row(page, 'ID').locator('[data-changed]').count() == 0
    see(page, '.legend', 'Present Position.*rad[\\s\\S]*Goal Position')
    page.get_by_label('Search fields').fill('temperature limit')
    wait(lambda: page.locator('.device-fields tbody').first.locator('tr').count() == 1)
    page.get_by_label('Search fields').fill('')
    page.get_by_role('button', name='Changing only').click()
    wait(lambda: 0 < page.locator('.device-fields tbody').first.locator('tr').count() < 10)


def test_plot_of_any_number(page):
    show(page, 'device')
    field = row(page, 'Present Temperature').locator('button')
    field.click()
    assert field.get_attribute('aria-pressed') == 'true'
    see(page, '.legend', 'Present Temperature.*\u00b0C')
    assert 'Present Temperature 4' in page.locator('canvas').get_attribute('aria-label')
    page.get_by_role('button', name='Reply latency', exact=True).click()
    see(page, '.legend', 'latency p50.*ms[\\s\\S]*latency p95[\\s\\S]*latency max')
    page.locator('canvas').focus()
    page.keyboard.press('ArrowLeft')
    see(page, '.legend', 'at \u2212')
    drawn = page.evaluate("""() => {
        const canvas = document.querySelector('canvas');
        const pixels = canvas.getContext('2d').getImageData(0, 0, canvas.width, canvas.height);
        return pixels.data.some((value) => value > 0);
    }""")
    assert drawn


def test_the_cursor_reads_the_line(page):
    """Between two points it is on the line; near a point it is that one; beyond a gap nothing."""
    points = '[[0, 10], [2, 20, 30], [4, 10], [9, 50]]'
    read = page.evaluate(f"""async () => {{
        const {{readAt}} = await import('./draw.js');
        return [1, 2.1, 3, 6, 9.5, -1].map((s) => readAt({points}, s, 0.2));
    }}""")
    assert read == [
        {'low': 15, 'high': 15, 'at': 1, 'isBetween': True}, {'low': 20, 'high': 30, 'at': 2},
        {'low': 20, 'high': 20, 'at': 3, 'isBetween': True}, None,
        {'low': 50, 'high': 50, 'at': 9}, None]


class Source:
    """Registers of the knee: position, read but for a second; goal, written twice."""

    def __init__(self):
        self.now_s = 1000.0
        self.rings = {f'{one} Position (rad)': PointRing() for one in ('Present', 'Goal')}
        self.sent, goal = list(self.rings.values())
        self.points = [(940 + at / 50, math.sin(at / 50)) for at in range(3000)
                       if not 2000 <= at < 2050]
        for at_s, value in self.points:
            self.sent.add(at_s, value)
        for at_s in (950.0, 990.0):
            goal.add(at_s, at_s / 1000)
            goal.is_written = True

    def clock(self):
        return self.now_s, 1.7e9

    def signal(self, name, key, after):
        if name.endswith('left_knee') and key in self.rings:
            return self.rings[key].after(after, self.now_s - 60)
        return None

    def drop(self, name, key):
        pass


def test_signals_at_the_rate_of_the_bus(open_page):
    """Chosen, read with the cursor, saved as they are shown; the choice is in the address."""
    source = Source()
    with Dashboard(signals=source) as dashboard, Feed(dashboard):
        page = open_page(f'{dashboard.address}#/signals')
        for name in ('Present', 'Goal'):        # chosen for somebody who chose nothing
            page.get_by_role('button', name=f'Remove 001 left_hip_yaw {name} Position').click()
        page.get_by_label('Device', exact=True).select_option('dxl_monitor: 007 left_knee')
        page.get_by_label('Register', exact=True).select_option('Present Position (rad)')
        page.get_by_role('button', name='60 s').click()
        page.get_by_label('Register', exact=True).locator('option').first.wait_for(
            state='attached')
        for _ in source.rings:
            page.get_by_role('button', name='Add', exact=True).click()
        see(page, '.legend', 'Present Position[^/]* rad\\s*49 /s, -1 to 1')
        see(page, '.legend', 'Goal Position.*0.99 rad')
        assert page.locator('.signals canvas').count() == 1         # over each other
        page.locator('.signals canvas').hover(position={'x': 700, 'y': 50})
        see(page, '.legend', 'Present Position.*rad at \u2212.*Goal Position.*0.95 rad')
        with page.expect_download() as download:
            page.get_by_role('button', name='CSV').click()
        assert re.fullmatch(r'robot_007_left_knee_Present_Position_\d{4}-\d\d-\d\dT\d{6}Z\.csv',
                            download.value.suggested_filename)
        see(page, '.legend', r'Present Position.*mean [^/]*, RMS 0\.7\d+, \u03c3 [^/]* of \d+')
        plot = page.locator('.signals canvas')
        plot.click(position={'x': 760, 'y': 50}, modifiers=['Shift'])
        plot.hover(position={'x': 700, 'y': 50})
        see(page, '.legend', 'Present Position.*:\\d\\d\\.\\d{3}\\), \u0394 .* rad in -[\\d.]+ s')
        page.mouse.wheel(0, -100)
        see(page, '.signals [aria-pressed=true]', 'Paused')
        page.keyboard.press('Escape')
        plot.dblclick()
        plot.drag_to(plot, source_position={'x': 700, 'y': 50},
                     target_position={'x': 800, 'y': 50})
        see(page, '.signals [aria-pressed=true]', 'Paused')
        plot.dblclick()
        see(page, '.signals [aria-pressed=true]', '60 s')
        head, *lines = download.value.path().read_text().splitlines()
        assert head == ('time,007 left_knee Present Position (rad),'
                        '007 left_knee Goal Position (rad)')
        cells = [line.split(',') for line in lines]
        assert all(re.fullmatch(r'2023-11-14T22:\d\d:\d\d\.\d{6}\+00:00', at) for at, *_ in cells)
        assert [(datetime.fromisoformat(at).timestamp() - 1.7e9, float(value))
                for at, value, _ in cells if value] == [
            (pytest.approx(at_s, abs=1e-5), value) for at_s, value in source.points]
        assert [goal for *_, goal in cells if goal] == ['0.95', '0.99']
        page.get_by_role('button', name='Pause').click()
        source.now_s = 1000.5
        source.sent.add(1000.5, 7.0)
        page.get_by_role('button', name='Paused').click()
        see(page, '.legend', 'Present Position.*7 rad')             # it came in the meantime
        page.reload()
        see(page, '.legend', 'Present Position.*7 rad')
        page.get_by_role('button', name='Remove', exact=True).click()
        wait(lambda: 'Present' not in page.url)
        page.goto(dashboard.address + VIEWS['device'])
        page.get_by_role('link', name='Signals').last.click()
        see(page, '.legend', 'Present Position')
        page.context.close()


KNEE = 'dxl_monitor: 007 left_knee'
PAIR = urlencode([pair for name in ('Present', 'Goal') for pair in (
    ('of', KNEE), ('register', f'{name} Position (rad)'))])


def test_a_link_shows_the_same_difference_time_and_cursors(open_page):
    with Dashboard(signals=Source()) as dashboard, Feed(dashboard):
        address = f'{dashboard.address}#/signals?{PAIR}&minus=0.1&span=60'
        page = open_page(f'{address}&from=1700000960&to=1700000970&mark=1700000962'
                         '&cursor=1700000965')
        for _ in range(2):
            see(page, '.legend', r'Present Position.* \u0394 .* in 3 s.* of 501')
            see(page, '.legend', r'007 left_knee Present Position \u2212 Goal Position'
                                 rf'{math.sin(25) - 0.95:.4}.*\u0394 .* in 3 s.* of 501')
            see(page, '.signals [aria-pressed=true]', 'Paused')
            page.reload()                       # the past is asked for again, and the time is kept
        page.locator('.signals canvas').first.hover(position={'x': 700, 'y': 50})
        page.mouse.wheel(0, -100)
        wait(lambda: 'from=1700000960.000' not in page.evaluate('location.href'))
        page.get_by_label('Difference', exact=True).select_option(index=1)     # again: removed
        see(page, '.signals [aria-label=Difference]', r'\u2026007 left_knee Present')
        assert page.locator('.signals canvas').count() == 1
        assert 'minus' not in page.evaluate('location.href')
        page.get_by_role('button', name='60 s').click()
        assert 'from=' not in page.evaluate('location.href')
        page.goto('about:blank')
        page.goto(f'{address}&from=1700000980.2&to=1700000980.8')       # nothing was read
        see(page, '.legend', 'Present Positionno data\u00d7.*Goal Position0.95 rad\u00d7')
        page.goto('about:blank')
        page.goto(f'{address}&from=1700000979&to=1700000990.5')         # part of it without values
        see(page, '.legend', r'Present Position[^/]*46 /s.* of 52.*Goal.*0.087 /s, 0.95 to 0.99')
        page.goto('about:blank')
        page.goto(f'{address}&from=1600000000&to=1600000001')
        see(page, '.signals [role=status]', 'The time of this link is over')
        see(page, '.signals [aria-pressed=true]', '60 s')
        page.context.close()


def test_an_arrow_key_moves_the_cursor_by_one_value(open_page):
    """Also where a column of the plot has several: what is read is the value of that time."""
    with Dashboard(signals=Source()) as dashboard, Feed(dashboard):
        page = open_page(f'{dashboard.address}#/signals?{PAIR}&from=1700000940&to=1700001000'
                         '&cursor=1700000965')
        see(page, '.legend', r'Present Position.* at \u2212.*RMS')
        page.locator('.signals canvas').focus()
        for key, at_s in (('ArrowRight', 965.02), ('ArrowRight', 965.04), ('ArrowLeft', 965.02)):
            page.keyboard.press(key)
            wait(lambda at_s=at_s: float(asked(page)['cursor']) == 1.7e9 + at_s)
            see(page, '.legend', f'Position{math.sin(at_s - 940):.4g} rad at .*0.95 rad at')
        page.keyboard.press('PageDown')
        wait(lambda: float(asked(page)['cursor']) == pytest.approx(1.7e9 + 959.02))
        page.context.close()


def test_signals_stay_while_another_view_is_looked_at(open_page):
    """By the tab and by Back: the choice, and a pause with data that the server has no more."""
    source = Source()
    with Dashboard(signals=source) as dashboard, Feed(dashboard):
        page = open_page(f'{dashboard.address}#/signals?{PAIR}&minus=0.1&span=60')
        see(page, '.legend', 'Present Position \u2212 Goal Position')
        page.get_by_role('link', name='History').click()
        see(page, 'h1', 'History')
        page.get_by_role('link', name='Signals').click()
        see(page, '.legend', 'Present Position \u2212 Goal Position.* of 2\\d\\d0')
        page.get_by_role('button', name='Pause').click()
        source.now_s += 1000
        source.rings.clear()
        for back in (page.get_by_role('link', name='Signals').click, page.go_back):
            page.get_by_role('link', name='Devices').click()
            page.locator('.devices tbody tr').first.wait_for()
            page.locator('#angles').click()
            back()
            see(page, '.signals [aria-pressed=true]', 'Paused')
            see(page, '.legend', 'Present Position \u2212 Goal Position.* of 2\\d\\d0')
            assert parse_qs(page.url.partition('?')[2])['minus'] == ['0.1']
        page.context.close()


def asked(page):
    """Return the address, by name, with the last value of each."""
    return {name: value[-1] for name, value in parse_qs(
        page.evaluate('location.hash').partition('?')[2]).items()}


PLACES = """() => [...document.querySelectorAll('.views a, main .past-head, main canvas')]
    .map((one) => one.getBoundingClientRect()).map(({x, y, width}) => [x, y, width].join())"""


@pytest.mark.parametrize('size', SIZES)
@pytest.mark.parametrize('view', ['signals', 'history'])
def test_a_problem_that_appears_moves_nothing(open_page, tmp_path, view, size):
    robot = SyntheticRobot()
    with Dashboard(history=tmp_path / 'history.sqlite') as dashboard, Feed(dashboard, robot):
        page = open_page(dashboard.address, size)
        show(page, view)
        see(page, '.past, .legend', 'Times here|Present')
        before = page.evaluate(PLACES)
        robot.lost = {7}
        page.locator('#headline').wait_for()
        page.locator('[data-pip=overview][data-state]').wait_for()
        assert page.evaluate(PLACES) == before
        box = page.locator('#headline').bounding_box()
        assert box['y'] + box['height'] <= SIZES[size][1]              # it is seen
        page.context.close()


@pytest.mark.parametrize('size', ['touch', 'phone'])
def test_the_choice_of_signals_is_whole_on_a_small_display(dashboard, robot, open_page, size):
    page = open_page(f'{dashboard.address}#/signals?{PAIR}', size)
    see(page, '[aria-label=Difference]', 'Present Position \u2212 Goal Position')
    assert page.evaluate(BEYOND) == []


def test_registers_of_several_servos_in_few_steps(page):
    """The register stays when the servo changes; one button adds it for all of a model."""
    show(page, 'signals')
    register = page.get_by_label('Register', exact=True)
    register.select_option('Present Temperature (\u00b0C)')
    page.get_by_role('button', name='Add', exact=True).click()
    page.get_by_label('Device', exact=True).select_option(index=1)
    page.get_by_role('button', name='Add', exact=True).click()
    see(page, '.legend', '002[^/]* Present Temperature')
    register.select_option('Present Input Voltage (V)')
    page.get_by_role('button', name='Add for all').click()
    wait(lambda: page.locator('.legend li', has_text='Present Input Voltage').count() == 5)
    assert page.get_by_role('button', name='Add for all').is_disabled()        # 8 registers


def test_a_mark_and_another_time_without_a_mouse(open_page):
    with Dashboard(signals=Source()) as dashboard, Feed(dashboard):
        page = open_page(f'{dashboard.address}#/signals?{PAIR}&span=60', 'phone')
        see(page, '.legend', 'Present Position')
        plot = page.locator('.signals canvas')
        plot.tap(position={'x': 200, 'y': 50})
        page.get_by_role('button', name='Mark').tap()
        plot.tap(position={'x': 240, 'y': 50})
        see(page, '.legend', r'Present Position.* \u0394 .* in [\d.]+ s')
        plot.focus()
        for key in ('+', '+', 'Shift+ArrowLeft'):
            before = page.evaluate('location.href')
            page.keyboard.press(key)
            wait(lambda before=before: page.evaluate('location.href') != before)
        from_s, to_s = (float(re.search(rf'{name}=([\d.]+)', page.evaluate('location.href'))[1])
                        for name in ('from', 'to'))
        assert to_s - from_s == pytest.approx(60 / 1.25 ** 2, abs=0.01)
        box, touch = plot.bounding_box(), page.context.new_cdp_session(page)
        for kind, x in (('touchStart', 150), ('touchMove', 175), ('touchMove', 200),
                        ('touchEnd', None)):
            touch.send('Input.dispatchTouchEvent', {'type': kind, 'touchPoints': [] if x is None
                       else [{'x': box['x'] + x, 'y': box['y'] + 40}]})
        wait(lambda: f'from={from_s:.3f}' not in page.evaluate('location.href'))
        moved_s = float(re.search(r'from=([\d.]+)', page.evaluate('location.href'))[1])
        assert moved_s < from_s - 1
        page.context.close()


def test_signals_over_ros_are_samples(page):
    show(page, 'signals')
    see(page, '.signals [role=status]', r'^\d Hz samples from dxl/diagnostics')
    page.get_by_label('Register', exact=True).select_option('Goal Position (rad)')
    page.get_by_role('button', name='Add', exact=True).click()
    see(page, '.legend', 'Goal Position[^/]*rad\\s*[\\d.]+ samples/s')
    read, steps = page.evaluate("""async () => {
        const {drawPlot, readAt} = await import('./draw.js');
        const points = [[0, 1, 1, 1], [1, 3, 3, 3], [2, 2, 2, 2]];
        const drawn = [];
        const {lineTo} = CanvasRenderingContext2D.prototype;
        CanvasRenderingContext2D.prototype.lineTo = function (x, y) {
            if (this.globalAlpha < 1) drawn.push([x, y]);
            lineTo.call(this, x, y);
        };
        drawPlot(document.querySelector('.signals canvas'), [{points, isSampled: true}],
            {from: 0, to: 2, cursor: null, mark: null, gap: Infinity, now: 2});
        CanvasRenderingContext2D.prototype.lineTo = lineTo;
        return [readAt(points, 0.5, 0.01, {gap: Infinity, isSampled: true}), drawn];
    }""")
    assert read == {'low': 1, 'high': 1, 'at': 0}
    assert all(x == before[0] or y == before[1]
               for before, (x, y) in pairwise(steps))
    assert len({x for x, _ in steps}) == 2


def test_a_difference_is_taken_where_both_are_known(page):
    """At the times of what was read; the other is the nearest one, or what was written last."""
    found = page.evaluate("""async () => {
        const {Difference, Signal} = await import('./signal.js');
        const signal = (isWritten, ...points) => {
            const made = new Signal('', '');
            made.take(isWritten, 0, Float64Array.from(points.flat()));
            made.gap = 1;
            return made;
        };
        const minus = (one, other) => {
            const made = new Difference(one, other);
            made.update();
            const pairs = [];
            for (let at = made.begin; at < made.end; at += 2) {
                pairs.push([made.data[at], Number.isNaN(made.data[at + 1]) ? null
                    : made.data[at + 1]]);
            }
            return [made.isWritten, pairs];
        };
        const read = signal(false, [0, 10], [1, 20], [2, 30], [9, 40]);
        const other = signal(false, [0.1, 1], [0.9, 2], [2.6, 3]);
        const goal = signal(true, [0.5, 100], [1.5, 200]);
        return [minus(read, other), minus(read, goal), minus(goal, read),
            minus(goal, signal(true, [1, 50])), minus(read, signal(false))];
    }""")
    assert found == [
        [False, [[0, 9], [1, 18], [2, 27], [9, None]]],
        [False, [[0, None], [1, -80], [2, -170], [9, -160]]],
        [False, [[0, None], [1, 80], [2, 170], [9, 160]]],
        [True, [[0.5, None], [1, 50], [1.5, 150]]],
        [False, [[0, None], [1, None], [2, None], [9, None]]]]


def test_a_plot_has_the_lowest_and_highest_of_each_column(page):
    """A gap is one where it can be seen; what was written holds until the next."""
    drawn = page.evaluate("""async () => {
        const {csvOf, Signal} = await import('./signal.js');
        const show = (isWritten, points, ...view) => {
            const signal = new Signal('', '');
            signal.take(isWritten, 5, Float64Array.from(points.flat()));
            return signal.drawn(...view);
        };
        const steady = Array.from({length: 1000}, (_, at) => [at / 100, at === 205 ? 9 : at % 3]);
        const silent = steady.filter(([s]) => s < 4 || s > 6);
        return [show(false, steady, 0, 10, 10, 10), show(false, silent, 3, 7, 8, 10),
            show(false, [...steady.slice(0, 50), [5, 8]], 4, 6, 8, 5.1),
            show(true, [[1, 1], [3, 2]], 2, 6, 40, 5),
            csvOf([], ['=1+1', 'a, "b"'], [0, 1], 's')];
    }""")
    *drawn, head = drawn
    assert drawn[0][3] == [3, 0, 2, 0]                                  # the last of them is 0
    columns, silent, alone, held = [[one[:3] for one in some] for some in drawn]
    assert head == 's,\'=1+1,"a, ""b"""\n'
    assert columns == [[at, 0, 9 if at == 2 else 2] for at in range(10)]
    assert silent == [[2.99, 2, 2], [3, 0, 2], [3.5, 0, 2], [pytest.approx(4.49), None],
                      [6.01, 0, 2], [6.5, 0, 2], [7, 1, 2], [7.51, None]]
    assert alone[-3:] == [[0.74, None], [5, 8, 8], [5.25, 8, 8]]        # a dot
    assert held == [[1, 1, 1], [3, 1, 1], [3, 2, 2], [5, 2, 2]]


def test_figures_between_two_times_of_a_plot(page):
    """Statistics are those of the values, not of the columns; a difference is as exact as both."""
    statistics, differences, ranges = page.evaluate("""async () => {
        const {Signal} = await import('./signal.js');
        const {differenceOf} = await import('./draw.js');
        const {turned} = await import('./plot.js');
        const signal = new Signal('', '');
        signal.take(false, 0, Float64Array.from([0, 50, 1, 2, 2, NaN, 3, 4, 4, 6, 5, 50]));
        const exact = {low: 1, high: 1};
        const turn = (deltaY, shiftKey, at = 20) =>
            turned([10, 30], at, {deltaX: 0, deltaY, deltaMode: 0, shiftKey}, [0, 60]);
        return [signal.statistics(1, 4), [differenceOf(exact, {low: 3, high: 4}),
            differenceOf({low: 3, high: 4}, exact), differenceOf(null, exact)],
            [turn(-100), turn(100, false, 10), turn(100, true), turn(-100, true),
             turned([0, 60], 9, {deltaX: 0, deltaY: 100, deltaMode: 0}, [0, 60]),
             turned([0, 20], 9, {deltaX: -9, deltaY: 0, deltaMode: 0}, [0, 60])]];
    }""")
    assert statistics == {'count': 3, 'rate': 1, 'low': 2, 'high': 6, 'mean': 4, 'deviation': 2,
                          'rms': pytest.approx(math.sqrt(56 / 3))}
    assert [one and (one['low'], one['high']) for one in differences] == [(2, 3), (-3, -2), None]
    assert ranges == [[12, 28], [10, 35], [12, 32], [8, 28], [0, 60], [0, 20]]


def test_error_history_and_findings(page, robot):
    robot.lost, robot.findings = {7}, FINDINGS
    show(page, 'device')
    see(page, '.device-errors li', '\\d\\d:\\d\\d:\\d\\dno answer to Read at Present Position')
    show(page, 'log')
    see(page, '.errors li', '\\d\\d007 left_kneeno answer to Read at Present Position')
    see(page, '.findings li', 'missing termination|Missing Termination')
    page.locator('.findings a', has_text='012').click()
    see(page, 'h1', '012')
    see(page, '.findings', 'Return Delay Time is 250')


def test_what_to_do_about_a_finding_is_a_button(page, robot):
    robot.findings = FINDINGS
    show(page, 'overview')
    see(page, '.findings li', 'missing termination|Missing Termination')
    assert page.get_by_role('link', name='What to do').count() == 1     # none of an unknown rule
    page.get_by_role('link', name='What to do: return delay').click()
    see(page, 'h1', '^return delay$')
    see(page, '.remedy', BY_NAME['return_delay'].advice[1])


def test_log_and_timing(page):
    show(page, 'log')
    see(page, '.figures tr', 'time per buffer\\s*0\\.')
    see(page, '.figures tr', 'time between buffers')
    see(page, '.figures tr', 'resident memory.*61.2')
    see(page, '[role=meter]', '[34]\\d(\\.\\d)? %')
    page.locator('.figures button', has_text='time per buffer').click()
    see(page, '.legend', 'p50.*ms[\\s\\S]*p95.*ms[\\s\\S]*max')


def test_history_of_a_lost_device_shows_what_was_before(open_page, tmp_path):
    path, begin = tmp_path / 'history.sqlite', int(time.time()) - 4000
    writer = HistoryWriter(path)
    record(writer, begin, 3000, 2400)
    writer.close()
    with Dashboard(history=path) as dashboard:
        dashboard.take([('dxl/diagnostics', second_of(3000, 2400))])
        page = open_page(f'{dashboard.address}#/device/{SICK}')
        see(page, '.badge', 'Error: disconnected')
        see(page, '.device-past .legend', 'temperature')
        assert 'temperature 4' in page.locator('.graphs canvas').nth(1).get_attribute('aria-label')
        see(page, '.device-past .events [data-state=error]', '\\d:\\d\\d.*7 answers missed')
        assert 'error from' in page.locator('.levels').get_attribute('aria-label')
        page.keyboard.press('5')
        page.locator('.events summary', has_text='003 knee').click()
        see(page, '.events ol li', '003: no answer to Read')        # missed on the way to its loss
        see(page, '.past', r'Times here: .*UTC[+\u2212]\d\d:\d\d. Times in the files: UTC')
        see(page, '.events li', r'nothing was recorded from .* to ')
        page.locator('.events a', has_text='003 knee').first.click()
        see(page, 'h1', '003 knee')
        asked = parse_qs(page.url.partition('?')[2])
        assert int(asked['from'][0]) + 120 == int(asked['to'][0]) - 120 == begin + 2400
        page.go_back()
        see(page, '.events summary', '003 knee')
        page.get_by_role('button', name='Errors', exact=True).click()
        see(page, '.events li', '003: no answer to Read')
        assert 'kind=error' in page.url
        page.get_by_role('button', name='10 min').click()
        see(page, '.events li', 'nothing was recorded')
        page.get_by_role('button', name='24 h').click()
        with page.expect_download() as download:
            page.get_by_role('link', name='events as CSV').click()
        assert 'no answer to Read' in download.value.path().read_text()
        page.reload()
        see(page, '.events li', '003: no answer to Read')
        page.context.close()


BAND = """async () => {
    const {drawPlot, readAt} = await import('./draw.js');
    const points = [[0, 0, 10], [10, 2, 4], [40, 6, 8]];
    const canvas = document.createElement('canvas');
    canvas.style.cssText = 'position: fixed; top: 0; width: 162px; height: 128px';
    document.body.append(canvas);
    const {left, width} = drawPlot(canvas, [{points, step: 10}],
        {from: 0, to: 60, cursor: null, mark: null, drag: null, unix: (s) => s, low: 0});
    const {data} = canvas.getContext('2d').getImageData(0, 8, 162, 100);
    const painted = (s) => Array.from({length: 100}, (_, y) =>
        4 * (162 * y + Math.round(left + s * width / 60)))
        .filter((at) => data[at + 2] - data[at] > 60).length;
    canvas.remove();
    return [[5, 15, 30, 45, 55].map(painted),
        [5, 10, 15, 30, 45, 55, null].map((s) => readAt(points, s, 1, {gap: 25, step: 10}))];
}"""


def test_lowest_and_highest_are_a_band(page):
    """Each step is as high as its range, all of it is painted, and where none is known nothing."""
    painted, read = page.evaluate(BAND)
    assert painted == [pytest.approx(high, abs=3) for high in (94, 19, 0, 19, 0)]
    assert [one and (one['low'], one['high']) for one in read] == [
        (0, 10), (0, 10), (2, 4), None, (6, 8), (6, 8), (6, 8)]


def causes(page, *events):
    """Return who, what, how often, from when, until when, of events (kind, level, who, text)."""
    newest_first = [[at, f'dxl_monitor: {who}', '', kind, level, text]
                    for at, (kind, level, who, text) in enumerate(events)][::-1]
    found = page.evaluate("""async (events) => {
        const {causesOf} = await import('./causes.js');
        return causesOf(events);
    }""", newest_first)
    return [(', '.join(one['who']), one['text'], one['count'], one['begin'], one['end'])
            for one in found]


def test_events_are_grouped_by_cause(page):
    lost, well = ('state', 2, '007 knee', 'disconnected: 7 answers missed'), (
        'state', 0, '007 knee', 'connected')
    missed = ('error', 2, 'bus', '007: no answer to Read at 132')
    other = (*missed[:3], '008: no answer to Read at 7')
    assert causes(page, lost, well) == [('007 knee', lost[3], 1, 0, 1)]
    assert causes(page, lost, well, lost, missed, other) == [
        ('007, 008', 'no answer to Read at 7', 2, 4, None), ('007 knee', lost[3], 2, 2, None)]
    assert causes(page, missed, other, missed, lost, well) == [     # missed on the way to its loss
        ('007 knee', lost[3], 1, 3, 4), ('008', 'no answer to Read at 7', 1, 1, None)]
    assert causes(page, lost, ('state', 2, '008 hip', 'disconnected: 9 answers missed'), well) == [
        ('007 knee, 008 hip', 'disconnected: 9 answers missed', 2, 0, None)]
    hot = ('finding', 1, '007 knee', 'too hot: 82 \u00b0C')
    assert causes(page, hot, ('state', 0, '007 knee', 'connected'), (*hot[:3], 'loose: x'),
                  ('over', 0, '007 knee', 'too hot')) == [
        ('007 knee', 'loose: x', 1, 2, None), ('007 knee', 'connected', 1, 1, None),
        ('007 knee', hot[3], 1, 0, 3)]
    assert causes(page, hot, (*hot[:3], 'too hot: 83'), ('over', 0, '007 knee', 'too hot')) == [
        ('007 knee', 'too hot: 83', 2, 0, 2)]
    assert causes(page, lost, ('state', 1, '007 knee', 'Warning'), well) == [
        ('007 knee', 'Warning', 1, 1, 2), ('007 knee', lost[3], 1, 0, 1)]


@contextmanager
def recorded(folder):
    """Yield a dashboard that recorded 50 min of two servos, and when that begins (Unix s)."""
    begin = int(time.time()) // 600 * 600 - 3600
    knee, hip = (Subject(f'dxl_monitor: {name}', 'devices', '', 'A', 'rad')
                 for name in ('007 left_knee', '001 left_hip_yaw'))
    with closing(HistoryWriter(folder / 'history.sqlite')) as writer:
        writer.write([Window(begin + at, source, 2 if source is knee and at >= 1800 else 0, (
            (0.1, 0.2), (40 + at // 600, 40 + at // 600), *[None] * 4))
            for at in range(0, 3000, 10) for source in (knee, hip)],
            [Event(begin + at, knee, 'state', level, text) for at, level, text in (
                (900, 2, 'disconnected: 5 answers missed'), (960, 0, 'connected'),
                (1800.3, 2, 'disconnected: 7 answers missed'))])
    with Dashboard(history=folder / 'history.sqlite') as dashboard, Feed(dashboard):
        yield dashboard, begin


def test_times_of_the_history_as_people_write_them(open_page, tmp_path):
    with recorded(tmp_path) as (dashboard, begin):
        page = open_page(f'{dashboard.address}#/history?from=-2 h', timezone_id='Asia/Tokyo',
                         locale='en-US')
        assert page.get_by_label('From', exact=True).input_value() == '-2 h'
        see(page, '.events summary', '007 left_knee.*7 answers missed.*2 times, first')
        page.locator('.events summary', has_text='left_knee').click()
        assert page.locator('.events ol li').count() == 3

        def local(at_s):
            return time.strftime('%H:%M', time.gmtime(begin + at_s + 9 * 3600))
        at = local(960)
        page.get_by_label('To', exact=True).fill(at)
        page.keyboard.press('Enter')
        see(page, '.events summary', f'{local(900)}.*5 answers missed.*until .*{local(960)}')
        assert int(asked(page)['to']) == begin + 960
        for one in ('From', 'To'):                                  # no AM, no month first
            assert re.fullmatch(r'(\d{4}-\d\d-\d\d )?\d\d:\d\d:\d\d',
                                page.get_by_label(one, exact=True).input_value())
        page.get_by_label('From', exact=True).fill('noonish')
        page.keyboard.press('Enter')
        see(page, '.past [role=status]', "^from: 'noonish' is not a time; write -10 min, 14:05")
        assert page.get_by_label('From', exact=True).get_attribute('aria-invalid') == 'true'
        assert [one for one in page.complaints if '400' not in one] == []
        page.complaints.clear()
        page.get_by_role('button', name='8 h').click()
        page.locator('.past [role=status]', has_text='noonish').wait_for(state='detached')
        wait(lambda: asked(page) == {'from': '-8 h'})
        page.goto('about:blank')
        page.goto(f'{dashboard.address}#/history?last=7200')        # a link of before
        see(page, '.events summary', '007 left_knee')
        page.context.close()


def test_the_zone_of_a_history_is_that_of_its_time(open_page, tmp_path):
    with recorded(tmp_path) as (dashboard, _):
        for month, offset in ((7, 2), (12, 1)):
            at_s = int(datetime(2025, month, 1, 12, tzinfo=timezone.utc).timestamp())
            page = open_page(f'{dashboard.address}#/history?from={at_s - 600}&to={at_s}',
                             timezone_id='Europe/Berlin')
            see(page, '.past', rf'Times here: Europe/Berlin, UTC\+0{offset}:00')
        page.get_by_label('From', exact=True).fill('2025-07-01T12:00')
        page.keyboard.press('Enter')
        wait(lambda: datetime.fromtimestamp(int(asked(page)['from']), timezone.utc).hour == 10)
        for context in page.context.browser.contexts:
            context.close()


def test_one_slider_moves_cards_plots_and_events(open_page, tmp_path):
    with recorded(tmp_path) as (dashboard, begin):
        span = f'from={begin}&to={begin + 3000}'
        page = open_page(f'{dashboard.address}#/history?{span}&at={begin + 1000}')
        see(page, '.then h2', time.strftime('%H:%M:%S', time.localtime(begin + 1000)))
        see(page, '.then .servo', 'left_knee.*Temperature41 \u00b0C')
        assert '7 answers' not in page.locator('.events').inner_text()
        slider = page.get_by_label('Time looked at')
        slider.focus()
        page.keyboard.press('End')
        see(page, '.then .servo[data-state=error]', 'left_knee.*7 answers missed.*44 \u00b0C')
        see(page, '.then .servo[data-state=ok]', 'left_hip_yaw.*Position0.1 to 0.2 rad')
        see(page, '.events', '7 answers missed')
        page.keyboard.press('PageDown')
        page.keyboard.press('ArrowLeft')
        wait(lambda: int(asked(page)['at']) == begin + 3000 - 300 - 10)     # one of what is kept
        at = asked(page)['at']
        assert slider.get_attribute('aria-valuetext') == time.strftime(
            '%H:%M:%S', time.localtime(int(at)))
        page.goto('about:blank')
        page.goto(f'{dashboard.address}#/history/dxl_monitor: 007 left_knee?{span}&at={at}')
        see(page, '.legend', 'temperature\\s*44 \u00b0C at \\d\\d:')
        page.locator('.graphs canvas').first.hover()
        page.locator('h1').hover()
        see(page, '.legend', 'temperature\\s*44 \u00b0C at \\d\\d:')
        page.get_by_role('button', name='Live').click()
        see(page, '.player-time', '^now$')
        wait(lambda: asked(page) == {'from': '-1 h'})
        page.context.close()


def test_two_servos_in_one_plot_of_the_history(open_page, tmp_path):
    """Over the same time, with the events of both; the link and the files have both."""
    with recorded(tmp_path) as (dashboard, begin):
        page = open_page(f'{dashboard.address}#/history/{KNEE}?from={begin + 1500}'
                         f'&to={begin + 2400}')
        see(page, '.legend', '^temperature')
        page.get_by_label('Compare with').select_option('dxl_monitor: 001 left_hip_yaw')
        for _ in range(2):
            see(page, '.legend', '007 left_knee temperature4[34] \u00b0C.*'
                                 '001 left_hip_yaw temperature4[34] \u00b0C')
            assert page.locator('.graphs canvas').count() == 2              # position, temperature
            assert 'error from' in page.get_by_label('State of 007 left_knee').get_attribute(
                'aria-label')
            see(page, '.graphs', '001 left_hip_yaw position0.1 to 0.2 rad')
            page.reload()
        page.locator('.graphs canvas').last.hover(position={'x': 300, 'y': 50})
        see(page, '.legend', r'007 left_knee temp.*C at .*001 left_hip_yaw temp.*C at ')
        with page.expect_download() as download:
            page.get_by_role('link', name='values as CSV').click()
        begins = time.strftime('%Y-%m-%dT%H%M%SZ', time.gmtime(begin + 1500))
        assert download.value.suggested_filename \
            == f'robot_007_left_knee_001_left_hip_yaw_values_{begins}.csv'
        saved = download.value.path().read_text()
        assert ',0.100,0.200,42.000,42.000,' in saved
        assert '007 left_knee' in saved
        assert '001 left_hip_yaw' in saved
        page.locator('.events a', has_text='left_knee').first.click()
        see(page, '.legend', '001 left_hip_yaw temperature')
        page.get_by_role('button', name='Remove 001 left_hip_yaw temperature').click()
        see(page, '.legend', '^temperature')
        assert 'with' not in asked(page)
        page.context.close()


def test_the_link_of_an_event_shows_it(open_page, tmp_path):
    """Also where it was within a second; and until when it lasted, where that is later."""
    with recorded(tmp_path) as (dashboard, begin):
        page = open_page(f'{dashboard.address}#/history/dxl_monitor: 007 left_knee?from={begin}'
                         f'&to={begin + 3000}&at={begin + 930}')
        shown_at = time.strftime('%H:%M:%S', time.localtime(begin + 930))
        see(page, '.past', f'Events up to {shown_at}')
        see(page, '.events li', '5 answers missed.*until')
        page.goto(f'{dashboard.address}#/history?from={begin}&to={begin + 3000}')
        page.locator('.events summary', has_text='left_knee').click()
        row = page.locator('.events ol li', has_text='7 answers missed')
        row.get_by_role('link', name='007 left_knee').click()
        see(page, 'h1', 'left_knee')
        see(page, '.events li', '7 answers missed')
        page.go_back()
        page.locator('.events summary', has_text='left_knee').click()
        row.get_by_role('link').first.click()                           # its time: of all
        see(page, '.then h2', time.strftime('%H:%M:%S', time.localtime(begin + 1801)))
        see(page, '.events li', '7 answers missed')
        page.context.close()


@pytest.mark.parametrize('size', SIZES)
def test_a_time_of_the_history_fits_and_is_accessible(open_page, tmp_path, size):
    with recorded(tmp_path) as (dashboard, begin):
        times = f'?from={begin}&to={begin + 3000}&at={begin + 2500}'
        page = open_page(dashboard.address, size)
        axe = dashboard_page.axe_source()
        for place, ready in (('', '.then .servo'), ('/dxl_monitor: 007 left_knee', '.legend b')):
            page.goto(f'{dashboard.address}#/history{place}{times}')
            page.locator(ready).first.wait_for()
            page.locator('.events summary').first.click()
            assert page.evaluate('document.documentElement.scrollWidth - innerWidth') <= 0
            assert page.evaluate(TOO_NARROW) == page.evaluate(BEYOND) == []
            assert size == 'desktop' or page.evaluate(TOO_SMALL) == []
            if axe:
                page.evaluate(axe)
                found = page.evaluate('axe.run({resultTypes: ["violations"]})')['violations']
                assert [(one['id'], one['nodes'][0]['html']) for one in found] == []
        page.context.close()


def test_the_history_of_a_position_is_in_its_unit(open_page, tmp_path):
    path, begin = tmp_path / 'history.sqlite', int(time.time()) // 10 * 10 - 600
    with closing(HistoryWriter(path)) as writer:
        writer.write([Window(begin + at, Subject(f'dxl_monitor: {name}', 'devices', '', 'A', unit),
                             0, ((value, value), *[None] * 5)) for at in range(0, 300, 10)
                      for name, unit, value in (('001', 'rad', 1608.49), ('002', 'm', 0.053))], [])
    with Dashboard(history=path) as dashboard, Feed(dashboard):
        page = open_page(f'{dashboard.address}#/history/dxl_monitor: 001')
        see(page, '.legend', r'position\s*1608\.49 rad')
        page.locator('#angles').click()
        see(page, '.legend', r'position\s*92159\.7\u00b0')
        page.goto(f'{dashboard.address}#/history/dxl_monitor: 002')
        see(page, '.legend', r'position\s*0\.053 m')
        page.context.close()


def test_bridge(page, robot):
    show(page, 'bridge')
    see(page, '.axes', 'driving[\\s\\S]*0.32[\\s\\S]*0.11[\\s\\S]*0.60')
    assert 'x 0.32 m/s' in page.locator('.dial').get_attribute('aria-label')
    see(page, '.panel', 'Time-outs\\s*2')
    see(page, '.legend', 'p50.*ms')
    robot.velocity = (0.0, -0.25, 0.0)
    see(page, '.axes', '0.00[\\s\\S]*\u22120.25')


def test_search_and_filter_of_devices(page, robot):
    robot.lost = {7}
    show(page, 'devices')
    page.get_by_role('button', name='Error').click()
    wait(lambda: page.locator('.devices tbody tr').count() == 1)
    page.get_by_role('button', name='All').click()
    page.get_by_label('Search devices').fill('hip left')
    wait(lambda: page.locator('.devices tbody tr').count() == 3)
    page.get_by_label('Search devices').fill('nothing like that')
    page.get_by_text('No device matches.').wait_for()


def test_keys(page):
    page.keyboard.press('4')
    see(page, '.axes', 'driving')
    page.keyboard.press('2')
    page.locator('.devices tbody tr').first.wait_for()
    page.keyboard.press('/')
    page.keyboard.type('t1')
    assert page.get_by_label('Search devices').input_value() == 't1'
    page.keyboard.press('Escape')
    show(page, 'device')
    see(page, 'h1', '007')
    page.keyboard.press(']')
    see(page, 'h1', '008')
    page.keyboard.press('u')
    see(page, 'h1', 'MX-106')
    page.keyboard.press('?')
    see(page, 'dialog', 'Enter or Shift click[\\s\\S]*wheel, Shift wheel[\\s\\S]*Esc')
    page.keyboard.press('Escape')
    page.keyboard.press('1')
    page.wait_for_selector('.tile')


def test_theme_follows_the_system_until_chosen(dashboard, robot, open_page):
    page = open_page(dashboard.address, color_scheme='dark')
    assert page.evaluate('document.documentElement.dataset.theme') == 'dark'
    page.emulate_media(color_scheme='light')
    wait(lambda: page.evaluate('document.documentElement.dataset.theme') == 'light')
    page.locator('#theme').click()
    page.reload()
    assert page.evaluate('document.documentElement.dataset.theme') == 'dark'


TOO_SMALL = """() => [...document.querySelectorAll(
    'main button, main a:not(.cell), main input, .views a, .top button')]
    .filter((one) => one.checkVisibility() && !one.closest('.figures'))
    .map((one) => [one.textContent, one.className, one.getBoundingClientRect()])
    .filter(([, , {width, height}]) => width && height < 43.5)
    .map(([text, kind, box]) => `${text} (${kind}) ${box.width} x ${box.height}`)"""


TOO_NARROW = """() => [...document.querySelectorAll('main .devices thead th')]
    .filter((one) => one.checkVisibility() && one.scrollWidth > one.clientWidth)
    .map((one) => `${one.textContent}: ${one.clientWidth} px`)"""


BEYOND = """() => [...document.querySelectorAll('.past-head > *')]
    .filter((one) => one.checkVisibility()
        && one.getBoundingClientRect().right > document.documentElement.clientWidth)
    .map((one) => one.textContent)"""


ANGLES = [('overview', '.servo', '007.*Position'), ('devices', '.devices tr', '007'),
          ('device', '.device-fields tr', 'Present Position'), ('device', '.legend', ''),
          ('signals', '.legend', 'Present Position'),
          ('signals', '[aria-label=Register]', 'Present Position')]


def test_angles_are_in_degrees_or_radians_wherever_they_are_shown(page):
    for unit, other in (('rad', '\u00b0'), ('\u00b0', 'rad')):
        see(page, '#angles', '^rad$' if unit == 'rad' else '^deg$')
        for view, items, text in ANGLES:
            show(page, view)
            see(page, items, f'{text}.*{unit}')
            assert other not in page.locator(items, has_text=re.compile(text)).first.inner_text()\
                .replace('\u00b0C', ''), (view, unit)
        see(page, '.legend', r'-0\.\d+ to 0\.\d' if unit == 'rad' else r'-\d\d[\d.]* to \d\d')
        page.locator('#angles').click()
        page.reload()                               # it is kept
    see(page, '#angles', '^rad$')


def test_a_value_is_exact_at_256_turns_and_metres_are_no_angle(open_page):
    turns = [('Present Position (rad)', '1608.49'), ('Max Position Limit (rad)', '3.14')]
    gripper = [('Present Position (m)', '0.0532'), ('Min Position Limit (m)', '0'),
               ('Max Position Limit (m)', '0.1064')]
    statuses = [Status(f'dxl_monitor: 00{at}', Level.OK, 'connected', str(at), [
        ('Model', 'Axis'), ('Firmware Version', ''), ('State', 'connected'), *values])
        for at, values in enumerate((turns, gripper), 1)]
    bus = Status('dxl_monitor: bus', Level.OK, '2 devices', '', [('Port', '/dev/ttyUSB0')])
    robot = SimpleNamespace(
        messages=lambda time_s: [('dxl/diagnostics', serialise([*statuses, bus]))])
    with Dashboard() as dashboard, Feed(dashboard, robot):
        page = open_page(dashboard.address)
        for angle in ('1608.49 rad', '92159.7\u00b0'):
            see(page, '.servo', f'001.*{angle}')
            see(page, '.servo', r'002.*0\.053 m')
            assert page.locator('.servo', has_text='001').locator('.position i').first.is_hidden()
            bar = page.locator('.servo', has_text='002').locator('.position i i')
            assert bar.evaluate('bar => parseFloat(bar.style.left)') == pytest.approx(48, abs=1)
            show(page, 'devices')
            see(page, '.devices tr', f'001.*{angle}')
            see(page, '.devices tr', r'002.*0\.053 m')
            page.locator('#angles').click()
            show(page, 'overview')
        page.context.close()


@pytest.mark.parametrize('size', SIZES)
def test_every_view_fits_and_fingers_find_their_targets(dashboard, robot, open_page, size):
    robot.lost, robot.warned, robot.findings = {7, 11}, {14}, FINDINGS
    page = open_page(dashboard.address, size)
    for view in VIEWS:
        show(page, view)
        page.locator('main .panel, main .tile').first.wait_for()
        wide = page.evaluate('document.documentElement.scrollWidth - innerWidth')
        assert wide <= 0, f'{view} is {wide} px too wide'
        assert page.evaluate(TOO_NARROW) == [], view
        assert page.evaluate(BEYOND) == [], view
        if size != 'desktop':
            assert page.evaluate(TOO_SMALL) == [], view


CUT = """() => ['#robot', '#machine', '.top'].map((one) => document.querySelector(one))
    .filter((one) => one.textContent && one.checkVisibility())
    .filter(({scrollWidth, clientWidth, scrollHeight, clientHeight}) =>
        scrollWidth > clientWidth + 1 || scrollHeight > clientHeight + 1)
    .map((one) => one.id)"""


@pytest.mark.parametrize(('namespace', 'name'), [('rover_of_the_lab', 'rover_of_the_lab'),
                                                 ('', 'robot')])
def test_the_name_is_whole_at_200_percent_and_a_wide_window_has_no_empty_half(
        open_page, namespace, name):
    robot = SyntheticRobot(namespace=namespace)
    with Dashboard() as dashboard, Feed(dashboard, robot):
        page = open_page(dashboard.address, 'panel')
        see(page, BAR, '24 of 24')
        for width in (640, 800, 900, 1024, 1280):
            page.set_viewport_size({'width': width, 'height': 600})
            see(page, '#machine:visible, #robot:visible', name)
            assert page.evaluate(CUT) == [], width
        page.set_viewport_size({'width': 1920, 'height': 1080})
        page.locator('.low').wait_for()
        left, right = (page.locator(one).first.bounding_box()
                       for one in ('.buses', '.below'))
        assert right['x'] > left['x'] + left['width']
        page.context.close()


def test_the_whole_overview_fits_the_touch_display(dashboard, robot, open_page):
    page = open_page(dashboard.address, 'touch')
    page.wait_for_selector('.tile')
    see(page, BAR, '24 of 24')
    for tile in page.locator('.tile').all():
        box = tile.bounding_box()
        assert box['y'] + box['height'] <= SIZES['touch'][1]


@pytest.mark.parametrize('size', SIZES)
def test_accessibility(dashboard, robot, open_page, size):
    axe = dashboard_page.axe_source()
    if not axe:
        pytest.skip('skipped: no axe-core; pip install axe-playwright-python')
    robot.lost, robot.warned, robot.silent, robot.findings = {7}, {14}, {103}, FINDINGS
    page = open_page(dashboard.address, size, reduced_motion='reduce')
    page.evaluate(axe)
    found = []
    for theme, view in product(('light', 'dark'), VIEWS):
        page.emulate_media(color_scheme=theme)
        show(page, view)
        page.locator('main .panel').first.wait_for()
        see(page, '.pip', '')
        page.locator('[data-lost]').wait_for(state='detached')      # a lost server makes it pale
        result = page.evaluate(
            'axe.run({resultTypes: ["violations"],'
            ' rules: {"label-content-name-mismatch": {enabled: true}}})')
        found += [(theme, view, one['id'], one['impact'],
                   [node['html'] for node in one['nodes']][:3]) for one in result['violations']]
    assert [one for one in found if one[3] in ('serious', 'critical')] == []
    assert found == []


@pytest.mark.parametrize(('view', 'items', 'changed'), [
    ('overview', '.servo[data-state=error]', '2 lost'), ('overview', '.findings li', ''),
    ('log', '.findings li', ''), ('log', '.errors li', '2 lost'),
    ('devices', '.devices tbody tr', '2 lost'), ('device', '.device-errors li', '')])
def test_what_moves_can_be_stopped(page, robot, view, items, changed):
    robot.lost, robot.findings = {7}, FINDINGS[:1]
    show(page, view)
    see(page, items, '007|[Mm]issing termination|no answer')
    lists = page.locator(items)
    button = page.get_by_role('button', name=re.compile('^Paused?$'))       # one for all lists
    button.click()
    before = lists.all_inner_texts()
    robot.lost, robot.findings = {7, 11}, FINDINGS
    wait(lambda: '2 problems' in page.title())
    assert lists.all_inner_texts() == before
    assert button.get_attribute('aria-pressed') == 'true'
    button.click()
    wait(lambda: lists.all_inner_texts() != before)


def test_a_pause_does_not_hold_what_is_searched_for(page):
    show(page, 'devices')
    page.get_by_role('button', name='Pause').click()
    page.get_by_label('Search devices').fill('left_knee')
    wait(lambda: page.locator('.devices tbody tr').count() == 1)


PRINTED = """() => {
    const canvas = [...document.querySelectorAll('canvas')].find((one) => one.checkVisibility());
    const style = getComputedStyle(document.documentElement);
    const inks = new Set();
    if (canvas) {
        const {data} = canvas.getContext('2d').getImageData(0, 0, canvas.width, canvas.height);
        for (let at = 0; at < data.length; at += 4) {
            if (data[at + 3] === 255) inks.add(data.slice(at, at + 3).join());
        }
    }
    return {ground: style.backgroundColor, text: style.color, inks: [...inks],
        plot: canvas ? style.getPropertyValue('--plot-0') : '',
        shown: [...document.querySelectorAll(
            'button, input:not([type=datetime-local]), .views, .live, .beside, .skip')]
            .filter((one) => one.checkVisibility() && !one.closest('th'))
            .filter((one) => one.getBoundingClientRect().bottom > 0)
            .map((one) => one.outerHTML.slice(0, 80)),
        cut: [...document.querySelectorAll('.errors, .events')]
            .filter((one) => one.scrollHeight > one.clientHeight + 1).length};
}"""


def test_on_paper_it_is_black_on_white(dashboard, robot, open_page):
    robot.lost, robot.findings = {7, 11}, FINDINGS
    page = open_page(dashboard.address, color_scheme='dark')
    drawn = 0
    for view in VIEWS:
        show(page, view)
        page.locator('main .panel, main .device, main .tile').first.wait_for()
        see(page, '.title, h1, main .bar', '')
        page.emulate_media(media='print')
        see(page, '#printed:visible', r'20\d\d-\d\d-\d\d \d\d:\d\d:\d\d \(.*UTC.*\), robot')
        wait(lambda: page.evaluate('document.documentElement.dataset.theme') == 'light')
        printed = page.evaluate(PRINTED)
        assert (printed['ground'], printed['text']) == ('rgb(255, 255, 255)', 'rgb(0, 0, 0)')
        assert (printed['shown'], printed['cut']) == ([], 0), view
        if printed['plot']:
            assert printed['plot'] == '#0a63ad'
            drawn += '10,99,173' in printed['inks']
        page.emulate_media(media='screen')
        wait(lambda: page.evaluate('document.documentElement.dataset.theme') == 'dark')
    assert drawn >= 3                           # overview, device, log: plots of light colours


@pytest.mark.parametrize(('view', 'name'), [('devices', 'Cards'), ('device', 'Changing only')])
def test_a_button_that_stays_pressed_is_one_before_it_is_pressed(page, view, name):
    """Without aria-pressed a screen reader says that it is no such button."""
    show(page, view)
    button = page.locator('main').get_by_role('button', name=name)
    assert button.get_attribute('aria-pressed') == 'false'


def test_shortcuts_can_be_switched_off(page):
    page.locator('#show-keys').click()
    page.locator('#shortcuts').uncheck()
    page.keyboard.press('Escape')
    page.keyboard.press('4')
    page.keyboard.press('2')
    assert page.locator('.tile').count()
    page.reload()
    page.locator('.tile').first.wait_for()
    page.keyboard.press('2')
    assert page.locator('.tile').count()


def test_search_is_in_the_address(dashboard, robot, open_page):
    page = open_page(f'{dashboard.address}#/devices?find=knee&by=temperature')
    wait(lambda: page.locator('.devices tbody tr').count() == 2)
    assert page.get_by_label('Search devices').input_value() == 'knee'
    assert page.locator('[aria-sort=descending]').inner_text().startswith('\u00b0C')
    page.get_by_label('Search devices').fill('left_knee')
    wait(lambda: 'find=left_knee' in page.evaluate('location.hash'))
    page.get_by_role('button', name='Cards').click()
    page.locator('.device').first.wait_for()
    assert 'as=cards' in page.evaluate('location.hash')


HOSTILE = '<img src=x onerror=alert(1)><script>alert(2)</script>'


def hostile_statuses():
    values = [('Model', HOSTILE), ('Firmware Version', 'NaN'), ('State', 'connected'),
              (f'{HOSTILE} (rad)', 'nan'), ('Not a number (V)', 'NaN'), ('Endless (A)', 'inf'),
              ('Huge', '9' * 400), ('Long', 'A' * 1_000_000), (b'\xff\xfe', b'\xed\xa0\x80'),
              ('', ''), ('__proto__', '1'), ('constructor', '{}'),
              (f'finding.{HOSTILE}', HOSTILE),
              ('observed', '{"Not a number":[0.1,"r"],"Endless":[NaN,"x"],"__proto__":[1,"r"]}')]
    bus = [('Port', HOSTILE), ('Baud (bit/s)', 'NaN'), ('error 00', HOSTILE),
           ('error 01', 'B' * 1_000_000)]
    return [Status('dxl_monitor: 001', Level.WARN, f'`{HOSTILE}` `', '1', values),
            Status(f'dxl_monitor: 002 {HOSTILE}', Level.OK, 'C' * 1_000_000, '2', values),
            Status(f'dxl_monitor: {HOSTILE}/003', Level.OK, '\u202e\0\n', f'{HOSTILE}/3',
                   values),
            Status('dxl_monitor: 004 __proto__', 7, '', '4', values[:3]),
            Status('dxl_monitor: bus', Level.ERROR, HOSTILE, '', bus),
            Status(f'dxl_monitor: timing/{HOSTILE}', Level.OK, '', '', [('value (%)', 'NaN')]),
            Status('vel2d_bridge: link', Level.OK, HOSTILE, '', [
                ('Port', HOSTILE), ('State', HOSTILE), ('Last x (m/s)', 'NaN'),
                ('Last y (m/s)', '1e400'), ('Last omega (rad/s)', HOSTILE)])]


def test_hostile_values_are_text(open_page):
    with Dashboard() as dashboard:
        for _ in range(3):
            dashboard.take([('dxl/diagnostics', serialise(hostile_statuses())),
                            ('/diagnostics', b'\0\1\0\0garbage')])
        page = open_page(dashboard.address)
        see(page, '.tile', re.escape(HOSTILE))
        show(page, 'log')
        see(page, '.errors li', re.escape(HOSTILE))
        see(page, '.errors li', '1000000 bytes')
        show(page, 'bridge')
        see(page, '.axes', 'NaN')
        page.goto(f'{dashboard.address}#/device/dxl_monitor: 001')
        see(page, '.fields td', 'NaN')
        see(page, '.fields td', '1000000 bytes')
        page.goto(f'{dashboard.address}#/devices')
        assert page.locator('.devices tbody tr').count() == 4
        assert page.locator('img').count() == 0
        assert page.locator('script').count() == 2
        page.context.close()


@pytest.mark.parametrize('address', [
    '#/device/unknown', '#/devices/x/y', '#/log/%', '#/%ff', '#/constructor', '#//', '#/device/',
    '#/finding/unknown', '#/finding/constructor', '#/finding'])
def test_any_address(dashboard, robot, open_page, address):
    page = open_page(dashboard.address + address)
    page.locator('main > *').first.wait_for()
    see(page, '#live', 'live')


def test_nothing_published_yet(open_page):
    with Dashboard() as dashboard:
        page = open_page(dashboard.address)
        see(page, '.empty', 'There is no publisher of dxl/diagnostics in ROS domain')
        see(page, '.empty', 'ros2 run mecarover_serial dxl_monitor')
        show(page, 'bridge')
        see(page, '.empty', 'vel2d_bridge')
        dashboard.server.store_publishers({'dxl/diagnostics': 1, 'vel2d/timing': 1})
        see(page, '.empty', '1 publisher of vel2d/timing, but no message yet')
        page.context.close()


@contextmanager
def lost_requests_allowed(page):
    """Allow the browser to log that it could not connect: that is what is tested."""
    yield
    page.complaints[:] = [one for one in page.complaints if 'ERR_' not in one]


def test_a_lost_connection_is_said_and_heals(open_page):
    with Dashboard() as dashboard, Feed(dashboard) as feed:
        page = open_page(dashboard.address)
        see(page, BAR, '24 of 24')
        show(page, 'device')
        row(page, 'Present Position').wait_for()
        with lost_requests_allowed(page):
            dashboard.stop()
            page.locator('#banner').wait_for()
            assert 'No connection to the dashboard. These values are old' \
                in page.locator('#banner').inner_text()
            see(page, '#live', 'lost')
            assert 'no connection' in page.title()
            feed.robot.lost = {7}
            dashboard.start()
            page.locator('#banner').wait_for(state='hidden')
            see(page, '.badge', 'disconnected')
            see(page, '.device-head .message', '7 answers missed')
            see(page, '#live', 'live')
        page.context.close()


def test_open_to_the_network_is_said_on_the_page(open_page):
    with Dashboard(is_open=True) as dashboard:
        page = open_page(dashboard.address)
        see(page, '#foot', 'Open to the network: everybody who can reach 127.0.0.1')
        page.context.close()
