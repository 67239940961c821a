# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""
Chosen registers of the devices of one bus, value by value, as they are read and written.

What is not chosen costs nothing: only the table of a device with a chosen register calls back.
Stamps are those of the monitor, in s.
"""
from __future__ import annotations

from contextlib import AbstractContextManager
import math

from msg_defs.signal import PointRing
from msg_defs.signal import Points
from servobus.bus.device import Device
from servobus.bus.registry import DeviceRegistry
from servobus.bus.table import Span
from servobus.bus.table import WRITTEN
from servobus.model.control_table import Field
from servobus.model.control_table import Model


class BusSignals:
    """The chosen registers of a bus; lock: held by who changes its devices."""

    def __init__(self, registry: DeviceRegistry, lock: AbstractContextManager[object]) -> None:
        self._registry = registry
        self._lock = lock
        self._chosen: dict[int, dict[str, PointRing]] = {}       # by ID and key
        self._recorders: dict[int, _DeviceSignals] = {}

    def read(self, number: int, key: str, after: int, since_s: float) -> Points:
        """Return what was recorded of a register, and record it from now on."""
        with self._lock:
            device = self._registry.devices.get(number)
            rings = self._chosen.setdefault(number, {})
            ring = rings.get(key)
            if ring is None:
                ring = rings[key] = PointRing()
                self._recorders.pop(number, None)
            if device is not None:
                self._attach(device)
            return ring.after(after, since_s)

    def drop(self, number: int, key: str) -> None:
        """Record a register no more."""
        with self._lock:
            rings = self._chosen.get(number, {})
            rings.pop(key, None)
            recorder = self._recorders.pop(number, None)
            if recorder is not None and recorder.device.number == number:
                recorder.device.table.set_listener(None)
                self._attach(recorder.device)

    def attach_new(self) -> None:
        """Record what is chosen of the devices that are new, before more comes from them."""
        new = self._registry.new_ids
        for number in new & self._chosen.keys() & self._registry.devices.keys():
            self._attach(self._registry.devices[number])
        new.clear()

    def _attach(self, device: Device) -> None:
        rings = self._chosen.get(device.number)
        recorder = self._recorders.get(device.number)
        if rings and (recorder is None or recorder.device is not device):
            recorder = _DeviceSignals(device, rings, self._registry)
            self._recorders[device.number] = recorder
            device.table.set_listener(recorder.record_span)


class _DeviceSignals:
    """The chosen registers of one device."""

    def __init__(self, device: Device, rings: dict[str, PointRing],
                 registry: DeviceRegistry) -> None:
        self.device = device
        self._number = device.number
        self._rings = rings
        self._resolve = registry.resolve
        self._model: Model | None = None            # for which the following holds
        self._places: list[tuple[PointRing, int, Field]] = []
        self._deciding: list[tuple[int, int]] = []

    def record_span(self, span: Span, data: bytes, stamp: int, source: int) -> None:
        """Record bytes of the table; called by it, for each span that was read or written."""
        if self.device.number != self._number:
            return                                  # it was given another ID
        self._resolve(self.device)
        if self._model is not self.device.model:
            self._locate(self.device.model)
        address, end = span[0], sum(span)
        for ring, at, field in self._places:
            if address <= at and at + field.size <= end:
                value = field.decode(data[at - address:at - address + field.size])
                number = math.nan if field.unit else value.raw  # words have no number in a unit
                ring.add(stamp / 1e9, number if value.number is None else value.number)
                ring.is_written = source == WRITTEN
        for first, last in self._deciding:
            if address < last and first < end:
                self._model = None

    def _locate(self, model: Model) -> None:
        """Find where the registers are: at their own address, and where indirect data are they."""
        table = self.device.table
        in_force = {field.key: field for field in (
            table.in_force(one, model) for one in model.fields)}
        self._model = model
        self._places = [(ring, at, field) for key, ring in self._rings.items()
                        for field in [in_force.get(key)] if field is not None
                        for at in (field.at, *table.indirect_places(field, model))]
        self._deciding = [(one.address, one.address + 2 * one.size) for one in model.indirect]
        self._deciding += [(other.at, other.end) for field in model.fields if field.cases
                           for other in [model.by_name[field.cases.by]]]
