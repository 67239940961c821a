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

from mecarover_fakes import fault_device as in_device
from mecarover_fakes import fault_master as in_master
from mecarover_fakes import fault_setup as in_setup
from mecarover_fakes import fault_wire as on_wire
from mecarover_fakes.fault import Effect
from mecarover_fakes.fault import Fault
from mecarover_fakes.fault import FaultScope
from mecarover_fakes.fault import S
from mecarover_serial.parameters import ParameterError

ALL = ('2', '1', 'feetech')
ONLY_2 = ('2',)
FAMILY_1 = ('1', 'feetech')


class FaultKind(NamedTuple):
    """A fault of the catalogue; `cause` numbers the field problem it plays (0: none of them)."""

    cause: int
    effect: type[Effect]
    protocols: tuple[str, ...] = ALL       # in which it can happen

    @property
    def about(self) -> str:
        """What happens, in a line."""
        return (self.effect.__doc__ or '').split('\n')[0]


# The numbers are those of docs/doctor.md: what users of such a bus meet.
KINDS: dict[str, FaultKind] = {
    'silent': FaultKind(1, in_device.Silent),
    'cable': FaultKind(1, in_device.Cable),
    'duplicate': FaultKind(3, in_device.Duplicate),
    'baud': FaultKind(4, in_setup.Baud),
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
    'wrong_map': FaultKind(12, in_master.WrongMap, ('2', '1')),
    'eeprom': FaultKind(13, in_master.Eeprom, ONLY_2),
    'eeprom_wear': FaultKind(13, in_master.EepromWear),
    'no_ack': FaultKind(14, in_device.NoAck),
    'ping_only': FaultKind(14, in_device.PingOnly, ('2', '1')),
    'old_firmware': FaultKind(15, in_device.OldFirmware, ONLY_2),
    'unstuffed': FaultKind(16, in_master.Unstuffed, ONLY_2),
    'noise': FaultKind(17, on_wire.Noise),
    'flip': FaultKind(17, on_wire.Flip),
    'drop': FaultKind(17, on_wire.Drop),
    'watchdog': FaultKind(18, in_device.Watchdog, ONLY_2),
    'protocol1': FaultKind(19, on_wire.Protocol1, ONLY_2),
    'protocol2': FaultKind(19, on_wire.Protocol2, FAMILY_1),
    'hot': FaultKind(0, in_device.Hot),
    'low_voltage': FaultKind(0, in_device.LowVoltage),
    'unwritten': FaultKind(0, in_device.Unwritten),
    'jitter': FaultKind(0, in_master.Jitter),
    'factory_id': FaultKind(3, in_setup.FactoryId),
    'high_supply': FaultKind(0, in_setup.HighSupply, FAMILY_1),
    'low_supply': FaultKind(0, in_setup.LowSupply, FAMILY_1),
    'locked': FaultKind(13, in_setup.Locked, FAMILY_1),
    'last_id': FaultKind(12, in_setup.LastId),
    'layout': FaultKind(12, in_setup.ForeignLayout, ('feetech',)),
    'baud_code': FaultKind(4, in_setup.BaudCode, ('feetech',)),
    'mixed_firmware': FaultKind(15, in_setup.MixedFirmware, ('feetech',)),
    'calibrated': FaultKind(0, in_setup.Calibrated, ('feetech',)),
    'middle': FaultKind(0, in_setup.Middle, ('feetech',)),
    'offset': FaultKind(0, in_setup.Offset, ('feetech',)),
}


def parse(text: str) -> Fault:
    """Return the fault that a person wrote; raise ParameterError when it is none."""
    name, *figures = text.split(':')
    if name not in KINDS:
        near = difflib.get_close_matches(name, KINDS, 1)
        remedy = f'did you mean {near[0]}?' if near else f'there are: {", ".join(KINDS)}'
        raise ParameterError(f'fault: there is no fault {name!r}; {remedy}')
    try:
        if len(figures) > 3:
            raise ValueError
        number = int(figures[0]) if figures and figures[0] else None
        begin, length = (float(part) if part else None for part in [*figures[1:], '', ''][:2])
        start = round((begin or 0.0) * S)
        end = None if length is None else start + round(length * S)
    except (ValueError, OverflowError):        # the latter: of inf
        raise ParameterError(f'fault: {text!r} does not have the form NAME[:id[:at_s[:for_s]]]; '
                             "write e.g. 'silent:5:2:3'") from None
    return Fault(name, number, start, end)


class Faults:
    """The effects of a run, switched on and off as time passes."""

    def __init__(self, faults: list[Fault], scene: FaultScope) -> None:
        for fault in faults:
            if scene.line.protocol not in KINDS[fault.name].protocols:
                raise ParameterError(f'fault: {fault.name}: not possible with these servos; it '
                                     f"needs {' and '.join(KINDS[fault.name].protocols)}")
            if fault.id is not None and scene.line.at(fault.id) is None:
                raise ParameterError(f'fault: {fault.name}:{fault.id}: no device has this ID; use '
                                     'one of --devices')
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
