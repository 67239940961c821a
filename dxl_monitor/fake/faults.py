# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""
The faults that the simulated bus can play, by name, and how a person writes one.

'silent:5:2:3' is fault `silent` of ID 5 from second 2 on for 3 seconds; without ID: the first
device or all, as the fault's line says; without times: from the beginning, for ever.
"""

from __future__ import annotations

import difflib
from typing import NamedTuple

from dxl_monitor.fake import fault_device as in_device
from dxl_monitor.fake import fault_master as in_master
from dxl_monitor.fake import fault_wire as on_wire
from dxl_monitor.fake.fault import Effect
from dxl_monitor.fake.fault import Fault
from dxl_monitor.fake.fault import FaultScope
from dxl_monitor.fake.fault import S
from mecarover_serial.parameters import ParameterError


class FaultKind(NamedTuple):
    """A fault of the catalogue; `cause` numbers the field problem it plays (0: none of them)."""

    cause: int
    effect: type[Effect]

    @property
    def about(self) -> str:
        """What happens, in a line."""
        return (self.effect.__doc__ or '').split('\n')[0]


# The numbers are those of docs/doctor.md: what users of such a bus meet.
KINDS: dict[str, FaultKind] = {
    'silent': FaultKind(1, in_device.Silent),
    'cable': FaultKind(1, in_device.Cable),
    'duplicate': FaultKind(3, in_device.Duplicate),
    'baud': FaultKind(4, in_device.Baud),
    'wrong_baud': FaultKind(4, on_wire.WrongBaud),
    'impatient': FaultKind(5, in_master.Impatient),
    'latency': FaultKind(5, in_master.Latency),
    'late': FaultKind(5, in_device.Late),
    'return_delay': FaultKind(6, in_device.ReturnDelay),
    'overload': FaultKind(7, in_master.Overload),
    'latched': FaultKind(8, in_device.Latched),
    'reboot': FaultKind(9, in_device.Reboot),
    'brownout': FaultKind(9, in_device.Brownout),
    'header': FaultKind(10, on_wire.Header),
    'turnaround': FaultKind(10, on_wire.Turnaround),
    'glitch': FaultKind(10, on_wire.Glitch),
    'echo': FaultKind(10, on_wire.Echo),
    'two_masters': FaultKind(11, in_master.TwoMasters),
    'foreign': FaultKind(11, on_wire.Foreign),
    'wrong_map': FaultKind(12, in_master.WrongMap),
    'eeprom': FaultKind(13, in_master.Eeprom),
    'eeprom_wear': FaultKind(13, in_master.EepromWear),
    'no_ack': FaultKind(14, in_device.NoAck),
    'ping_only': FaultKind(14, in_device.PingOnly),
    'old_firmware': FaultKind(15, in_device.OldFirmware),
    'unstuffed': FaultKind(16, in_master.Unstuffed),
    'noise': FaultKind(17, on_wire.Noise),
    'flip': FaultKind(17, on_wire.Flip),
    'drop': FaultKind(17, on_wire.Drop),
    'watchdog': FaultKind(18, in_device.Watchdog),
    'protocol1': FaultKind(19, on_wire.Protocol1),
    'hot': FaultKind(0, in_device.Hot),
    'low_voltage': FaultKind(0, in_device.LowVoltage),
    'unwritten': FaultKind(0, in_device.Unwritten),
    'jitter': FaultKind(0, in_master.Jitter),
}


def parse(text: str) -> Fault:
    """Return the fault that a person wrote; raise ParameterError when it is none."""
    name, *figures = text.split(':')
    if name not in KINDS:
        near = difflib.get_close_matches(name, KINDS, 1)
        remedy = f'did you mean {near[0]}?' if near else f'there are: {", ".join(KINDS)}'
        raise ParameterError(f'fault: {name!r} is none; {remedy}')
    try:
        if len(figures) > 3:
            raise ValueError
        number = int(figures[0]) if figures and figures[0] else None
        begin, length = (float(part) if part else None for part in [*figures[1:], '', ''][:2])
        start = round((begin or 0.0) * S)
        end = None if length is None else start + round(length * S)
    except (ValueError, OverflowError):        # the latter: of inf
        raise ParameterError(f'fault: {text!r} is not NAME[:id[:at_s[:for_s]]]; '
                             "write e.g. 'silent:5:2:3'") from None
    return Fault(name, number, start, end)


class Faults:
    """The effects of a run, switched on and off as time passes."""

    def __init__(self, faults: list[Fault], scene: FaultScope) -> None:
        for fault in faults:
            if fault.id is not None and scene.line.at(fault.id) is None:
                raise ParameterError(f'fault: {fault.name}:{fault.id}: no device has this ID; '
                                     'name one of --devices')
        self._waiting = sorted(faults, key=lambda fault: fault.begin)
        self._scene = scene
        self.active: list[Effect] = []
        self.exact = True

    def update(self, now: int) -> None:
        """Begin and end what is due at `now`."""
        while self._waiting and self._waiting[0].begin <= now:
            fault = self._waiting.pop(0)
            effect = KINDS[fault.name].effect(fault, self._scene)
            effect.begin(now)
            self.active.append(effect)
            self.exact &= effect.exact
        for effect in [one for one in self.active
                       if one.fault.end is not None and one.fault.end <= now]:
            effect.end(now)
            self.active.remove(effect)
        for effect in self.active:
            effect.step(now)
