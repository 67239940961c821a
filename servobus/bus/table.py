# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""
Table: what is known of one device's memory, byte by byte: the value, when and how it was seen.

keep() is on the packet path and only notes the latest data of a span; the bytes are put in
place when somebody looks. Nothing is decoded before it is asked for. No clock, no locks: the
caller stamps (ns, monotonic) and keeps that and the look apart.
"""

from __future__ import annotations

from array import array
from collections.abc import Callable
from collections.abc import Iterable
from functools import lru_cache
from typing import Literal
from typing import NamedTuple

from servobus.model.control_table import Field
from servobus.model.control_table import Indirect
from servobus.model.control_table import Model
from servobus.model.control_table import Value

READ = 1                           # the device said so
WRITTEN = 2                        # the master wrote it and the device did not refuse
SOURCES = {READ: 'r', WRITTEN: 'w'}
# What lies beyond is not kept: the tables of nearly all devices end before the first of them, and
# none that is known reaches 10600.
USUAL_ADDRESS_END = 0x800
ADDRESS_END_MAX = 0x4000
SPAN_LIMIT = 64                    # spans waiting to be put in place; a master uses a handful
STAMP_MAX_NS = (1 << 63) - 1       # ns: 292 years
WAITING_SPAN_MAX_BYTES = 256       # bytes of a span that does not wait
Data = bytes            # the built-in: Table.bytes hides its name
Span = tuple[int, int]  # address and size
SpanListener = Callable[[Span, Data, int, int], object]
NO_SPAN = (-1, 0)                  # for an answer without registers
IDENTITY_REGISTERS = ('Model Number', 'Model Information', 'Firmware Version')


class Observed(NamedTuple):
    """A field that was seen in full; age_s of its oldest byte, source 'r' or 'w'."""

    field: Field
    value: Value
    age_s: float
    source: str


@lru_cache(maxsize=8192)           # most registers hold at this look what they held at the last
def _decoded(field: Field, raw: bytes) -> Value:
    return field.decode(raw)


class Image:
    """Bytes with a stamp and a source each; source 0 = never seen."""

    def __init__(self) -> None:
        self.data = bytearray()
        self.stamps = array('q')
        self.sources = bytearray()

    def copy(self) -> Image:
        twin = Image()
        twin.data[:] = self.data
        twin.stamps = self.stamps[:]
        twin.sources[:] = self.sources
        return twin

    def grow(self, size: int) -> None:
        more = size - len(self.data)
        if more > 0:
            self.data.extend(bytes(more))
            self.stamps.frombytes(bytes(8 * more))
            self.sources.extend(bytes(more))

    def put(self, address: int, data: bytes, stamp: int, source: int, limit: int) -> None:
        data = data[:max(0, limit - address)]
        end = address + len(data)
        if not data:
            return
        self.grow(end)
        self.data[address:end] = data
        self.stamps[address:end] = array('q', (min(max(stamp, 0), STAMP_MAX_NS),)) * len(data)
        self.sources[address:end] = bytes((source,)) * len(data)

    def knows(self, at: int, end: int) -> bool:
        return end <= len(self.data) and 0 not in self.sources[at:end]

    def resolve_cases(self, field: Field, model: Model) -> Field:
        """Return the field with the meaning that another register gives; while unknown: as is."""
        if field.cases is None:
            return field
        other = model.by_name[field.cases.by]
        if not self.knows(other.at, other.end):
            return field
        code = other.code_of(bytes(self.data[other.at:other.end])) & field.cases.mask
        return field.cases.fields.get(code, field)

    def observed(self, field: Field, now_ns: int) -> Observed:
        at, end = field.at, field.end
        source = WRITTEN if WRITTEN in self.sources[at:end] else READ
        age_s = (now_ns - min(self.stamps[at:end])) / 1e9
        return Observed(field, _decoded(field, bytes(self.data[at:end])), age_s, SOURCES[source])


class _ListenedSpans(dict[Span, tuple[Data, int, int]]):
    """Spans that wait, with a call for each; a plain dict costs nothing more."""

    def __init__(self, waiting: dict[Span, tuple[Data, int, int]], listener: SpanListener) -> None:
        super().__init__(waiting)
        self._listener = listener

    def __setitem__(self, span: Span, seen: tuple[Data, int, int]) -> None:
        super().__setitem__(span, seen)
        self._listener(span, *seen)


class Table:
    """The memory image of one device, up to the address `limit`."""

    def __init__(self) -> None:
        self.limit = USUAL_ADDRESS_END
        self._latest: dict[Span, tuple[Data, int, int]] = {}
        self._image = Image()

    def store(self, address: int, data: Data, stamp: int, source: int) -> None:
        """Note that the bytes from `address` on were seen at `stamp`, READ or WRITTEN."""
        self.keep((address, len(data)), data, stamp, source)

    def keep(self, span: Span, data: Data, stamp: int, source: int) -> None:
        """Do as store(), for who has the span at hand: data are as long as it says."""
        latest = self._latest
        # Taken out and put back, so that the dict stays in order of arrival (stamps may be equal).
        before = latest.pop(span, None)
        latest[span] = (data, stamp, source)
        if before is None and (len(latest) > SPAN_LIMIT or len(data) > WAITING_SPAN_MAX_BYTES):
            self._settle()

    def set_listener(self, listener: SpanListener | None) -> None:
        """Hand each span that comes from now on to the listener, too, as keep() gets it."""
        self._latest = dict(self._latest) if listener is None \
            else _ListenedSpans(self._latest, listener)

    def _settle(self) -> Image:
        if self._latest:
            put = self._image.put
            for (address, _), (data, stamp, source) in self._latest.items():
                put(address, data, stamp, source, self.limit)
            self._latest.clear()
        return self._image

    def copy(self) -> Table:
        """Take a snapshot that later stores do not touch: a few microseconds."""
        twin = Table()
        twin._image = self._settle().copy()
        return twin

    def bytes(self, address: int, size: int) -> Data | None:
        """`size` bytes from `address` on, None unless all were seen; indirect data as they are."""
        image = self._settle()
        end = address + size
        return bytes(image.data[address:end]) if image.knows(address, end) else None

    def observed(self, model: Model, now_ns: int) -> list[Observed]:
        """
        Every field of `model` that is wholly known, in order of address.

        What was read or written through indirect addresses counts for the registers they point
        at; indirect data stay `Indirect Data N` while it is unknown where they point.
        """
        image = self._resolved(model)
        sources = image.sources
        reach = len(sources)
        # The first byte alone rules out most fields of a table of which a part was seen.
        return [image.observed(image.resolve_cases(field, model), now_ns) for field in model.fields
                if field.end <= reach and sources[field.at] and image.knows(field.at, field.end)]

    def resolve_cases(self, field: Field, model: Model) -> Field:
        """Return the field with the meaning that another register gives it at present."""
        return self._settle().resolve_cases(field, model)

    def indirect_places(self, field: Field, model: Model) -> list[int]:
        """Return at which addresses of indirect data a whole field is at present."""
        wanted = [at.to_bytes(2, 'little') for at in range(field.at, field.end)]
        found = []
        for one in model.indirect:
            targets = [self.bytes(one.address + 2 * n, 2) for n in range(one.size)]
            found += [one.data + n for n in range(one.size - field.size + 1)
                      if targets[n:n + field.size] == wanted]
        return found

    def observed_of(self, model: Model, names: Iterable[str],
                    now_ns: int) -> list[Observed | None]:
        """Do as observed(), for these fields; None for what is not known or not there."""
        image = self._resolved(model)
        found = [model.by_name.get(name) for name in names]
        return [image.observed(image.resolve_cases(field, model), now_ns)
                if field is not None and image.knows(field.at, field.end) else None
                for field in found]

    def clear(self) -> None:
        """Forget everything: this is another device."""
        self._latest.clear()
        if self._image.data:
            self._image = Image()

    def forget(self, memory: Literal['ram', 'all'], model: Model,
               keep: Iterable[str] = IDENTITY_REGISTERS) -> None:
        """
        Forget what a Reboot ('ram') or a Factory Reset ('all') has changed.

        'ram' keeps the fields that `model` has in EEPROM, 'all' none; both keep those named by
        `keep`. Bytes the model does not know are forgotten.
        """
        names = set(keep)
        image = self._settle()
        kept = bytearray(len(image.sources))
        for field in model.fields:
            if field.name in names or (memory == 'ram' and field.memory == 'eeprom'):
                kept[field.at:field.end] = image.sources[field.at:field.end]
        image.sources = kept

    def _resolved(self, model: Model) -> Image:
        image = self._settle()
        if len(image.data) <= model.indirect_from:
            return image
        resolved = image.copy()
        for indirect in model.indirect:
            _resolve(image, indirect, resolved)
        return resolved


@lru_cache(maxsize=256)
def kept_end(model: Model) -> int:
    """Return up to which address bytes of this model are kept."""
    ends = [field.end for field in model.fields[-1:]]
    ends += [one.data + one.size for one in model.indirect]
    return min(max(USUAL_ADDRESS_END, *ends), ADDRESS_END_MAX) if ends else USUAL_ADDRESS_END


def _resolve(image: Image, indirect: Indirect, resolved: Image) -> None:
    """
    Move indirect data to the registers they stand for (one level); the newer byte wins.

    Data older than the address they lie under were read when it pointed elsewhere.
    """
    for n in range(indirect.size):
        here, address = indirect.data + n, indirect.address + 2 * n
        if not (image.knows(here, here + 1) and image.knows(address, address + 2)):
            continue
        target = image.data[address] | image.data[address + 1] << 8
        stamp = image.stamps[here]
        if target < ADDRESS_END_MAX and stamp >= max(image.stamps[address:address + 2]):
            resolved.grow(target + 1)
            if stamp >= resolved.stamps[target] or not resolved.sources[target]:
                resolved.data[target] = image.data[here]
                resolved.stamps[target] = stamp
                resolved.sources[target] = image.sources[here]
            resolved.sources[here] = 0
