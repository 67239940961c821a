# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""The fake MCU: receiver and cable on simulated time, then the pty and the console tool."""
import json
import os
import subprocess
import sys
import time

from mecarover_fakes.fake_mcu import FakeMcu
from mecarover_fakes.receiver import Receiver
from msg_defs.vel2d import encode
from msg_defs.vel2d import FRAME_SIZE
from msg_defs.vel2d import STOP
from msg_defs.vel2d import Vel2d

MS = 1_000_000
DRIVE = Vel2d(0.5, -0.25, 1.0)
FRAME = encode(DRIVE)


def numbered(index):
    return encode(Vel2d(index / 1000, 0.0, 0.0))


def until(mcu, condition):
    """Pump until the condition holds; fail after 10 s."""
    deadline = time.monotonic() + 10
    while not condition():
        assert time.monotonic() < deadline
        mcu.pump(0.01)


def test_bytes_arrive_at_the_pace_of_the_line_and_ten_set_points_wait():
    mcu = Receiver()
    mcu.feed(FRAME[:20], 0)
    mcu.feed(FRAME[20:] + b''.join(map(numbered, range(1, 20))), 5)     # the line is still busy
    taken = mcu.advance(30 * MS)            # 12 frames have arrived, two find the queue full
    assert [arrival.stamp for arrival in mcu.arrivals] == [
        FRAME_SIZE * mcu.character * count for count in range(1, 21)]
    assert [(one.stamp, one.x) for one in taken] == [(30 * MS, 500.0)]
    assert (len(mcu._queue), mcu.totals.queue_full) == (9, 2)
    mcu.overrun()
    mcu.feed(FRAME, 100 * MS)
    assert (mcu.totals.frames, mcu.totals.unheard) == (20, FRAME_SIZE)


def test_pty_to_set_point():
    mcu = FakeMcu()
    host = os.open(mcu.path, os.O_RDWR | os.O_NOCTTY)
    os.write(host, FRAME)
    until(mcu, lambda: mcu.receiver.wheels.x == 500.0)
    mcu.send_text(b'hello')
    assert os.read(host, 9) == b'hello'
    os.close(host)
    mcu.close()


def test_with_a_watchdog_it_stops_and_reports():
    stamp, heard = [0], b''
    mcu = FakeMcu(clock=lambda: stamp[0], talks=True, watchdog=True)
    host = os.open(mcu.path, os.O_RDWR | os.O_NOCTTY)
    mcu.receiver.overrun()
    os.write(host, FRAME)
    for ms in (300, 330, 630):
        stamp[0] = ms * MS
        mcu.pump(10 if ms == 300 else 0)
    while heard.count(b'\n') < 3:
        heard += os.read(host, 300)
    assert heard.endswith(b'vel2d receiver 1: stopped, 1 good, 0 bad, 0 refused, 1 stops\r\n')
    os.close(host)
    mcu.close()


def test_frames_in_one_read_are_counted_and_kept_apart():
    mcu = FakeMcu()
    host = os.open(mcu.path, os.O_RDWR | os.O_NOCTTY)
    os.write(host, b''.join(map(numbered, range(3))))
    until(mcu, lambda: mcu.receiver.totals.frames == 3)
    assert mcu.totals()['merged'] == 1
    assert mcu.totals()['insufficient'] == mcu.totals()['crc_err'] == 0
    os.close(host)
    mcu.close()


def test_a_late_reader_does_not_invent_a_full_queue():
    stamp = [0]
    mcu = FakeMcu(clock=lambda: stamp[0])
    host = os.open(mcu.path, os.O_RDWR | os.O_NOCTTY)
    os.write(host, b''.join(map(numbered, range(20))))
    stamp[0] = 700 * MS                              # 20 frames at 30 Hz, read at once
    mcu.pump(10)
    stamp[0] = 1500 * MS
    mcu.pump(0)
    assert mcu.totals()['taken'] == 20
    assert mcu.totals()['queue_full'] == 0
    os.close(host)
    mcu.close()


def tool(*arguments, **options):
    return subprocess.Popen(
        [sys.executable, '-m', 'mecarover_fakes.fake_mcu', *arguments], stdout=subprocess.PIPE,
        stderr=subprocess.PIPE, text=True, **options)


def test_tool_prints_set_points_and_totals(tmp_path):
    link = str(tmp_path / 'mcu')
    process = tool('--link', link, '--json', '--frames')
    assert json.loads(process.stdout.readline())['path'] == link
    host = os.open(link, os.O_RDWR | os.O_NOCTTY)
    os.write(host, FRAME)
    records = [json.loads(process.stdout.readline()) for _ in range(2)]
    os.write(host, encode(STOP))
    records += [json.loads(process.stdout.readline()) for _ in range(2)]
    process.terminate()
    out, err = process.communicate(timeout=10)
    os.close(host)
    frames = [record['frame'] for record in records if 'frame' in record]
    assert frames == [[0.5, -0.25, 1.0], [0.0, 0.0, 0.0]]
    changes = [(record['x'], record['what']) for record in records if 'what' in record]
    assert changes == [(500.0, 'drive'), (0.0, 'stop')]
    assert json.loads(out)['totals']['frames'] == 2
    assert (process.returncode, err) == (0, '')
    assert not os.path.lexists(link)
