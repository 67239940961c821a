# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""
Where a serial adapter is on USB: from the name of its tty, of its socket, or of its number.

Everything comes from /sys; the tty is not opened.
"""

from __future__ import annotations

from contextlib import suppress
from pathlib import Path
import re
from typing import NamedTuple

from servobus.port.port_error import PortError
from servobus.port.port_error import Reason
from servobus.port.port_users import file_text
from servobus.port.port_users import tty_of
from servobus.sources.adapters import Adapter
from servobus.sources.adapters import FAMILIES
from servobus.sources.serial_driver import SYS
from servobus.sources.usb_port import Place
from servobus.sources.usb_survey import described_ports

_SOCKET = re.compile(r'\d+-\d+(\.\d+)*')               # bus and the numbers of sockets: 1-1.2
_NUMBER = re.compile(r'(\d+)\.(\d+)')                  # bus and device: 1.7


class PluggedAdapter(NamedTuple):
    """An adapter that is plugged in; words: its name for a person."""

    place: Place
    adapter: Adapter
    latency_timer_ms: int | None
    words: str


def find(name: str, root: Path = SYS) -> PluggedAdapter:
    """Return the adapter of `/dev/ttyUSB0`, `1-1.2` or `1.7`; raise PortError without one."""
    device, number = _device(name, root)
    identity = f'{_text(device / "idVendor")}:{_text(device / "idProduct")}'
    descriptors = b''
    with suppress(OSError):            # it may be unplugged by now
        descriptors = (device / 'descriptors').read_bytes()
    for port in described_ports(descriptors, *_numbers(device)):
        if port.interface >= number:   # the bytes of a modem are on the interface after its own
            return PluggedAdapter(port.place, port.adapter, _latency(device, port.interface),
                                  f'{port.adapter.name} {identity} at {device.name}')
    raise _refused(name, f'is a USB device {identity}, but not one of the known serial adapters',
                   f"known are: {', '.join(one.name for one in FAMILIES)}")


def _device(name: str, root: Path) -> tuple[Path, int]:
    """Return the folder of a device, and the number of the interface that `name` means."""
    number = _NUMBER.fullmatch(name)
    if number or _SOCKET.fullmatch(name):
        wanted = number and (int(number[1]), int(number[2]))
        for device in (root / 'bus/usb/devices').glob('[0-9]*-*'):
            if name == device.name or wanted == _numbers(device):
                return device.resolve(), 0
        raise _absent(name)
    tty = root / 'class/tty' / tty_of(name)
    if not tty.exists():
        raise _absent(name)
    place = (tty / 'device').resolve()
    for folder in (place, *place.parents):
        if interface := _text(folder / 'bInterfaceNumber'):
            return folder.parent, int(interface, 16)
    raise _refused(name, 'is not on USB', 'usb: works with USB adapters only; listen to the port '
                   'itself, or use dxl_tap')


def _numbers(device: Path) -> tuple[int, int]:
    """Return the numbers of a device and its bus."""
    return int(_text(device / 'busnum') or 0), int(_text(device / 'devnum') or 0)


def _latency(device: Path, interface: int) -> int | None:
    for file in device.glob(f'*.{interface}/tty*/latency_timer'):
        with suppress(OSError, ValueError):
            return int(file.read_text())
    return None


def _text(file: Path) -> str:
    return file_text(file).strip()


def _refused(name: str, reason: str, remedy: str) -> PortError:
    return PortError(f'usb:{name}', Reason('other', reason, remedy))


def _absent(name: str) -> PortError:
    return PortError(f'usb:{name}', Reason('absent', 'is not there', 'plug the adapter in, or '
                                           'check the name (ls /dev/serial/by-id; lsusb)'))
