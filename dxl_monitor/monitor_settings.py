# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""The parameters of dxl_monitor, and what they say about each bus."""
from __future__ import annotations

from collections.abc import Sequence
from itertools import chain
import os
from typing import Any
from typing import NamedTuple

from mecarover_serial.parameters import Parameter
from mecarover_serial.parameters import TIMING_PARAMETER
from servobus.bus.decoder import PROTOCOLS
from servobus.bus.decoder import Settings
from servobus.bus.expected import Expected
from servobus.bus.expected import parse_all
from servobus.bus.expected import refuse_twice
from servobus.bus.expected import split_bus
from servobus.errors import ParameterError
from servobus.model.models import Models
from servobus.settings import check_models
from servobus.sources.capture_recorder import Recorder
from servobus.sources.flight_recorder import FlightRecorder
from servobus.sources.recorders import Recorders
from servobus.sources.source_name import bus_name
from servobus.sources.source_name import has_sides

PARAMETERS = (
    Parameter('ports', ['/dev/ttyUSB0'], 'one source per bus: a path (a stable one is in '
              '/dev/serial/by-id), a pyserial URL, usb:PORT (the traffic of another program that '
              'uses PORT) or tap:NAME (a program started with dxl_tap)', element=str),
    Parameter('bauds', [2_000_000], 'baud rate of each bus, or one for all; usb: and tap: follow '
              'the rate that the program sets, with 0 from the start', 'bit/s', 9600, 4_500_000,
              or_zero=True, element=int),
    Parameter('names', [], 'names of the buses; default: the base name of the port', element=str),
    Parameter('devices', [], "devices on the bus, in the order along the cable: "
              "'11:MX-106:left_knee', '1-20:MX-64', '30'; with several buses 'NAME/11:MX-106'",
              element=str),
    Parameter('publish_rate', 2.0, 'rate of dxl/diagnostics', 'Hz', 0.1, 50.0),
    Parameter('missed_limit', 4, 'a device that misses more answers in a row than this is '
              'disconnected', '', 0, 1000),
    Parameter('warn_loss', 1.0, 'a device that missed more of its answers in the last 10 s is at '
              'WARN', '%', 0.0, 100.0),
    Parameter('silent_after', 5.0, 'a device that is not asked and sends nothing for so long is '
              'STALE', 's', 0.1, 3600.0),
    Parameter('model_dirs', [], 'folders with more model files; they replace built-in models of '
              'the same number', element=str),
    Parameter('joint_state_rate', 0.0, 'rate of dxl/joint_states; 0 = off', 'Hz', 0.1, 200.0,
              or_zero=True),
    Parameter('capture', '', 'text file that all buses are recorded to'),
    Parameter('capture_size', 100.0, 'largest size of the capture file; then FILE is renamed to '
              'FILE.1, FILE.1 to FILE.2 and so on', 'MB', 0.001, 1e6),
    Parameter('capture_files', 9, 'how many older capture files to keep', '', 0, 1000),
    Parameter('flight_recorder', '', 'folder for recordings of faults: 60 s before each new '
              'finding and 30 s after it'),
    Parameter('flight_recorder_size', 1000.0, 'size of that folder; the oldest recordings go',
              'MB', 1.0, 1e6),
    Parameter('protocols', ['auto'], 'protocol of each bus, or one for all: 2 (Dynamixel Protocol '
              '2.0), 1 (Protocol 1.0), feetech, or auto, which learns it from the traffic',
              choices=PROTOCOLS, element=str),
    Parameter('write_acks', 'auto', 'whether devices acknowledge writes; auto learns it from the '
              'traffic', choices=('auto', 'always', 'never')),
    TIMING_PARAMETER,
)


class Bus(NamedTuple):
    """One bus: `name` identifies it, `label` is part of status names, '' for the only one."""

    name: str
    label: str
    port: str
    settings: Settings


def make_recorders(values: dict[str, Any]) -> Recorders:
    """Return the recorders that the parameters ask for; ParameterError as buses."""
    capture = flight = None
    if values['capture']:
        capture = Recorder(values['capture'], int(1e6 * values['capture_size']),
                           values['capture_files'])
    if values['flight_recorder']:
        flight = FlightRecorder(values['flight_recorder'],
                                int(1e6 * values['flight_recorder_size']), len(values['ports']))
    return Recorders(capture, flight)


def buses(values: dict[str, Any], models: Models) -> list[Bus]:
    """Return the buses that the parameters describe; raise ParameterError when they disagree."""
    ports = values['ports']
    if not ports:
        raise ParameterError('ports: none given; set e.g. ports:=/dev/ttyUSB0')
    for port in ports:
        if ',' in port and not os.path.lexists(port):
            raise ParameterError(f'ports: {port!r} is the name of one port; write a list: '
                                 f'ports:="{port.split(",")}"')
    refuse_twice('ports:', ports)
    bauds, protocols = (_one_each(name, values[name], len(ports))
                        for name in ('bauds', 'protocols'))
    for port, baud in zip(ports, bauds, strict=True):
        if not baud and not has_sides(port):
            raise ParameterError(f'bauds: 0 for {port}, but only usb: and tap: can learn the '
                                 'rate; give it, e.g. bauds:=1000000')
    names = _names(values['names'], ports)
    devices = _devices_by_bus(values['devices'], names)
    check_models(chain.from_iterable(devices.values()), models)
    return [Bus(name, name if len(ports) > 1 else '', port, Settings(
        baud=baud, devices=tuple(devices[name]), missed_limit=values['missed_limit'],
        warn_loss=values['warn_loss'], silent_after=values['silent_after'],
        write_acks=values['write_acks'], protocol=protocol)) for name, port, baud, protocol in zip(
            names, ports, bauds, protocols, strict=True)]


def _one_each(name: str, given: Sequence[Any], count: int) -> list[Any]:
    """Return a value for each port."""
    if len(given) not in (1, count):
        raise ParameterError(f'{name}: {len(given)} for {count} ports; give one per port, or one '
                             'for all')
    return list(given) * (count if len(given) == 1 else 1)


def _names(given: Sequence[str], ports: Sequence[str]) -> list[str]:
    if given:
        if len(given) != len(ports):
            raise ParameterError(f'names: {len(given)} names for {len(ports)} ports; '
                                 'give one per port')
        refuse_twice('names:', given)
        return list(given)
    names: list[str] = []
    for port in ports:
        name = base = bus_name(port)
        count = 2
        while name in names:
            name, count = f'{base}_{count}', count + 1
        names.append(name)
    return names


def _devices_by_bus(entries: Sequence[str], names: Sequence[str]) -> dict[str, list[Expected]]:
    """Sort the entries by bus; 'NAME/...' says which, needed only where there are several."""
    texts: dict[str, list[str]] = {name: [] for name in names}
    for entry in entries:
        bus, rest = split_bus(entry)
        if bus in texts:
            texts[bus].append(rest)
        elif len(names) == 1 and not bus:
            texts[names[0]].append(entry)
        else:
            raise ParameterError(f'devices: {entry!r} does not say which bus; write '
                                 f'{names[0]}/{rest} (buses: '
                                 f"{', '.join(names)})")
    return {name: parse_all(some) for name, some in texts.items()}
