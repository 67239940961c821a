# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""Packets in a pcapng file: each byte once, sides, events, findings; read back, and by tshark."""
from collections import defaultdict
import json
import shutil
import subprocess

import pytest
from test_dump import bursts
from test_dump import capture
from test_dump import dump
from test_dump import SECOND
from usb_files import tshark

from msg_defs.dxl_packet import Framer
from msg_defs.event import Change
from msg_defs.event import Chunk
from msg_defs.event import IN
from msg_defs.event import OUT
from msg_defs.servo_frame import IS_STATUS
from msg_defs.uart import byte_ns
from rigs.usb_pcap import MMAPPED
from rigs.usb_pcap import pcapng
from servobus.sources.capture import ClockReading
from servobus.sources.capture import Wire
from servobus.sources.capture import Writer
from servobus.sources.opening import open_file
from servobus.sources.packet_file import PacketFile
from servobus.sources.packet_file import PacketWriter

BAUD = 1_000_000
FAULTS = ('silent:2:0.2', 'noise::0.4:0.3')
needs_tshark = pytest.mark.skipif(not shutil.which('tshark'),
                                  reason='skipped: tshark is not installed (apt has it)')


def chunks(path):
    """Return the bytes of each side of a file, and its changes."""
    sides, changes = defaultdict(bytes), []
    for chunk in open_file(str(path), None, tool='dxl_dump').chunks():
        sides[chunk.side] += chunk.data
        changes += [chunk.change] if chunk.change else []
    return sides, changes


def with_sides(path, pattern='mixed'):
    """Record a bus as its master hears it; the cable is lost at the end."""
    wire, framer = Wire('arm', BAUD, port='/dev/ttyUSB0'), Framer()
    with open(path, 'wb') as file:
        writer = Writer(file, ClockReading(1_790_000_000 * SECOND, SECOND))
        for data, stamp in bursts(pattern=pattern):
            done = framer.bytes
            for begin, end, kind, *_ in framer.frames(data):
                writer.write_chunk(wire, Chunk(stamp, 'arm', data[begin - done:end - done],
                                        IN if kind == IS_STATUS else OUT))
        writer.write_chunk(wire, Chunk(stamp + 1, 'arm', change=Change('unread', 5)))
        writer.write_chunk(wire, Chunk(stamp + 2, 'arm', b'\xff\xff', IN))
        writer.write_chunk(wire, Chunk(stamp + 3, 'arm', change=Change('unplugged', 1)))
    return path


@pytest.mark.parametrize('pattern', ['mixed', 'fast'])
def test_every_byte_is_there_once_and_the_counters_are_the_same(pattern, tmp_path):
    text = capture(tmp_path / 'bus.txt', bursts(*FAULTS, pattern=pattern))
    file = tmp_path / 'bus.pcapng'
    dump(text, '-w', file)
    assert chunks(file)[0] == chunks(text)[0]
    assert json.loads(dump(text, '--summary')) == json.loads(dump(file, '--summary'))


def test_sides_and_events_come_back(tmp_path):
    text, file = with_sides(tmp_path / 'arm.txt'), tmp_path / 'arm.pcapng'
    dump(text, '-w', file)
    assert chunks(file) == chunks(text)
    source = open_file(str(file), None, tool='dxl_dump')
    list(source.chunks())
    assert source.wire('arm') == Wire('arm', BAUD, port='/dev/ttyUSB0')


def test_a_given_rate_holds_also_where_the_file_says_another_one_later(tmp_path):
    text, file = tmp_path / 'arm.txt', tmp_path / 'arm.pcapng'
    with text.open('wb') as open_text:
        writer = Writer(open_text, ClockReading(1_790_000_000 * SECOND, SECOND))
        for chunk in (Chunk(SECOND, 'arm', change=Change('baud', BAUD)),
                      Chunk(SECOND + 1, 'arm', bytes.fromhex('ffff010201fb'), OUT)):
            writer.write_chunk(Wire('arm', 2 * BAUD), chunk)
    dump(text, '-w', file)
    for path in (text, file):
        source = open_file(str(path), BAUD // 2, tool='dxl_dump')
        assert [chunk.change for chunk in source.chunks()] == [None]
        assert source.wire('arm').baud == BAUD // 2
        assert Change('baud', BAUD) in chunks(path)[1]


def test_it_can_be_piped_and_what_is_cut_off_says_so(tmp_path):
    text = with_sides(tmp_path / 'arm.txt')
    file = tmp_path / 'arm.pcapng'
    dump(text, '-w', file)
    whole = file.read_bytes()
    assert dump(text, '-w', '-', '--format', 'pcapng', binary=True) == whole
    for size in (40, 100, len(whole) - 1):
        file.write_bytes(whole[:size])
        source = PacketFile('cut', file.open('rb'), None)
        list(source.chunks())
        source.close()
        assert source.problems()


@pytest.mark.parametrize(('name', 'why'), [
    ('bus.pcap', 'cannot write .pcap'),
    ('usb.pcapng', 'is not a recording of dxl_dump'),
    ('notes.pcapng', 'is not a recording of dxl_dump')])
def test_what_is_no_recording_of_ours_is_not_written_over(name, why, tmp_path):
    (tmp_path / 'notes.pcapng').write_text('shopping list')
    (tmp_path / 'usb.pcapng').write_bytes(pcapng(MMAPPED, b''))
    text = with_sides(tmp_path / 'arm.txt')
    assert why in dump(text, '-w', tmp_path / name, code=2)


@needs_tshark
def test_tshark_sees_direction_time_comments_and_the_same_bytes(tmp_path):
    text, file = with_sides(tmp_path / 'arm.txt'), tmp_path / 'arm.pcapng'
    dump(text, '-w', file)
    fields = ('frame.interface_name', 'frame.packet_flags_direction', 'frame.comment', 'data.data',
              'frame.time_epoch')
    rows = tshark(file, fields)
    assert {row[0] for row in rows} == {'arm'}
    assert {int(row[1], 0) for row in rows if row[3]} == {1, 2}
    assert rows[-1][2] == 'event: unplugged 1'
    assert bytes.fromhex(''.join(row[3] for row in rows)) == b''.join(
        chunk.data for chunk in open_file(str(text), None, tool='dxl_dump').chunks())
    assert 1_790_000_000 <= float(rows[0][4]) < 1_790_000_002
    again = tmp_path / 'again.pcapng'                   # with its own section header
    subprocess.run(['tshark', '-r', file, '-w', again], capture_output=True, check=True)
    assert chunks(again) == chunks(file)


def test_a_finding_is_a_comment_where_it_begins(tmp_path):
    text = capture(tmp_path / 'bus.txt', bursts('silent:2:0.5', seconds=6.0))
    file = tmp_path / 'bus.pcapng'
    dump(text, '-w', file)
    data = file.read_bytes()
    assert data.count(b'no answer from 002') > 20
    assert data.count(b'ERROR: 002: ') == 1


def test_the_stamp_of_a_packet_is_that_of_its_first_byte(tmp_path):
    path, wire = tmp_path / 'bus.pcapng', Wire('bus', BAUD)
    with path.open('wb') as file:
        writer = PacketWriter(file)
        writer.write(wire, 5_000, b'\xff\xff\xfd\x00', OUT)
        writer.write(wire, 9_000, b'\xff\xff\xfd\x00', IN)
    source = open_file(str(path), None, tool='dxl_dump')
    assert [chunk.stamp for chunk in source.chunks()] == [5_000, 9_000 + int(4 * byte_ns(BAUD))]
