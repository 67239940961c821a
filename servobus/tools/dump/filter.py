# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""Which entries dxl_dump shows: --id, --about, --instruction, --errors. Pure."""

import argparse

from servobus.tools.dump.listing import DAMAGED
from servobus.tools.dump.listing import Entry
from servobus.tools.dump.listing import MISSED
from servobus.tools.dump.listing import PACKET


def is_wanted(entry: Entry, options: argparse.Namespace) -> bool:
    """Tell whether options ask for it: ids, about, instructions (sets, or None for all), ..."""
    if options.json and entry.kind != PACKET:
        return False
    if options.errors and not _is_error(entry):
        return False
    if options.instructions is not None and _instruction(entry) not in options.instructions:
        return False
    if options.ids is None and options.about is None:
        return True
    return _id(entry) in (options.ids or ()) or not _ids(entry).isdisjoint(options.about or ())


def _id(entry: Entry) -> int | None:
    if entry.packet is not None:
        return entry.packet.id
    if entry.kind == DAMAGED and entry.data:
        return entry.data[0]
    return None if entry.device is None else entry.device.number


def _ids(entry: Entry) -> set[int | None]:
    """Return every ID that it is about; of a status only the device that sent it."""
    own: set[int | None] = {_id(entry)}
    packet = entry.packet
    if packet is not None and packet.error is None:
        own.update(access.id for access in entry.request.accesses)
    own.update(block.id for block in entry.blocks)
    return own


def _instruction(entry: Entry) -> int | None:
    if entry.packet is not None:
        return entry.packet.instruction
    if entry.kind == MISSED:
        return entry.request.instruction
    return entry.code or None


def _is_error(entry: Entry) -> bool:
    packet = entry.packet
    return packet is None or bool(
        packet.error or entry.notes or entry.request.malformed or packet.repaired
        or any(block.error for block in entry.blocks))
