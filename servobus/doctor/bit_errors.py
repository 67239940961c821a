# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""
What damage looks like bit by bit: which bits of a packet turned over, and what does that. Pure.

A damaged packet is compared with what must have been sent: header, ID, length and code are known
from what the master repeats; in the rest a single wrong bit is found by the checksum. What this
says is evidence of a finding, worded as "looks like", and nothing where it is not clear.
"""

from __future__ import annotations

from collections import Counter
from collections import defaultdict
from collections.abc import Iterable
from collections.abc import Sequence
from functools import lru_cache
from typing import NamedTuple

from msg_defs.crc import crc16
from msg_defs.dxl1_packet import HEADER as FAMILY_HEADER
from msg_defs.dxl1_packet import MAX_LENGTH as MAX_LENGTH_1
from msg_defs.dxl_instruction import Instruction
from msg_defs.dxl_packet import BROADCAST
from msg_defs.dxl_packet import encode
from msg_defs.dxl_packet import HEADER
from msg_defs.dxl_packet import MAX_LENGTH
from msg_defs.dxl_packet import STATUS
from servobus.bus.report import BusReport
from servobus.bus.report import PROTOCOL_2

KNOWN_BITS_MAX_WRONG = 1 / 8       # share; by chance half are
PICTURE_MIN = 8                    # damaged packets, and wrong bits, that make a picture
NEARLY_ALL = 0.9
NEARLY_NONE = 0.1
SINGLE_BITS_MIN_SHARE = 0.7        # share of packets: at most two bits of their first wrong byte
SAME_BITS_MIN_SHARE = 1 / 4        # share of packets of a kind, wrong in the same way: no chance
GAPS_MIN = 16                      # distances between wrong bits that can show a period
GAPS_MAX = 100
BYTE_GRID_MIN_SHARE = 0.7          # share of the gaps, which are whole bytes: it goes with these
PERIOD_MIN_SHARE = 3 / 4           # share of the gaps, which are multiples of it: by chance 1 in 5
GAP_TOLERANCE_BITS = 1.5
RARER_WAY_MIN_SHARE = 1 / 4        # share of packets, for wrong bits that go both ways
PULSE_MAX_BITS = 15                # nearer wrong bits are of one pulse
OVERLAID_MIN_SHARE = 0.4           # share of a question's ones: in other bytes fewer fit by chance
NOISE_MAX_BITS = 2                 # wrong: more is another packet, not noise
SYNC_READS = (Instruction.SYNC_READ, Instruction.FAST_SYNC_READ)
_Question = tuple[int, tuple[int, ...], int | None, int]     # instruction, IDs, address, length
LINE_BITS = 10                     # a byte on the line, start and stop bit with it

CLOCK = 'a wrong clock rate: the last bits of bytes are wrong'
TWO_SENDERS = 'two senders at once'
SIGNAL_LEVEL = 'a wrong level or edge'
INTERFERENCE = 'interference: single wrong bits, 0 as 1 and 1 as 0'
PWM = 'the PWM of a motor'


class ExpectedPacket(NamedTuple):
    """What is known of a packet that is due again and again. known: its first bytes."""

    known: bytes
    size: int                      # bytes in all
    device: int                    # who says it, -1 for the master


class WrongBit(NamedTuple):
    """One wrong bit. at: bits of the line from the first start bit, -1 unknown."""

    at: int
    bit: int                       # 0 to 7 in its byte
    is_up: bool                    # 0 became 1
    is_late: bool | None           # it is as the bit before it was, None unknown


class DamagedPacket(NamedTuple):
    """A damaged packet that was recognised; flips: none where too many bits of data are wrong."""

    device: int
    size: int                      # bytes of the packet
    flips: tuple[WrongBit, ...]


# --- what is due -------------------------------------------------------------------------------

def expected_packets(report: BusReport) -> tuple[ExpectedPacket, ...]:
    """Return what the master repeats and what is answered, in the form of this bus."""
    is_2 = report.protocol.startswith(PROTOCOL_2)
    longest = MAX_LENGTH - 4 if is_2 else MAX_LENGTH_1 - 2     # bytes of data in a status
    found: dict[ExpectedPacket, None] = {}
    sizes: dict[int, int] = {Instruction.WRITE: 0, Instruction.PING: 3 if is_2 else 0}
    for cycle in report.cycles:
        code = cycle.instruction
        size = sizes.get(code, cycle.length)
        if size <= longest and (code in (Instruction.READ, Instruction.SYNC_READ)
                                or (code in sizes and len(cycle.ids) == 1)):
            found.update((_expected_status(number, size, is_2), None) for number in cycle.ids)
    return tuple(found)


def _expected_status(number: int, size: int, is_2: bool) -> ExpectedPacket:
    if is_2:
        length = (size + 4).to_bytes(2, 'little')
        return ExpectedPacket(HEADER + bytes((number, *length, STATUS)), size + 11, number)
    return ExpectedPacket(FAMILY_HEADER + bytes((number, size + 2, 0)), size + 6, number)


# --- what is wrong with it ---------------------------------------------------------------------

def damaged_packets(noise: bytes, due: Sequence[ExpectedPacket]) -> list[DamagedPacket]:
    """Return the damaged packets that are recognised in bytes that were no packets."""
    found = []
    at = 0
    while at < len(noise):
        shape = _nearest(noise, at, due)
        if shape is None:
            at += 1
            continue
        got = noise[at:at + shape.size]
        packet = _damaged_packet(got, shape)
        if packet is not None:
            found.append(packet)
        at += shape.size if packet is not None and not packet.flips else len(shape.known)
    return found


def _nearest(noise: bytes, at: int, due: Sequence[ExpectedPacket]) -> ExpectedPacket | None:
    best, least = None, KNOWN_BITS_MAX_WRONG
    for shape in due:
        got = noise[at:at + len(shape.known)]
        share = wrong_bits(got, shape.known) / (8 * len(shape.known))
        if share < least and len(got) == len(shape.known):
            best, least = shape, share
    return best


def wrong_bits(got: bytes, sent: bytes) -> int:
    """Return in how many bits two texts of one length differ."""
    return (int.from_bytes(got, 'big') ^ int.from_bytes(sent, 'big')).bit_count()


def _damaged_packet(got: bytes, shape: ExpectedPacket) -> DamagedPacket | None:
    """Return what is wrong with a packet, None where nothing is, or it breaks off."""
    flips = tuple(_flips(got, shape.known))
    if flips:
        return DamagedPacket(shape.device, shape.size, flips)
    rest = got[len(shape.known):]
    if len(got) < shape.size or FAMILY_HEADER in rest or rest.endswith(FAMILY_HEADER[:1]):
        return None                                    # another packet begins in there
    is_2 = shape.known.startswith(HEADER)
    if not _syndrome(got, is_2):
        return None
    one = _one_flip_2(got) if is_2 else _one_flip_1(got)
    return DamagedPacket(shape.device, shape.size, () if one is None else (one,))


def _flips(got: bytes, known: bytes) -> Iterable[WrongBit]:
    for place, (heard, sent) in enumerate(zip(got, known, strict=False)):
        for bit in range(8):
            if (heard ^ sent) >> bit & 1:
                yield _flip(place, bit, heard, sent)


def _flip(place: int, bit: int, heard: int, sent: int) -> WrongBit:
    value = heard >> bit & 1
    before = sent >> bit - 1 & 1 if bit else 0         # the start bit is low
    return WrongBit(LINE_BITS * place + bit + 1, bit, value == 1, value == before)


def _syndrome(got: bytes, is_2: bool) -> int:
    """Return what the checksum is off by, 0 if it is right."""
    if is_2:
        return crc16(got[:-2]) ^ (got[-2] | got[-1] << 8)
    return sum(got[2:]) + 1 & 0xFF


def _one_flip_2(got: bytes) -> WrongBit | None:
    """Return the only bit that can have turned over: each has a syndrome of its own."""
    place = _places(len(got)).get(_syndrome(got, True))
    if place is None:
        return None
    byte, bit = place
    return _flip(byte, bit, got[byte], got[byte])          # the bit before it is as it was sent


@lru_cache(maxsize=64)
def _places(size: int) -> dict[int, tuple[int, int]]:
    found = {}
    for byte in range(size):
        for bit in range(8):
            wrong = bytearray(size)
            wrong[byte] = 1 << bit
            found[_syndrome(bytes(wrong), True)] = byte, bit
    return found


def _one_flip_1(got: bytes) -> WrongBit | None:
    """Return the bit that turned over, if it was one: a sum of 8 bits does not tell the byte."""
    off = _syndrome(got, False)
    for bit in range(7):                               # the highest goes either way alike
        if off in (1 << bit, 256 - (1 << bit)):
            return WrongBit(-1, bit, off == 1 << bit, None)
    return None


@lru_cache(maxsize=1)              # it is asked at each report
def cut_packets(noise: bytes, due: tuple[ExpectedPacket, ...]) -> list[tuple[ExpectedPacket, int]]:
    """Return the packets in the noise that lack only their first bytes, and how many of these."""
    by_first = defaultdict[int, list[tuple[ExpectedPacket, int]]](list)
    for shape in due:
        for lost in range(2, len(shape.known)):
            by_first[shape.known[lost]].append((shape, lost))
    found, at = [], 0
    while at < len(noise):
        one = next(((shape, lost) for shape, lost in by_first.get(noise[at], ())
                    if _is_whole_without(shape, lost, noise[at:])), None)
        at += 1 if one is None else one[0].size - one[1]
        found += [] if one is None else [one]
    return found


def _is_whole_without(shape: ExpectedPacket, lost: int, got: bytes) -> bool:
    packet = shape.known[:lost] + got[:shape.size - lost]
    return len(packet) == shape.size and packet.startswith(shape.known) \
        and not _syndrome(packet, shape.known.startswith(HEADER))


# --- what it looks like ------------------------------------------------------------------------

def describe_damage(found: Sequence[DamagedPacket]) -> str:
    """Return what these damaged packets look like, '' where that is not clear."""
    if len(found) < PICTURE_MIN:
        return ''
    known = [packet for packet in found if packet.flips]
    if len(known) < NEARLY_NONE * len(found):
        return f'{TWO_SENDERS}: the headers are whole, data and checksums are not'
    flips = [flip for packet in known for flip in packet.flips]
    if len(flips) < PICTURE_MIN:
        return ''
    if sum(flip.bit == 7 for flip in flips) >= NEARLY_ALL * len(flips):
        return CLOCK
    if _are_same(known):
        return ''
    period = _period(known)
    if period:
        return f'{PWM}: wrong bits about {period} bits apart, or a multiple'
    return _by_direction(known, flips)


def _by_direction(known: Sequence[DamagedPacket], flips: Sequence[WrongBit]) -> str:
    """Return what makes zeros of ones, ones of zeros, or both."""
    first = [_first_byte(packet) for packet in known]
    is_single = sum(len(some) <= 2 for some in first) >= SINGLE_BITS_MIN_SHARE * len(first)
    ups = sum(some[0].is_up for some in first)
    rarer = min(ups, len(first) - ups)
    if rarer > RARER_WAY_MIN_SHARE * len(first):
        return INTERFERENCE if is_single else ''
    if rarer >= NEARLY_NONE * len(first):
        return ''
    was, became = ('0', '1') if 2 * ups > len(first) else ('1', '0')
    late = [flip.is_late for flip in flips if flip.is_late is not None]
    if is_single or (late and sum(late) >= NEARLY_ALL * len(late)):
        cause = SIGNAL_LEVEL if was == '0' else f'{SIGNAL_LEVEL}, or {TWO_SENDERS}'
        return f'{cause}: {was} read as {became} each time'
    return ''


def _first_byte(packet: DamagedPacket) -> list[WrongBit]:
    """Return the wrong bits of the first wrong byte: a lost start bit spoils the next ones."""
    place = packet.flips[0].at // LINE_BITS
    return [flip for flip in packet.flips if flip.at // LINE_BITS == place]


def _are_same(known: Sequence[DamagedPacket]) -> bool:
    """Tell whether it is always the same bits: chance does not hit them again and again."""
    kinds = Counter((packet.device, packet.size) for packet in known)
    same = sum(count for packet, count in Counter(known).items() if count > 1
               and count >= SAME_BITS_MIN_SHARE * kinds[packet.device, packet.size])
    return same >= NEARLY_ALL * len(known)


def _period(known: Sequence[DamagedPacket]) -> int:
    """Return the distance (bits) of which the gaps between wrong bits are multiples, or 0."""
    gaps = [later.at - one.at for packet in known for one, later in zip(
        packet.flips, packet.flips[1:], strict=False)
        if one.at >= 0 and later.at - one.at >= PULSE_MAX_BITS][-GAPS_MAX:]
    if len(gaps) < GAPS_MIN or _on_grid(gaps, LINE_BITS) >= BYTE_GRID_MIN_SHARE:
        return 0
    fit, half_bits = max((_on_grid(gaps, halves / 2), halves) for halves in range(
        2 * PULSE_MAX_BITS, 2 * max(gaps) + 1))
    return half_bits // 2 if fit >= PERIOD_MIN_SHARE else 0


def _on_grid(gaps: Sequence[int], period: float) -> float:
    """Return the share of distances that are near a multiple of a period."""
    return sum(abs(gap - round(gap / period) * period) <= GAP_TOLERANCE_BITS and gap > period / 2
               for gap in gaps) / len(gaps)


# --- two talkers at once -----------------------------------------------------------------------

def count_overlaid(report: BusReport) -> int:
    """Return how many questions were wholly inside something else, as far as the last noise."""
    return _overlaid(report.noise, tuple([
        (one.instruction, one.ids, one.address, one.length) for one in report.cycles]))


@lru_cache(maxsize=8)
def _overlaid(noise: bytes, questions: tuple[_Question, ...]) -> int:
    """Return how many questions are in the noise with bits lost and none added."""
    heard, found = int.from_bytes(noise, 'big'), 0
    for packet in filter(None, (packet_of(*question) for question in questions)):
        sent, size = int.from_bytes(packet, 'big'), 8 * len(packet)
        ones, whole = sent.bit_count(), (1 << size) - 1
        for shift in range(0, 8 * len(noise) - size + 1, 8):
            if not heard >> shift & whole & ~sent:
                left = (heard >> shift & whole).bit_count()
                found += OVERLAID_MIN_SHARE * ones < left < ones - NOISE_MAX_BITS
    return found


def packet_of(instruction: int, ids: tuple[int, ...], address: int | None, length: int) -> bytes:
    """Return the packet of a question that is the same each time, b'' for anything else."""
    if not ids or address is None:
        return b''
    at = address.to_bytes(2, 'little') + length.to_bytes(2, 'little')
    if instruction == Instruction.READ:
        return encode(ids[0], instruction, at)
    if instruction in SYNC_READS:
        return encode(BROADCAST, instruction, at + bytes(ids))
    return b''
