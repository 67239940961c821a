# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""What a user says of a bus, checked: models, devices, and the settings that follow."""
from __future__ import annotations

from collections.abc import Iterable
from collections.abc import Sequence

from servobus.bus.decoder import Settings
from servobus.bus.expected import Expected
from servobus.bus.expected import parse_all
from servobus.bus.expected import split_bus
from servobus.errors import ParameterError
from servobus.model.checked_yaml import ModelError
from servobus.model.models import Models
from servobus.sources.capture import Wire


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


def settings_of(bus: str, wire: Wire, devices: Sequence[str], protocol: str) -> Settings:
    """Return those of a bus that a tool hears; devices: of all buses, as given by --devices."""
    mine = [rest for of, rest in map(split_bus, devices) if of in ('', bus)]
    return Settings(baud=wire.baud, devices=tuple(parse_all(mine)), protocol=protocol,
                    latency_timer_ms=wire.latency_timer_ms)
