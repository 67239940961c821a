# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""Capture files: any lines, and what was written."""

import io

from dxl_monitor.capture import Chunk
from dxl_monitor.capture import MAGIC
from dxl_monitor.capture import Moment
from dxl_monitor.capture import Reader
from dxl_monitor.capture import Wire
from dxl_monitor.capture import Writer
from fuzz.script import Script

LINES = (
    MAGIC + b'began 2026-09-20T10:13:20.123456Z at 12345.678901234\n',
    b'# bus ttyUSB0 baud 2000000 latency_timer_ms 1 port /dev/ttyUSB0\n',
    b'# bus - baud 57600 latency_timer_ms 0 port socket://h:1\n',
    b'(12345.690172411) ttyUSB0 fffffd00010300011 94e\n',
    b'(12345.690172411) ttyUSB0 fffffd0001030001194e\n',
    b'(1.5) - ff\n', b'# gap: the disk was too slow\n', b'\n', b'(', b'(.) - ff\n', b'# bus\n',
    b'# bus x baud\n', b'# bus x baud -1 port\n', MAGIC, b'(-1.5) a 00\n', b'# \xff\n')
BUSES = ('', 'left', 'a b', 'tty\u00e9', '-', '%2D', '#', '(', 'x' * 60)


def check(data):
    """
    Check one file.

    Never raises; a line is a chunk, a header, a remark, blank or counted as bad; what was
    written is read again to the byte and the ns, behind any bad lines too.
    """
    script = Script(data)
    lines = [line(script) for _ in range(script.byte() % 16)]
    reader = Reader(lines)
    chunks = list(reader)
    assert all(isinstance(chunk.data, bytes) and isinstance(chunk.stamp, int) for chunk in chunks)
    assert len(chunks) + reader.bad_lines <= len(lines)
    assert bool(reader.first_bad_line) == bool(reader.bad_lines)
    comes_back(script)


def line(script):
    text = script.pick(LINES)
    if script.byte() < 100:
        return text
    at = script.byte() % (len(text) + 1)
    return text[:at] + script.take(script.byte() % 12) + text[at + script.byte() % 4:]


def comes_back(script):
    stamp = script.word() * 1_000_000_007
    file = io.BytesIO()
    writer = Writer(file, Moment(1_700_000_000_000_000_000 + stamp, stamp))
    written = []
    while script:
        name = script.pick(BUSES)
        stamp += script.word()
        chunk = Chunk(stamp, name, script.take(1 + script.byte() % 32) or b'\0')
        writer.take(Wire(name, 57600 + script.word(), script.byte(), '/dev/' + name), chunk.data,
                    chunk.stamp)
        written.append(chunk)
    file.seek(0)
    assert writer.size == len(file.getvalue())
    reader = Reader(file)
    assert list(reader) == written
    assert reader.bad_lines == 0
    assert {name: wire.port for name, wire in reader.wires.items()} == {
        chunk.bus: '/dev/' + chunk.bus for chunk in written}
    noisy = Reader([b'(x\n', b'garbage\n', *file.getvalue().splitlines(True)])
    assert list(noisy) == written
    assert noisy.bad_lines == 2
