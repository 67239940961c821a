# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""The process of the dashboard: its options, its address, and what it says about both."""
from __future__ import annotations

import argparse
from collections.abc import Sequence
import errno
import ipaddress
import os
from pathlib import Path
import socket
import sys
from typing import Any
from typing import TYPE_CHECKING

from mecarover_dashboard.history import is_read_only
from mecarover_dashboard.history_recorder import default_path
from mecarover_dashboard.history_recorder import History
from mecarover_dashboard.history_recorder import HistoryError
from mecarover_dashboard.history_recorder import HistoryRecorder
from mecarover_dashboard.history_recorder import ReadOnlyHistory
from mecarover_serial.node_command_line import begin_node
from mecarover_serial.node_command_line import complain_no_ros
from servobus.printable_text import plain_streams
from servobus.printable_text import printable
from servobus.tools.cli import COULD_NOT_RUN
from servobus.tools.command_line import number
from servobus.tools.command_line import Parser

if TYPE_CHECKING:
    from mecarover_dashboard.signal_requests import SignalSource
    from mecarover_dashboard.web_server import RecordingPlayer
    from mecarover_dashboard.web_server import Server

NAME = 'dxl_dashboard'
NONE = 'none'
NOT_WANTED = 'the server was started with --history none'
HOST, PORT = '127.0.0.1', 8420
_REMEDIES = {
    errno.EADDRINUSE: 'in use; stop the other dashboard, or choose another port with --port',
    errno.EACCES: 'permission denied; choose a port above 1023 with --port',
    errno.EADDRNOTAVAIL: 'not an address of this machine; use one of its addresses, or --host '
                         '0.0.0.0 for all',
}


@plain_streams()
def main(args: Sequence[str] | None = None) -> int:
    """Run the dashboard; return the exit code."""
    options, arguments = begin_node(make_parser(), args)
    try:
        from mecarover_dashboard.topic_subscriber import PageSubscriber
        from mecarover_serial.ros_node import run
    except ImportError as error:
        return complain_no_ros(NAME, error)
    server = open_server(options)
    if server is None:
        return COULD_NOT_RUN
    return run(NAME, lambda: PageSubscriber(server), arguments)


def open_server(options: argparse.Namespace, source: str = '',
                player: RecordingPlayer | None = None,
                signals: SignalSource | None = None) -> Server | None:
    """
    Return a server for these options, and say where it is; None: it was said why not.

    source: what it shows, in words; '': ROS topics. player: of a recording. signals: where
    registers are heard at the rate of the bus.
    """
    try:
        listener = listening_socket(options.host, options.port)
    except OSError as error:
        remedy = _REMEDIES.get(error.errno or 0, f'{error.strerror}; see --help')
        print(f'{NAME}: {options.host}:{options.port}: {remedy}', file=sys.stderr)
        return None
    try:
        from mecarover_dashboard.web_server import Server
    except ImportError as error:
        print(f'{NAME}: {error.name} is not installed; sudo apt install python3-aiohttp, or pip '
              "install 'mecarover_serial[dashboard]'", file=sys.stderr)
        return None
    recording, why_no_history = open_history(options.history)
    if recording is None and options.history not in (None, NONE):
        return None
    host, port = listener.getsockname()[:2]
    is_open = not is_loopback(host)
    # A program that is started has stdout for itself.
    print(announcement(host, port, is_open), flush=True, file=sys.stderr if source else None)
    about = facts(host, port, why_no_history) | ({'source': printable(source)} if source else {})
    return Server(listener, about, is_open, recording, options.name, player, signals)


def open_history(wanted: str | None) -> tuple[History | None, str]:
    """Return what records the history; or None and why, which is said unless it is wanted."""
    if wanted == NONE:
        return None, NOT_WANTED
    path = default_path() if wanted is None else Path(wanted)
    recording: History
    try:
        recording = ReadOnlyHistory(path) if is_read_only(path) else HistoryRecorder(path)
    except HistoryError as error:
        print(f'{NAME}: no history: {printable(str(error))}', file=sys.stderr)
        return None, str(error)
    if recording.notice:
        print(f'{NAME}: {printable(recording.notice)}', file=sys.stderr)
    return recording, ''


def listening_socket(host: str, port: int) -> socket.socket:
    """Return a socket that listens on an address (or a name); raise OSError with its errno."""
    try:
        family, _, _, _, address = socket.getaddrinfo(
            host or '0.0.0.0', port, type=socket.SOCK_STREAM, flags=socket.AI_PASSIVE)[0]
    except UnicodeError:                        # two dots, or a label of more than 63 letters
        raise OSError(errno.EINVAL, 'not a name') from None
    return socket.create_server(address[:2], family=family)


def is_loopback(host: str) -> bool:
    """Tell whether only this machine reaches an address."""
    return ipaddress.ip_address(host.partition('%')[0]).is_loopback


def announcement(host: str, port: int, is_open: bool) -> str:
    """Return what the terminal says: where the page is and who can see it."""
    if not is_open:
        return (f'{NAME}: http://{_bracketed(host)}:{port} '
                '(this machine only; --host 0.0.0.0 opens it to the network)')
    shown = socket.gethostname() if ipaddress.ip_address(host).is_unspecified else host
    return (f'{NAME}: http://{_bracketed(shown)}:{port}\n'
            f'{NAME}: OPEN TO THE NETWORK: everybody who can reach {host} can read all of it; '
            'there is no password and no encryption. Nothing can be changed from there.')


def facts(host: str, port: int, why_no_history: str = NOT_WANTED) -> dict[str, Any]:
    """Return what the page says about where it comes from, and why it has no history, if so."""
    return {'machine': socket.gethostname(), 'address': f'{_bracketed(host)}:{port}',
            'domain': os.environ.get('ROS_DOMAIN_ID') or '0', 'without': why_no_history}


def _bracketed(host: str) -> str:
    return f'[{host}]' if ':' in host else host


def make_parser() -> Parser:
    """Return the options of the page, with and without ROS."""
    parser = Parser(
        NAME, description='Web page of devices, registers, timing and the bridge: shows '
        'what dxl_monitor and vel2d_bridge publish, live or from ros2 bag play. Read-only.')
    parser.add_argument('--host', default=HOST, help='address to listen on; default %(default)s '
                        '(this machine only), 0.0.0.0 or :: = open to the network')
    parser.add_argument('--port', type=number(int, 0, 65535), default=PORT,
                        help='port to listen on; default %(default)s, 0 = any free port')
    parser.add_argument('--name', default='', help='one more name of this machine that browsers '
                        'may use, e.g. rover1.example.org')
    parser.add_argument('--history', metavar='FILE', help='file for the history of the last 24 '
                        f'hours; default {default_path()}, {NONE} = keep no history')
    parser.add_argument('--no-browser', action='store_true',
                        help='open no browser (over ROS none is opened)')
    return parser


if __name__ == '__main__':
    sys.exit(main())
