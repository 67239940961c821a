# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""Framers as tests read them: chunks in, whole packets out, without what was damaged."""
from pathlib import Path
import re
from typing import NamedTuple

from msg_defs.dxl_instruction import Access
from msg_defs.dxl_packet import packet_of
from msg_defs.frame import is_good
from rigs.tables import rows_of


def packets_in(framer, chunk, stamp=0):
    """Return the packets that this chunk completes."""
    return [packet_of(one, stamp) for one in filter(is_good, framer.frames(chunk))]


def packets_left(framer, stamp=0):
    """Return the packets that are found when the line is idle."""
    return [packet_of(one, stamp) for one in filter(is_good, framer.flush_frames())]


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
