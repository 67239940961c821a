# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""
Both families on one wire: packets of Protocol 2.0 first, the 1.0 family in what is left.

A packet of 2.0 is certain (four bytes of header, 16 bits of CRC), so nothing of the 1.0 family is
looked for inside one. The 1.0 family has one byte of sum, and one right sum proves little: what it
finds is handed on as packets once Detector believes it; until then its bytes are noise, as they
are on a bus without that family.
"""

from collections import Counter
import re
from typing import NamedTuple

from msg_defs import dxl1_packet
from msg_defs.dxl1_proof import Candidate
from msg_defs.dxl1_proof import Detector
from msg_defs.dxl_packet import Framer
from msg_defs.event import OUT
from msg_defs.frame import ahead
from msg_defs.frame import EITHER_1
from msg_defs.frame import Flaw
from msg_defs.frame import Frame
from msg_defs.frame import Frames
from msg_defs.frame import GLITCH
from msg_defs.frame import is_good
from msg_defs.frame import UNPROVEN_1

_TAIL = b'\xff\xfd\x00'
# What may become a header of 2.0, or one with a damaged first byte, longest first.
_BEGUN = (b'\xff\xff\xfd', b'\xff\xfd', b'\xff\xff', b'\xff')
# FF FF, an ID and a LEN of the 1.0 family; and what the next bytes may complete to that.
_HOLDS = re.compile(rb'\xff\xff[^\xff][^\0\1]')
_ENDS = re.compile(rb'\xff(\xff[^\xff]?)?\Z')
_ENDINGS = (b'\xff', b'\xff\xfd')  # a chunk that may go on as such a header
_SHORT = 3                         # bytes that cannot hold one
Data = bytes                       # the built-in, whose name MixedFramer.bytes takes
# Where it begins in the stream, its bytes, whether a packet of 2.0 directly after it ends it.
Gap = tuple[int, Data, bool]


class _Run(NamedTuple):
    """What the framer of the 1.0 family made of one gap."""

    at: int                        # where the gap begins in the stream
    frames: Frames
    noise_ahead: int               # bytes of noise after the last good one


class _GapFramer(Framer):
    """
    The framer of 2.0, which keeps what it gives up as `gaps`.

    is_shared: there is another family on the wire. Then it holds back as little as it can, and
    a byte in front of a damaged header may be the sum of another packet: it is not taken.
    keeps_all_gaps: every gap is kept, else only what may hold a packet of the 1.0 family.
    noise_ahead: bytes of noise since the last good frame of either.
    """

    __slots__ = ('gaps', 'is_shared', 'keeps_all_gaps', 'noise_ahead')

    def __init__(self, is_shared: bool) -> None:
        super().__init__()
        self.gaps: list[Gap] = []
        self.noise_ahead = 0
        self.keeps_all_gaps = False
        self.is_shared = is_shared

    def has_nothing(self) -> bool:
        """Return whether no bytes wait, and no gap."""
        return not self._buffer and not self.gaps

    def pass_over(self, noise: bytes) -> int:
        """Give up a chunk that has nothing of 2.0; return the stream offset after it."""
        self.bytes += len(noise)
        self._give_up(noise)
        return self.bytes

    def peek(self, size: int) -> bytes:
        """Return so many of the bytes that may begin a packet."""
        return self._buffer[:size]

    def drop(self, size: int) -> Frames:
        """Give so many of these up: they belong to another packet. Return what follows."""
        data = self._buffer
        self._give_up(data[:size])
        return self._scan(data[size:], False)

    def _cut_off(self, chunk: bytes) -> Frames:
        # Of a frame that waits and of what follows a pause, either may be of the other family.
        if not self.is_shared or not chunk.startswith(dxl1_packet.HEADER) \
                or self._ends_in(chunk):
            return super()._cut_off(chunk)
        self._is_interrupted = False
        return self._scan(self._buffer, True)

    def _flaw(self, data: bytes, done: int, mark: int) -> Flaw:
        begin = mark - 1
        is_repaired = mark == done or data[begin] != 0xFF
        if is_repaired and (mark == done or self.is_shared):
            begin = mark
        gap = data[done:begin]
        if self.gaps or self.keeps_all_gaps or (begin - done > _SHORT and _HOLDS.search(gap)):
            self.gaps.append((self.bytes - len(data) + done, gap, True))
        else:
            self.noise_ahead = 0
        if is_repaired:
            self.repaired += 1
        if gap:
            self._give_up(gap)
        flaw = ahead(is_repaired, self.noise_length)
        self.noise_length = 0
        return flaw

    def _keep(self, data: bytes, done: int, undecided: int) -> None:
        if self.is_shared and undecided < len(data):
            undecided = self._begun(data, done, undecided)
        if undecided > done:
            gap = data[done:undecided]
            if self.gaps or self.keeps_all_gaps or not _is_passed_over(gap, data[undecided:]):
                self.gaps.append((self.bytes - len(data) + done, gap, False))
            else:
                self.noise_ahead += len(gap)
            self._give_up(gap)
        self._buffer = data[undecided:]

    def _begun(self, data: bytes, done: int, undecided: int) -> int:
        """Return where what may become a packet of 2.0 begins."""
        mark = data.find(_TAIL, undecided)
        if mark < 0:
            return max(done, len(data) - next(
                (len(one) for one in _BEGUN if data.endswith(one)), 0))
        return undecided if data[undecided] == 0xFF else mark


def _is_passed_over(gap: Data, following: Data) -> bool:
    """
    Return whether a gap neither holds a packet of the 1.0 family nor ends in a begin of one.

    following: what is known of the bytes after it, perhaps nothing.
    """
    if len(gap) > _SHORT and _HOLDS.search(gap):
        return False
    end = gap[-_SHORT:]
    if 0xFF not in end or not _ENDS.search(end):
        return True
    return len(following) >= _SHORT and not _HOLDS.search(end + following[:_SHORT])


class MixedFramer:
    """
    Finds the packets of both families, with the interface of Framer.

    Good frames of the 1.0 family are packets, damaged ones may be noise: they are handed on once
    something is proven, or when they come with a good one. is_shared: hold back no end of a
    packet, not even at first; its time matters. stamp, side: of the chunk that comes next.
    """

    __slots__ = ('_claimed_bytes', '_damaged', '_detector', '_first', '_is_open', '_second',
                 '_seen', '_shift', 'bytes', 'claimed', 'has_other', 'held', 'side', 'stamp')

    def __init__(self, detector: Detector, is_shared: bool = False, side: str = '') -> None:
        self._second = dxl1_packet.Dxl1Framer()
        self._first = _GapFramer(is_shared)
        self._detector = detector
        self._is_open = False          # some bytes wait in the second framer
        self._seen = 0                 # good frames of the second framer so far
        self._shift = 0                # from offsets of the second framer to those of the wire
        self.bytes = 0
        self._claimed_bytes = 0
        self._damaged: Counter[str] = Counter()
        self.claimed = 0               # packets of the 1.0 family
        self.held = 0                  # bytes of frames that are not decided on
        self.has_other = False         # a frame of the 1.0 family is held, or was in this chunk
        self.stamp = 0
        self.side = side

    @property
    def packets(self) -> int:
        return self._first.packets + self.claimed

    @property
    def has_first(self) -> bool:
        """Whether there were packets of 2.0 on this wire."""
        return self._first.packets > 0

    @property
    def repaired(self) -> int:
        return self._first.repaired

    @property
    def crc_errors(self) -> int:
        return self._first.crc_errors + self._damaged['crc']

    @property
    def truncated(self) -> int:
        return self._first.truncated + self._damaged['cut']

    @property
    def bad_length(self) -> int:
        return self._first.bad_length + self._damaged['length']

    @property
    def pending(self) -> int:
        """Bytes received and not decided yet."""
        return self._first.pending + self._second.pending + self.held

    @property
    def noise_bytes(self) -> int:
        return self._first.noise_bytes - self._second.pending - self._claimed_bytes - self.held

    @property
    def packet_bytes(self) -> int:
        """Bytes that belong to a packet."""
        return self._first.packet_bytes + self._claimed_bytes

    @property
    def noise(self) -> Data:
        """The last of the noise."""
        return self._second.noise if self.claimed else self._first.noise

    @property
    def noise_length(self) -> int:
        """Bytes of noise since the last good frame of either family."""
        return self._first.noise_ahead

    @property
    def wrong(self) -> int:
        """How many candidates of the 1.0 family failed; of random ones 255 in 256 do."""
        return self._second.crc_errors + self._second.truncated

    def claim(self, frame: Frame) -> None:
        """Count a good frame of the 1.0 family as a packet."""
        self._detector.proven.add(frame[3])
        self.claimed += 1
        self._first.is_shared = True
        self._claimed_bytes += frame[1] - frame[0]

    def interrupt(self) -> None:
        """Take note of a pause: on the line, or in the delivery of what was on the line."""
        self._first.interrupt()
        self._second.interrupt()

    def frames(self, chunk: Data) -> Frames:
        """Return what this chunk completes, in the order of the wire."""
        first = self._first
        begin, proven = first.bytes, self._detector.proven
        if proven or self._is_open or first.keeps_all_gaps:
            self._check_each_gap()
        self.has_other = self.held > 0
        if (proven and first.is_shared and _TAIL not in chunk and not chunk.endswith(_ENDINGS)
                and first.has_nothing()):
            self.bytes = first.pass_over(chunk)    # no packet of 2.0 begins, goes on or ends in it
            found = self._search_gap(begin, chunk)
        else:
            found = first.frames(chunk)
            self.bytes = first.bytes
            if first.gaps or self._is_open:
                found = self._insert_other(found)
        return self._mark_unproven(found, self.side == OUT and (begin, self.bytes)) \
            if self.has_other else found

    def flush_frames(self) -> Frames:
        """Decide what is left, because the line is idle."""
        self._check_each_gap()
        found = self._first.flush_frames()
        self.has_other = self.held > 0
        if self._first.gaps or self._is_open:
            found = self._insert_other(found)
        if self._is_open:
            found = self._drop_inner_damage(found + self._end_gap())
        return self._mark_unproven(found)

    def _check_each_gap(self) -> None:
        """Have each gap looked at, if any may belong to a packet of the 1.0 family."""
        self._first.keeps_all_gaps = self._is_open or bool(self._detector.proven)

    def _mark_unproven(self, found: Frames, whole: object = None) -> Frames:
        """Mark frames of the 1.0 family that are no packets; whole: what was written at once."""
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
                one = Candidate(self, frame, self.stamp, self.bytes, self.side)
                is_one = detector.add_candidate(one, (begin, end) == whole)
            if not is_one:
                found[at] = begin, end, UNPROVEN_1, number, code, content, flaw
        if detector.streak and self.noise_length > GLITCH:
            detector.reject_streak()
        return found

    def _insert_other(self, found: Frames) -> Frames:
        """Put the frames of the other family where they were, in front of those of 2.0."""
        runs = self._search_gaps()
        mixed = self._merge_runs(found, runs) if self.has_other or self.claimed else found
        if self._is_open and self._first.is_shared and self._first.pending:
            mixed = mixed + self._complete_packet()
        return self._drop_inner_damage(mixed)

    def _search_gaps(self) -> list[_Run]:
        """Look through the gaps, as long as nothing is proven only where a packet may be."""
        first = self._first
        runs = []
        for at, data, is_ended in first.gaps:
            if (self._is_open or self._detector.proven or _HOLDS.search(data)
                    or not (is_ended or _is_passed_over(data, b''))):
                frames = self._search_gap(at, data) if data else []
                if is_ended and self._is_open:
                    frames += self._end_gap()
                runs.append(_Run(at, frames, first.noise_ahead))
            elif not is_ended:
                first.noise_ahead += len(data)
            if is_ended:
                first.noise_ahead = 0
        first.gaps.clear()
        return runs

    def _search_gap(self, at: int, data: Data) -> Frames:
        """Return what is in a gap, or ends in it."""
        self._shift = at - self._second.bytes
        self._second.noise_length = self._first.noise_ahead
        return self._shift_frames(self._second.frames(data))

    def _merge_runs(self, found: Frames, runs: list[_Run]) -> Frames:
        """Put what was in the gaps in front of the packets of 2.0 that ended them."""
        mixed: Frames = []
        left = iter(runs)
        run = next(left, None)
        for frame in found:
            begin, end, kind, number, code, data, flaw = frame
            if flaw is not None and not flaw.reason:
                noise = 0
                while run is not None and run.at <= begin + 1:
                    mixed += run.frames
                    noise = run.noise_ahead
                    run = next(left, None)
                if self.claimed:       # the noise in front is without what the gap held
                    flaw = ahead(flaw.repaired, noise, flaw.unstuffed)
                    frame = begin, end, kind, number, code, data, flaw if any(flaw) else None
            mixed.append(frame)
        while run is not None:
            mixed += run.frames
            run = next(left, None)
        return mixed

    def _complete_packet(self) -> Frames:
        """Decide a packet whose last bytes might begin one of 2.0, if its sum is right."""
        first, second = self._first, self._second
        first.keeps_all_gaps = True
        lacks = second.lacks()
        tail = first.peek(lacks)
        if not lacks or len(tail) < lacks or not second.ends_with(tail):
            return []
        return self._search_gap(first.bytes - first.pending, tail) \
            + self._insert_other(first.drop(lacks))

    def _drop_inner_damage(self, mixed: Frames) -> Frames:
        """Leave out what only looks like a damaged packet of 2.0: the data of another packet."""
        if not self.claimed or not any(frame[2] < EITHER_1 for frame in mixed):
            return mixed
        good = [frame[:2] for frame in mixed if frame[2] == EITHER_1 and is_good(frame)]
        kept = []
        for frame in mixed:
            flaw = frame[6]
            if flaw is not None and flaw.reason and frame[2] != EITHER_1 and any(
                    first < frame[0] + 4 < last for first, last in good):
                self._damaged[flaw.reason] -= 1
            else:
                kept.append(frame)
        return kept

    def _end_gap(self) -> Frames:
        """Decide what is left of a gap: a packet of 2.0 follows, or silence."""
        if not self._is_open:
            return []
        self._second.noise_length = self._first.noise_ahead
        return self._shift_frames(self._second.flush_frames())

    def _shift_frames(self, frames: Frames) -> Frames:
        """Return frames of the second framer as they stand in the stream."""
        self._first.noise_ahead = self._second.noise_length
        self._is_open = self._second.pending > 0
        if not frames:
            return frames
        if self._second.packets > self._seen or self._detector.proven:
            self._seen = self._second.packets
            self.has_other = True
        if not self.has_other:
            return []
        shift = self._shift
        return [(begin + shift, end + shift, kind, number, code, content, flaw)
                for begin, end, kind, number, code, content, flaw in frames]
