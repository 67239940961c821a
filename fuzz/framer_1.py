# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""Framer of the Protocol 1.0 family: any bytes, in any split."""

from fuzz import reference
from fuzz.framer import pieces
from fuzz.script import Script
from msg_defs.dxl1_packet import content
from msg_defs.dxl1_packet import Dxl1Framer
from msg_defs.dxl1_packet import encode
from msg_defs.dxl1_packet import HEADER
from msg_defs.dxl1_packet import MAX_FRAME
from msg_defs.frame import is_good

GOOD = encode(1, 0, b'good')
TRICKY = (b'\xff\xff', b'\xff', b'\xff\xff\xff', b'\x00', b'\xfd', b'\xff\xff\xfd\x00',
          b'\xff\xff\x01\x02', b'\xff\xff\x01\x00', b'\xff\xff\xfe\xff', b'\x01\x02\x01\xfb')
NOISE_KEPT = 256


def check(data):
    """
    Check one stream, whole, in pieces and byte by byte.

    Never raises; memory bounded; every byte in exactly one counter; any split finds the same, a
    packet as soon as its last byte is there; a good packet behind garbage is found: all as in
    fuzz/reference.py.
    """
    script = Script(data)
    seed = script.word()
    stream = b''.join(traffic(script))
    sent = reference.Stream1(stream)
    whole = feed([stream], sent)
    assert feed(pieces(stream, seed), sent) == whole
    if len(stream) < 300:
        assert feed((stream[at:at + 1] for at in range(len(stream))), sent) == whole
    good_is_found_behind(stream)


def traffic(script):
    """Yield pieces of traffic until the script is over: frames, damaged ones, noise."""
    last = b''
    while script:
        kind = script.byte() % 8
        if kind < 2:
            last = script.take(script.byte() % 40)
        elif kind < 4:
            last = script.pick(TRICKY)
        elif kind < 6:
            last = encode(script.byte(), script.byte(), script.take(script.byte() % 24))
        elif kind == 6 and last:
            at = script.byte() % len(last)
            last = last[:at] + bytes([last[at] ^ 1 << script.byte() % 8]) + last[at + 1:]
        else:
            last = last[:script.byte() % 30]
        yield last


def feed(chunks, sent):
    """Return what is found in chunks and a flush; compare with the reference on the way."""
    framer = Dxl1Framer()
    total = 0
    good = []
    damaged = []
    for chunk in [*chunks, None]:
        for frame in framer.flush_frames() if chunk is None else framer.frames(chunk):
            (good if is_good(frame) else damaged).append(frame)
        total += len(chunk or b'')
        packets, noise = sent.found(total, chunk is None)
        assert [as_found(frame) for frame in good] == packets
        assert framer.noise_bytes == len(noise)
        assert framer.noise == noise[-NOISE_KEPT:]
        assert framer.packet_bytes == sum(end - begin for begin, end, *_ in good)
        assert framer.bytes == total == framer.packet_bytes + len(noise) + framer.pending
        assert framer.packets == len(packets)
        assert framer.pending < MAX_FRAME
    assert framer.pending == 0
    assert framer.crc_errors + framer.truncated + framer.bad_length == len(damaged)
    for begin, end, _, *said, _ in good:
        assert sent.data[begin:end] == encode(*said)
    return good, damaged


def as_found(frame):
    _, end, _, *said, flaw = frame
    return reference.Found(end, content(*said), False,
                           flaw.noise_length if flaw is not None else 0)


def good_is_found_behind(stream):
    """Hold that a good packet is found, or lies in a frame that the sum takes for good."""
    framer = Dxl1Framer()
    frames = framer.frames(stream + GOOD) + framer.flush_frames()
    end = len(stream) + len(GOOD)
    assert any((one == end and data == GOOD[5:-1]) or begin < len(stream) < one
               for begin, one, _, _, _, data, _ in filter(is_good, frames))
    framer.frames(stream)
    framer.flush_frames()
    assert [frame[3:6] for frame in framer.frames(GOOD)] == [(1, 0, b'good')]
    assert GOOD[:2] == HEADER
