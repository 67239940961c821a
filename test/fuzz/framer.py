# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""The framers of both families: any bytes, in any split."""

from collections.abc import Callable
from typing import Any
from typing import NamedTuple

from fuzz import reference
from fuzz.script import PIECES_1
from fuzz.script import PIECES_2
from fuzz.script import Script
from fuzz.script import traffic
from msg_defs import dxl1_packet
from msg_defs.dxl_packet import encode
from msg_defs.dxl_packet import Framer
from msg_defs.dxl_packet import MAX_FRAME
from msg_defs.dxl_packet import packet_of
from msg_defs.dxl_packet import STATUS
from msg_defs.servo_frame import is_good
from msg_defs.servo_frame import IS_STATUS
from rigs.bus import frames

NOISE_KEPT = 256


class Watching:
    """A framer that keeps what it finds good, and adds up by itself how many bytes that is."""

    def __init__(self):
        super().__init__()
        self.good = []
        self.accounted = self._last = 0

    def frames(self, chunk):
        return self._keep_good(super().frames(chunk))

    def flush_frames(self):
        frames = self._keep_good(super().flush_frames())
        self._last = self.bytes        # what was in front is noise, also of a header's first byte
        return frames

    def _keep_good(self, frames):
        for frame in frames:
            if is_good(frame):
                begin, end = frame[:2]
                assert self._last < end, 'frames overlap'
                self.good.append(frame)
                self.accounted += end - max(self._last, begin)
                self._last = end
        return frames


class Watched(Watching, Framer):
    pass


class Watched1(Watching, dxl1_packet.Dxl1Framer):
    pass


def as_said(frame):
    """Return what a frame says, and that its readable form says the same."""
    begin, end, kind, number, code, data, flaw = frame
    is_status = kind == IS_STATUS
    assert packet_of(frame, 7)[:6] == (7, begin, number, STATUS if is_status else code,
                                       code if is_status else None, data)
    return (begin, end, is_status, number, code, data, flaw is not None and flaw.repaired,
            flaw.noise_length if flaw is not None else 0, flaw is not None and flaw.unstuffed)


def as_sent(one):
    """Return the same of a packet of the reference; a fast reply is never stuffed."""
    number, code, is_status = one.body[0], one.body[3], one.body[3] == 0x55
    params = data = one.body[5:] if is_status else one.body[4:]
    if not is_status or number != 0xFE:
        data = frames.unstuffed(params)
    return (one.end - len(one.body) - 6, one.end, is_status, number,
            one.body[4] if is_status else code, data, one.repaired, one.noise,
            not is_status and frames.stuffed(data) != params)


def as_said_1(frame):
    begin, end, _, *said, flaw = frame
    return begin, end, dxl1_packet.content(*said), flaw.noise_length if flaw is not None else 0


def as_sent_1(one):
    return one.end - len(one.body) - 3, one.end, one.body, one.noise


class Family(NamedTuple):
    """What differs between the two; good: a packet with the data `good`."""

    framer: type[Any]
    reference: type[Any]
    pieces: tuple[Any, ...]
    longest: int                       # that a framer keeps back
    good: bytes
    as_said: Callable[[Any], Any]      # what a frame says
    as_sent: Callable[[Any], Any]      # what a packet of the reference says


FAMILY_2 = Family(Watched, reference.Stream, PIECES_2, MAX_FRAME, encode(1, STATUS, b'good', 0),
                  as_said, as_sent)
FAMILY_1 = Family(Watched1, reference.Stream1, PIECES_1, dxl1_packet.MAX_FRAME - 1,
                  dxl1_packet.encode(1, 0, b'good'), as_said_1, as_sent_1)


def check(data):
    """
    Check one stream of a family, whole, in pieces and byte by byte.

    Never raises; memory bounded; every byte in exactly one counter; any split finds the same, a
    packet as soon as its last byte is there; a good packet behind garbage is found; what it finds
    was sent, but for the checksum: all as in fuzz/reference.py.
    """
    script = Script(data)
    family = script.pick((FAMILY_2, FAMILY_1))
    seed = script.word()
    stream = b''.join(traffic(script, family.pieces))
    sent = family.reference(stream + family.good)
    whole = feed([stream], sent, family)
    assert feed(pieces(stream, seed), sent, family) == whole
    if len(stream) < 300:
        assert feed((stream[at:at + 1] for at in range(len(stream))), sent, family) == whole
    feed([stream + family.good], sent, family)
    good_is_found_behind(stream, family)


def feed(chunks, sent, family=FAMILY_2):
    """Return what is found in chunks and a flush; compare with what was sent on the way."""
    framer = family.framer()
    total = 0
    damaged = []
    for chunk in [*chunks, None]:
        frames = framer.flush_frames() if chunk is None else framer.frames(chunk)
        total += len(chunk or b'')
        damaged += [frame for frame in frames if not is_good(frame)]
        packets, noise = sent.found(total, chunk is None)
        assert list(map(family.as_said, framer.good)) == list(map(family.as_sent, packets))
        assert framer.noise_bytes == len(noise)
        assert framer.noise == noise[-NOISE_KEPT:]
        assert framer.bytes == total == framer.accounted + len(noise) + framer.pending
        assert framer.packet_bytes == framer.accounted
        assert framer.packets == len(packets)
        assert framer.repaired == sum(one.repaired for one in packets)
        assert framer.pending <= family.longest
    assert framer.pending == 0
    assert sum(framer.damaged.values()) == len(damaged)
    return framer.good, damaged


def pieces(stream, seed):
    """Cut a stream into pieces of 1 to 64 bytes that follow from the seed."""
    at = 0
    while at < len(stream):
        seed = (seed * 1103515245 + 12345) & 0x7FFFFFFF
        size = 1 + (seed >> 16) % 64 if seed & 0x100 else 1 + (seed >> 16) % 3
        yield stream[at:at + size]
        at += size


def good_is_found_behind(stream, family):
    """Hold that a good packet is found, or lies in a frame that the checksum takes for good."""
    framer = family.framer()
    frames = framer.frames(stream + family.good) + framer.flush_frames()
    end = len(stream) + len(family.good)
    assert any((one == end and data == b'good') or begin < len(stream) < one
               for begin, one, _, _, _, data, _ in filter(is_good, frames))
    framer.frames(stream)
    framer.flush_frames()
    assert [frame[3:6] for frame in framer.frames(family.good)] == [(1, 0, b'good')]
