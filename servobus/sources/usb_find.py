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

from msg_defs.event import IN
from msg_defs.event import OUT
from servobus.port.port_error import PortError
from servobus.port.port_error import Reason
from servobus.port.port_users import file_text
from servobus.port.port_users import tty_of
from servobus.sources.adapters import Adapter
from servobus.sources.adapters import adapter_of
from servobus.sources.adapters import FAMILIES
from servobus.sources.adapters import UsbIdentity
from servobus.sources.serial_driver import SYS
from servobus.sources.usb_port import Place

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
    interface = _interface(name, root)
    device = interface.parent
    identity = UsbIdentity(_hex(device / 'idVendor'), _hex(device / 'idProduct'),
                        _hex(device / 'bcdDevice'), _hex(interface / 'bInterfaceClass'))
    number = f'{identity.vendor:04x}:{identity.product:04x}'
    ends = _bulk(interface)
    adapter = adapter_of(identity, ends[IN][1])
    if adapter is None:
        raise _refused(name, f'is a USB device {number}, but not one of the known serial '
                             'adapters', f"known are: {', '.join(one.name for one in FAMILIES)}")
    place = Place(int(_text(device / 'busnum')), int(_text(device / 'devnum')),
                  ends[IN][0] & 0x7F, ends[OUT][0])
    return PluggedAdapter(place, adapter, _latency(interface),
                          f'{adapter.name} {number} at {device.name}')


def _interface(name: str, root: Path) -> Path:
    """Return the folder of the interface that carries the bytes."""
    devices = root / 'bus/usb/devices'
    number = _NUMBER.fullmatch(name)
    if number or _SOCKET.fullmatch(name):
        wanted = [int(one) for one in number.groups()] if number else []
        for device in sorted(devices.glob('[0-9]*-*' if number else name)):
            if not number or wanted == [int(_text(device / file) or -1)
                                        for file in ('busnum', 'devnum')]:
                return _data_interface(device.resolve(), 0)
        raise _absent(name)
    tty = root / 'class/tty' / tty_of(name)
    if not tty.exists():
        raise _absent(name)
    place = (tty / 'device').resolve()
    while not (place / 'bInterfaceNumber').exists():
        if place == place.parent or not place.is_relative_to(root.resolve()):
            raise _refused(name, 'is not on USB', 'usb: works with USB adapters only; listen to '
                           'the port itself, or use dxl_tap')
        place = place.parent
    return _data_interface(place.parent, _hex(place / 'bInterfaceNumber'))


def _data_interface(device: Path, number: int) -> Path:
    """Return this interface of a device, or the one after it that holds a modem's data."""
    interfaces = {_hex(one / 'bInterfaceNumber'): one for one in device.glob(f'{device.name}:*')}
    for following, interface in sorted(interfaces.items()):
        if following >= number and len(_bulk(interface)) == 2:
            return interface
    raise _refused(device.name, 'has no pair of bulk endpoints', 'give the name of its tty')


def _bulk(interface: Path) -> dict[str, tuple[int, int]]:
    """Return address and packet size of the bulk endpoints by side."""
    found: dict[str, tuple[int, int]] = {}
    for folder in sorted(interface.glob('ep_*')):
        if folder.is_dir() and _hex(folder / 'bmAttributes') & 3 == 2:
            address = _hex(folder / 'bEndpointAddress')
            found.setdefault(IN if address & 0x80 else OUT,
                             (address, _hex(folder / 'wMaxPacketSize') & 0x7FF))
    return found


def _latency(interface: Path) -> int | None:
    for file in interface.glob('tty*/latency_timer'):
        with suppress(OSError, ValueError):
            return int(file.read_text())
    return None


def _text(file: Path) -> str:
    return file_text(file).strip()


def _hex(file: Path) -> int:
    try:
        return int(_text(file), 16)
    except ValueError:
        return 0


def _refused(name: str, reason: str, remedy: str) -> PortError:
    return PortError(f'usb:{name}', Reason('other', reason, remedy))


def _absent(name: str) -> PortError:
    return PortError(f'usb:{name}', Reason('absent', 'is not there', 'plug the adapter in, or '
                                           'check the name (ls /dev/serial/by-id; lsusb)'))
