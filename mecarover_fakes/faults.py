# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""
The faults that the simulated bus can play, by name, and how a person writes one.

'silent:5:2:3' is fault `silent` of ID 5 from second 2 on for 3 seconds; without ID: the first
device or all, as the fault's line says; without times: from the beginning, for ever.
"""

from __future__ import annotations

import re
from threading import Lock

from mecarover_fakes import fault_device
from mecarover_fakes import fault_master
from mecarover_fakes import fault_setup
from mecarover_fakes import fault_wire
from mecarover_fakes.fault import Effect
from mecarover_fakes.fault import Fault
from mecarover_fakes.fault import FaultScope
from mecarover_fakes.fault import Play
from msg_defs.nanoseconds import NS_PER_S
from servobus.errors import did_you_mean
from servobus.errors import ParameterError

MODULES = (fault_device, fault_master, fault_setup, fault_wire)      # what is in `kinds`
KINDS = Effect.kinds
BACK = 'back'                    # the command that ends faults
_SECONDS = r'(\d{1,9}(?:\.\d*)?)?'
_FORM = re.compile(rf'\w+(?::(\d{{1,9}})?(?::{_SECONDS}(?::{_SECONDS})?)?)?')


def parse(text: str) -> Fault:
    """Return the fault that a person wrote; raise ParameterError when it is none."""
    name = text.partition(':')[0]
    if name not in KINDS:
        raise ParameterError(f'fault: there is no fault {name!r}; {did_you_mean(name, KINDS)}')
    found = _FORM.fullmatch(text)
    if found is None:
        raise ParameterError(f'fault: {text!r} does not have the form NAME[:id[:at_s[:for_s]]]; '
                             "write e.g. 'silent:5:2:3'")
    number, begin, length = found.groups()
    start = round(float(begin or 0) * NS_PER_S)
    return Fault(name, int(number) if number else None, start,
                 start + round(float(length) * NS_PER_S) if length else None)


class Faults:
    """The effects of a run, switched on and off as time passes."""

    def __init__(self, faults: list[Fault], scope: FaultScope) -> None:
        self._scope = scope
        for fault in faults:
            self._check(fault)
        self._waiting = sorted(faults, key=lambda fault: fault.begin)
        self._running: dict[Effect, Play] = {}
        self._lock = Lock()            # commands come from another thread

    def _check(self, fault: Fault) -> None:
        line, protocols = self._scope.line, KINDS[fault.name].protocols
        if line.protocol not in protocols:
            raise ParameterError(f'fault: {fault.name}: not possible with these servos; it '
                                 f"needs {' and '.join(protocols)}")
        if fault.id is not None and line.at(fault.id) is None:
            raise ParameterError(f'fault: {fault.name}:{fault.id}: no device has this ID; use '
                                 'one of --devices')

    def command(self, text: str, now: int) -> None:
        """
        Begin the fault of a command, its times from `now` on, or end faults at the next update().

        text: as parse() reads it, or `back`, `back NAME`, `back NAME:ID`. From any thread.
        """
        word, _, which = text.partition(' ')
        fault = parse(which if word == BACK else text) if text != BACK else None
        with self._lock:
            if fault is None or word == BACK:
                self._end(fault, now)
                return
            self._check(fault)
            self._waiting.append(fault._replace(
                begin=now + fault.begin, end=None if fault.end is None else now + fault.end))

    def _end(self, fault: Fault | None, now: int) -> None:
        """End what has the name and the ID of a fault, None: all."""
        waiting = [one for one in self._waiting if fault is None or one[:2] == fault[:2]]
        running = [one for one in self.active if fault is None or one.fault[:2] == fault[:2]]
        if fault and not waiting and not running:
            raise ParameterError(f'fault: {fault.name} is not on like that; `{BACK}` ends all')
        for one in waiting:
            self._waiting.remove(one)
        for effect in running:
            effect.fault = effect.fault._replace(end=now)

    @property
    def active(self) -> tuple[Effect, ...]:
        """The effects that are on."""
        return tuple(self._running)

    def update(self, now: int) -> None:
        """Begin and end what is due at `now`."""
        with self._lock:
            for fault in [one for one in self._waiting if one.begin <= now]:
                self._waiting.remove(fault)
                effect = KINDS[fault.name](fault, self._scope)
                effect.now = now
                self._running[effect] = effect.play()
                next(self._running[effect])
            for effect in self.active:
                effect.now = now
                if effect.fault.end is not None and effect.fault.end <= now:
                    next(self._running.pop(effect), None)
            for effect in self.active:
                effect.step()
