# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""
The registers of the devices of one bus, value by value, as they were read and written.

Once it has started, the bytes of all spans of the last minute are kept, so that a register that
is chosen now has a past; only what is chosen is decoded, when somebody asks. Stamps are those of
the monitor, in s.
"""
from __future__ import annotations

from bisect import bisect_right
from collections.abc import Callable
from collections.abc import Iterator
from contextlib import AbstractContextManager
import math
from struct import Struct

from msg_defs.signal import PointRing
from msg_defs.signal import Points
from msg_defs.signal import SPAN_S
from servobus.bus.device import Device
from servobus.bus.registry import DeviceRegistry
from servobus.bus.table import Span
from servobus.bus.table import WRITTEN
from servobus.model.control_table import Field
from servobus.model.control_table import UNKNOWN

BYTES_MAX = 64_000_000              # for a bus: then the past is shorter than a minute
LOGS_MAX = 256                      # spans for a device
_LOG_BYTES = 1000                   # a new log: it grows to what a minute needs
_STAMP = Struct('<d')
_Value = tuple[float, float, int]   # s, number, READ or WRITTEN


class BusSignals:
    """The registers of a bus; lock: held by who changes its devices."""

    def __init__(self, registry: DeviceRegistry, lock: AbstractContextManager[object]) -> None:
        self._registry = registry
        self._lock = lock
        self._is_started = False
        self._recorders: dict[Device, _DeviceSignals] = {}

    def start(self) -> None:
        """Keep what is read and written from now on."""
        with self._lock:
            self._is_started = True
            self._registry.new_ids |= self._registry.devices.keys()
            self.attach_new()

    def read(self, number: int, key: str, after: int, since_s: float) -> Points | None:
        """Return the points of a register from a number on; None without such a device."""
        with self._lock:
            recorder = self._recorder(number)
            return None if recorder is None else recorder.ring(key, since_s).after(after, since_s)

    def drop(self, number: int, key: str) -> None:
        """Keep the points of a register no more."""
        with self._lock:
            if recorder := self._recorder(number):
                recorder.rings.pop(key, None)

    def attach_new(self) -> None:
        """Keep what comes from the devices that are new, before more comes from them."""
        devices, new = self._registry.devices, self._registry.new_ids
        if self._is_started:
            here = {devices[number] for number in new & devices.keys()}
            here |= {one for one in self._recorders if devices.get(one.number) is one}
            self._recorders = {one: self._recorders.get(one) or self._attach(one) for one in here}
        new.clear()

    def _attach(self, device: Device) -> _DeviceSignals:
        recorder = _DeviceSignals(device, self._registry, self._can_grow)
        device.table.set_listener(recorder.record_span)
        return recorder

    def _recorder(self, number: int) -> _DeviceSignals | None:
        device = self._registry.devices.get(number)
        return None if device is None else self._recorders.get(device)

    def _can_grow(self, more: int) -> bool:
        return more + sum(log.limit for one in self._recorders.values()
                          for log in one.logs.values()) <= BYTES_MAX


class _SpanLog:
    """What one span of a table held, time after time: s as f64, then its bytes."""

    def __init__(self, span: Span, deciding: list[int]) -> None:
        self.data = bytearray()
        self.size = _STAMP.size + span[1]
        self.limit = max(_LOG_BYTES, 4 * self.size)
        self.deciding = deciding            # addresses of what other registers depend on

    def first_after(self, s: float) -> int:
        """Return where the entries after a time begin."""
        return self.size * bisect_right(range(len(self.data) // self.size), s, key=self._stamp)

    def _stamp(self, entry: int) -> float:
        stamp: float = _STAMP.unpack_from(self.data, entry * self.size)[0]
        return stamp

    def last_s(self) -> float:
        return self._stamp(len(self.data) // self.size - 1) if self.data else -math.inf

    def values(self, at: int, field: Field, after_s: float) -> Iterator[tuple[float, float]]:
        """Yield what a register was, from its first byte in the span, after a time."""
        entry = Struct(f'<d{at}x{field.size}s{self.size - _STAMP.size - at - field.size}x')
        numbers: dict[bytes, float] = {}
        for s, raw in entry.iter_unpack(bytes(self.data[self.first_after(after_s):])):
            if raw not in numbers:
                numbers[raw] = _number(field, raw)
            yield s, numbers[raw]

    def make_room(self, can_grow: Callable[[int], bool]) -> None:
        """Forget what is older than a minute; more only where the bus has no room to grow."""
        del self.data[:self.first_after(self.last_s() - SPAN_S)]
        if 4 * len(self.data) > 3 * self.limit:
            if can_grow(self.limit // 2):
                self.limit += self.limit // 2
            else:
                del self.data[:len(self.data) // self.size // 2 * self.size]


class _DeviceSignals:
    """The spans of one device, and the points of its chosen registers."""

    def __init__(self, device: Device, registry: DeviceRegistry,
                 can_grow: Callable[[int], bool]) -> None:
        self._device = device
        self._resolve = registry.resolve
        self._can_grow = can_grow
        self._model = UNKNOWN               # for which the following holds
        self._deciding: list[tuple[int, int]] = []
        self._decided: dict[int, int] = {}          # their bytes, by address
        self._places: dict[str, list[tuple[Field, int]]] = {}      # where chosen registers are
        self.logs: dict[tuple[Span, int], _SpanLog] = {}
        self.rings: dict[str, PointRing] = {}

    def record_span(self, span: Span, data: bytes, stamp: int, source: int) -> None:
        """Record bytes of the table; called by it, for each span that was read or written."""
        device = self._device
        if device.is_unresolved or device.model is not self._model:
            self._accept_model()
        log = self.logs.get((span, source)) or self._begin_log(span, source)
        if log.deciding and self._has_other_meaning(log, span, data, source):
            log = self._begin_log(span, source)
        log.data += _STAMP.pack(stamp / 1e9) + data
        if len(log.data) > log.limit:
            log.make_room(self._can_grow)

    def ring(self, key: str, since_s: float) -> PointRing:
        """Return the points of a register, with all that came up to now."""
        if self._device.is_unresolved or self._device.model is not self._model:
            self._accept_model()
        if key not in self.rings:
            self.rings[key] = PointRing()
            self._places[key] = self._locate(key)
        self._fill(key, since_s)
        return self.rings[key]

    def _fill(self, key: str, since_s: float) -> None:
        ring = self.rings[key]
        after_s = max(since_s, ring.last_s())
        found = sorted(
            (s, number, source) for field, at in self._places[key]
            for ((begin, size), source), log in self.logs.items()
            if begin <= at and at + field.size <= begin + size
            for s, number in log.values(at - begin, field, after_s))
        for s, number, _ in found:
            ring.add(s, number)
        if found:
            ring.is_written = found[-1][2] == WRITTEN

    def _accept_model(self) -> None:
        """Begin again where this is another model; what came while it was unknown stays."""
        self._resolve(self._device)
        before, self._model = self._model, self._device.model
        if before is self._model:
            return
        model = self._model
        self._deciding = [(one.address, one.address + 2 * one.size) for one in model.indirect]
        self._deciding += [(other.at, other.end) for field in model.fields if field.cases
                           for other in [model.by_name[field.cases.by]]]
        if before is not UNKNOWN:
            self._forget()
        for (span, _), log in self.logs.items():
            log.deciding = self._deciding_in(span)
        self._places = {key: self._locate(key) for key in self.rings}

    def _begin_log(self, span: Span, source: int) -> _SpanLog:
        if len(self.logs) >= LOGS_MAX:
            del self.logs[min(self.logs, key=lambda one: self.logs[one].last_s())]
        log = self.logs[span, source] = _SpanLog(span, self._deciding_in(span))
        return log

    def _has_other_meaning(self, log: _SpanLog, span: Span, data: bytes, source: int) -> bool:
        """Return whether what was before was forgotten, as registers mean something else now."""
        now = {at: data[at - span[0]] for at in log.deciding}
        known = self._decided
        if now.items() <= known.items():
            return False
        self._decided = known | now
        is_other = source == WRITTEN or any(known.get(at, now[at]) != now[at] for at in now)
        if is_other:                                # what was read first held before, too
            self._forget()
        self._places = {key: self._locate(key) for key in self.rings}
        return is_other

    def _forget(self) -> None:
        for key in self.rings:
            self._fill(key, -math.inf)
        self.logs.clear()

    def _deciding_in(self, span: Span) -> list[int]:
        return [at for at in range(span[0], sum(span))
                if any(first <= at < last for first, last in self._deciding)]

    def _locate(self, key: str) -> list[tuple[Field, int]]:
        """Find where a register is: at its own address, and where indirect data are it."""
        table, model = self._device.table, self._model
        return [(field, at) for one in model.fields for field in [table.resolve_cases(one, model)]
                if field.key == key
                for at in (field.at, *table.indirect_places(field, model))]


def _number(field: Field, raw: bytes) -> float:
    value = field.decode(raw)
    number = math.nan if field.unit else value.raw      # words have no number in a unit
    return number if value.number is None else value.number
