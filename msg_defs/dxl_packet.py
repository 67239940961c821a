# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""
Dynamixel Protocol 2.0 packets: bytes on the wire to packets and back (e-Manual, Protocol 2.0).

A frame is decided by its Length and CRC alone. Inside a frame that passes, anything that looks
like a header is data: fast replies are never stuffed, and the official Python SDK does not stuff
what it sends. Only a failed CRC, or flush_frames() on an idle line, searches on from the header
+ 1. A pause in the delivery is not an idle line: after interrupt() the next chunk decides.
Nothing on the wire raises; every byte ends as a packet byte or as a noise byte.
"""

from __future__ import annotations

import re
from struct import Struct
from typing import NamedTuple

from msg_defs.crc import bare_crc16
from msg_defs.crc import crc16
from msg_defs.crc import CRC16_TABLE
from msg_defs.servo_frame import Flaw
from msg_defs.servo_frame import Frame
from msg_defs.servo_frame import Frames
from msg_defs.servo_frame import good_frame_flaw
from msg_defs.servo_frame import INSTRUCTION_2
from msg_defs.servo_frame import IS_STATUS

HEADER = b'\xff\xff\xfd\x00'
BROADCAST = 0xFE
STATUS = 0x55
MAX_LENGTH = 1024                  # in the Length field: the buffer of most devices, and the SDK's
MAX_FRAME = MAX_LENGTH + 7

HEADER_TAIL = HEADER[1:]           # what a header has left when the line turned round too late
HEADER_CRC = crc16(HEADER)
_RUN = b'\xff\xff\xfd'
_BEGUN = re.compile(rb'\xff\xff?\xfd?\Z')     # it may become a header
_crc_at = Struct('<H').unpack_from
# The header as a number, ID, Length, instruction, error. Single bytes and searches cost more.
_head_at = Struct('<IBHBB').unpack_from
_WHOLE = int.from_bytes(HEADER, 'little')
NOISE_KEPT = 256


class Packet(NamedTuple):
    """One packet. stamp and offset: the chunk that decided it, its first byte in the stream."""

    stamp: int
    offset: int
    id: int
    instruction: int
    error: int | None              # in a status, alert bit included
    params: bytes                  # unstuffed
    repaired: bool                 # the first header byte was missing or wrong


def body_crc(body: bytes) -> int:
    """Return the CRC of a frame from its ID on: the header is taken as good."""
    return crc16(body, HEADER_CRC)


def stuff(data: bytes) -> bytes:
    """Insert FD after every FF FF FD."""
    return data.replace(_RUN, b'\xff\xff\xfd\xfd') if _RUN in data else data


def unstuff(data: bytes) -> bytes:
    """Undo stuff(); an unstuffed FF FF FD followed by anything but FD stays as it is."""
    return data.replace(b'\xff\xff\xfd\xfd', _RUN) if _RUN in data else data


def encode(
    id: int,
    instruction: int,
    params: bytes = b'',
    error: int | None = None,
    stuffed: bool = True,
) -> bytes:
    """Return the bytes of the packet on the wire; error is given for a status only."""
    content = bytes([instruction]) + (b'' if error is None else bytes([error])) + params
    if stuffed:
        content = stuff(content)
    frame = HEADER + bytes([id]) + (len(content) + 2).to_bytes(2, 'little') + content
    return frame + crc16(frame).to_bytes(2, 'little')


def packet_of(frame: Frame, stamp: int) -> Packet:
    """Return the readable form of a good frame."""
    begin, _, kind, number, code, data, flaw = frame
    instruction, error = (STATUS, code) if kind == IS_STATUS else (code, None)
    return Packet(stamp, begin, number, instruction, error, data,
                  flaw is not None and flaw.repaired)


def fast_wire(error: int, data: bytes) -> bytes:
    """Return a good fast reply as it was on the wire, from its ID on, without its last CRC."""
    return b'%c%c%c%c%c' % (BROADCAST, len(data) + 4 & 0xFF, len(data) + 4 >> 8, STATUS,
                            error) + data


# Why a frame is damaged; cut: by another header, or silence, before the declared end.
REASONS = ('crc', 'cut', 'length')


class StreamFramer:
    """
    What the framers of all protocols share: chunks of any size, bytes counted, pauses.

    A protocol adds its header, _scan() and is_whole(). stamp: of the chunk that comes next.
    """

    header = b''                   # how a whole frame begins

    def __init__(self) -> None:
        self.stamp = 0
        self.bytes = 0
        self.packets = 0
        self.repaired = 0          # packets with a damaged first header byte
        self.damaged = dict.fromkeys(REASONS, 0)
        self.noise_bytes = 0
        self.noise = b''           # the last of these
        self._buffer = b''         # not decided yet, at most one frame
        self._wanted = 0           # bytes in the buffer before it is worth looking again
        self._is_interrupted = False       # a pause followed what is in the buffer
        self.noise_length = 0     # the run in front of the next frame

    @property
    def pending(self) -> int:
        """Bytes received and not decided yet."""
        return len(self._buffer)

    @property
    def packet_bytes(self) -> int:
        """Bytes that belong to a packet."""
        return self.bytes - self.noise_bytes - len(self._buffer)

    def frames(self, chunk: bytes) -> Frames:
        """Return what this chunk completes; damaged frames are among it, with a flaw."""
        if self._is_interrupted and chunk:
            return self._cut_off(chunk) + StreamFramer.frames(self, chunk)
        self.bytes += len(chunk)
        if self._buffer:
            chunk = self._buffer + chunk
            if len(chunk) < self._wanted:
                self._buffer = chunk
                return []
        return self._scan(chunk, False)

    def interrupt(self) -> None:
        """
        Take note of a pause: on the line, or in the delivery of what was on the line.

        The next chunk shows which of the two: if it begins with a header, the frame that waits
        for its end was cut off, unless it ends in this chunk after all (its CRC or sum decides).
        """
        self._is_interrupted = bool(self._buffer)

    def _cut_off(self, chunk: bytes) -> Frames:
        """Decide what is pending, if this chunk after a pause does not go on with it."""
        self._is_interrupted = False
        if not chunk.startswith(self.header) or self.is_whole(self._buffer + chunk):
            return []
        return self._scan(self._buffer, True)

    def take_over(self, other: StreamFramer) -> None:
        """Go on where another framer is, with what that has not decided."""
        data, other._buffer = other._buffer, b''
        self.bytes = other.bytes
        other.bytes -= len(data)
        self._buffer += data
        self._is_interrupted |= other._is_interrupted
        self._wanted = 0

    def flush_frames(self) -> Frames:
        """Decide what is left, because the line is idle; as frames()."""
        self._is_interrupted = False
        return self._scan(self._buffer, True)

    def _scan(self, data: bytes, final: bool) -> Frames:
        """Return the frames in the buffer and what follows it; final: no more will come."""
        raise NotImplementedError

    def is_whole(self, data: bytes) -> bool:
        """Tell whether data begin with a whole good frame."""
        raise NotImplementedError

    def _give_up(self, data: bytes, begin: int, end: int, is_ended: bool = False) -> None:
        """Count noise; is_ended: a good frame follows."""
        if begin < end:
            self.noise_bytes += end - begin
            self.noise_length += end - begin
            self.noise = (self.noise + data[begin:end])[-NOISE_KEPT:]


class Framer(StreamFramer):
    """
    Finds the frames of Protocol 2.0 in a stream that comes in chunks of any size.

    is_shared: a byte in front of a damaged header may be of another packet: it is not taken, and
    no end of a packet is held back for it.
    """

    header = HEADER
    has_other = False              # whether some frame of the last chunk is of the 1.0 family

    def __init__(self, is_shared: bool = False) -> None:
        super().__init__()
        self.is_shared = is_shared

    def is_whole(self, data: bytes) -> bool:
        """Tell whether data begin with a whole good frame, its header perhaps damaged."""
        mark = data.find(HEADER_TAIL)
        if not 0 <= mark < len(data) - 6:
            return False
        length = data[mark + 4] | data[mark + 5] << 8
        end = mark + 6 + length
        return end <= len(data) and length <= MAX_LENGTH \
            and length > (3 if data[mark + 6] == STATUS else 2) \
            and body_crc(data[mark + 3:end - 2]) == data[end - 2] | data[end - 1] << 8

    def _scan(self, data: bytes, final: bool) -> Frames:
        crc_of = bare_crc16
        size = len(data)
        base = self.bytes - size
        header = base - 1          # from the second FF of a header to the offset of the first
        found: Frames = []
        damaged = 0
        is_flawed = self.noise_length > 0      # noise or a damaged header is ahead
        is_usual = True
        done = 0                   # everything in front of it is decided
        wanted = 0                 # as many bytes are needed to go on
        mark = 1                   # where the second FF of a header is, if it follows directly
        sought = 0                 # else it is searched for from here
        judged = size - 5 if final else size - 6       # with its instruction, if that may come
        heads = b'\0%b\0\0' % data    # the first header may begin too late, the last end too early
        while mark < judged or 0 <= (mark := data.find(HEADER_TAIL, sought)) < judged:
            head, number, length, code, error = _head_at(heads, mark)
            if head != _WHOLE:
                is_flawed = True
                if head | 0xFF != _WHOLE:
                    mark = size        # it does not follow
                    continue
            end = mark + 6 + length
            if end <= size:
                crc = end - 2
                body = data[mark + 3:crc]
                if (length <= MAX_LENGTH and crc_of(body, HEADER_CRC, CRC16_TABLE)
                        == _crc_at(data, crc)[0]
                        and (length > 3 or (length == 3 and code != STATUS))):
                    flaw = None
                    if is_flawed:
                        flaw = self._flaw(data, done, mark)
                        is_flawed = is_usual = False
                    done = sought = end
                    found.append(
                        (header + mark, base + end, IS_STATUS, number, error, body[5:], flaw)
                        if code == STATUS else
                        (header + mark, base + end, INSTRUCTION_2, number, code, body[4:], flaw))
                    mark = end + 1
                    continue
            elif length <= MAX_LENGTH and not final:
                wanted = end
                break
            if mark > done and head == _WHOLE:
                found.append(self._damaged(data, base, done, mark, length))
                damaged += 1
            is_flawed = True
            sought = mark + 1
            mark = size
        count = len(found) - damaged
        self.packets += count
        if not is_usual or data.count(_RUN, 0, done) != count:      # one in each header
            found = [_without_stuffing(frame) for frame in found]
        undecided = size if final or done == size \
            else self._undecided(data, done, mark)
        if undecided > done:
            self._give_up(data, done, undecided)
        self._buffer = data[undecided:]
        self._wanted = wanted - undecided
        return found

    def _undecided(self, data: bytes, done: int, mark: int) -> int:
        """Return where the bytes begin that may still become a frame."""
        size = len(data)
        if mark < 0 and self.is_shared:
            begun = _BEGUN.search(data, max(done, size - len(HEADER_TAIL)))
            return begun.start() if begun else size
        return max(done, mark - 1 if mark >= 0 else size - len(HEADER_TAIL))

    def _flaw(self, data: bytes, done: int, mark: int) -> Flaw:
        """Return what is unusual about a good frame: noise in front of it, a damaged header."""
        repaired = mark == done or data[mark - 1] != 0xFF
        self.repaired += repaired
        self._give_up(data, done, mark - 1 + (repaired and self.is_shared), True)
        flaw = good_frame_flaw(repaired, self.noise_length)
        self.noise_length = 0
        return flaw

    def _damaged(self, data: bytes, base: int, done: int, mark: int, length: int) -> Frame:
        """Count a frame that has a header and fails; its bytes are noise, and searched again."""
        end = mark + 6 + length
        body = data[mark + 3:end]
        code = body[3] if len(body) > 3 else 0
        if not 2 < length <= MAX_LENGTH or (length == 3 and code == STATUS):
            reason = 'length'
            body = body[:4]
        elif end > len(data) or HEADER in body or body.endswith((_RUN, _RUN[:2])):
            reason = 'cut'
        else:
            reason = 'crc'
        self.damaged[reason] += 1
        begin = base + mark - 1
        flaw = Flaw(reason, noise_length=self.noise_length + mark - 1 - done, length=length)
        return (begin, begin + 4 + len(body), IS_STATUS if code == STATUS else INSTRUCTION_2,
                body[0], code, body, flaw)


def _without_stuffing(frame: Frame) -> Frame:
    """Return a frame with the parameters that its sender meant; a fast reply is not stuffed."""
    begin, end, kind, number, code, data, flaw = frame
    if _RUN not in data or (flaw is not None and flaw.reason) \
            or (kind == IS_STATUS and number == BROADCAST):
        return frame
    if kind != IS_STATUS and data.count(_RUN) != data.count(_RUN + b'\xfd'):
        _, repaired, noise_length, *_ = flaw or good_frame_flaw(False, 0)
        flaw = good_frame_flaw(repaired, noise_length, True)
    return begin, end, kind, number, code, unstuff(data), flaw
