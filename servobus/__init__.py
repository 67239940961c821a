# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""
Listen to a bus of Dynamixel or Feetech servos, and name what is wrong with it. It never sends.

What is named here is public and stays (docs/library.md); everything else may change. Each name is
imported when it is first used: opening a port does not load the doctor.
"""
from __future__ import annotations

TYPE_CHECKING = False               # not from typing: it is the first import of every command
if TYPE_CHECKING:
    from msg_defs.diagnostics import Level as Level
    from msg_defs.event import Change as Change
    from msg_defs.event import Chunk as Chunk
    from servobus.bus.decoder import Settings as Settings
    from servobus.bus.expected_devices import Expected as Expected
    from servobus.bus.expected_devices import parse_all as parse_all
    from servobus.bus.report import BusReport as BusReport
    from servobus.bus.report import DeviceReport as DeviceReport
    from servobus.bus.report import Finding as Finding
    from servobus.errors import ClosedError as ClosedError
    from servobus.errors import NothingHeardError as NothingHeardError
    from servobus.errors import ParameterError as ParameterError
    from servobus.errors import ServobusError as ServobusError
    from servobus.errors import UsageError as UsageError
    from servobus.listening import listen as listen
    from servobus.listening import Listening as Listening
    from servobus.model.checked_yaml import ModelError as ModelError
    from servobus.model.models import Models as Models
    from servobus.monitor import Monitor as Monitor
    from servobus.plain_data import report_data as report_data
    from servobus.port.port_error import PortError as PortError
    from servobus.sources.opening import open_source as open_source

_HOMES = {
    'BusReport': 'servobus.bus.report',
    'Change': 'msg_defs.event',
    'Chunk': 'msg_defs.event',
    'ClosedError': 'servobus.errors',
    'DeviceReport': 'servobus.bus.report',
    'Expected': 'servobus.bus.expected_devices',
    'Finding': 'servobus.bus.report',
    'Level': 'msg_defs.diagnostics',
    'Listening': 'servobus.listening',
    'ModelError': 'servobus.model.checked_yaml',
    'Models': 'servobus.model.models',
    'Monitor': 'servobus.monitor',
    'NothingHeardError': 'servobus.errors',
    'ParameterError': 'servobus.errors',
    'PortError': 'servobus.port.port_error',
    'ServobusError': 'servobus.errors',
    'Settings': 'servobus.bus.decoder',
    'UsageError': 'servobus.errors',
    'listen': 'servobus.listening',
    'open_source': 'servobus.sources.opening',
    'parse_all': 'servobus.bus.expected_devices',
    'report_data': 'servobus.plain_data',
}
__all__ = list(_HOMES)


def __getattr__(name: str) -> object:
    if name not in _HOMES:
        raise AttributeError(f'module {__name__!r} has no attribute {name!r}')
    from importlib import import_module
    found = getattr(import_module(_HOMES[name]), name)
    globals()[name] = found
    return found


def __dir__() -> list[str]:
    return __all__
