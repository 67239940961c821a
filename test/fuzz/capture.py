# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""Capture files: any lines, and what was written."""

from collections import Counter
import io
import re

from fuzz.script import Script
from msg_defs.event import Chunk
from servobus.sources.capture import Moment
from servobus.sources.capture import Reader
from servobus.sources.capture import Wire
from servobus.sources.capture import Writer

SECOND = 1_000_000_000
MAGIC = b'# dxl_capture 2 '
LINES = (
    MAGIC + b'began 2026-09-20T10:13:20.123456Z at 12345.678901234\n',
    b'# bus ttyUSB0 baud 2000000 latency_timer_ms 1 port /dev/ttyUSB0\n',
    b'# bus - baud 57600 latency_timer_ms 0 port socket://h:1\n',
    b'(12345.690172411) ttyUSB0 fffffd00010300011 94e\n',
    b'(12345.690172411) ttyUSB0 fffffd0001030001194e\n',
    b'(1.5) - ff\n', b'# gap: the disk was too slow\n', b'\n', b'(', b'(.) - ff\n', b'# bus\n',
    b'# bus x baud\n', b'# bus x baud -1 port\n', MAGIC, b'(-1.5) a 00\n', b'# \xff\n',
    b'# bus x port /dev/x\n', b'garbage\n')
BUSES = ('', 'left', 'a b', 'tty\u00e9', '-', '%2D', '#', '(', 'x' * 60)
CHUNK = re.compile(rb'\((\d+)\.(\d+)\) ([!-~]+) ((?:[0-9a-f]{2})+)\n')
REMARK = re.compile(rb'# (?! *(?:bus|dxl_capture)\b)[ -~]*\n')
BROKEN = re.compile(rb'[^(#\s][!-~]*\n|\([^) ]*\n|# bus\n|# bus \w+\n|# dxl_capture [19] \n')


def check(data):
    """
    Check one file.

    Never raises; each line is a chunk, a header, a remark, blank or counted as bad, and what is
    plainly one of these is taken for it; what was written is read again to the byte and the ns,
    each bus with all its facts told once, behind bad lines too, and behind another capture with a
    clock began again.
    """
    script = Script(data)
    lines = [line(script) for _ in range(script.byte() % 16)]
    any_lines(lines)
    moment, written, told = wrote(script)
    whole = io.BytesIO()
    writer = Writer(whole, moment)
    for wire, chunk in written:
        writer.write_chunk(wire, chunk)
    assert writer.size == len(whole.getvalue())
    comes_back(moment, [chunk for _, chunk in written], told, whole.getvalue())
    bad = [b'(x\n', b'garbage\n', b'# bus\n', b'(1.5) - f\n']
    noisy = Reader([*bad, *whole.getvalue().splitlines(True)])
    assert list(noisy) == [chunk for _, chunk in written]
    assert (noisy.bad_lines, noisy.first_bad_line) == (len(bad), 1)
    second_boot(moment, written, whole.getvalue().splitlines(True))


def any_lines(lines):
    reader = Reader(lines)
    chunks, bad = [], []
    for number, text in enumerate(lines, 1):
        before = reader.bad_lines
        reader._lines = [text]
        found = list(reader)
        chunks += found
        assert len(found) + reader.bad_lines - before <= 1
        bad += [number] * (reader.bad_lines - before)
        plain = CHUNK.fullmatch(text)
        if plain:
            assert [one.data for one in found] == [bytes.fromhex(plain[4].decode())]
        if not text.strip() or REMARK.fullmatch(text):
            assert not found
            assert reader.bad_lines == before
        if BROKEN.fullmatch(text):
            assert reader.bad_lines == before + 1
    assert all(isinstance(chunk.data, bytes) and isinstance(chunk.stamp, int) for chunk in chunks)
    whole = Reader(lines)
    assert list(whole) == chunks
    assert whole.bad_lines == len(bad)
    assert whole.first_bad_line == (bad[0] if bad else 0)


def line(script):
    text = script.pick(LINES)
    if script.byte() < 100:
        return text
    at = script.byte() % (len(text) + 1)
    return text[:at] + script.take(script.byte() % 12) + text[at + script.byte() % 4:]


def wrote(script):
    """Return when a capture began, (wire, chunk) of all in it, and the wires by name."""
    stamp = script.word() * 1_000_000_007
    moment = Moment(1_700_000_000_123_456_000 + stamp // 1000 * 1000, stamp)
    written = []
    wires = {}
    while script:
        name = script.pick(BUSES)
        stamp += script.word()
        wire = wires.setdefault(
            name, Wire(name, 57600 + script.word(), script.byte(), '/dev/' + name))
        written.append((wire, Chunk(stamp, name, script.take(1 + script.byte() % 32) or b'\0')))
    return moment, written, wires


def comes_back(moment, chunks, wires, text):
    reader = Reader(io.BytesIO(text))
    assert list(reader) == chunks
    assert reader.bad_lines == reader.first_bad_line == 0
    assert reader.began == moment
    assert reader.wires == wires
    first = Counter(text.split()[0] for text in text.splitlines())
    assert first[b'#'] == 1 + len(wires)


def second_boot(moment, written, lines):
    """Hold that behind a capture an hour long one of the next boot goes on by the wall-clock."""
    file = io.BytesIO()
    later = Moment(moment.wall + 7200 * SECOND, 5 * SECOND)
    writer = Writer(file, moment)
    wire = Wire('left', 57600, 1, '')
    writer.write_chunk(wire, Chunk(moment.stamp + 3600 * SECOND, wire.name, b'\1'))
    writer = Writer(file, later)
    writer.write_chunk(wire, Chunk(6 * SECOND, wire.name, b'\2'))
    both = list(Reader([*lines, *file.getvalue().splitlines(True)]))
    assert both[:len(written)] == [chunk for _, chunk in written]
    assert both[-1] == Chunk(moment.stamp + 7201 * SECOND, 'left', b'\2')
