# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""What a user says of a bus, checked: models, devices, and the settings that follow."""
from __future__ import annotations

from collections.abc import Iterable
from collections.abc import Sequence
from itertools import chain
import os
from typing import Any
from typing import NamedTuple

from servobus.bus.decoder import Settings
from servobus.bus.expected_devices import Expected
from servobus.bus.expected_devices import parse_all
from servobus.bus.expected_devices import refuse_twice
from servobus.bus.expected_devices import split_bus
from servobus.errors import ParameterError
from servobus.model.checked_yaml import ModelError
from servobus.model.models import Models
from servobus.sources.capture import Wire
from servobus.sources.source_name import bus_name
from servobus.sources.source_name import has_sides

_LIMITS = ('missed_limit', 'warn_loss', 'silent_after', 'write_acks')


class Bus(NamedTuple):
    """One bus: `name` identifies it, `label` is part of status names, '' for the only one."""

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


def check_models(devices: Iterable[Expected], models: Models) -> None:
    """Raise ParameterError for a device of a model that does not exist."""
    for model in {device.model for device in devices if device.model}:
        if models.by_name(model) is None:
            near = models.closest(model)
            remedy = f'did you mean {near}?' if near else (
                'write it as XL430-W250, MX-64 or STS3215, leave it out, or add a file for it to '
                'model_dirs')
            raise ParameterError(f'devices: no model is called {model!r}; {remedy}')


def check_devices(entries: Sequence[str], models: Models) -> None:
    """Raise ParameterError where entries 'BUS/ID:MODEL:JOINT' cannot be used, of each bus."""
    for bus in {named for named, _ in map(split_bus, entries)}:
        check_models(_devices_of(bus, entries), models)


def _devices_of(bus: str, entries: Sequence[str]) -> list[Expected]:
    """Return the devices of the entries that name this bus or none."""
    return parse_all(rest for of, rest in map(split_bus, entries) if of in ('', bus))


def settings_of(bus: str, wire: Wire, devices: Sequence[str], protocol: str) -> Settings:
    """Return those of a bus that a tool hears; devices: of all buses, as given by --devices."""
    return Settings(baud=wire.baud, devices=tuple(_devices_of(bus, devices)), protocol=protocol,
                    latency_timer_ms=wire.latency_timer_ms)


def buses(values: dict[str, Any], models: Models) -> list[Bus]:
    """
    Return the buses that the parameters of the node describe; ParameterError when they disagree.

    Needed are ports, bauds, devices and protocols.
    """
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
    names = _names(values.get('names', ()), ports)
    devices = _devices_by_bus(values['devices'], names)
    check_models(chain.from_iterable(devices.values()), models)
    limits = {name: values[name] for name in _LIMITS if name in values}
    return [Bus(name, name if len(ports) > 1 else '', port, Settings(
        baud=baud, devices=tuple(devices[name]), protocol=protocol, **limits))
        for name, port, baud, protocol in zip(names, ports, bauds, protocols, strict=True)]


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
