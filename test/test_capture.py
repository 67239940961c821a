# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""Captures: exact to the ns and the chunk, tolerant of damage; the recorder and its disk."""
import io
import os
import re

from harness import wait
from hypothesis import given
from hypothesis import strategies as st
import pytest

from msg_defs.event import Change
from msg_defs.event import Chunk
from servobus.errors import ParameterError
from servobus.port.pty import Pty
from servobus.printable_text import printable
from servobus.sources.capture import BUSES_MAX
from servobus.sources.capture import check_new
from servobus.sources.capture import chunk_line
from servobus.sources.capture import ClockReading
from servobus.sources.capture import LINE_MAX_BYTES
from servobus.sources.capture import lines
from servobus.sources.capture import open_new
from servobus.sources.capture import Reader
from servobus.sources.capture import Wire
from servobus.sources.capture import Writer
from servobus.sources.capture_recorder import Recorder

NOW = ClockReading(1_790_000_000_123_456_000, 12_345_678_901_234)
WIRE = Wire('ttyUSB0', 2_000_000, 1, '/dev/ttyUSB0')


def written(*chunks, wire=WIRE):
    file = io.BytesIO()
    writer = Writer(file, NOW)
    for chunk in chunks:
        writer.write_chunk(wire._replace(name=chunk.bus), chunk)
    assert writer.size == len(file.getvalue())
    return file.getvalue()


def test_the_format_is_the_one_in_the_docs():
    assert written(Chunk(12_345_690_172_411, 'ttyUSB0', b'\xff\xff\xfd\x00\x01')) == (
        b'# dxl_capture 2 began 2026-09-21T14:13:20.123456Z at 12345.678901234\n'
        b'# bus ttyUSB0 baud 2000000 latency_timer_ms 1 port /dev/ttyUSB0\n'
        b'(12345.690172411) ttyUSB0 fffffd0001\n')


@given(st.lists(st.builds(Chunk, st.integers(0, 2**62), st.text(
    st.characters(codec='utf-8'), min_size=1) | st.sampled_from(('', '-', '%2D')),
    st.binary(min_size=1, max_size=50), st.sampled_from(('', 'out', 'in')), st.none())))
def test_what_is_written_is_read(chunks):
    reader = Reader(io.BytesIO(written(*chunks)))
    chunks = [chunk._replace(bus=printable(chunk.bus)) for chunk in chunks]
    assert list(reader) == chunks
    assert reader.began == NOW
    assert not reader.bad_lines
    for chunk in chunks:
        assert reader.wires[chunk.bus] == WIRE._replace(name=chunk.bus)


def test_sides_and_changes_come_back_and_old_files_stay_readable():
    chunks = [Chunk(5, 'bus', b'\xff', 'out'), Chunk(6, 'bus', change=Change('baud', 57_600)),
              Chunk(7, 'bus', b'\x01', 'in'), Chunk(8, 'bus', b'\x02')]
    text = written(*chunks)
    assert b'(0.000000005) bus out ff\n(0.000000006) bus baud 57600\n' in text
    assert list(Reader(io.BytesIO(text))) == chunks
    old = text.replace(b'# dxl_capture 2', b'# dxl_capture 1').splitlines(keepends=True)
    assert list(Reader([*old[:2], old[-1]])) == chunks[-1:]
    assert list(Reader([b'(1.5) - ff\n'])) == [Chunk(1_500_000_000, '', b'\xff')]
    bad = Reader(io.BytesIO(text.replace(b'capture 2', b'capture 3') + b'(1.0) bus up ff\n'
                            b'(1.0) bus baud x\n(1.0) bus baud 1 2\n(1.0) bus\n'))
    assert (len(list(bad)), bad.bad_lines) == (4, 5)


FAR = 400 * b'9'


@pytest.mark.parametrize('line', [
    b'(-1.0) bus ff', b'(1.-5) bus ff', b'(nan) bus ff', b'(1e400) bus ff', b'(1) bus ff',
    b'(1_0.0) bus ff', b'(9223372037.0) bus ff', b'(' + FAR + b'.0) bus ff', b'(1.50 bus ff',
    b'(1.0) bus fff', b'(1.0) bus 0x', b'(1.0) bus \xff', b'(1.0) bus', b'(1.0) bus ff ff',
    b'# bus bus baud', b'# bus bus baud 9600 latency_timer_ms ' + FAR,
    b'# bus bus baud 9600 latency_timer_ms -1', b'# dxl_capture 2 began',
    b'# dxl_capture 2 began 2026-13-21T14:13:20.0Z at 1.0',
    b'# dxl_capture 2 began 9999-12-31T23:59:59.999999Z at 1.0',
    b'# dxl_capture 2 began 2026-09-21T14:13:20.0Z at -1.0', b'\x1b[31mred\x1b[m',
    b'(1.0) bus ' + b'f' * (LINE_MAX_BYTES + 1)])
def test_impossible_lines_are_told_and_left_out(line):
    text = written(Chunk(NOW.stamp + 5, 'bus', b'\x01')) + line + b'\n' + line + b'\n' \
        + chunk_line(Chunk(NOW.stamp + 6, 'bus', b'\x02'))
    reader = Reader(lines(io.BytesIO(text)))
    assert [chunk.data for chunk in reader] == [b'\x01', b'\x02']
    assert reader.wires == {'bus': WIRE._replace(name='bus')}
    [problem] = reader.problems()
    assert problem.startswith('2 lines do not belong in a capture and were left out, '
                              'the first is line 4: ')
    assert problem.isprintable()
    assert len(problem) < 160


@pytest.mark.parametrize('cut', range(1, 39))
def test_a_capture_that_is_cut_off_says_so(cut):
    text = written(Chunk(5, 'bus', b'\x01'), Chunk(6, 'bus', bytes(range(10))))[:-cut]
    reader = Reader(lines(io.BytesIO(text)))
    first, *rest = [chunk.data for chunk in reader]
    assert first == b'\x01'
    assert not rest or bytes(range(10)).startswith(rest[0])
    assert len(reader.problems()) == 1


def test_a_capture_does_not_make_buses_without_end():
    text = b''.join(chunk_line(Chunk(5, f'bus{number}', b'\x01')) for number in range(1000))
    reader = Reader(lines(io.BytesIO(text)))
    assert len(list(reader)) == BUSES_MAX
    assert reader.bad_lines == 1000 - BUSES_MAX


@pytest.mark.parametrize(('wall', 'boot', 'after'), [
    (-10**18, 5, 3),                                    # the clock was set back
    (60_000_000_000, 5_000_000_000, 60_000_000_007)])   # another boot: by the wall clock
def test_the_stamps_of_a_second_capture_go_on(wall, boot, after):
    first = written(Chunk(NOW.stamp + 1, 'bus', b'\x01'))
    file = io.BytesIO()
    Writer(file, ClockReading(NOW.wall + wall, boot)).write_chunk(
        WIRE, Chunk(boot + (2 if wall < 0 else 7), WIRE.name, b'\x02'))
    stamps = [chunk.stamp for chunk in Reader(io.BytesIO(first + file.getvalue()))]
    assert stamps == [NOW.stamp + 1, NOW.stamp + after]


def test_nothing_is_written_to_a_port_or_over_a_file_that_is_no_capture(tmp_path):
    notes = tmp_path / 'notes.txt'
    notes.write_text('keep me')
    with Pty() as pty:
        for path, reason in ((pty.path, 'is a port'), (notes, 'exists, is not a capture'),
                             (tmp_path, 'is a directory'),
                             (tmp_path / 'none' / 'x', 'No such file or directory')):
            with pytest.raises(ParameterError, match=f'{re.escape(str(path))}: {reason}.*; '):
                check_new(path)
                open_new(path)
    assert notes.read_text() == 'keep me'


def test_the_recorder_rotates_and_loses_nothing(tmp_path):
    path = tmp_path / 'bus.txt'
    recorder = Recorder(str(path), 2000, 3, lambda: NOW)
    recorder.start()
    sent = [Chunk(NOW.stamp + number, 'ttyUSB0', bytes([number])) for number in range(250)]
    for chunk in sent:
        recorder.record_chunk(WIRE, Chunk(chunk.stamp, WIRE.name, chunk.data))
    recorder.stop()
    files = [tmp_path / name for name in ('bus.txt.3', 'bus.txt.2', 'bus.txt.1', 'bus.txt')]
    assert sorted(tmp_path.iterdir()) == sorted(files)
    assert all(2000 <= file.stat().st_size < 2200 for file in files[:3])
    read = list(Reader(line for file in files for line in file.read_bytes().splitlines(True)))
    assert read == sent[-len(read):]
    assert len(read) > 180
    assert not recorder.problem


def test_a_capture_of_before_is_kept(tmp_path):
    path = tmp_path / 'bus.txt'
    path.write_bytes(written(Chunk(1, 'bus', b'\x01')))
    recorder = Recorder(str(path), 10**6, 2)
    recorder.start()
    recorder.stop()
    assert (tmp_path / 'bus.txt.1').read_bytes() == written(Chunk(1, 'bus', b'\x01'))


def test_what_was_heard_is_on_the_disk_soon(tmp_path):
    path = tmp_path / 'bus.txt'
    recorder = Recorder(str(path), 10**6, 2)
    recorder.start()
    recorder.record_chunk(WIRE, Chunk(77, WIRE.name, b'\xab\xcd'))
    wait(lambda: b'abcd' in path.read_bytes())
    recorder.stop()


def test_a_full_disk_ends_the_capture_and_is_told(tmp_path):
    recorder = Recorder('/dev/full', 10**6, 2)
    recorder.start()
    recorder.record_chunk(WIRE, Chunk(1, WIRE.name, b'\x01' * 5000))
    wait(lambda: recorder.problem)
    assert recorder.words.startswith('capture stopped: /dev/full: No space left on device; ')
    recorder.record_chunk(WIRE, Chunk(2, WIRE.name, b'\x01'))
    recorder.stop()


def test_a_disk_that_stands_still_costs_bytes_and_says_so(tmp_path, monkeypatch):
    monkeypatch.setattr('servobus.sources.capture_recorder.WAITING_MAX_BYTES', 100)
    path = tmp_path / 'bus.txt'
    recorder = Recorder(str(path), 10**6, 2, lambda: NOW)
    for number in range(20):
        recorder.record_chunk(WIRE, Chunk(NOW.stamp + number, WIRE.name, bytes(10)))
    recorder.start()
    recorder.stop()
    assert recorder.left_out == 90
    assert b'# gap: the disk was too slow from 12345.678901245 on, 90 bytes' in path.read_bytes()
    assert len(list(Reader(path.open('rb')))) == 11


def test_a_pipe_that_nobody_reads_is_refused(tmp_path):
    """Opening it waits for a reader: the node never got to its ports."""
    path = tmp_path / 'pipe'
    os.mkfifo(path)
    with pytest.raises(ParameterError, match='pipe: is a pipe that no program reads; '):
        Recorder(str(path), 10**6, 2)


@pytest.fixture
def pipe(tmp_path):
    """Return the path of a pipe and the end that reads it."""
    path = tmp_path / 'pipe'
    os.mkfifo(path)
    reader = os.open(path, os.O_RDONLY | os.O_NONBLOCK)
    yield path, reader
    os.close(reader)


def test_a_pipe_is_not_rotated(tmp_path, pipe):
    path, reader = pipe
    recorder = Recorder(str(path), 1000, 2)
    recorder.record_chunk(WIRE, Chunk(1, WIRE.name, bytes(1000)))
    recorder.record_chunk(WIRE, Chunk(2, WIRE.name, bytes(1000)))
    recorder.start()
    recorder.stop()
    assert recorder.problem == ''
    assert os.read(reader, 65536).count(b'# dxl_capture') == 1
    assert os.listdir(tmp_path) == ['pipe']


def test_a_pipe_whose_reader_sleeps_does_not_hold_up_the_end(pipe, monkeypatch):
    monkeypatch.setattr('servobus.sources.capture_recorder.STOP_PATIENCE_S', 0.2)
    path, _ = pipe
    recorder = Recorder(str(path), 10**6, 2)
    recorder.record_chunk(WIRE, Chunk(1, WIRE.name, bytes(200_000)))
    recorder.start()
    recorder.stop()
    assert recorder.words == (f'capture stopped: {path}: no data could be written; what was not '
                              'written yet is lost')
