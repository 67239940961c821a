# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""The parameters of dxl_monitor, and what they say about each bus. Pure."""
from __future__ import annotations

from collections.abc import Iterable
from collections.abc import Sequence
from itertools import chain
import os
from typing import Any
from typing import NamedTuple

from dxl_monitor.devices import Device
from dxl_monitor.devices import parse_all
from dxl_monitor.model_yaml import ModelError
from dxl_monitor.models import Models
from dxl_monitor.monitor import Settings
from dxl_monitor.recorder import Recorder
from mecarover_serial.parameters import Parameter
from mecarover_serial.parameters import ParameterError
from mecarover_serial.parameters import refuse_twice

PARAMETERS = (
    Parameter('ports', ['/dev/ttyUSB0'], 'one port per bus: a path, best a stable one from '
              '/dev/serial/by-id, or a pyserial URL', element=str),
    Parameter('bauds', [2_000_000], 'rate of each bus, or one for all', 'bit/s', 9600, 4_500_000,
              element=int),
    Parameter('names', [], 'names of the buses; default: the base name of the port', element=str),
    Parameter('devices', [], "what is on the bus, in the order along the cable: "
              "'11:MX-106:left_knee', '1-20:MX-64', '30'; with several buses 'NAME/11:MX-106'",
              element=str),
    Parameter('publish_rate', 2.0, 'of dxl/diagnostics', 'Hz', 0.1, 50.0),
    Parameter('missed_limit', 4, 'more missed answers in a row than this: disconnected', '', 0,
              1000),
    Parameter('warn_loss', 1.0, 'more answers missed in the last 10 s than this: WARN', '%', 0.0,
              100.0),
    Parameter('silent_after', 5.0, 'nobody asked it and it said nothing for so long: STALE', 's',
              0.1, 3600.0),
    Parameter('model_dirs', [], 'folders with further model files; they win over the built-in '
              'ones', element=str),
    Parameter('joint_state_rate', 0.0, 'of dxl/joint_states; 0 = off', 'Hz', 0.1, 200.0,
              or_zero=True),
    Parameter('capture', '', 'file to record all buses to, as text (docs/captures.md)'),
    Parameter('capture_size', 100.0, 'of a capture file; then it becomes FILE.1, that one FILE.2 '
              'and so on', 'MB', 0.001, 1e6),
    Parameter('capture_files', 9, 'older capture files to keep beside the one being written', '',
              0, 1000),
    Parameter('write_acks', 'auto', 'whether devices acknowledge writes; auto learns it',
              choices=('auto', 'always', 'never')),
)


class Bus(NamedTuple):
    """One bus: `name` identifies it, `label` stands in status names ('' if it is the only one)."""

    name: str
    label: str
    port: str
    settings: Settings


def load_models(folders: Sequence[str]) -> Models:
    """Return built-in and extra models; raise ParameterError for the first file that is wrong."""
    try:
        return Models(folders)
    except ModelError as error:
        raise ParameterError(f'model_dirs: {error}') from error


def make_recorder(values: dict[str, Any]) -> Recorder | None:
    """Return the recorder that the parameters ask for, None for none; ParameterError as buses."""
    if not values['capture']:
        return None
    return Recorder(values['capture'], int(1e6 * values['capture_size']), values['capture_files'])


def buses(values: dict[str, Any], models: Models) -> list[Bus]:
    """Return the buses that the parameters describe; raise ParameterError when they disagree."""
    ports, bauds = values['ports'], values['bauds']
    if not ports:
        raise ParameterError('ports: none given; set e.g. ports:=/dev/ttyUSB0')
    refuse_twice('ports:', ports)
    if len(bauds) == 1:
        bauds = bauds * len(ports)
    if len(bauds) != len(ports):
        raise ParameterError(f'bauds: {len(bauds)} rates for {len(ports)} ports; '
                             'give one per port, or one for all')
    names = _names(values['names'], ports)
    devices = _devices_by_bus(values['devices'], names)
    check_models(chain.from_iterable(devices.values()), models)
    return [Bus(name, name if len(ports) > 1 else '', port, Settings(
        baud=baud, devices=tuple(devices[name]), missed_limit=values['missed_limit'],
        warn_loss=values['warn_loss'], silent_after=values['silent_after'],
        write_acks=values['write_acks'])) for name, port, baud in zip(
            names, ports, bauds, strict=True)]


def _names(given: Sequence[str], ports: Sequence[str]) -> list[str]:
    if given:
        if len(given) != len(ports):
            raise ParameterError(f'names: {len(given)} names for {len(ports)} ports; '
                                 'give one per port')
        refuse_twice('names:', given)
        return list(given)
    names: list[str] = []
    for port in ports:
        name = base = os.path.basename(port.rstrip('/')) or port
        count = 2
        while name in names:
            name, count = f'{base}_{count}', count + 1
        names.append(name)
    return names


def _devices_by_bus(entries: Sequence[str], names: Sequence[str]) -> dict[str, list[Device]]:
    """Sort the entries by bus; 'NAME/...' says which, needed only where there are several."""
    texts: dict[str, list[str]] = {name: [] for name in names}
    for entry in entries:
        bus, slash, rest = entry.partition('/')
        if slash and bus in texts:
            texts[bus].append(rest)
        elif len(names) == 1 and not slash:
            texts[names[0]].append(entry)
        else:
            raise ParameterError(f'devices: {entry!r} names no bus; write '
                                 f'{names[0]}/{rest if slash else entry} (buses: '
                                 f'{", ".join(names)})')
    return {name: parse_all(some) for name, some in texts.items()}


def check_models(devices: Iterable[Device], models: Models) -> None:
    """Raise ParameterError for a device of a model that does not exist."""
    for model in {device.model for device in devices if device.model}:
        if models.by_name(model) is None:
            near = models.closest(model)
            remedy = f'did you mean {near}?' if near else 'add a file for it to model_dirs'
            raise ParameterError(f'devices: no model is called {model!r}; {remedy}')
