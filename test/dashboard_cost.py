# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""
What the dashboard costs with 253 devices of 60 fields at 2 Hz, as a table: not a test.

    .venv/bin/python test/dashboard_cost.py [SECONDS]

Server: CPU time of its whole process, ROS included. Page: CPU time of Chromium's main thread.
Red after: from publishing a lost device to a red bar, polled each frame by the page itself.
"""
import os
from pathlib import Path
import sys
from tempfile import TemporaryDirectory
import threading
import time

sys.path.insert(0, str(Path(__file__).parents[1]))
os.environ.setdefault('ROS_DOMAIN_ID', '77')
os.environ.setdefault('ROS_AUTOMATIC_DISCOVERY_RANGE', 'LOCALHOST')

import dashboard_page
from diagnostic_msgs.msg import DiagnosticArray
from harness import Program
import rclpy
from synthetic_robot import MANY
from synthetic_robot import SyntheticRobot

from rigs.harness import usage

PREPARED = 20                   # reports, played in a loop
WATCH_BAR = """() => { window.redAt = new Promise((resolve) => {
    const look = () => document.querySelector('.buses .buses .bar')?.dataset.state === 'error'
        ? resolve(Date.now()) : requestAnimationFrame(look);
    look(); }); }"""


class Publisher:
    """Plays prepared reports as the nodes do: tables at 2 Hz, the rest at 1 Hz."""

    def __init__(self):
        robot = SyntheticRobot({'': MANY})
        self._reports = [robot.messages(100 + i / 2, all_topics=i % 2 == 0)
                         for i in range(PREPARED)]
        robot.lost = {42}
        self._lost = robot.messages(100.0)
        self.is_lost = threading.Event()
        self.lost_at = 0.0
        self._done = threading.Event()
        rclpy.init()
        self._node = rclpy.create_node('robot')
        self._publishers = {topic: self._node.create_publisher(DiagnosticArray, topic, 100)
                            for topic, _ in self._reports[0]}
        self._thread = threading.Thread(target=self._run)

    def _run(self):
        at = 0
        while not self._done.is_set():
            messages = self._reports[at % PREPARED]
            if self.is_lost.is_set():
                messages, self.lost_at = self._lost, self.lost_at or time.time()
            for topic, message in messages:
                self._publishers[topic].publish(message)
            at += 1
            self._done.wait(0.5)

    def __enter__(self):
        self._thread.start()
        return self

    def __exit__(self, *_):
        self._done.set()
        self._thread.join()
        rclpy.shutdown()


def measure(page, session, pid, seconds):
    """Return the busy share of the server and of the page's main thread, in %."""
    def busy():
        metrics = session.send('Performance.getMetrics')['metrics']
        return next(one['value'] for one in metrics if one['name'] == 'TaskDuration')
    page.wait_for_timeout(2000)
    begin, server, task = time.monotonic(), usage(pid).cpu_s, busy()
    page.wait_for_timeout(1000 * seconds)
    elapsed = time.monotonic() - begin
    return 100 * (usage(pid).cpu_s - server) / elapsed, 100 * (busy() - task) / elapsed


def main(seconds=10.0):
    views = {**dashboard_page.VIEWS, 'device': '#/device/dxl_monitor: 042'}
    with TemporaryDirectory() as folder, Program(
            'mecarover_dashboard.serve', '--port', '0', '--history', f'{folder}/history.sqlite',
            ) as server, Publisher() as robot, dashboard_page.browser() as browser:
        address = server.wait_for('http://').split()[1]
        page = browser.new_page(viewport={'width': 1280, 'height': 800})
        session = page.context.new_cdp_session(page)
        session.send('Performance.enable', {'timeDomain': 'threadTicks'})
        print(f'{"view":10}  {"server":>7}  {"page":>7}')
        for view, path in views.items():
            page.goto(f'{address}/{path}')
            page.locator('main .panel, main .device').first.wait_for()
            print('{:10}  {:5.1f} %  {:5.1f} %'.format(
                view, *measure(page, session, server.pid, seconds)), flush=True)
        page.goto(f'{address}/#/')
        page.locator('.buses .buses .bar[data-state=ok]').wait_for()
        page.evaluate(WATCH_BAR)
        robot.is_lost.set()
        red_at = page.evaluate('window.redAt')
        print(f'red after   {red_at / 1000 - robot.lost_at:.2f} s')


if __name__ == '__main__':
    main(*map(float, sys.argv[1:2]))
