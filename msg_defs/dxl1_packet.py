# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""
Packets of the Protocol 1.0 family, Dynamixel 1.0 and Feetech: bytes on the wire to frames.

FF FF, ID, LEN, instruction or error byte, parameters, sum (e-Manual, Protocol 1.0; Feetech, SCS
Communication Protocol). An instruction and a status have the same form, so a frame here is
neither: who reads both sides decides. Nothing is stuffed: FF FF may stand in the data. A frame
is decided by its LEN and its sum alone; only a wrong sum, or flush_frames() on an idle line,
searches on from the header + 1. A pause in the delivery is not an idle line: interrupt() leaves
the decision to the next chunk. Nothing on the wire raises; every byte ends as a packet byte or as
noise.
"""

from msg_defs.dxl_packet import StreamFramer
from msg_defs.servo_frame import EITHER_1
from msg_defs.servo_frame import Flaw
from msg_defs.servo_frame import Frame
from msg_defs.servo_frame import Frames
from msg_defs.servo_frame import good_frame_flaw
from msg_defs.servo_frame import is_good

HEADER = b'\xff\xff'
BROADCAST = 0xFE
NO_ID = 0xFF
MIN_LENGTH = 2                     # the LEN field counts instruction and sum
MAX_LENGTH = 0xFF
MAX_FRAME = MAX_LENGTH + 4


def content(id: int, code: int, params: bytes = b'') -> bytes:
    """Return a packet from its ID to its last parameter; code: instruction or error byte."""
    return bytes([id, len(params) + 2, code]) + params


def encode(id: int, code: int, params: bytes = b'') -> bytes:
    """Return a packet as it is on the wire."""
    inner = content(id, code, params)
    return HEADER + inner + bytes([~sum(inner) & 0xFF])


def ends_with_another(frame: Frame) -> bool:
    """Return whether a good frame ends with a whole one, as one does that lost its own end."""
    _, _, _, number, code, data, _ = frame
    if HEADER not in data:
        return False
    last = Dxl1Framer().frames(encode(number, code, data)[5:])[-1:]
    return any(is_good(one) and one[1] == len(data) + 1 for one in last)


class Dxl1Framer(StreamFramer):
    """
    Finds the frames of the 1.0 family in a stream that comes in chunks of any size.

    It repairs nothing: a sum of 8 bits is too weak to repair a header by it.
    """

    header = HEADER
    has_other = True               # whether some frame of the last chunk is of the 1.0 family

    def is_whole(self, data: bytes) -> bool:
        """Tell whether data begin with a whole good frame."""
        end = data[3] + 4 if len(data) > 3 else MAX_FRAME
        return len(data) >= end >= MIN_LENGTH + 4 and sum(data[2:end]) & 0xFF == 0xFF

    def _scan(self, data: bytes, final: bool) -> Frames:
        find = data.find
        size = len(data)
        base = self.bytes - size
        found: Frames = []
        add_frame = found.append
        damaged = 0
        noisy = self.noise_length
        done = 0                   # everything in front of it is decided
        wanted = 0                 # as many bytes are needed to go on
        mark = find(HEADER)
        while 0 <= mark < size - 3:
            length = data[mark + 3]
            end = mark + 4 + length
            number = data[mark + 2]
            if number == NO_ID:
                mark += 1          # the header is further on in this run of FF
                continue
            if end > size and length >= MIN_LENGTH and not final:
                wanted = end
                break
            if (length >= MIN_LENGTH and end <= size
                    and sum(data[mark + 2:end]) & 0xFF == 0xFF):
                flaw = None
                if mark != done or noisy:
                    flaw = self._flaw(data, done, mark)
                    noisy = 0
                add_frame((base + mark, base + end, EITHER_1, number, data[mark + 4],
                           data[mark + 5:end - 1], flaw))
                done = end
                mark = find(HEADER, end)
            else:
                add_frame(self._damaged(data, base, done, mark))
                damaged += 1
                mark = find(HEADER, mark + 1)
        self.packets += len(found) - damaged
        undecided = size if final else self._undecided(data, done, mark)
        self._give_up(data, done, undecided)
        self._buffer = data[undecided:]
        self._wanted = wanted - undecided
        return found

    def _flaw(self, data: bytes, done: int, mark: int) -> Flaw:
        """Return what is unusual about a good frame: noise in front of it."""
        self._give_up(data, done, mark)
        flaw = good_frame_flaw(False, self.noise_length)
        self.noise_length = 0
        return flaw

    def _undecided(self, data: bytes, done: int, mark: int) -> int:
        """Return where the bytes begin that may still become a frame."""
        if mark >= 0:
            return mark
        size = len(data)
        return size - 1 if size > done and data[size - 1] == 0xFF else size

    def _damaged(self, data: bytes, base: int, done: int, mark: int) -> Frame:
        """Count a frame that has a header and fails; its bytes are noise, and searched again."""
        length = data[mark + 3]
        body = data[mark + 2:mark + 3 + length]
        if length < MIN_LENGTH:
            reason = 'length'
            body = data[mark + 2:mark + 4]
        elif mark + 4 + length > len(data) or _has_header(data[mark + 4:mark + 4 + length]):
            reason = 'cut'
        else:
            reason = 'crc'
        self.damaged[reason] += 1
        begin = base + mark
        flaw = Flaw(reason, noise_length=self.noise_length + mark - done, length=length)
        return (begin, begin + 2 + len(body), EITHER_1, body[0], body[2] if len(body) > 2 else 0,
                body, flaw)


def _has_header(body: bytes) -> bool:
    """Return whether another frame may begin in there: data with FF FF may look alike."""
    at = body.find(HEADER)
    return at >= 0 and (at + 3 >= len(body)
                        or (body[at + 2] != NO_ID and body[at + 3] >= MIN_LENGTH))

