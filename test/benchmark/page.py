# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""
The time between two frames of the page in a browser, where much comes: devices, or values.

The server runs in this process, as one without ROS. A frame that comes late is one that a person
sees as a jerk; a browser without a screen makes 60 a second, so that 16.7 ms is all there is.
"""

from contextlib import ExitStack
from itertools import cycle
import sys
import time
from urllib.parse import urlencode

import dashboard_page
from dashboard_page import Dashboard
from dashboard_page import SIZES
from harness import Background
from synthetic_robot import MANY
from synthetic_robot import SyntheticRobot

from msg_defs.signal import PointRing
from rigs.harness import Figure
from rigs.harness import quantile

SECTION = 'page: time between two frames'
WARM_UP_S = 5.0
ALLOWED_MS = 17.0               # at the 99th percentile
SERVOS = tuple((number, 'MX-106', '') for number in range(1, 21))
KEY = 'Present Position (rad)'
SHOWN = 8                       # as many as a page may show
FRAMES = """(ms) => new Promise((end) => {
    const times = [];
    const begin = performance.now();
    const note = (now) => {
        times.push(now);
        if (performance.now() - begin < ms) requestAnimationFrame(note);
        else end(times.slice(1).map((at, index) => at - times[index]));
    };
    requestAnimationFrame(note);
})"""


def run(options):
    """Look at each view; a figure has the time between any two frames."""
    why_not = dashboard_page.why_not()
    if why_not:
        print(f'page: {why_not}', file=sys.stderr)
        return []
    signals = urlencode([pair for number, *_ in SERVOS[:SHOWN] for pair in (
        ('of', f'dxl_monitor: {number:03}'), ('register', KEY))])
    cases = {
        'overview, 20 servos, 2 Hz': ('#/', 2.0, SERVOS, None),      # what the machine itself adds
        'overview, 253 devices, 10 Hz': ('#/', 10.0, MANY, None),
        'devices, 253 devices, 10 Hz': ('#/devices', 10.0, MANY, None),
        f'signals, {SHOWN} of 20 servos, 500 Hz': (
            f'#/signals?{signals}', 2.0, SERVOS, FastSignals(500.0)),
    }
    with dashboard_page.browser() as browser:
        return [figure for name, case in cases.items()
                for figure in _figures(name, _frames(browser, options.seconds, *case))]


def problems(figures):
    """Return what must not be."""
    return [f'{one.name}: {one.median:.1f} ms, {ALLOWED_MS:g} is allowed'
            for one in figures if one.name.endswith('p99') and one.median > ALLOWED_MS]


def _figures(name, times_ms):
    return [Figure(SECTION, f'{name}: {word}', 'ms', [quantile(times_ms, share)], beside)
            for word, share, beside in (('p50', 0.5, ''), ('max', 1.0, ''), (
                'p99', 0.99, f'at most {ALLOWED_MS:g}'))]


def _frames(browser, seconds, place, rate, devices, source):
    with ExitStack() as stack:
        dashboard = stack.enter_context(Dashboard(signals=source))
        stack.enter_context(_Feed(dashboard, devices, rate))
        width, height = SIZES['desktop']
        context = browser.new_context(viewport={'width': width, 'height': height})
        stack.callback(context.close)
        page = context.new_page()
        page.goto(dashboard.address + place)
        page.locator('.cell, .devices tbody tr, .legend b').first.wait_for(state='attached')
        page.wait_for_timeout(1000 * WARM_UP_S)
        return page.evaluate(FRAMES, 1000 * seconds)


class FastSignals:
    """Each register that is asked for has a value at each multiple of a time."""

    def __init__(self, rate):
        self._rate = rate
        self._rings = {}

    def clock(self):
        return time.monotonic(), time.time() - time.monotonic()

    def signal(self, name, key, after):
        ring = self._rings.setdefault((name, key), PointRing())
        now_s = time.monotonic()
        last = int(max(ring.last_s(), now_s - 60.0) * self._rate + 0.5)
        for at in range(last + 1, int(now_s * self._rate)):
            ring.add(at / self._rate, at * 37 % 101 / 50)
        return ring.after(after, now_s - 60.0)

    def drop(self, name, key):
        del self._rings[name, key]


class _Feed(Background):
    """Publishes devices to a dashboard, each time other values."""

    def __init__(self, dashboard, devices, rate):
        robot = SyntheticRobot({'': devices})
        self._messages = cycle([robot.messages(100.0 + at) for at in range(10)])
        self._dashboard = dashboard
        self._rate = rate
        super().__init__()

    def _run(self):
        while not self._done.wait(1.0 / self._rate):
            self._dashboard.take(next(self._messages))
