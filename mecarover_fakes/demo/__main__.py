# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""
The demo: a fake MCU, a fake bus, both nodes, and a scripted drive, ending with a verdict.

Every process is started as a user would start it, every figure comes out of a fake or a topic.
"""
from __future__ import annotations

import argparse
from collections.abc import Callable
import json
import math
import os
import re
import socket
import sys
import tempfile
import time
from typing import Any
import urllib.request

from mecarover_fakes.demo.device_watch import DeviceWatch
from mecarover_fakes.demo.process_group import ProcessGroup
from mecarover_fakes.demo.scenes import judge
from mecarover_fakes.demo.scenes import judge_missed
from mecarover_fakes.demo.scenes import MISSED
from mecarover_fakes.demo.scenes import Scene
from mecarover_fakes.demo.scenes import SceneResult
from mecarover_fakes.demo.scenes import SCENES
from mecarover_fakes.demo.scenes import TakenSetPoint
from mecarover_fakes.demo.scenes import TIME_OUT_BOUND_S
from mecarover_fakes.domain_lock import DEMOS
from mecarover_fakes.domain_lock import ReservedDomain
from mecarover_serial.node_command_line import complain_no_ros
from msg_defs.vel2d import STOP
from msg_defs.vel2d import Vel2d
from servobus.tools.cli import COULD_NOT_RUN
from servobus.tools.cli import run_tool

READY_S = 20.0          # starting everything on a busy machine; discovery alone takes up to 2.5 s
COMMAND_PERIOD_S = 0.05
SILENT_ID, SILENT_AT_S, SILENT_FOR_S = 7, 6, 4
DEVICES = ('1-4:MX-106', '5-12:MX-64', '13-15:Rhoban DXL board', '16-18:BitFoot',
           '19-20:Bit-Bots IMU')


def main() -> int:
    """Run the demo; return the exit code."""
    return run_tool('demo', _main)


def _main(arguments: list[str]) -> int:
    options = _parser().parse_args(arguments)
    # Not ROS_DOMAIN_ID: in the domain of a robot the demo would drive it.
    own = ReservedDomain(DEMOS)
    domain = own.number
    os.environ.update(ROS_AUTOMATIC_DISCOVERY_RANGE='LOCALHOST', ROS_DOMAIN_ID=str(domain))
    try:
        from mecarover_fakes.demo.demo_node import Operator
    except ImportError as error:
        return complain_no_ros('demo', error)
    operator = Operator()
    if operator.is_in_company():
        operator.close()
        raise OSError(f"other nodes run in ROS domain {domain}, and the demo's cmd_vel could "
                      'drive a rover; end them, or wait 20 s if they were killed')
    print(f'demo: to see its topics: export ROS_DOMAIN_ID={domain}', flush=True)
    with tempfile.TemporaryDirectory(prefix='mecarover-') as folder, ProcessGroup() as group:
        demo = DemoRun(group, operator, folder, _page_port(domain))
        verdicts = demo.verdicts
        try:
            demo.run(options.seconds)
        except KeyboardInterrupt:
            pass
        finally:
            operator.close()
        group.close()
        demo.compare_missed()
        verdicts += [SceneResult(one.name, one.exit_code == 0, f'ended with {one.exit_code}')
                     for one in reversed(group.processes)]
    return _conclude(verdicts)


def _conclude(verdicts: list[SceneResult]) -> int:
    failed = [one for one in verdicts if not one.passed]
    for one in failed:
        print(f'FAILED  {one.scene}: {one.text}')
    print(f'demo: {len(verdicts) - len(failed)} of {len(verdicts)} checks passed')
    return COULD_NOT_RUN if failed else 0


class DemoRun:
    """One run of the demo."""

    def __init__(self, group: ProcessGroup, operator: Any, folder: str, page_port: str) -> None:
        self.verdicts: list[SceneResult] = []
        self._operator = operator
        self._set_points: list[TakenSetPoint] = []
        mcu = os.path.join(folder, 'mcu')
        bus = os.path.join(folder, 'bus')
        print(f'demo: ports of the fake MCU and bus: {mcu}, bus', flush=True)
        self._mcu = group.start('mecarover_fakes.fake_mcu', '--link', mcu, '--json')
        self._bridge = group.start('vel2d_bridge.main', '--ros-args', '-p', f'port:={mcu}')
        self._devices = DeviceWatch(operator.state)
        self._group = group
        self._truth = os.path.join(folder, 'truth.json')
        devices = ','.join(DEVICES)
        group.start('mecarover_fakes.fake_bus', '--link', bus, '--devices', devices, '--fault',
                    f'silent:{SILENT_ID}:{SILENT_AT_S}:{SILENT_FOR_S}', '--truth', self._truth)
        group.start('dxl_monitor.start', '--ros-args', '-p', f'ports:={bus}', '-p',
                    f'devices:={list(DEVICES)}')
        self._dashboard = group.start('mecarover_dashboard.ros_server', '--port', page_port,
                                        '--history', 'none')

    def run(self, seconds: float | None) -> None:
        """Play scene after scene; with a time limit, every scene once and then until it ends."""
        self._await(self._are_nodes_ready)
        self._load_dashboard()
        end = math.inf if seconds is None else time.monotonic() + seconds
        is_first = True
        while is_first or time.monotonic() < end:
            for scene in SCENES:
                self._play(scene)
            is_first = False
        self.verdicts += self._devices.verdicts(SILENT_ID)

    def compare_missed(self) -> None:
        """Compare what the monitor counted with what the fake bus, which has ended, knows."""
        try:
            with open(self._truth, encoding='utf-8') as file:
                truth = json.load(file)
        except (OSError, ValueError) as error:
            self._add(SceneResult(MISSED, False, f'the fake bus gave no counts: {error}'))
        else:
            self._add(judge_missed(self._devices.missed(), truth))

    def _add(self, verdict: SceneResult) -> None:
        self.verdicts.append(verdict)
        mark = 'ok    ' if verdict.passed else 'FAILED'
        print(f'  {mark}  {verdict.scene:24} {verdict.text}', flush=True)

    def _await(self, is_so: Callable[[], object]) -> None:
        """Wait for something that all processes are needed for."""
        deadline = time.monotonic() + READY_S
        while not is_so():
            self._operator.spin(COMMAND_PERIOD_S)
            for process in self._group.processes:
                if process.exit_code is not None:
                    raise OSError(f'{process.name} ended: {" / ".join(list(process.lines)[-3:])}')
            if time.monotonic() > deadline:
                raise OSError(f'not ready after {READY_S:g} s; the computer may be too busy')

    def _are_nodes_ready(self) -> bool:
        """Tell whether the bridge listens and the monitor reports."""
        self._operator.command(STOP)
        return self._operator.is_heard() and bool(self._devices.devices())

    def _address(self) -> str:
        """Return the address that the dashboard has printed, '' before."""
        found = re.search(r'http://\S+', ' '.join(list(self._dashboard.lines)))
        return found[0] if found else ''

    def _load_dashboard(self) -> None:
        """Say where the page is, and load it."""
        self._await(self._address)
        address = self._devices.page = self._address()
        try:
            with urllib.request.urlopen(address, timeout=READY_S) as page:
                is_page = '<title>' in page.read().decode()
        except (OSError, ValueError) as error:
            self._add(SceneResult('dashboard', False, f'{address}: {error}'))
        else:
            self._add(SceneResult('dashboard', is_page, address))

    def _play(self, scene: Scene) -> None:
        begin = time.monotonic()
        while time.monotonic() < begin + scene.seconds:
            if scene.command is not None:
                self._operator.command(scene.command)
            self._listen(COMMAND_PERIOD_S)
        end = time.monotonic()
        if scene.kill:
            end = self._bridge.kill()
            self._listen(TIME_OUT_BOUND_S)
            self._operator.forget()
            self._bridge.start()
        elif scene.name == 'restarted':
            self._await(self._are_nodes_ready)
        self._add(judge(scene, begin, end, self._set_points))

    def _listen(self, seconds: float) -> None:
        """Take what topics and the MCU say for so long, and show it."""
        deadline = time.monotonic() + seconds
        while (left := deadline - time.monotonic()) > 0:
            self._operator.spin(left)
            self._read_mcu()
            self._devices.show(time.monotonic())

    def _read_mcu(self) -> None:
        while self._mcu.lines:
            record = json.loads(self._mcu.lines.popleft())
            if 'what' in record:
                x, y, omega = record['x'] / 1000, record['y'] / 1000, record['omega']
                self._set_points.append(TakenSetPoint(record['stamp'], Vel2d(x, y, omega)))
                print(f'     MCU  x {x:6.3f} m/s  y {y:6.3f} m/s  omega {omega:6.3f} rad/s  '
                      f'{record["what"]}', flush=True)


def _page_port(domain: int) -> str:
    """Return the usual port of the dashboard; 0 (any) for a second demo, or where it is taken."""
    with socket.socket() as probe:
        is_taken = probe.connect_ex(('127.0.0.1', 8420)) == 0
    return '0' if is_taken or domain != DEMOS[0] else '8420'


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog='scripts/demo', description='The whole suite against fake hardware.',
        epilog='Exit code 0: everything worked.')
    parser.add_argument('--seconds', type=float, metavar='N',
                        help='end after about N seconds (default: run until Ctrl-C)')
    return parser


if __name__ == '__main__':
    sys.exit(main())
