# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""Framer: any bytes, in any split."""

from fuzz import reference
from fuzz.script import Script
from fuzz.script import traffic
from msg_defs.dxl_packet import encode
from msg_defs.dxl_packet import Framer
from msg_defs.dxl_packet import HEADER
from msg_defs.dxl_packet import MAX_FRAME
from msg_defs.dxl_packet import packet_of
from msg_defs.dxl_packet import STATUS

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
            end, body, flaw = frame
            if flaw is None or not flaw.reason:
                assert self._last < end, 'frames overlap'
                self.good.append(frame)
                self.accounted += end - max(self._last, end - len(body) - 6)
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
        damaged += [frame for frame in frames if frame[2] is not None and frame[2].reason]
        packets, noise = sent.found(total, chunk is None)
        assert [as_found(frame) for frame in framer.good] == packets
        assert framer.noise_bytes == len(noise)
        assert framer.noise == noise[-NOISE_KEPT:]
        assert framer.bytes == total == framer.accounted + len(noise) + framer.pending
        assert framer.packet_bytes == framer.accounted
        assert framer.packets == len(packets)
        assert framer.repaired == sum(one.repaired for one in packets)
        assert framer.pending <= MAX_FRAME
    assert framer.pending == 0
    assert framer.crc_errors + framer.truncated + framer.bad_length == len(damaged)
    for frame in framer.good:
        readable(frame)
    return framer.good, damaged


def as_found(frame):
    end, body, flaw = frame
    return reference.Found(end, body, flaw is not None and flaw.repaired,
                           flaw.noise_length if flaw is not None else 0)


def readable(frame):
    """Hold that a packet says what its frame says; a fast reply is never stuffed."""
    end, body, _ = frame
    packet = packet_of(frame, 7)
    is_status = body[3] == 0x55
    params = body[5:] if is_status else body[4:]
    if not is_status or body[0] != 0xFE:
        params = reference.unstuff(params)
    assert packet[:6] == (7, end - len(body) - 6, body[0], body[3],
                          body[4] if is_status else None, params)


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
    assert any((one == end and body == GOOD[len(HEADER):-2]) or one > len(stream)
               for one, body, flaw in frames if flaw is None or not flaw.reason)
    framer.frames(stream)
    framer.flush_frames()
    assert [body for _, body, _ in framer.frames(GOOD)] == [GOOD[len(HEADER):-2]]
