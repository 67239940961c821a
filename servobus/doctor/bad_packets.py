# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""
Bad packets: instructions of the noise that the program makes wrong, each time in the same way.

A byte that is damaged on the way is another one each time; a program that counts or sums up
wrongly does so in each packet. The noise keeps these whole, as good ones are not part of it.
"""

from __future__ import annotations

from functools import lru_cache
import re
from typing import NamedTuple

from msg_defs.dxl1_instruction import fits
from msg_defs.dxl_instruction import NAMES
from msg_defs.dxl_packet import body_crc
from msg_defs.dxl_packet import BROADCAST
from msg_defs.dxl_packet import HEADER
from msg_defs.dxl_packet import STATUS
from msg_defs.event import IN
from msg_defs.event import OUT
from servobus.doctor.case import Case
from servobus.doctor.thresholds import INCIDENTS_MIN

_HEADS = re.compile(rb'\xff\xff(?:\xfd\x00|(?=[^\xff\xfd]))')      # Protocol 2.0, the 1.0 family
SENT_MIN_PACKETS = 2               # what a program writes is whole; the noise holds few long ones
MIN_BYTES, MIN_BYTES_2 = 6, 10    # the 1.0 family, Protocol 2.0
_SUM = 0x100                       # as `shift`: the sum, not inverted
_LENGTH_1_END, _LENGTH_2_END = 4, 7            # Length counts what follows it


class BadPacket(NamedTuple):
    """What is wrong about a packet: the field, what is in it, what would be right."""

    id: int
    instruction: int
    field: str                     # 'Length', 'checksum', 'CRC'
    got: str
    right: str
    shift: int                     # from the right number to that in the field


def repeated_bad_packet(case: Case) -> BadPacket | None:
    """
    Return the last bad packet of the master, if all of its kind are bad in the same way.

    Where the sides are not known, each of them has to be as wrong as the others, and none good.
    """
    report = case.report
    if not report.noise or report.noise_side == IN \
            or _fresh_noise(case) < INCIDENTS_MIN * MIN_BYTES \
            or not (found := _bad_packets(report.noise)):
        return None
    last = found[-1]
    alike = [one for one in found if one[:3] == last[:3]]
    if report.noise_side == OUT:
        return last if len(alike) >= SENT_MIN_PACKETS else None
    is_good_too = any(cycle.instruction == last.instruction
                      and (last.id == BROADCAST or last.id in cycle.ids)
                      for cycle in report.cycles)
    is_alike = len(alike) >= INCIDENTS_MIN and all(one.shift == last.shift for one in alike)
    return last if is_alike and not is_good_too else None


def _fresh_noise(case: Case) -> int:
    """Return how many bytes of the window are no packet; a recording may have but one report."""
    if len(case.marks) > 1:
        return case.increase_of('bytes') - case.increase_of('packet_bytes')
    return case.report.counters['Noise Bytes']


@lru_cache(maxsize=1)              # it is asked at each report
def _bad_packets(noise: bytes) -> list[BadPacket]:
    """Return the instructions of the noise with one wrong field."""
    begins = [match.start() for match in _HEADS.finditer(noise)]
    packets = [noise[begin:end] for begin, end in zip(begins, [*begins[1:], len(noise)],
                                                      strict=False)]
    return [bad for packet in packets
            if (bad := (_bad_packet_2 if packet.startswith(HEADER) else _bad_packet_1)(packet))
            is not None]


def _bad_packet_1(packet: bytes) -> BadPacket | None:
    """Return what is wrong about a packet of the 1.0 family, from its header to its last byte."""
    if len(packet) < MIN_BYTES:
        return None
    number, length, code = packet[2:5]
    if not fits(code, number, packet[5:-1]):
        return None                    # a status, mostly
    right = len(packet) - _LENGTH_1_END
    excess = sum(packet[2:]) + 1 & 0xFF            # what the sum has too much
    if length != right:
        # The checksum is that of this Length or of the right one, else the packet was cut.
        is_whole = excess in (0, length - right & 0xFF)
        # Bytes 00 do not change the sum: a shell drops them from what it keeps in a variable.
        may_lack = not excess and length > right + 1 and right > MIN_BYTES - _LENGTH_1_END
        zeros = f', or {length - right} bytes 00 are missing' * may_lack
        return BadPacket(number, code, 'Length', f'{length}', f'{right}{zeros}',
                         length - right) if is_whole else None
    checksum = packet[-1] - excess & 0xFF
    is_sum = packet[-1] ^ checksum == 0xFF
    return BadPacket(number, code, 'checksum', f'0x{packet[-1]:02X}', f'0x{checksum:02X}'
                     + ', the inverted sum' * is_sum, _SUM if is_sum else excess) \
        if excess else None


def _bad_packet_2(packet: bytes) -> BadPacket | None:
    """Return what is wrong about a packet of Protocol 2.0."""
    if len(packet) < MIN_BYTES_2:
        return None
    number, length, code = packet[4], int.from_bytes(packet[5:7], 'little'), packet[7]
    right, crc = len(packet) - _LENGTH_2_END, body_crc(packet[4:-2])
    sent = int.from_bytes(packet[-2:], 'little')
    if code not in NAMES or code == STATUS:
        return None
    if length != right:
        return BadPacket(number, code, 'Length', f'{length}', f'{right}',
                         length - right) if sent == crc else None
    if sent == crc:
        return None
    is_swapped = packet[-2:] == crc.to_bytes(2, 'big')
    return BadPacket(number, code, 'CRC', f'0x{sent:04X}', f'0x{crc:04X}'
                     + ', low byte first' * is_swapped, 0 if is_swapped else sent ^ crc)
