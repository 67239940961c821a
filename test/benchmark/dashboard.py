# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""
From a servo that falls silent on the bus to the event that turns its page red, in real processes.

dxl_monitor, dxl_dashboard with its history, and this process, which is the bus on a pty and hears
the stream that a page gets. One servo after the other falls silent, at no particular moment of
cycles and reports, and comes back.
"""

from contextlib import ExitStack
import json
from pathlib import Path
import random
from tempfile import TemporaryDirectory
import time
from urllib.request import urlopen

from mecarover_fakes.bus_ptys import FakeBus
from mecarover_fakes.fake_bus import make_devices
from mecarover_fakes.line import Line
from mecarover_fakes.master import Master
from mecarover_fakes.traffic import PATTERNS
from msg_defs.diagnostics import Level
from rigs.harness import Child
from rigs.harness import Figure
from rigs.harness import ros_environment
from servobus.model.models import Models

SECTION = 'dashboard: silent on the bus to red on the page'
SERVOS = 20
ENTRY = f'1-{SERVOS}:MX-106'
BAUD = 2_000_000
ROUNDS = 21
START_S = 30.0                  # until the nodes have found each other and all is well
DEADLINE_S = 10.0               # for each change after that
ALLOWED_S = 0.5                 # at the median


def run(options):
    rng = random.Random(1)
    env = ros_environment()
    with ExitStack() as stack:
        folder = Path(stack.enter_context(TemporaryDirectory()))
        devices = make_devices([ENTRY], Models(), BAUD)
        bus = FakeBus(Master(Line(devices, BAUD, waits_in_line=False), PATTERNS['moving']))
        stack.callback(bus.stop)
        bus.start()
        stack.enter_context(Child(
            'dxl_monitor.start', '--ros-args', '-p', f"ports:=['{bus.path}']",
            '-p', f"devices:=['{ENTRY}']", env=env, quiet=True))
        dashboard = stack.enter_context(Child(
            'mecarover_dashboard.ros_server', '--port', '0',
            '--history', str(folder / 'history.sqlite'), env=env, quiet=True))
        page = Page(stack.enter_context(
            urlopen(f'{dashboard.read_line().split()[1]}/events', timeout=START_S)))
        for device in devices:
            page.wait(device.id, _is_well, START_S)
        took = []
        for at in range(options.asked_rounds or (options.rounds if options.quick else ROUNDS)):
            device = devices[at % SERVOS]
            time.sleep(rng.uniform(0.5, 1.5))
            device.silent, fault_s = True, time.monotonic()
            took.append(page.wait(device.id, _is_red) - fault_s)
            device.silent = False
            page.wait(device.id, lambda row: not _is_red(row))
    return [Figure(SECTION, 'a silent servo', 's', took, f'at most {ALLOWED_S:g} at the median')]


def problems(figures):
    """Return what must not be."""
    return [f'{one.name}: red after {one.median:.2f} s at the median, {ALLOWED_S:g} is allowed'
            for one in figures if one.median > ALLOWED_S]


def _is_well(row):
    return bool(row['level'] == Level.OK)


def _is_red(row):
    return bool(row['level'] == Level.ERROR)


class Page:
    """What a page knows of the devices."""

    def __init__(self, stream):
        self._stream = stream
        self._rows = {}

    def wait(self, device, is_so, seconds=DEADLINE_S):
        """Return when something is so of a device (monotonic s)."""
        now_s = time.monotonic()
        deadline = now_s + seconds
        while not (device in self._rows and is_so(self._rows[device])):
            event = self._event()
            if (now_s := time.monotonic()) > deadline:
                raise TimeoutError(f'device {device}: no such change within {seconds:g} s')
            for row in event.get('devices', {}).values():
                if row is not None:
                    self._rows[row['id']] = row
        return now_s

    def _event(self):
        """Return the next server-sent event."""
        for line in self._stream:
            if line.startswith(b'data: '):
                return json.loads(line.removeprefix(b'data: '))
        raise ConnectionError('dxl_dashboard: ended; run it alone to see why')
