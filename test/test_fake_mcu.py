# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""The fake MCU: receiver and cable on simulated time, then the pty and the console tool."""
from contextlib import suppress
from itertools import pairwise
import json
import os
import random
import subprocess
import sys
import time

from hypothesis import given
from hypothesis import settings
from hypothesis import strategies as st

from mecarover_fakes.fake_mcu import FakeMcu
from mecarover_fakes.receiver import BadCable
from mecarover_fakes.receiver import LOOP
from mecarover_fakes.receiver import QUEUE_DEPTH
from mecarover_fakes.receiver import Receiver
from msg_defs.crc import crc32_mpeg2_words
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


def test_a_frame_becomes_a_set_point_in_mm_per_s():
    mcu = Receiver()
    mcu.feed(FRAME, MS)
    assert mcu.advance(LOOP - 1) == []
    (taken,) = mcu.advance(LOOP)
    assert taken == (LOOP, 500.0, -250.0, 1.0)
    assert not taken.is_stop


def test_the_last_set_point_is_held_for_ever():
    mcu = Receiver()
    mcu.feed(FRAME, 0)
    mcu.advance(3600 * 1000 * MS)
    assert mcu.wheels[1:] == (500.0, -250.0, 1.0)
    assert mcu.totals.taken == 1


def test_a_crc_over_words_is_another_crc():
    mcu = Receiver(crc=crc32_mpeg2_words)
    mcu.feed(FRAME, 0)
    mcu.feed(encode(DRIVE, crc32_mpeg2_words), 10 * MS)
    mcu.advance(100 * MS)
    assert (mcu.totals.crc_err, mcu.totals.frames) == (1, 1)


def test_one_idle_character_ends_a_frame():
    mcu = Receiver()
    mcu.feed(FRAME[:27], 0)
    end = mcu.line_free
    mcu.advance(end + mcu.character - 1)
    assert mcu.totals.insufficient == 0
    mcu.advance(end + mcu.character)
    assert mcu.totals.insufficient == 1


def test_nothing_received_does_not_prolong_a_pause():
    mcu = Receiver()
    mcu.feed(FRAME[:27], 0)
    end = mcu.line_free + mcu.character
    mcu.feed(b'', end - 1)
    mcu.advance(end)
    assert [arrival.stamp for arrival in mcu.arrivals] == [end]


def test_a_pause_inside_a_frame_spoils_it():
    mcu = Receiver()
    mcu.feed(FRAME[:14], 0)
    mcu.feed(FRAME[14:], mcu.line_free + mcu.character)
    mcu.advance(100 * MS)
    assert [arrival.size for arrival in mcu.arrivals] == [14, 14]
    assert mcu.totals.insufficient == 2


def test_without_gaps_a_lost_byte_spoils_everything_until_the_line_is_idle():
    mcu = Receiver()
    mcu.feed(FRAME[1:], 0)
    for _ in range(20):
        mcu.feed(FRAME, 0)                           # behind the one before, without a gap
    assert mcu.totals.frames == 0
    mcu.feed(FRAME, mcu.line_free + 2 * mcu.character)
    assert (mcu.totals.crc_err, mcu.totals.insufficient, mcu.totals.frames) == (20, 1, 1)


def test_with_gaps_only_damaged_frames_are_lost():
    mcu, cable = Receiver(), BadCable(drop=50, seed=3)
    now = 0
    for index in range(1000):
        mcu.feed(cable.carry(numbered(index)), now)
        now += (FRAME_SIZE + 2) * mcu.character
        mcu.advance(now)
    assert (mcu.totals.frames, mcu.totals.insufficient, mcu.totals.crc_err) == (980, 20, 0)
    good = [arrival.velocity.x for arrival in mcu.arrivals if arrival.velocity]
    assert good == [index / 1000 for index in range(1000) if index % 50 != 49]


def test_a_flipped_bit_is_a_crc_error():
    mcu, cable = Receiver(), BadCable(flip=10)
    for index in range(100):
        mcu.feed(cable.carry(numbered(index)), index * 10 * MS)
    mcu.advance(1000 * MS)
    assert (mcu.totals.frames, mcu.totals.crc_err, mcu.totals.insufficient) == (90, 10, 0)
    assert cable.damaged == 10


def test_a_full_queue_drops_the_newest():
    mcu = Receiver()
    for index in range(1, 15):
        mcu.feed(numbered(index), index)             # 2.43 ms each: number 13 ends after 30 ms
    taken = mcu.advance(2000 * MS)
    assert [round(set_point.x) for set_point in taken] == [*range(1, 11), 13]
    assert mcu.totals.queue_full == 3
    assert all(after.stamp - before.stamp == LOOP for before, after in pairwise(taken))


def test_at_100_frames_per_second_the_rover_acts_on_old_commands():
    mcu = Receiver()
    for index in range(200):
        mcu.feed(numbered(index), index * 10 * MS)
        mcu.advance(index * 10 * MS)
    assert mcu.queued >= QUEUE_DEPTH - 1
    sent_ago_ms = 10 * (199 - mcu.wheels.x)
    assert 250 < sent_ago_ms < 400


def test_after_an_overrun_it_is_deaf():
    mcu = Receiver()
    mcu.feed(FRAME, 0)
    mcu.overrun()
    mcu.feed(encode(STOP), 100 * MS)
    mcu.advance(1000 * MS)
    assert mcu.wheels.x == 500.0
    assert (mcu.totals.overruns, mcu.totals.unheard) == (1, FRAME_SIZE)


@settings(max_examples=200, deadline=None)
@given(st.lists(st.tuples(st.binary(max_size=100), st.integers(0, 50 * MS))))
def test_any_bytes_are_accounted_for(chunks):
    mcu = Receiver()
    now = 0
    for chunk, pause in chunks:
        mcu.feed(chunk, now)
        now += pause
        mcu.advance(now)
    mcu.advance(max(now, mcu.line_free) + LOOP)
    totals = mcu.totals
    assert sum(arrival.size for arrival in mcu.arrivals) == totals.received
    assert len(mcu.arrivals) == totals.frames + totals.crc_err + totals.insufficient
    assert totals.frames == totals.taken + totals.queue_full + mcu.queued


@settings(max_examples=100, deadline=None)
@given(st.lists(st.integers(1, 3 * FRAME_SIZE), max_size=30), st.integers(0, 2**32))
def test_how_a_stream_is_cut_makes_no_difference(sizes, seed):
    stream = random.Random(seed).randbytes(10 * FRAME_SIZE) + FRAME
    whole, cut = Receiver(), Receiver()
    whole.feed(stream, 0)
    at = 0
    for size in [*sizes, len(stream)]:
        cut.feed(stream[at:at + size], at * cut.character)
        at = min(len(stream), at + size)
    assert list(cut.arrivals) == list(whole.arrivals)


def test_pty_to_set_point():
    mcu = FakeMcu()
    host = os.open(mcu.path, os.O_RDWR | os.O_NOCTTY)
    os.write(host, FRAME)
    until(mcu, lambda: mcu.receiver.wheels.x == 500.0)
    mcu.say(b'hello')
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


def test_it_vanishes_and_comes_back(tmp_path):
    link = str(tmp_path / 'mcu')
    mcu = FakeMcu(link)
    mcu.vanish()
    assert not os.path.lexists(link)
    assert mcu.pump(0.0) == []
    mcu.come_back()
    host = os.open(link, os.O_RDWR | os.O_NOCTTY)
    os.write(host, FRAME)
    until(mcu, lambda: mcu.totals()['frames'] == 1)
    os.close(host)
    mcu.close()
    assert not os.path.lexists(link)


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


def test_tool_for_people():
    process = tool('--seconds', '0.3')
    out, err = process.communicate(timeout=10)
    first, last = out.splitlines()
    assert first.startswith('fake_mcu: /dev/pts/')
    assert last.startswith('totals: ')
    assert (process.returncode, err) == (0, '')


def test_tool_refuses_in_one_line(tmp_path):
    occupied = tmp_path / 'file'
    occupied.write_text('mine')
    for arguments, code in ((['--link', str(occupied)], 1), (['--vanish', 'soon'], 2)):
        process = tool(*arguments)
        out, err = process.communicate(timeout=10)
        assert (process.returncode, out) == (code, '')
        assert err.startswith('fake_mcu: ')
        assert len(err.splitlines()) == 1
    assert occupied.read_text() == 'mine'


def test_it_says_which_frames_it_refuses():
    both = b'crc mismatch!\r\ninsufficient bytes received\r\n'
    for talks in (True, False):
        mcu, heard = FakeMcu(talks=talks), bytearray()
        fd = os.open(mcu.path, os.O_RDWR | os.O_NOCTTY | os.O_NONBLOCK)

        def hear(fd=fd, heard=heard):
            with suppress(BlockingIOError):
                heard += os.read(fd, 100)
            return bytes(heard)
        for count, name in ((FRAME_SIZE, 'crc_err'), (5, 'insufficient')):
            os.write(fd, bytes(count))
            until(mcu, lambda name=name, mcu=mcu: getattr(mcu.receiver.totals, name))
        if talks:
            until(mcu, lambda hear=hear: hear() == both)
        assert hear() == (both if talks else b'')
        os.close(fd)
        mcu.close()
