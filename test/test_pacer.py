# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""Pacer: writes, refusals, a line that is slow or stuck, freezes; on simulated time."""
import pytest

from msg_defs.nanoseconds import NS_PER_S
from msg_defs.vel2d import decode
from msg_defs.vel2d import FRAME_SIZE
from msg_defs.vel2d import STOP
from msg_defs.vel2d import Vel2d
from vel2d_bridge.deadman_process import SILENCE
from vel2d_bridge.gate import BURST_FRAMES
from vel2d_bridge.gate import characters_ns
from vel2d_bridge.gate import Gate
from vel2d_bridge.gate import NEVER
from vel2d_bridge.gate import NS_PER_MS as MS
from vel2d_bridge.gate import Outcome
from vel2d_bridge.gate import Stop
from vel2d_bridge.pacer import Pacer

START = 5 * NS_PER_S
DRIVE = Vel2d(0.5, -0.25, 1.0)
TIMEOUT = 50 * MS
RETRY = 2 * MS                                       # soon, and not busily


class Line:
    """A line that takes and holds what it is told to."""

    def __init__(self):
        self.written = []
        self.dropped = 0
        self.takes = FRAME_SIZE
        self.holds = 0
        self.on_write = lambda: None

    def write(self, data):
        self.on_write()
        self.written.append(data[:self.takes])
        return len(self.written[-1])

    def pending(self):
        return self.holds

    def drop_output(self):
        self.dropped += 1
        self.holds = 0


class World:
    """A pacer behind its opening burst, and the time."""

    def __init__(self, baud=115200, **options):
        self.now = START
        self.line = Line()
        self.sent = []
        self.pacer = Pacer(Gate(baud=baud), lambda: self.now, baud=baud,
                           on_sent=self.sent.append, **options)
        self.pacer.attach(self.line, START)
        self.run(NS_PER_S)
        self.line.written.clear()

    def run(self, ns):
        """Be the thread: turn when asked to, every 50 ms at least."""
        end = self.now + ns
        while self.now < end:
            wake = self.pacer.turn(self.now)
            self.now = min(max(wake, self.now + 1), self.now + 50 * MS, end)

    def drive(self):
        self.pacer.offer_command(DRIVE, self.now)
        self.pacer.step(self.now)

    @property
    def velocities(self):
        return [decode(data) for data in self.line.written]


def test_nothing_happens_without_a_line():
    pacer = Pacer(Gate(), lambda: START)
    assert pacer.turn(START) == NEVER
    assert pacer.turn(START + NS_PER_S, True) == NEVER
    assert pacer.offer_command(DRIVE, START) is Outcome.NO_PORT
    assert (pacer.freezes, pacer.is_idle()) == (0, True)


def test_a_thread_that_is_silent_for_200_ms_was_frozen():
    world = World()
    world.pacer.turn(world.now)
    world.pacer.turn(world.now + SILENCE - 1)
    assert world.pacer.freezes == 0
    world.pacer.turn(world.now + 2 * SILENCE - 1)
    assert world.pacer.freezes == 1


def test_a_callback_notices_a_freeze_as_well_and_it_counts_once():
    world = World()
    world.drive()
    world.pacer.turn(world.now)
    now = world.now + SILENCE
    assert world.pacer.offer_command(DRIVE, now) is Outcome.FROZEN
    assert world.pacer.offer_command(DRIVE, now + MS) is Outcome.FROZEN
    assert world.pacer.freezes == 1
    world.pacer.turn(now + 2 * MS)
    assert world.pacer.freezes == 1
    assert world.pacer.gate.velocity == STOP


def test_where_the_deadman_acted_the_bridge_begins_anew():
    world = World()
    world.drive()
    world.pacer.turn(world.now, True)
    assert world.pacer.freezes == 1
    assert world.pacer.offer_command(DRIVE, world.now, acted=True) is Outcome.FROZEN


def test_a_driver_that_counts_whole_transfers_is_given_the_time_of_any_other():
    """The Linux driver cdc-acm calls all of a USB transfer pending, for any content."""
    world = World()
    world.line.holds = 64
    world.pacer.step(world.now + MS)
    assert (world.line.dropped, world.pacer.time_outs) == (0, 0)


def test_a_frame_is_given_the_time_it_takes_however_short_the_write_time_out_is():
    world = World(baud=19200, write_timeout_s=0.005)
    on_the_wire = characters_ns(FRAME_SIZE, 19200)
    assert on_the_wire > 5 * MS
    world.drive()
    while not world.line.written:
        world.run(MS)
    begin = world.sent[-1].stamp
    world.line.holds = FRAME_SIZE
    world.pacer.step(begin + on_the_wire)
    assert (world.line.dropped, world.pacer.time_outs) == (0, 0)
    world.pacer.step(begin + 2 * characters_ns(FRAME_SIZE + 2, 19200))
    assert (world.line.dropped, world.pacer.time_outs) == (1, 1)


def test_what_the_kernel_takes_and_the_wire_does_not_is_no_good_write():
    """A UART blocked by flow control: each frame is taken, none ever leaves."""
    world = World()
    world.line.on_write = lambda: setattr(world.line, 'holds', FRAME_SIZE)
    world.run(NS_PER_S)
    assert world.pacer.time_outs_in_row == world.pacer.time_outs > 5
    world.line.on_write = lambda: None
    world.run(NS_PER_S)
    assert world.pacer.time_outs_in_row == 0


def test_a_frame_that_does_not_leave_is_dropped_at_the_time_out_and_a_stop_follows():
    world = World()
    world.drive()
    written = world.now
    world.line.holds = 3
    world.pacer.step(written + TIMEOUT - 1)
    assert world.line.dropped == 0
    world.pacer.step(written + TIMEOUT)
    assert (world.line.dropped, world.pacer.time_outs_in_row) == (1, 1)
    assert world.pacer.gate.counters.stops[Stop.WRITE] == 1
    world.now = written + TIMEOUT
    drained = world.now + characters_ns(128 + 2, 115200)
    world.run(drained - world.now)
    assert world.velocities == [DRIVE]
    world.run(50 * MS)
    assert world.velocities[1] == STOP
    assert world.sent[-1].stamp == drained


def test_time_outs_in_a_row_are_counted_and_a_good_write_ends_the_row():
    world = World()
    world.line.takes = 0
    for _ in range(3):
        before = world.pacer.time_outs
        while world.pacer.time_outs == before:
            world.run(10 * MS)
    assert world.pacer.time_outs_in_row == world.pacer.time_outs == 3
    world.line.takes = FRAME_SIZE
    world.run(100 * MS)
    assert world.pacer.time_outs_in_row == 0


def test_a_refused_write_is_tried_again_soon_but_not_busily():
    world = World()
    world.line.takes = 0
    world.pacer.offer_command(DRIVE, world.now)
    wake = world.pacer.step(world.now)
    assert wake == world.now + RETRY
    world.line.takes = FRAME_SIZE
    world.pacer.step(wake)
    assert world.velocities[-1] == DRIVE


def test_while_bytes_are_pending_it_looks_again_soon_and_writes_nothing():
    world = World()
    world.drive()
    world.line.holds = 5
    assert world.pacer.step(world.now + MS) >= world.now + MS + RETRY
    world.pacer.offer_command(DRIVE, world.now + 40 * MS)
    world.pacer.step(world.now + 40 * MS)
    assert len(world.line.written) == 1


def test_a_partial_write_is_dropped_not_completed():
    world = World()
    world.line.takes = 11
    world.drive()
    assert (world.pacer.partial_writes, world.line.dropped) == (1, 1)
    world.line.takes = FRAME_SIZE
    world.run(200 * MS)
    assert set(world.velocities[1:]) == {STOP}


@pytest.mark.parametrize('early', [0, 1])
def test_behind_a_frame_that_left_late_there_is_a_gap_and_else_none(early):
    world = World()
    world.drive()
    world.line.holds = 1
    world.pacer.step(world.now + characters_ns(FRAME_SIZE + 2, 115200) - early)
    world.line.holds = 0
    now = world.now + 45 * MS
    world.pacer.offer_command(DRIVE, now)
    wake = world.pacer.step(now)
    assert len(world.line.written) == 1 + early
    if not early:
        assert wake == now + characters_ns(2, 115200)
        world.pacer.step(wake)
        assert len(world.line.written) == 2


def test_a_new_line_begins_anew():
    world = World()
    world.line.takes = 0
    world.run(200 * MS)
    world.pacer.detach()
    assert world.pacer.is_idle()
    line = Line()
    world.pacer.attach(line, world.now)
    assert world.pacer.time_outs_in_row == 0
    assert not world.pacer.is_idle()
    world.run(10 * MS)
    assert [decode(data) for data in line.written] == [STOP]


def test_the_timings_of_a_frame_are_those_of_its_write():
    world = World()
    begin = world.now
    world.pacer.offer_command(DRIVE, begin)
    world.now = begin + 2 * MS                       # the thread comes a little later
    world.line.on_write = lambda: setattr(world, 'now', begin + 5 * MS)
    world.pacer.step(world.now)
    sent = world.sent[-1]
    assert (sent.stamp, sent.write, sent.latency) == (begin + 5 * MS, 3 * MS, 5 * MS)


def test_frames_and_mishaps_are_counted_from_0():
    pacer = Pacer(Gate(), lambda: START)
    assert (pacer.frames, pacer.time_outs, pacer.partial_writes, pacer.freezes) == (0, 0, 0, 0)
    world = World()
    assert world.pacer.frames == len(world.sent) > BURST_FRAMES
    world.line.takes = 0
    world.run(200 * MS)
    assert world.pacer.frames == len(world.sent)     # what the line refuses is none


def test_what_has_not_left_is_waited_for_before_it_counts_as_idle():
    world = World()
    assert world.pacer.is_idle()
    world.line.holds = 1
    assert not world.pacer.is_idle()


def test_a_new_line_does_not_pay_for_a_slow_one():
    world = World()
    world.drive()
    world.line.holds = 1
    world.pacer.step(world.now + characters_ns(FRAME_SIZE + 2, 115200))
    world.pacer.detach()
    line = Line()
    world.now += NS_PER_S
    world.pacer.attach(line, world.now)
    world.now += characters_ns(FRAME_SIZE + 2, 115200)
    world.pacer.turn(world.now)
    assert [decode(data) for data in line.written] == [STOP]
