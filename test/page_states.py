# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""
The states of a robot, and what the page, a scrape, an alert and the terminal make of each.

Buses are simulated and judged by the monitor itself.
The clock is moved on, so that nothing waits for what falls silent.
"""
from functools import cache
from pathlib import Path
import re
import time
from types import SimpleNamespace
from urllib.request import urlopen

from harness import wait
from synthetic_robot import NO_COMMANDS
from synthetic_robot import serialise
from synthetic_robot import SyntheticRobot
import yaml

from benchmark import confusion
from benchmark.confusion_cases import Scene
from mecarover_dashboard.state import OVERVIEW
from mecarover_dashboard.state import State
from mecarover_dashboard.state import TABLES
from mecarover_dashboard.status_lines import screen
from mecarover_dashboard.status_lines import status_lines
from servobus.bus.decoder import Settings
from servobus.bus.expected_devices import parse_all
from servobus.monitor import Monitor
from servobus.status import PortState
from servobus.status import statuses_of

ARM = ('1-6:MX-64',)
ALERTS = (Path(__file__).parents[1] / 'deploy/alerts.yml').read_text()
GONE = '/dev/ttyUSB0: there is no such device; plug it in'
_QUIET_S = 5.0
_PERIOD_S = 0.5
PLACES = ('', 'devices', 'device/dxl_monitor: 003', 'log', 'bridge', 'history', 'signals')
_SENTENCE_MIN_WORDS = 4
# Go to a place; return the texts that are seen there as (text, list whose lines are records).
_TEXTS = """(place) => new Promise((done) => {
    const look = () => {
        const walker = document.createTreeWalker(document.body, NodeFilter.SHOW_TEXT);
        const found = [];
        for (let node; (node = walker.nextNode());) {
            const one = node.parentElement;
            const records = one.closest('table, .errors, .events');
            const isSeen = node.data.trim() && one.checkVisibility() && !one.closest('.unseen');
            if (isSeen) found.push([node.data, records?.className ?? '']);
        }
        if (found.some(([text]) => text.startsWith('Waiting'))) setTimeout(look, 20);
        else done(found);
    };
    addEventListener('hashchange', look, {once: true});
    location.hash = place;
})"""


@cache
def heard(*faults, waits=True, silence_s=0.0):
    """Return the last report of a bus of six servos; the master stopped `silence_s` before."""
    scene = Scene(devices=ARM, waits_in_line=waits, rate=20.0)
    *_, report = confusion.reports(list(faults), scene, 6.0, silence_s=silence_s)
    return report


@cache
def unheard(chunk=b''):
    """Return the report of a bus on which nothing came, or what is no packet."""
    monitor = Monitor('bus', confusion.MODELS, Settings(devices=tuple(parse_all(ARM))))
    for at in range(20 if chunk else 0):
        monitor.feed(chunk, at * 100_000_000)
    return monitor.report(2_000_000_000)


class Robot:
    """What one robot publishes: its buses by name as reports, and its bridge."""

    def __init__(self, namespace='', buses=None, port='', bridge=SyntheticRobot, problem='',
                 silent=(), is_idle=False):
        self.buses = {'': heard()} if buses is None else buses
        self._port = port
        self.silent = silent                   # nodes that do not report any more
        self._node = '/'.join(filter(None, (namespace, 'dxl_monitor')))
        self._bridge = bridge and bridge({}, namespace)
        if self._bridge:
            self._bridge.bridge_problem = problem
            if is_idle:
                self._bridge.velocity = (0.0, 0.0, 0.0)
                self._bridge.absence = NO_COMMANDS

    def port_state(self):
        return PortState('/dev/ttyUSB0', self._port, ())

    def messages(self, with_silent=False):
        """Return what it publishes, without that of the silent nodes where these are silent."""
        found = []
        if with_silent or 'dxl_monitor' not in self.silent:
            for topic, is_whole in ((TABLES, True), (OVERVIEW, False)):
                for bus, report in self.buses.items():
                    port = self.port_state()
                    found.append((topic, serialise(
                        statuses_of(self._node, bus, report, port, is_whole))))
        if self._bridge and (with_silent or 'vel2d_bridge' not in self.silent):
            found.append((OVERVIEW, serialise(self._bridge.bridge(100.0))))
        return found


class Row:
    """A cause, and what of it each way to look at a robot must say (page_states.yaml)."""

    def __init__(self, cause, headline, mark='', problem='', level=2, count='', robots=(),
                 remedy=''):
        self.cause, self.headline, self.mark, self.problem = cause, headline, mark, problem
        self.remedy = remedy
        self.robots, self.level, self.count = [
            _robot(**one) for one in robots] or [Robot()], level, count

    @property
    def bar(self):
        """The text that is seen first: of devices that have cards of their own it is the mark."""
        names_devices = re.match('(Lost|Error|Warning): ', self.headline)
        return self.mark if names_devices and len(self.robots) == 1 else self.headline


def _robot(bus=None, port='', **of):
    if bus is not None:
        of['buses'] = {'': unheard(8 * bytes.fromhex(bus['chunk'])) if 'chunk' in bus else heard(
            *bus.get('faults', '').split(), waits=bus.get('waits', True),
            silence_s=bus.get('silence_s', 0.0))}
    return Robot(port=port and GONE, **of)


def rows(of):
    table = Path(__file__).with_suffix('.yaml').read_text(encoding='utf-8')
    return [Row(**row) for row in yaml.safe_load(table)[of]]


def places(robots):
    """Return the places of the page while it shows these robots, the overview last."""
    if len(robots) == 1:
        return [f'#/{place}' for place in reversed(PLACES)]
    return [f'#/@rover{number}/{place.replace("dxl", f"rover{number}%2Fdxl")}'
            for number in (1, 2) for place in PLACES] + ['#/']


def repeated(page, place):
    """
    Return the sentences that a place of the page says twice.

    Each line of a table, and of a list of events, is of another device or time.
    """
    texts = [(text.lower(), records) for text, records in page.evaluate(_TEXTS, place)]
    return sorted({part for at, (text, records) in enumerate(texts)
                   for part in re.split(r'[;.:(]\s|[.)]$', text)
                   if len(re.findall('[a-z]{2,}', part)) >= _SENTENCE_MIN_WORDS
                   and any(part in other for one, (other, of) in enumerate(texts)
                           if one != at and not (records and records == of))})


class Clock:
    """The clock of the server, which can be moved on."""

    def __init__(self, monkeypatch):
        self._ahead_s = 0.0
        monkeypatch.setattr('mecarover_dashboard.web_server.time', SimpleNamespace(
            monotonic=self.now, time=lambda: time.time() + self._ahead_s))

    def now(self):
        return time.monotonic() + self._ahead_s

    def move(self, seconds):
        self._ahead_s += seconds


class Stage:
    """A dashboard and a terminal that hear the same robots."""

    def __init__(self, dashboard, clock):
        self._dashboard, self._clock = dashboard, clock
        self._terminal = State()

    def play(self, robots):
        """Have the robots report; then time goes by, and those that are not silent go on."""
        self._publish(robots, True)
        if any(robot.silent for robot in robots):
            self._clock.move(_QUIET_S)
            self.go_on(robots)

    def go_on(self, robots):
        """Have those that are not silent report once more."""
        self._publish(robots, False)

    def wait_for(self, robots, condition):
        """Wait for it, while they go on to report: on a busy machine the page may need long."""
        reported_s = time.monotonic()

        def is_met():
            nonlocal reported_s
            if time.monotonic() - reported_s > _PERIOD_S:
                reported_s = time.monotonic()
                self.go_on(robots)
            return condition()
        return wait(is_met)

    def _publish(self, robots, with_silent):
        for robot in robots:
            messages = robot.messages(with_silent)
            self._dashboard.take(messages)
            for topic, message in 3 * messages:        # the gap before was none of theirs
                if topic == OVERVIEW:
                    self._terminal.store_message(topic, message, self._clock.now())

    def terminal(self):
        """Return the lines of mecarover_status."""
        return screen(status_lines(self._terminal, self._clock.now()))

    def problems(self):
        """Return {labels: level} of what /metrics says is wrong."""
        self._clock.move(1.1)                  # an answer is kept for a second
        with urlopen(f'{self._dashboard.address}metrics', timeout=20) as answer:
            found = re.findall(r'^mecarover_problem\{(.*)\} (\S+)$', answer.read().decode(), re.M)
        return {labels: float(level) for labels, level in found}


def alerts(problems):
    """Return what the rule `Problem` of deploy/alerts.yml says of such series."""
    at_least, text = re.search(
        r"alert: Problem .*?mecarover_problem >= (\d).*?summary: '(.*?)'\n", ALERTS,
        re.DOTALL).groups()
    return [filled(text, dict(re.findall(r'(\w+)="([^"]*)"', labels)))
            for labels, level in problems.items() if level >= float(at_least)]


def filled(text, labels):
    """Fill a template of Prometheus, as far as our rules use its language."""
    labels['instance'] = 'rover.local:8420'
    text = re.sub(r'\{\{ with \$labels\.(\w+) \}\}(.*?)\{\{ end \}\}',
                  lambda it: labels[it[1]] and it[2].replace('{{ . }}', labels[it[1]]), text)
    return re.sub(r'\{\{ \$labels\.(\w+) \}\}', lambda it: labels[it[1]], text)
