# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""A packet as a JSON object, for `dxl_dump --json`; docs/dump.md describes it. Pure."""

from collections.abc import Sequence
import json
from typing import Any

from msg_defs.dxl_instruction import name_of
from msg_defs.dxl_packet import Packet
from servobus.bus.evidence import text_of
from servobus.tools.dump.decode import Part
from servobus.tools.dump.listing import Entry
from servobus.tools.dump.listing import NO_REQUEST
from servobus.tools.dump.text_format import packet_name
from servobus.tools.dump.text_format import status_error

DECIMALS = 9                       # finer than any register


def json_line(bus: str, stamp_us: int, packet: Packet, entry: Entry, parts: Sequence[Part]
              ) -> str:
    """Return one packet; stamp_us as it is to be shown."""
    record: dict[str, Any] = {
        'stamp': stamp_us / 1e6, 'offset': packet.offset, 'bus': bus, 'id': packet.id,
        'code': packet.instruction, 'instruction': packet_name(packet),
        'error': packet.error, 'params': packet.params.hex(), 'repaired': packet.repaired,
        'model': None if entry.device is None else entry.device.model.known_name or None,
    }
    if entry.side:
        record['side'] = entry.side
    if packet.error is not None and entry.request is not NO_REQUEST:
        record['answer_to'] = name_of(entry.request.instruction)
        record['sure'] = entry.is_sure
    if packet.error:
        record['error_text'] = status_error(packet, entry)
    if entry.identity is not None:
        record['identity'] = entry.identity._asdict()
    if entry.request.option and packet.error is None:
        record['option'] = entry.request.option
    if parts:
        record['registers'] = [_registers(part) for part in parts]
    if entry.notes:
        record['notes'] = [text_of(incident) for incident in entry.notes]
    return json.dumps(record)


def _registers(part: Part) -> dict[str, Any]:
    found: dict[str, Any] = {'id': part.id, 'address': part.address, 'length': part.length}
    if part.error:
        found['error'] = part.error
    if part.data is None:
        found['names'] = [field.name for field in part.fields]
    else:
        found['data'] = part.data.hex()
        found['values'] = {
            field.key: value.text if value.number is None else round(value.number, DECIMALS)
            for field, value in zip(part.fields, part.values, strict=True)}
    return found
