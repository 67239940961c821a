# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""Framer: any bytes, in any split."""

from fuzz.script import Script
from fuzz.script import traffic
from msg_defs.dxl_packet import encode
from msg_defs.dxl_packet import Framer
from msg_defs.dxl_packet import HEADER
from msg_defs.dxl_packet import MAX_FRAME
from msg_defs.dxl_packet import NOISE_KEPT
from msg_defs.dxl_packet import STATUS

GOOD = encode(1, STATUS, b'good', 0)


def check(data):
    """
    Check one stream, whole and in pieces.

    Never raises; memory bounded; every byte in exactly one counter; any split finds the same
    packets; a good packet behind garbage is found; what it finds was sent, but for the CRC.
    """
    script = Script(data)
    seed = script.word()
    stream = b''.join(traffic(script))
    whole = feed([stream])
    assert feed(pieces(stream, seed)) == whole
    good_is_found_behind(stream)


def feed(chunks):
    """Return the packets and the byte counters after chunks and a flush, checked on the way."""
    framer = Framer()
    total = accounted = last = 0
    packets = []
    for chunk in [*chunks, None]:
        frames = framer.flush_frames() if chunk is None else framer.frames(chunk)
        total += len(chunk or b'')
        for end, body, flaw in frames:
            assert 0 <= end <= total
            if flaw is None or not flaw.reason:
                assert last < end, 'frames overlap'
                accounted += end - max(last, end - len(body) - 6)
                last = end
                packets.append((end, body, flaw is not None and flaw.repaired))
        assert framer.bytes == total == accounted + framer.noise_bytes + framer.pending
        assert framer.packet_bytes == accounted
        assert framer.packets == len(packets)
        assert framer.pending <= MAX_FRAME
        assert len(framer.noise) <= NOISE_KEPT
    assert framer.pending == 0
    return packets, framer.noise_bytes, framer.repaired, framer.noise


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
