# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""Framer: any bytes, in any split."""

from fuzz import reference
from fuzz.script import Script
from fuzz.script import traffic
from msg_defs.dxl_packet import encode
from msg_defs.dxl_packet import Framer
from msg_defs.dxl_packet import MAX_FRAME
from msg_defs.dxl_packet import packet_of
from msg_defs.dxl_packet import STATUS
from msg_defs.frame import is_good
from msg_defs.frame import IS_STATUS

GOOD = encode(1, STATUS, b'good', 0)
NOISE_KEPT = 256


class Watched(Framer):
    """A Framer that keeps what it finds good, and adds up by itself how many bytes that is."""

    __slots__ = ('_last', 'accounted', 'good')

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


def check(data):
    """
    Check one stream, whole, in pieces and byte by byte.

    Never raises; memory bounded; every byte in exactly one counter; any split finds the same, a
    packet as soon as its last byte is there; a good packet behind garbage is found; what it finds
    was sent, but for the CRC: all as in fuzz/reference.py.
    """
    script = Script(data)
    seed = script.word()
    stream = b''.join(traffic(script))
    sent = reference.Stream(stream + GOOD)
    whole = feed([stream], sent)
    assert feed(pieces(stream, seed), sent) == whole
    if len(stream) < 300:
        assert feed((stream[at:at + 1] for at in range(len(stream))), sent) == whole
    feed([stream + GOOD], sent)
    good_is_found_behind(stream)


def feed(chunks, sent):
    """Return what is found in chunks and a flush; compare with what was sent on the way."""
    framer = Watched()
    total = 0
    damaged = []
    for chunk in [*chunks, None]:
        frames = framer.flush_frames() if chunk is None else framer.frames(chunk)
        total += len(chunk or b'')
        damaged += [frame for frame in frames if not is_good(frame)]
        packets, noise = sent.found(total, chunk is None)
        assert [as_said(frame) for frame in framer.good] == [as_sent(one) for one in packets]
        assert framer.noise_bytes == len(noise)
        assert framer.noise == noise[-NOISE_KEPT:]
        assert framer.bytes == total == framer.accounted + len(noise) + framer.pending
        assert framer.packet_bytes == framer.accounted
        assert framer.packets == len(packets)
        assert framer.repaired == sum(one.repaired for one in packets)
        assert framer.pending <= MAX_FRAME
    assert framer.pending == 0
    assert framer.crc_errors + framer.truncated + framer.bad_length == len(damaged)
    return framer.good, damaged


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
        data = reference.unstuff(params)
    return (one.end - len(one.body) - 6, one.end, is_status, number,
            one.body[4] if is_status else code, data, one.repaired, one.noise,
            not is_status and reference.stuff(data) != params)


def pieces(stream, seed):
    """Cut a stream into pieces of 1 to 64 bytes that follow from the seed."""
    at = 0
    while at < len(stream):
        seed = (seed * 1103515245 + 12345) & 0x7FFFFFFF
        size = 1 + (seed >> 16) % 64 if seed & 0x100 else 1 + (seed >> 16) % 3
        yield stream[at:at + size]
        at += size


def good_is_found_behind(stream):
    """Hold that a good packet is found, or lies in a frame that the CRC takes for good."""
    framer = Framer()
    frames = framer.frames(stream + GOOD) + framer.flush_frames()
    end = len(stream) + len(GOOD)
    assert any((one == end and data == b'good') or one > len(stream)
               for _, one, _, _, _, data, _ in filter(is_good, frames))
    framer.frames(stream)
    framer.flush_frames()
    assert [frame[2:6] for frame in framer.frames(GOOD)] == [(IS_STATUS, 1, 0, b'good')]
