# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""
A packet that somebody typed: whether it is right, what it says, what would be right.

For those who write their own code: e-Manual, Protocol 1.0 and 2.0, "Instruction Packet".
"""

from __future__ import annotations

from contextlib import suppress
import re

from msg_defs.dxl_instruction import Instruction
from msg_defs.dxl_instruction import name_of
from msg_defs.dxl_packet import body_crc
from msg_defs.dxl_packet import BROADCAST
from msg_defs.dxl_packet import HEADER
from msg_defs.dxl_packet import STATUS
from msg_defs.dxl_packet import stuff
from msg_defs.dxl_packet import unstuff
from servobus.bus.decoder import Settings
from servobus.errors import UsageError
from servobus.model.models import Models
from servobus.monitor import Monitor
from servobus.sources.pasted_text import read_text
from servobus.tools.dump.decode import parts_of
from servobus.tools.dump.listing import Entry
from servobus.tools.dump.listing import Listing
from servobus.tools.dump.packet_lines import columns_of

_SEPARATORS = re.compile(r'\\x|0x|[\s,;:{}\[\]()-]', re.IGNORECASE)
_BROKEN = re.compile(r'(?<=\bFF )(?=\S*[G-Z])\S{2}(?!\S)|(?<=[0-9A-F]{2} )(?=\S*[G-Z])'
                     r'(?=\S?[0-9A-F])\S{2}(?!\S)', re.IGNORECASE)     # a letter O, as a rule
_STAMP = 1_000_000_000
_FRONT_1, _FRONT_2 = 4, 7          # bytes up to the end of Length
_MIN_1, _MIN_2 = 6, 10             # bytes of the shortest packet


def bytes_of(text: str) -> bytes:
    """Return the bytes of hex digits, as programs print them; UsageError for something else."""
    digits = _SEPARATORS.sub(' ', text).split()
    with suppress(ValueError):
        return b''.join(bytes.fromhex(one if len(one) != 1 else f'0{one}') for one in digits)
    if broken := _BROKEN.search(' '.join(digits)):
        raise UsageError(f'--check {text!r}: {broken[0]!r} is no byte in hex')
    if data := read_text(text).data:       # decimal numbers, Python's b''
        return data
    raise UsageError(f"--check {text!r}: not bytes in hex; write e.g. 'FF FF 01 04 02 38 02 BE'")


def check_packets(data: bytes, settings: Settings, models: Models) -> tuple[bool, list[str]]:
    """Return whether packets in a row are right, and the lines about them."""
    end = int.from_bytes(data[5:7], 'little') + _FRONT_2 if data.startswith(HEADER) \
        else sum(data[3:4]) + _FRONT_1
    if not data[end:].startswith(b'\xff\xff'):
        return check_packet(data, settings, models)
    first, rest = (check_packet(data[:end], settings, models),
                   check_packets(data[end:], settings, models))
    return first[0] and rest[0], first[1] + rest[1]


def check_packet(packet: bytes, settings: Settings, models: Models) -> tuple[bool, list[str]]:
    """Return whether a packet is right, and the lines about it."""
    is_2 = packet.startswith(HEADER)
    is_feetech = not is_2 and packet[4:5] == bytes((Instruction.SYNC_READ,))
    family = 'Protocol 2.0' if is_2 else 'Feetech' if is_feetech else 'Protocol 1.0 or Feetech'
    if not packet.startswith(b'\xff\xff'):
        return False, ['a packet begins with FF FF FD 00 (Protocol 2.0) or FF FF (Protocol 1.0, '
                       'Feetech)']
    shortest = _MIN_2 if is_2 else _MIN_1
    if len(packet) < shortest:
        return False, [f'{family}: {len(packet)} bytes; the shortest packet has {shortest}']
    if not is_2 and packet[2] == 0xFF:
        return False, [f'{family}: FF FF FF, one FF too many, or ID 255, which no servo has']
    if is_2 and packet[4] in (0xFD, 0xFF):
        return False, [f'{family}: ID {packet[4]}, which no servo has; use 0 to 252, 254 for all']
    right, problems = (_right_2 if is_2 else _right_1)(packet)
    lines = [f'{family}, {len(packet)} bytes: {"wrong" if problems else "right"}', *problems]
    if problems:
        lines.append(f'right: {right.hex(" ").upper()}')
    given = 'feetech' if is_feetech else settings.protocol \
        if settings.protocol not in ('auto', '2') else '1'
    settings = settings._replace(protocol='2' if is_2 else given)
    return not problems, lines + _meaning(right, settings, models)


def _right_1(packet: bytes) -> tuple[bytes, list[str]]:
    body = packet[_FRONT_1:-1]
    length, right_length = packet[3], len(packet) - _FRONT_1
    sums = [~sum((packet[2], one, *body)) & 0xFF for one in (length, right_length)]
    if length == right_length + 1 and packet[-1] not in sums:
        whole = packet + bytes((~sum(packet[2:]) & 0xFF,))
        return whole, [f'its end is missing: the checksum is {whole[-1]:02X}']
    problems = _length_problems(length, right_length)
    if packet[-1] not in sums:
        hint = ': it is the sum, not inverted' if packet[-1] ^ sums[-1] == 0xFF else ''
        problems.append(f'checksum is {packet[-1]:02X}, must be {sums[-1]:02X}{hint}')
    return bytes((0xFF, 0xFF, packet[2], right_length & 0xFF, *body, sums[-1])), problems


def _right_2(packet: bytes) -> tuple[bytes, list[str]]:
    length, right_length = int.from_bytes(packet[5:7], 'little'), len(packet) - _FRONT_2
    right = packet[:5] + right_length.to_bytes(2, 'little') + packet[_FRONT_2:-2]
    crcs = [body_crc(one[4:]).to_bytes(2, 'little') for one in (packet[:-2], right)]
    problems = _length_problems(length, right_length)
    whole = packet[:_FRONT_2 + length - 2]
    whole += body_crc(whole[4:]).to_bytes(2, 'little')
    if length - right_length in (1, 2) and packet[-2:] not in crcs and whole.startswith(packet):
        return whole, [f'its end is missing: the CRC is {whole[-2:].hex(" ").upper()}']
    if (stuffed := _stuffed(packet)) != packet[_FRONT_2:-2]:
        problems.append('FF FF FD after Length must be FF FF FD FD (byte stuffing), and counts '
                        'as 4')
        right = packet[:5] + (len(stuffed) + 2).to_bytes(2, 'little') + stuffed
        return right + body_crc(right[4:]).to_bytes(2, 'little'), problems
    if packet[-2:] not in crcs:
        hint = ': the low byte comes first' if packet[:-3:-1] == crcs[-1] else ''
        problems.append(f'CRC is {packet[-2:].hex(" ").upper()}, must be '
                        f'{crcs[-1].hex(" ").upper()}{hint}')
    return right + crcs[-1], problems


def _stuffed(packet: bytes) -> bytes:
    """Return instruction and parameters as they must be on the wire."""
    body = packet[_FRONT_2:-2]
    is_fast = packet[4] == BROADCAST and body[0] == STATUS         # that is never stuffed
    return body if is_fast else stuff(unstuff(body))


def _length_problems(length: int, right: int) -> list[str]:
    return [f'Length is {length}, must be {right}: the bytes that follow it'] * (length != right)


def _meaning(packet: bytes, settings: Settings, models: Models) -> list[str]:
    """Return what dxl_dump shows of a packet, without its time."""
    found: list[str] = []

    def show(entry: Entry) -> None:
        mark, _, number, name, words = columns_of(entry, parts_of(entry, listing))
        found.append(f'{mark} {number} {name} {words}'.rstrip())
        if (number, name) == ('all', name_of(Instruction.READ)):
            found.append('no device answers: a Read needs the ID of one servo')

    listing = Listing(models, show, settings)
    monitor = Monitor('', models, settings, decoder=listing)
    monitor.feed(packet, _STAMP)
    monitor.end(2 * _STAMP)
    return [one for one in found if not one.startswith('!')]
