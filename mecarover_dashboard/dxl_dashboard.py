# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""dxl_dashboard: the page of a port, a recording or a program; without a source that of ROS."""
from __future__ import annotations

import argparse
import os
import sys
import threading
import webbrowser

from mecarover_dashboard import ros_server
from mecarover_dashboard.command_line import is_of_ros
from mecarover_dashboard.command_line import make_run
from mecarover_dashboard.local_monitor import conclusion
from mecarover_dashboard.local_monitor import LocalMonitor
from mecarover_dashboard.recording_run import RecordingRun
from servobus.errors import UsageError
from servobus.tools.bus_options import add_bus_options
from servobus.tools.bus_options import parse_run
from servobus.tools.bus_options import RUN
from servobus.tools.cli import COULD_NOT_RUN
from servobus.tools.cli import DONE
from servobus.tools.cli import run_tool

NAME = ros_server.NAME
EXAMPLES = """examples:
  dxl_dashboard run -- python my_script.py      a Python program, or any other (Linux: strace)
  dxl_dashboard usb:/dev/ttyUSB0                a program that runs already (Linux, root)
  dxl_dashboard /dev/ttyUSB1 -b 1000000         a second adapter on the wire
  dxl_dashboard bus.txt                         a recording of dxl_dump -w bus.txt
  dxl_dashboard                                 ROS topics of dxl_monitor and vel2d_bridge"""


def main() -> int:
    """Run the command; return the exit code."""
    arguments = sys.argv[1:]
    return ros_server.main(arguments) if is_of_ros(_parser(), arguments) else run_tool(NAME, _run)


def _run(arguments: list[str]) -> int:
    options, command = parse_run(_parser(), arguments)
    if not options.source:
        raise UsageError('SOURCE: none given, and ROS 2 is not sourced; name a port or a '
                         f'recording, or write {NAME} {RUN} -- python my_script.py')
    if not command and len(options.source) == 1 and os.path.isfile(options.source[0]):
        options.history = options.history or ros_server.NONE    # its times are not of now
    monitor = LocalMonitor(is_for_page=True)
    run = make_run(NAME, options, command, monitor)
    player = run if isinstance(run, RecordingRun) else None
    server = ros_server.open_server(options, run.words, player, monitor)
    if server is None:
        return COULD_NOT_RUN
    monitor.out = server.queue_message
    if player is not None:
        player.restart = server.restart
    try:
        server.start()
        if not options.no_browser and _has_display():
            threading.Thread(target=webbrowser.open, args=(server.address,), daemon=True).start()
        run.start()
        run.play(lambda: False)
        print(f'{NAME}: {conclusion(run.end())}', file=sys.stderr)
    finally:
        server.stop()
    return DONE


def _has_display() -> bool:
    """Tell whether a browser would open where somebody looks."""
    return sys.stderr.isatty() and not os.environ.get('SSH_CONNECTION') and (
        sys.platform in ('win32', 'darwin')
        or any(map(os.environ.get, ('DISPLAY', 'WAYLAND_DISPLAY'))))


def _parser() -> argparse.ArgumentParser:
    parser = ros_server.make_parser()
    parser.epilog = EXAMPLES
    parser.usage = f'{NAME} [options] [SOURCE ...]\n       {NAME} [options] {RUN} -- COMMAND'
    parser.description = ('Web page of servo buses: devices, registers, what is wrong. It never '
                          'sends.\nWithout a source: of dxl_monitor and vel2d_bridge, over ROS.')
    add = parser.add_argument
    add('source', metavar='SOURCE', nargs='*',
        help='ports, usb:PORT, tap:NAME, or a recording; or run, with a command after --')
    add_bus_options(parser)
    return parser


if __name__ == '__main__':
    sys.exit(main())
