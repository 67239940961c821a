# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""
Which family a wire speaks, and its packets: 2.0 first, the 1.0 family where that is proven.

A packet of 2.0 is certain (four bytes of header, 16 bits of CRC), so at first its framer runs
alone, and only what that gives up as noise is searched for packets of the 1.0 family. That has one
byte of sum, and one right sum proves little: what is found are packets once Detector believes it;
until then its bytes are noise, as they are on a bus without that family. From the proof on one
framer reads both, from left to right, until 2.0 alone was spoken for long.
"""

from collections import deque
from operator import attrgetter
from operator import itemgetter
import re

from msg_defs.dxl1_detector import Candidate
from msg_defs.dxl1_detector import Detector
from msg_defs.dxl1_packet import Dxl1Framer
from msg_defs.dxl1_packet import MAX_FRAME
from msg_defs.dxl1_packet import MIN_LENGTH
from msg_defs.dxl_packet import Framer
from msg_defs.dxl_packet import HEADER_TAIL
from msg_defs.dxl_packet import MAX_LENGTH
from msg_defs.event import OUT
from msg_defs.servo_frame import EITHER_1
from msg_defs.servo_frame import Frame
from msg_defs.servo_frame import Frames
from msg_defs.servo_frame import GLITCH
from msg_defs.servo_frame import good_frame_flaw
from msg_defs.servo_frame import is_good
from msg_defs.servo_frame import UNPROVEN_1

# FF FF, an ID and a LEN of the 1.0 family; or what the next bytes may complete to that.
_HOLDS = re.compile(rb'\xff\xff[^\xff][^\0\1]')
_MAY_HOLD = re.compile(rb'\xff(\xff([^\xff]([^\0\1]|\Z)|\Z)|\Z)')
_BEGIN = re.compile(rb'\xff\xff(?!\xff)|\xff\xfd\0')   # either header, even damaged
_BEGUN = b'\xff\xfd'                   # it may become the latter
ALONE_PACKETS = 1000                   # in a row, 2.0 only: the 1.0 family is spoken no more
_offset_of = itemgetter(0)
Data = bytes                           # the built-in, whose name MixedFramer.bytes takes


class _BothFramer(Dxl1Framer):
    """
    The framer of the 1.0 family, which finds the packets of 2.0 as well.

    Of two frames that overlap the first counts, but a whole one of 2.0 is no part of one of the
    1.0 family that lacks its end, or has its sum by chance.
    two: the framer of 2.0, which reads a frame once its place is known; None: 1.0 is all.
    """

    def __init__(self) -> None:
        super().__init__()
        self.two: Framer | None = None

    def is_whole(self, data: bytes) -> bool:
        """Tell whether data begin with a whole good frame."""
        if self.two is not None and data.find(HEADER_TAIL, 0, 4) >= 0:
            return self.two.is_whole(data)
        return super().is_whole(data)

    def _undecided(self, data: bytes, done: int, mark: int) -> int:
        if mark < 0 and self.two is not None and data.endswith(_BEGUN):
            return max(done, len(data) - len(_BEGUN))
        return super()._undecided(data, done, mark)

    def _scan(self, data: bytes, final: bool) -> Frames:
        if self.two is None:
            return super()._scan(data, final)
        found = self._scan_both(self.two, data, final) if HEADER_TAIL in data \
            else super()._scan(data, final)
        self._wanted = 0               # a packet of 2.0 may come before that
        return found

    def _scan_both(self, two: Framer, data: bytes, final: bool) -> Frames:
        size = len(data)
        base = self.bytes - size
        found = []
        done = at = 0                  # all in front of it is decided; the search goes on there
        while (begin := _BEGIN.search(data, at)) is not None:
            mark = begin.start()
            tail = data.find(HEADER_TAIL, mark, mark + 4)
            is_2 = tail >= 0
            if (tail + 6 if is_2 else mark + 4) > size:
                if not final:
                    break
                at = mark + 1
                continue
            if is_2:
                length = data[tail + 4] | data[tail + 5] << 8
                end = tail + 6 + length
                is_possible = length <= MAX_LENGTH
            else:
                length = data[mark + 3]
                end = mark + 4 + length
                inner = data.find(HEADER_TAIL, mark + 4, end + 2)
                is_possible = length >= MIN_LENGTH and (
                    inner < 0 or not two.is_whole(data[inner:]))
            if is_possible and end > size and not final:
                break
            if is_possible and self.is_whole(data[mark:end]):
                self._give_up(data, done, mark)
                found.append(self._frame(two if is_2 else None, data[mark:end], base + mark))
                done = at = end
                continue
            if not is_2:
                found.append(self._damaged(data, base, done, mark))
            elif tail > mark:
                two.noise_length = self.noise_length
                found.append(two._damaged(data, base, done, tail, length))
            at = mark + 1
        undecided = size if final else begin.start() if begin else self._undecided(data, done, -1)
        self._give_up(data, done, undecided)
        self._buffer = data[undecided:]
        return found

    def _frame(self, two: Framer | None, data: bytes, at: int) -> Frame:
        """Return a whole frame, at this offset of the stream; two: the framer of 2.0, if it is."""
        noise, self.noise_length = self.noise_length, 0
        if two is None:
            self.packets += 1
            return (at, at + len(data), EITHER_1, data[2], data[4], data[5:-1],
                    good_frame_flaw(False, noise) if noise else None)
        shift, two.noise_length = at - two.bytes, noise
        [(begin, end, kind, number, code, params, flaw)] = two.frames(data)
        return begin + shift, end + shift, kind, number, code, params, flaw


class _GapFramer(Framer):
    """
    The framer of 2.0, which has what it gives up searched by that of the 1.0 family.

    found: what that found. is_open: some bytes wait in it. is_searched: one of the two.
    """

    def __init__(self, one: Dxl1Framer, is_shared: bool) -> None:
        super().__init__(is_shared)
        self.found: Frames = []
        self._one = one
        self.is_open = self.is_searched = False

    def _give_up(self, data: bytes, begin: int, end: int, is_ended: bool = False) -> None:
        Framer._give_up(self, data, begin, end)        # super() costs more
        one = self._one
        if self.is_open or (
                _HOLDS if is_ended else _MAY_HOLD).search(data, begin, end):
            one.bytes = self.bytes - len(data) + begin
            self.found += one.frames(data[begin:end])
            self.is_open = one.pending > 0
            self.is_searched |= self.is_open or bool(self.found)
            if is_ended:
                self.end_gap()
        elif not is_ended:
            one.noise_length += end - begin
        if is_ended:
            one.noise_length = 0

    def end_gap(self) -> None:
        """Decide what is left of a gap: a packet of 2.0 follows, or silence."""
        if self.is_open:
            self.found += self._one.flush_frames()
            self.is_open = False


class MixedFramer:
    """
    Finds the packets of both families, with the interface of Framer.

    Good frames of the 1.0 family are packets, damaged ones may be noise: they are handed on once
    something is proven. stamp, side: of the chunk that comes next.
    """

    def __init__(self, detector: Detector, side: str = '') -> None:
        self._one = _BothFramer()
        self._two = _GapFramer(self._one, bool(side))
        self._detector = detector
        # Chunks with bytes that may be a packet, decided by later ones: stamp, offset after it.
        self._arrivals = deque[tuple[int, int]](maxlen=MAX_FRAME)
        self._claimed = 0              # packets of the 1.0 family
        self._claimed_bytes = 0
        self._is_2_alone = False       # again, after both were
        self._first_alone = 0          # packets of 2.0 when the last of the 1.0 family came
        self.bytes = 0
        self.held = 0                  # bytes of frames that are not decided on
        self.has_other = False         # a frame of the 1.0 family is held, or was in this chunk
        self.stamp = 0
        self.side = side

    # Of 2.0: the classifier counts the damage of the other family.
    repaired = property(attrgetter('_two.repaired'))
    damaged = property(attrgetter('_two.damaged'))

    @property
    def packets(self) -> int:
        return self._two.packets + self._claimed

    @property
    def has_protocol_2(self) -> bool:
        """Whether there were packets of 2.0 on this wire."""
        return self._two.packets > 0

    @property
    def pending(self) -> int:
        """Bytes received and not decided yet."""
        return self._two.pending + self._one.pending + self.held

    @property
    def noise_bytes(self) -> int:
        return (self.bytes - self._two.bytes + self._two.noise_bytes - self._one.pending
                - self._claimed_bytes - self.held)

    @property
    def packet_bytes(self) -> int:
        """Bytes that belong to a packet."""
        return self._two.packet_bytes + self._claimed_bytes

    @property
    def noise(self) -> Data:
        """The last of the noise."""
        return self._two.noise if self._one.two is None else self._one.noise

    @property
    def noise_length(self) -> int:
        """Bytes of noise since the last good frame of either family."""
        return self._one.noise_length

    @property
    def failed_candidates(self) -> int:
        """How many candidates of the 1.0 family failed; of random ones 255 in 256 do."""
        return self._one.damaged['crc'] + self._one.damaged['cut']

    def claim(self, frame: Frame) -> None:
        """Count a good frame of the 1.0 family as a packet."""
        self._detector.proven.add(frame[3])
        self._is_2_alone = False
        self._first_alone = self._two.packets
        self._claimed += 1
        self._claimed_bytes += frame[1] - frame[0]

    def interrupt(self) -> None:
        """Take note of a pause: on the line, or in the delivery of what was on the line."""
        self._two.interrupt()
        self._one.interrupt()

    def frames(self, chunk: Data) -> Frames:
        """Return what this chunk completes, in the order of the wire."""
        if self._detector.proven and not self._is_2_alone:
            return self._frames_of_both(chunk)
        two = self._two
        found = two.frames(chunk)
        self.bytes = two.bytes
        if two.is_searched or self.held:
            self._arrivals.append((self.stamp, self.bytes))
            return self._insert_candidates(found, len(chunk))
        self.has_other = False
        return found

    def flush_frames(self) -> Frames:
        """Decide what is left, because the line is idle."""
        if self._detector.proven and not self._is_2_alone:
            return self._frames_of_both(b'') + self._mark_unproven(self._one.flush_frames(), 0)
        found = self._two.flush_frames()
        self._two.end_gap()
        return self._insert_candidates(found, 0)

    def _frames_of_both(self, chunk: Data) -> Frames:
        one, two = self._one, self._two
        if one.two is None:
            one.take_over(two)
            one.two, two.is_open = two, False
            self._first_alone = two.packets
        found = one.frames(chunk)
        self.bytes = one.bytes
        if two.packets > self._first_alone + ALONE_PACKETS:
            self._is_2_alone, one.two = True, None
            before = two.bytes
            two.take_over(one)
            two.noise_bytes += one.bytes - before      # or it was of the 1.0 family
            two.noise_length = one.noise_length
        self.has_other = self.held > 0 or bool(found)
        return self._mark_unproven(found, len(chunk)) if self.has_other else found

    def _insert_candidates(self, found: Frames, size: int) -> Frames:
        """Put what may be packets of the 1.0 family where it was, in front of those of 2.0."""
        candidates, self._two.found = [*filter(is_good, self._two.found)], []
        self._two.is_searched = self._two.is_open
        self.has_other = self.held > 0 or bool(candidates)
        if not self.has_other:
            return found
        return self._mark_unproven(sorted(found + candidates, key=_offset_of), size)

    def _mark_unproven(self, found: Frames, size: int) -> Frames:
        """Mark frames of the 1.0 family that are no packets; size: of the chunk."""
        written = self.side == OUT and (self.bytes - size, self.bytes)
        detector, proven = self._detector, self._detector.proven
        detector.proof = []
        for at, frame in enumerate(found):
            begin, end, kind, number, code, content, flaw = frame
            if kind != EITHER_1:
                continue
            if flaw is not None and flaw.reason:
                is_one = number in proven
            elif proven and (flaw is None or flaw.noise_length <= GLITCH or number in proven):
                self.claim(frame)
                continue
            else:
                stamp, received = next((one for one in self._arrivals if one[1] >= end),
                                       (self.stamp, self.bytes))
                one = Candidate(self, frame, stamp, received, self.side)
                is_one = detector.add_candidate(one, (begin, end) == written)
            if not is_one:
                found[at] = begin, end, UNPROVEN_1, number, code, content, flaw
        if detector.streak and self.noise_length > GLITCH:
            detector.reject_streak()
        return found
