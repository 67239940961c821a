# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""
The meaning of a packet in words, for a line of dxl_dump.

Pure. 'Goal Position 1.5708 rad' where the model is known, '4 at 116: 00 08 00 00' where not.
"""

from collections.abc import Sequence
from itertools import groupby

from msg_defs.dxl1_instruction import error_text as bits_text
from msg_defs.dxl1_instruction import UNDECIDED
from msg_defs.dxl_instruction import ALERT
from msg_defs.dxl_instruction import Answers
from msg_defs.dxl_instruction import error_text
from msg_defs.dxl_instruction import name_of
from msg_defs.dxl_instruction import NAMES
from msg_defs.dxl_packet import Packet
from msg_defs.dxl_packet import STATUS
from msg_defs.servo_frame import OPEN
from servobus.bus.evidence import text_of
from servobus.bus.expected_devices import spans
from servobus.tools.dump.decode import Part
from servobus.tools.dump.listing import Entry

# What a device means by its error number (e-Manual, Protocol 2.0, status packet).
_ERROR_MEANINGS = {
    1: 'it could not do it', 2: 'it does not know this instruction',
    3: 'the instruction came damaged', 4: 'value out of range', 5: 'too few bytes',
    6: 'beyond its limit', 7: 'no such register, read-only, or locked by Torque Enable',
}
_FLAWS = {'crc': 'wrong CRC', 'cut': 'ends too early', 'length': 'impossible Length'}


def error_words(error: int) -> str:
    """Return an error byte with what it means: 'Access error: no such register, ...'."""
    code = error & ~ALERT
    words = [f'{error_text(code)} error: {_ERROR_MEANINGS[code]}' if code in _ERROR_MEANINGS
             else f'unknown error {code}'] if code else []
    if error & ALERT:
        words.append('alert: see Hardware Error Status')
    return '; '.join(words)


def status_error(packet: Packet, entry: Entry) -> str:
    """Return what the error byte of a status means; of the 1.0 family each bit of it."""
    if entry.is_2:
        return error_words(packet.error or 0)
    error = sum(entry.wire[-2 - len(packet.params):][:1])
    dialect = (entry.device.dialect if entry.device is not None else None) or UNDECIDED
    return 'error: ' + ', '.join(f'{bits_text(1 << bit, dialect)} (bit {bit})'
                                 for bit in range(8) if error >> bit & 1)


def packet_name(packet: Packet) -> str:
    """Return its instruction or 'Status'; its code may be an instruction of 1.0."""
    is_strange = packet.error is None and packet.instruction == STATUS
    return f'instruction 0x{STATUS:02X}' if is_strange else name_of(packet.instruction)


def request_words(packet: Packet, entry: Entry, parts: Sequence[Part]) -> str:
    """Return what an instruction asks for."""
    request = entry.request
    if request.malformed:
        return f'makes no sense: {packet.params.hex(" ")}'
    if parts:
        return _grouped(parts, with_ids=request.answers in _LISTS or len(parts) > 1
                        or packet.id != parts[0].id)
    if packet.instruction not in NAMES:
        return f'unknown; {packet.params.hex(" ")}'
    return request.option or packet.params.hex(' ')


_LISTS = (Answers.LISTED, Answers.COMBINED, Answers.ADAPTER)


def answer_words(packet: Packet, entry: Entry, parts: Sequence[Part]) -> str:
    """Return what a status says, its error first; (?): damage may hide what it answers."""
    words = [text_of(incident) for incident in entry.notes]
    if packet.error and not entry.blocks:
        words.append(status_error(packet, entry))
    if one := entry.identity:
        words.append(f'{one.model_name or f"unknown model {one.model_number}"}, '
                     f'firmware {one.firmware}')
    elif parts:
        words.append(_grouped(parts, with_ids=bool(entry.blocks)))
    elif packet.params:
        words.append(packet.params.hex(' '))
    return ('; '.join(words) or 'ok') + ('' if entry.is_sure else '  (?)')


def missed_words(entry: Entry) -> str:
    """Return what was not answered."""
    accesses = entry.request.accesses
    where = f' at {accesses[0].address}' if accesses else ''
    return f'no answer to {name_of(entry.request.instruction)}{where}'


def damaged_words(entry: Entry) -> str:
    """Return what is wrong about a frame, or undecided, and its bytes."""
    name = name_of(entry.code) if entry.code else 'packet'
    if entry.reason == OPEN:
        return f'{name}, or a status; {entry.data.hex(" ")}'
    return f'{name}: {flaw_words(entry)}; {entry.data.hex(" ")}'


def flaw_words(entry: Entry) -> str:
    """Return what is wrong about a frame; of Protocol 2.0 it has a CRC."""
    return 'wrong checksum' if entry.reason == 'crc' and not entry.is_2 else _FLAWS[entry.reason]


def noise_words(entry: Entry) -> str:
    """Return how much noise there was; a lot of it hints at the baud rate."""
    if entry.data:
        return f'{entry.length} bytes and no packet: wrong --baud? ... {entry.data.hex(" ")}'
    return f'{entry.length} bytes of noise'


def _grouped(parts: Sequence[Part], with_ids: bool) -> str:
    """
    Return parts in words, devices with the same registers together.

    Devices of one model have the same range in common, but not what is in it: indirect
    addresses may differ, and what a register means may hang on another one.
    """
    words = []
    for _, group in groupby(parts, key=lambda part: (
            part.model, part.address, part.length, part.fields, part.data is None, part.error)):
        same = list(group)
        show = _fields_asked if same[0].data is None else _values_shown
        words.append(show(same, with_ids))
    return '; '.join(words)


def _fields_asked(parts: Sequence[Part], with_ids: bool) -> str:
    one = parts[0]
    front = ', '.join(spans(part.id for part in parts)) + ': ' if with_ids else ''
    place = f'{one.length} at {one.address}'
    if not one.fields:
        return f'{front}{place}'
    first, last = one.fields[0].name, one.fields[-1].name
    return f'{front}{first if first == last else f"{first} .. {last}"} ({place})'


def _values_shown(parts: Sequence[Part], with_ids: bool) -> str:
    one = parts[0]
    if len(parts) > 1 and len(one.fields) == 1 and not one.error:
        values = ', '.join(f'{part.id}: {part.values[0].text}' for part in parts)
        return f'{one.fields[0].key}  {values}'
    return '; '.join((f'{part.id}: ' if with_ids else '') + _values(part) for part in parts)


def _values(part: Part) -> str:
    if part.error:
        return error_words(part.error)
    if not part.fields:
        return f'{part.length} at {part.address}: {(part.data or b"").hex(" ")}'
    return ', '.join(f'{field.name} {value.text} {field.unit}'.rstrip()
                     for field, value in zip(part.fields, part.values, strict=True))
