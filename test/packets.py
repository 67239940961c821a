# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""Framers as tests read them: chunks in, whole packets out, without what was damaged."""
from pathlib import Path
import re
from typing import NamedTuple

from msg_defs.dxl_instruction import Access
from msg_defs.dxl_packet import packet_of
from msg_defs.servo_frame import is_good
from rigs.tables import rows_of


def packets_in(framer, chunk, stamp=0):
    """Return the packets that this chunk completes; None: the line is idle."""
    found = framer.flush_frames() if chunk is None else framer.frames(chunk)
    return [packet_of(one, stamp) for one in filter(is_good, found)]


def packets_left(framer, stamp=0):
    """Return the packets that are found when the line is idle."""
    return packets_in(framer, None, stamp)


class Packet1(NamedTuple):
    """A packet of the 1.0 family. code: the instruction, or the error byte of a status."""

    offset: int
    id: int
    code: int
    params: bytes


def packets_1_in(framer, chunk):
    """Return the packets that this chunk completes; None: the line is idle."""
    found = framer.flush_frames() if chunk is None else framer.frames(chunk)
    return [Packet1(begin, number, code, params)
            for begin, _, _, number, code, params, _ in filter(is_good, found)]


def fed(framer, chunk_in, longest, data, sizes=()):
    """Feed in chunks of these sizes, the rest at once; then flush. Checks the byte accounting."""
    found = []
    at = 0
    for size in [*sizes, len(data)]:
        found += chunk_in(framer, data[at:at + size])
        at += size
        assert framer.bytes == framer.packet_bytes + framer.noise_bytes + framer.pending
        assert framer.pending < longest
    found += chunk_in(framer, None)
    assert framer.pending == 0
    assert framer.bytes == framer.packet_bytes + framer.noise_bytes == len(data)
    assert framer.packets == len(found)
    return found, framer


def instructions_of(protocol):
    """Return code, ID, parameters, who answers and the accesses of the rows of a protocol."""
    rows = rows_of(Path(__file__).with_name('instructions.tsv'))
    return [(int(code, 16), int(number), bytes.fromhex(params), answers,
             tuple(map(_access, registers.split(', ') if registers else ())))
            for name, code, number, params, answers, registers in rows if name == protocol]


def _access(text):
    """Read ID: ADDRESS+SIZE of what is read, ID: ADDRESS=DATA of what is written."""
    number, at, size, data = re.fullmatch(r'(\d+): (\d+)(?:\+(\d+)|=(\w+))', text).groups()
    data = data and bytes.fromhex(data)
    return Access(int(number), int(at), len(data) if data else int(size), data)
