# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""A dashboard on a free port, fed by a synthetic robot; and the browser that looks at it."""
from contextlib import contextmanager
from importlib import util
from pathlib import Path
import shutil
import time

from harness import Background
from synthetic_robot import SyntheticRobot

SIZES = {'desktop': (1440, 900), 'phone': (390, 844), 'panel': (800, 480), 'touch': (480, 272)}
VIEWS = {'overview': '#/', 'devices': '#/devices', 'device': '#/device/dxl_monitor: 007 left_knee',
         'log': '#/log', 'bridge': '#/bridge', 'history': '#/history',
         'signals': '#/signals?of=dxl_monitor: 007 left_knee&register=Present Position (rad)'}
NAMES = ('chromium', 'chromium-browser', 'google-chrome', 'google-chrome-stable')
OPTIONS = ('--no-sandbox', '--disable-gpu', '--disable-quic', '--no-first-run',
           '--disable-background-networking', '--disable-component-update', '--disable-sync')


def browser_path():
    """Return where Chromium is, None if it is nowhere."""
    return next(filter(None, map(shutil.which, NAMES)), None)


def why_not():
    """Return why there can be no browser test; '' if there can."""
    if util.find_spec('playwright') is None:
        return 'skipped: no playwright; pip install playwright'
    if util.find_spec('aiohttp') is None:
        return 'skipped: no aiohttp; pip install aiohttp'
    if browser_path() is None:
        return 'skipped: no Chromium; sudo apt install chromium'
    return ''


def axe_source():
    """Return the source of axe-core, None if it is not installed."""
    found = util.find_spec('axe_playwright_python')
    return found and (Path(found.origin).parent / 'axe.min.js').read_text()


@contextmanager
def browser():
    from playwright.sync_api import sync_playwright
    with sync_playwright() as playwright:
        started = playwright.chromium.launch(executable_path=browser_path(), args=OPTIONS)
        yield started
        started.close()


class Dashboard:
    """A server without ROS; `port` is kept over a restart."""

    def __init__(self, is_open=False, history=None, signals=None):
        self.port = 0
        self._history = history
        self._is_open = is_open
        self._signals = signals
        self.server = None
        self.start()

    def start(self):
        from mecarover_dashboard.history_recorder import HistoryRecorder
        from mecarover_dashboard.ros_server import facts
        from mecarover_dashboard.ros_server import listening_socket
        from mecarover_dashboard.web_server import Server
        listener = listening_socket('127.0.0.1', self.port)
        self.port = listener.getsockname()[1]
        source = 'tap:arm' if self._signals else ''     # each value is heard, not sampled
        about = facts('127.0.0.1', self.port) | {'machine': 'robot', 'source': source}
        recording = self._history and HistoryRecorder(self._history)
        self.server = Server(listener, about, self._is_open, recording,
                             signals=self._signals)
        self.server.start()

    @property
    def address(self):
        return f'http://127.0.0.1:{self.port}/'

    def take(self, messages):
        for topic, message in messages:
            self.server.queue_message(topic, message)

    def stop(self):
        self.server.stop()

    def __enter__(self):
        return self

    def __exit__(self, *_):
        self.stop()


class Feed(Background):
    """Publishes a robot to a dashboard, twice a second, as long as it is entered."""

    def __init__(self, dashboard, robot=None, start_s=100.0):
        self.robot = robot or SyntheticRobot()
        self._dashboard = dashboard
        self._start_s = start_s
        super().__init__()

    def _run(self):
        begun_s = time.monotonic()
        while not self._done.is_set():
            time_s = self._start_s + time.monotonic() - begun_s
            self._dashboard.take(self.robot.messages(time_s))
            self._done.wait(0.5)
