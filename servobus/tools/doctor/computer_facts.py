# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""
The computer of a source, for a report: versions, system, adapter. It looks only.

What identifies a person is for those who ask for it: host and user name, paths and command line
come from personal(), serial numbers from adapters(). A port has its name only where the kernel or
Windows gave it: links and macOS put a serial number into it.
"""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import suppress
import getpass
from importlib.metadata import PackageNotFoundError
from importlib.metadata import version
import os
import platform
import re
import shlex
import socket

from serial.tools import list_ports

from servobus.sources.serial_driver import latency_timer_ms
from servobus.sources.serial_driver import SYS
from servobus.sources.source_name import PREFIXES

_PACKAGES = ('mecarover_serial', 'dxl-doctor', 'pyserial', 'crcmod-plus', 'dynamixel-sdk',
             'feetech-servo-sdk', 'lerobot', 'pypot')
# An absolute path, in quotes or up to what ends a word; an escape of bytes is none.
_PATH = re.compile(r"""(['"])((?:[A-Za-z]:\\|~?/).*?)\1"""
                   r"""|(?<![\w.])((?:[A-Za-z]:\\|~?/)[^\s'",;()\[\]]*[^\s'",;:()\[\].])""")
_NUMBERED = re.compile(r'[/\\](tty(?:[A-Z]{1,5}|mxc)\d{1,3}|pts/\d+|COM\d+)$')


def system() -> list[str]:
    """Return versions and the kind of machine."""
    found = [f'{platform.system()} {platform.release()}, {platform.machine()}, '
             f'Python {platform.python_version()}']
    for name in _PACKAGES:
        with suppress(PackageNotFoundError):
            found.append(f'{name} {version(name)}')
    return found


def port_of(source: str) -> str:
    """Return the port of a source, '' if it has none: of usb:/dev/ttyUSB0 the part after usb:."""
    path = source.removeprefix('usb:')
    is_port = path.startswith('/dev/') or re.fullmatch(r'COM\d+', path) is not None
    return path if is_port else ''


def plain_name(source: str, is_program: bool) -> str:
    """Return the kind of a source, without path, serial number or command line."""
    if is_program:
        return 'a program that was run'
    prefix = next(filter(source.startswith, PREFIXES), '')
    if port := port_of(source):
        return prefix + _plain_port(port)
    scheme, mark, _ = source.partition('://')
    return prefix or (scheme + mark if mark else 'a file')


def _plain_port(port: str) -> str:
    """Return the name of a port that is no secret; a link to one that has gone leads nowhere."""
    name = _NUMBERED.search(os.path.realpath(port))
    return name[1] if name else 'a port'


def plain_text(text: str) -> str:
    """Return a text without paths, serial numbers, host and user name."""
    def plain(found: re.Match[str]) -> str:
        path = found[2] or found[3]
        quote = found[1] or ''
        return quote + (_plain_port(path) if path.startswith('/dev/') else 'a path') + quote

    text = _PATH.sub(plain, text)
    for name in {socket.gethostname(), os.path.basename(os.path.expanduser('~')),
                 *(one.serial_number for one in list_ports.comports())}:
        if name:
            text = re.sub(rf'(?<!\w){re.escape(name)}(?!\w)', '...', text)
    return text


def adapters(ports: Sequence[str], with_serial_number: bool) -> list[str]:
    """Return maker, product, driver and latency timer of the adapters of these ports."""
    known = {one.device: one for one in list_ports.comports()}
    return [_adapter(os.path.realpath(port), known, with_serial_number) for port in ports]


def _adapter(port: str, known: dict[str, list_ports.ListPortInfo],
             with_serial_number: bool) -> str:
    tty = SYS / 'class/tty' / os.path.basename(port) / 'device'
    parts = []
    info = known.get(port)
    if info is not None and info.vid is not None:
        parts.append(f'USB {info.vid:04x}:{info.pid:04x} {info.manufacturer or ""} '
                     f'{info.product or ""}'.strip())
        if with_serial_number and info.serial_number:
            parts.append(f'serial number {info.serial_number}')
    if (tty / 'driver').exists():
        parts.append(f'driver {(tty / "driver").resolve().name}')
    if (timer_ms := latency_timer_ms(port)) is not None:
        parts.append(f'latency timer {timer_ms} ms')
    return f'{_plain_port(port)}: {", ".join(parts) or "no USB adapter"}'


def personal(source: str, command: Sequence[str]) -> list[str]:
    """Return what is personal: who and where this is."""
    return [f'host {socket.gethostname()}, user {getpass.getuser()}',
            f'source {source}', *([f'command {shlex.join(command)}'] if command else [])]
