# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""
What a packet says: which registers of which devices, with their names and values.

The one place that knows; text_format.py makes text of it, json.py JSON. Names and values
come from the models, indirect data from where they point; without a model there are raw bytes.
"""

from collections.abc import Sequence
from functools import lru_cache
from typing import NamedTuple

from msg_defs.dxl_instruction import Access
from servobus.bus.table import Table
from servobus.model.control_table import Field
from servobus.model.control_table import Model
from servobus.model.control_table import UNKNOWN
from servobus.model.control_table import Value
from servobus.tools.dump.listing import Entry
from servobus.tools.dump.listing import Listing

LAYOUTS_MAX = 1024
DATA_MAX_BYTES = 1024              # bytes of data: more do not fit into a packet
_NOTHING = Table()


class Part(NamedTuple):
    """
    What a packet says of one device.

    data is None where data are only asked for; `fields` are then those that are asked for, and
    `values` is empty. error: of this device, in a combined status.
    """

    id: int
    model: Model
    address: int
    length: int
    data: bytes | None
    fields: tuple[Field, ...]
    values: tuple[Value, ...]
    error: int = 0


Layout = tuple[tuple[Field, tuple[int, ...]], ...]     # a field, and where its bytes are


def parts_of(entry: Entry, listing: Listing) -> list[Part]:
    """
    Return what an instruction or a status is about, in the order on the wire.

    Call it only while the entry is handed on.
    """
    packet = entry.packet
    if packet is None:
        return []
    accesses = entry.request.accesses
    if packet.error is None:
        return [_part(listing, access, access.data) for access in accesses]
    if entry.blocks:
        by_id = {access.id: access for access in accesses}
        return [_part(listing, by_id[block.id], block.data, block.error)
                for block in entry.blocks]
    return [_part(listing, access, packet.params) for access in accesses
            if access.id == packet.id and access.data is None
            and access.length == len(packet.params)]


def _part(listing: Listing, access: Access, data: bytes | None, error: int = 0) -> Part:
    device = listing.device(access.id)
    model, table = (UNKNOWN, _NOTHING) if device is None else (device.model, device.table)
    layout = _layout(model, access, table)
    fields = tuple(field if field.cases is None else table.resolve_cases(field, model)
                   for field, _ in layout)
    values = () if data is None else tuple(
        field.decode(bytes([data[index] for index in indices]))
        for field, (_, indices) in zip(fields, layout, strict=True))
    return Part(access.id, model, access.address, access.length, data, fields, values, error)


def _layout(model: Model, access: Access, table: Table) -> Layout:
    """Return the fields that lie wholly in a range, and which of its bytes are theirs."""
    _, address, length, _ = access
    if model is UNKNOWN or length > DATA_MAX_BYTES:
        return ()
    is_indirect = any(one.data < address + length and address < one.data + one.size
                      for one in model.indirect)
    return _lay_out(model, _targets(model, access, table) if is_indirect
                    else range(address, address + length))


def _targets(model: Model, access: Access, table: Table) -> tuple[int, ...]:
    """
    Return where each byte of a range belongs, indirect data where they point.

    A write that sets the addresses and the data after them at once goes by its own addresses.
    """
    _, first, length, written = access
    targets = []
    for at in range(first, first + length):
        target = None
        for one in model.indirect:
            if one.data <= at < one.data + one.size:
                where = one.address + 2 * (at - one.data)
                target = table.bytes(where, 2)
                if written is not None and first <= where <= first + length - 2:
                    target = written[where - first:where - first + 2]
        targets.append(at if target is None else target[0] | target[1] << 8)
    return tuple(targets)


@lru_cache(LAYOUTS_MAX)
def _lay_out(model: Model, targets: Sequence[int]) -> Layout:
    index_of = {target: index for index, target in enumerate(targets)}
    found = [(field, tuple(index_of[at] for at in range(field.at, field.end)))
             for field in model.fields
             if all(at in index_of for at in range(field.at, field.end))]
    return tuple(sorted(found, key=lambda one: one[1][0]))
