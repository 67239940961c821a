# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""Which entries dxl_dump shows: --id, --about, --instruction, --errors. Pure."""

import argparse
from collections.abc import Callable

from dxl_monitor.tools.dump.listing import DAMAGED
from dxl_monitor.tools.dump.listing import Entry
from dxl_monitor.tools.dump.listing import MISSED
from dxl_monitor.tools.dump.listing import PACKET


class Filter:
    """options: ids, about, instructions (sets, or None for all), errors and json."""

    def __init__(self, options: argparse.Namespace) -> None:
        self._tests: list[Callable[[Entry], bool]] = []
        ids, about, codes = options.ids, options.about, options.instructions
        if options.json:
            self._tests.append(lambda entry: entry.kind == PACKET)
        if ids is not None or about is not None:
            exact, broad = ids or frozenset(), about or frozenset()
            self._tests.append(lambda entry: _id(entry) in exact or not broad.isdisjoint(
                _ids(entry)))
        if codes is not None:
            self._tests.append(lambda entry: _code(entry) in codes)
        if options.errors:
            self._tests.append(_is_error)

    def wants(self, entry: Entry) -> bool:
        return all(test(entry) for test in self._tests)


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


def _code(entry: Entry) -> int | None:
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
