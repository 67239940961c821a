# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""
Takes the pictures of the dashboard for the docs: both nodes on fake hardware, a driven rover.

A walking humanoid with a left knee that falls silent; the pictures are taken when the plots have
something to show. See scripts/screenshots; not a test.
"""
import argparse
from contextlib import ExitStack
import math
import os
from pathlib import Path
import shutil
import sys
import time
from urllib.parse import urlencode

sys.path.insert(0, str(Path(__file__).parents[1]))
os.environ.setdefault('ROS_DOMAIN_ID', str(1 + os.getpid() % 100))
os.environ.setdefault('ROS_AUTOMATIC_DISCOVERY_RANGE', 'LOCALHOST')

import dashboard_page
from dashboard_page import SIZES
from dashboard_page import VIEWS
from harness import Program
from harness import wait
import ros_side
from synthetic_robot import JOINTS

ROOT = Path(__file__).parents[1]
FOR_DOCS = ('overview-desktop-dark', 'overview-desktop-light', 'overview-phone-light',
            'overview-touch-dark', 'device-desktop-light', 'log-desktop-light',
            'bridge-desktop-dark', 'history-desktop-light', 'signals-desktop-light')
WARM_UP_S = 75                  # until the plots have lines
LOOK_S = {'device': 20, 'signals': 22}      # so that their plots have lines
BAUD = '2000000'
CHOSEN = urlencode([pair for joint, register in (
    ('008 right_knee', 'Present Position (rad)'), ('008 right_knee', 'Goal Position (rad)'),
    ('014 right_shoulder_pitch', 'Present Current (A)'),
    ('014 right_shoulder_pitch', 'Present Temperature (\u00b0C)'))
    for pair in (('of', f'dxl_monitor: {joint}'), ('register', register))])
# The names of the ports are in the pictures. PORTS=/dev gives real ones: run it as root in a mount
# namespace (unshare -m) where /dev is an overlay, so that the machine's own stays as it is.
FOLDER = Path(os.environ.get('PORTS', '/tmp/dev'))
SERVOS = 18
DEVICES = [*(f'{at + 1}:{"MX-106" if at < 10 else "MX-64"}:{JOINTS[at]}' for at in range(SERVOS)),
           '100:Rhoban DXL Board:power', '101:BitFoot:left_foot', '102:BitFoot:right_foot',
           '103:Bit-Bots IMU:imu']


DASHBOARD = """
import socket, sys
socket.gethostname = lambda: 'wolfgang'
from mecarover_dashboard.dxl_dashboard import main
sys.exit(main())
"""


def drive():
    """Return a command of somebody who drives in wide bends."""
    bend = time.monotonic() / 4
    x, y, omega = 0.32 + 0.06 * math.sin(bend), 0.05 * math.cos(bend), 0.6 * math.sin(bend)
    return ros_side.twist(x, y, omega)


def robot(stack, folder):
    """Start everything, return the address of the page with ROS and of that without."""
    bus, mcu, tap = folder / 'ttyUSB0', folder / 'ttyAMA0', folder / 'ttyUSB1'
    start = stack.enter_context
    start(Program('mecarover_fakes.fake_bus', '--link', str(bus), '--behind-silent', 'answer',
                  '--tap', str(tap), '--pattern', 'moving',
                  '--fault', f'silent:7:{WARM_UP_S}:600', '--fault', f'hot:14:{WARM_UP_S}:600'))
    start(Program('mecarover_fakes.fake_mcu', '--link', str(mcu)))
    dashboard = start(Program('', '--port', '0', '--history', str(folder / 'history.sqlite'),
                              script=DASHBOARD))
    wait(lambda: bus.exists() and mcu.exists() and tap.exists())
    without_ros = start(Program('', str(tap), '-b', BAUD, '--no-browser', '--port', '0',
                                '--history', 'none', '--devices', ','.join(DEVICES),
                                script=DASHBOARD))
    start(Program('dxl_monitor.start', '--ros-args', '-p', f"ports:=['{bus}']",
                  '-p', f'devices:={DEVICES}'))
    start(Program('vel2d_bridge.main', '--ros-args', '-p', f'port:={mcu}'))
    graph = start(ros_side.Graph('operator'))
    start(ros_side.Teleop(graph.publisher(), drive, rate=10))
    return [one.wait_for('http://').split()[1] for one in (dashboard, without_ros)]


def take(browser, places, folder, wanted):
    """Take the wanted pictures, one page for each size and theme."""
    for size, (width, height) in SIZES.items():
        for theme in ('dark', 'light'):
            views = [view for view in places if f'{view}-{size}-{theme}' in wanted]
            if not views:
                continue
            context = browser.new_context(
                viewport={'width': width, 'height': height}, color_scheme=theme,
                has_touch=size != 'desktop', is_mobile=size != 'desktop',
                device_scale_factor=2 if size == 'phone' else 1)
            page = context.new_page()
            for view in views:
                page.goto(places[view])
                page.locator('main .panel, main .device, main .tile').first.wait_for()
                page.wait_for_timeout(1000 * LOOK_S.get(view, 2))
                if view == 'signals':
                    page.locator('canvas').first.hover(position={'x': 0.6 * width, 'y': 50})
                path = folder / f'dashboard-{view}-{size}-{theme}.png'
                page.screenshot(path=path)
                print(path.name, flush=True)
            context.close()


def main():
    parser = argparse.ArgumentParser(description=__doc__.strip().partition('\n')[0])
    parser.add_argument('--all', metavar='FOLDER', type=Path,
                        help='every view in every size and theme, to a folder')
    folder = parser.parse_args().all
    why_not = dashboard_page.why_not()
    if why_not:
        print(f'screenshots: {why_not}', file=sys.stderr)
        return 1
    everything = [f'{view}-{size}-{theme}' for view in VIEWS for size in SIZES
                  for theme in ('dark', 'light')]
    with ExitStack() as stack:
        if not FOLDER.exists():
            FOLDER.mkdir()
            stack.callback(shutil.rmtree, FOLDER)
        address, without_ros = robot(stack, FOLDER)
        places = {view: f'{address}/{place}' for view, place in VIEWS.items()} | {
            'signals': f'{without_ros}/#/signals?{CHOSEN}'}
        browser = stack.enter_context(dashboard_page.browser())
        print(f'screenshots: the robot walks for {WARM_UP_S} s first', flush=True)
        time.sleep(WARM_UP_S)
        page = browser.new_page()
        page.goto(address)
        page.locator('.buses .buses .bar[data-state=error]').wait_for(timeout=120_000)
        page.close()
        if folder:
            folder.mkdir(parents=True, exist_ok=True)
        take(browser, places, folder or ROOT / 'docs/images', everything if folder else FOR_DOCS)
    return 0


if __name__ == '__main__':
    sys.exit(main())
