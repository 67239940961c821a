# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""
The states of a robot, and what the page, a scrape, an alert and the terminal make of each.

Buses are simulated and judged by the monitor itself; a bridge reports what its own functions say.
The clock is moved on, so that nothing waits for what falls silent.
"""
from functools import cache
from pathlib import Path
import re
import time
from types import SimpleNamespace
from urllib.request import urlopen

from synthetic_robot import serialise
from synthetic_robot import SyntheticRobot

from benchmark import confusion
from benchmark.confusion_cases import Scene
from dxl_monitor.bus.decoder import Settings
from dxl_monitor.bus.expected import parse_all
from dxl_monitor.monitor import Monitor
from dxl_monitor.monitor_status import PortState
from dxl_monitor.monitor_status import statuses_of
from mecarover_dashboard.state import OVERVIEW
from mecarover_dashboard.state import State
from mecarover_dashboard.state import TABLES
from mecarover_dashboard.status_lines import screen
from mecarover_dashboard.status_lines import status_lines

ARM = ('1-6:MX-64',)
ALERTS = (Path(__file__).parents[1] / 'deploy/alerts.yml').read_text()
GONE = '/dev/ttyUSB0: there is no such device; plug it in'
_QUIET_S = 5.0


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
                 silent=()):
        self.buses = {'': heard()} if buses is None else buses
        self._port = port
        self.silent = silent                   # nodes that do not report any more
        self._node = '/'.join(filter(None, (namespace, 'dxl_monitor')))
        self._bridge = bridge and bridge({}, namespace)
        if self._bridge:
            self._bridge.bridge_problem = problem

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
    """A cause, and what of it each way to look at a robot must say (a pattern)."""

    def __init__(self, cause, headline, mark, problem, *robots, level=2, count=''):
        self.cause, self.headline, self.mark, self.problem = cause, headline, mark, problem
        self.robots, self.level, self.count = robots or (Robot(),), level, count


def rows():
    lost = heard('silent:3:1', waits=False)
    return [
        Row('all is well', 'All 6 devices connected', '', '', level=0, count='6/6'),
        Row('one servo lost', 'Lost: 003, no answer', '1 lost', 'lost',
            Robot(buses={'': lost}), count='5/6'),
        Row('first servo of a Sync Read dead', 'none of 6 devices answers.*check power',
            'no device answers', 'no device answers',
            Robot(buses={'': heard('silent:1:1')}), count='0/6'),
        Row('supply or first cable', 'none of 6 devices answers.*check power',
            'no device answers', 'no device answers',
            Robot(buses={'': heard('cable:1:1')}), count='0/6'),
        Row('cable broken in the middle', 'Lost: 003, .*after it are never read',
            '1 lost', 'lost', Robot(buses={'': heard('cable:3:1')}), count='2/6'),
        Row('servo too hot', 'Error: 003, .*80 °C', '1 error', 'error',
            Robot(buses={'': heard('hot:3:1')}), count='6/6'),
        Row('hardware error', 'Error: 003, .*overload', '1 error', 'error',
            Robot(buses={'': heard('latched:3:1')}), count='6/6'),
        Row('supply low', 'Error: 003, .*9.5 V', '1 error', 'error',
            Robot(buses={'': heard('low_voltage:3:1')}), count='6/6'),
        Row('late answers', 'Warning: 003, ', '1 warning', 'warning',
            Robot(buses={'': heard('late:3:1')}), level=1, count='6/6'),
        Row('supply failed for a moment', 'restarted together', 'error', 'error',
            Robot(buses={'': heard('brownout::3')}), count='6/6'),
        Row('noise', 'damaged|[Nn]oise', 'warning', 'warning',
            Robot(buses={'': heard('noise::1')}), level=1),
        Row('wrong baud rate', 'no packet', 'no device answers', 'no device answers',
            Robot(buses={'': unheard(b'\x80\x13\xf0\x07' * 8)}), count='0/6'),
        Row('nothing heard yet', 'nothing heard yet', 'silent', 'silent',
            Robot(buses={'': unheard()}), count='0/6'),
        Row('master stopped', 'the master stopped', 'silent', 'silent',
            Robot(buses={'': heard(silence_s=10.0)}), level=3, count='0/6'),
        Row('adapter unplugged', 'no such device; plug it in', 'port closed', 'port closed',
            Robot(port=GONE), count=r'\?/6'),
        Row('adapter unplugged while a servo is lost', 'no such device; plug it in',
            'port closed', 'port closed', Robot(buses={'': lost}, port=GONE), count=r'\?/6'),
        Row('monitor dead', 'No report from dxl_monitor: nothing is known of its 6 devices',
            'no report', 'no report', Robot(silent=('dxl_monitor',)), level=3, count=r'\?/6'),
        Row('monitor frozen while a servo is lost', 'No report from dxl_monitor',
            'no report', 'no report', Robot(buses={'': lost}, silent=('dxl_monitor',)),
            level=3, count=r'\?/6'),
        Row('bridge killed while driving', 'No report from vel2d_bridge.*last state: driving',
            'bridge: no report', 'no report', Robot(silent=('vel2d_bridge',)), level=3),
        Row('MCU unplugged', 'there is no such device', 'bridge: lost', 'lost',
            Robot(problem='/dev/ttyAMA0: there is no such device; plug it in')),
        Row('robot switched off', 'No report from', 'bridge: no report, no report', 'no report',
            Robot(silent=('dxl_monitor', 'vel2d_bridge')), level=3),
    ]


def rows_of_two():
    lost = heard('silent:3:1', waits=False)
    return [
        Row('two robots: one has lost a servo', 'Lost: 003, no answer', 'rover2: 1 lost', 'lost',
            Robot('rover1'), Robot('rover2', buses={'': lost}), count='5/6'),
        Row('two robots: the monitor of one is dead', 'No report from rover1/dxl_monitor',
            'rover1: no report', 'no report', Robot('rover1', silent=('dxl_monitor',)),
            Robot('rover2'), level=3, count=r'\?/6'),
        Row('two robots: two causes', 'none of 6 devices answers',
            'rover1: no device answers, rover2: bridge: no report', 'no device answers',
            Robot('rover1', buses={'': heard('cable:1:1')}),
            Robot('rover2', silent=('vel2d_bridge',)), count='0/6'),
        Row('two robots: two buses, one port closed', 'no such device', 'rover2: .*port closed',
            'port closed', Robot('rover1'), Robot('rover2', port=GONE), count=r'\?/6'),
    ]


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
            self._publish(robots, False)

    def _publish(self, robots, with_silent):
        for robot in robots:
            messages = robot.messages(with_silent)
            self._dashboard.take(messages)
            for topic, message in 3 * messages:        # the gap before was none of theirs
                if topic == OVERVIEW:
                    self._terminal.take(topic, message, self._clock.now())

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
