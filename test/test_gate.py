# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""Gate: what is refused, limited, replaced, resent and stopped, on simulated time."""
from itertools import accumulate
from itertools import pairwise
import math
import random
import statistics

from harness import later
from hypothesis import given
from hypothesis import settings
from hypothesis import strategies as st
import pytest

from mecarover_fakes.receiver import Receiver
from msg_defs.nanoseconds import NS_PER_S
from msg_defs.vel2d import encode
from msg_defs.vel2d import FRAME_SIZE
from msg_defs.vel2d import STOP
from msg_defs.vel2d import Vel2d
from vel2d_bridge.bridge_settings import PARAMETERS
from vel2d_bridge.gate import BURST_FRAMES
from vel2d_bridge.gate import characters_ns
from vel2d_bridge.gate import FrameKind
from vel2d_bridge.gate import Gate
from vel2d_bridge.gate import GateSettings
from vel2d_bridge.gate import limit
from vel2d_bridge.gate import NEVER
from vel2d_bridge.gate import NS_PER_MS as MS
from vel2d_bridge.gate import Outcome
from vel2d_bridge.gate import Stop
from vel2d_bridge.wall_clock import WallClock

DRIVE = Vel2d(0.5, -0.25, 1.0)
OTHER = Vel2d(-0.5, 0.0, 0.0)
START = 5 * NS_PER_S


def play(gate, begin, end, offers=()):
    """Run the gate as its owner does; `offers` are (stamp, velocity); return (stamp, frame)s."""
    offers = list(offers)
    sent = []
    now = begin
    while now <= end:
        while offers and offers[0][0] <= now:
            gate.offer_command(offers.pop(0)[1], now)
        frame = gate.next_frame(now)
        if frame is not None:
            gate.sent(now)
            sent.append((now, frame))
        wake = gate.next_deadline(now)
        assert wake > now
        now = min(wake, offers[0][0] if offers else NEVER)
    return sent


def opened(**changes):
    """Return a gate after its opening burst, and the time."""
    gate = Gate(GateSettings(**changes))
    gate.opened(START)
    play(gate, START, START + NS_PER_S)
    return gate, START + NS_PER_S


def stops_of(sent):
    return [stamp for stamp, frame in sent if frame.kind is FrameKind.STOP]


def assert_burst(stamps):
    assert len(stamps) >= 5
    assert stamps[-1] - stamps[0] >= 200 * MS
    assert all(after - before >= 30 * MS for before, after in pairwise(stamps))


def test_opening_begins_with_a_burst_and_goes_on_with_zeros():
    gate = Gate()
    gate.opened(START)
    sent = play(gate, START, START + 2 * NS_PER_S)
    assert_burst(stops_of(sent))
    assert sent[0][0] - START < 3 * MS
    assert all(frame.velocity == STOP for _, frame in sent)
    assert sent[-1][0] > START + 1900 * MS


def test_nothing_is_written_while_the_port_is_closed():
    gate = Gate()
    assert gate.offer_command(DRIVE, 0) is Outcome.NO_PORT
    assert gate.next_frame(0) is None
    assert gate.next_deadline(0) == NEVER
    gate.stop(0, Stop.DISABLED)
    assert not gate.stopping


def test_command_goes_out_at_once_and_is_resent():
    gate, now = opened()
    gate.offer_command(DRIVE, now)
    frame = gate.next_frame(now)
    assert frame == (DRIVE, FrameKind.COMMAND, now)
    gate.sent(now)
    sent = play(gate, now, now + 400 * MS)
    assert {frame for _, frame in sent} == {(DRIVE, FrameKind.RESEND, None)}
    assert [stamp - now for stamp, _ in sent] == [at * MS for at in range(75, 400, 50)]


def test_silence_stops_at_the_time_out_with_a_burst():
    gate, now = opened()
    sent = play(gate, now, now + 2 * NS_PER_S, [(now, DRIVE)])
    stops = stops_of(sent)
    assert_burst(stops)
    assert 500 * MS <= stops[0] - now <= 530 * MS
    assert gate.counters.time_outs == 1
    assert not gate.driving


def test_without_resending_the_burst_is_still_sent():
    gate, now = opened(resend_rate=0.0)
    sent = play(gate, now, now + 5 * NS_PER_S, [(now, DRIVE)])
    assert [frame.kind for _, frame in sent] \
        == [FrameKind.COMMAND] + [FrameKind.STOP] * BURST_FRAMES
    assert_burst(stops_of(sent))
    assert gate.next_deadline(now + 5 * NS_PER_S) == NEVER


@pytest.mark.parametrize(('velocity', 'arguments', 'verdict'), [
    (Vel2d(math.nan, 0.0, 0.0), {}, Outcome.NOT_FINITE),
    (Vel2d(0.0, math.inf, 0.0), {}, Outcome.NOT_FINITE),
    (Vel2d(0.0, 0.0, -math.inf), {}, Outcome.NOT_FINITE),
    (Vel2d(1e308, 0.0, 0.0), {}, Outcome.TOO_LARGE),
    (Vel2d(0.0, 0.0, -1.1e6), {}, Outcome.TOO_LARGE),
    (DRIVE, {'waited': 501 * MS}, Outcome.WAITED),
    (DRIVE, {'stamp_age': 1001 * MS}, Outcome.STAMP_OLD),
    (DRIVE, {'stamp_age': -1001 * MS}, Outcome.STAMP_AHEAD),
])
def test_a_refused_command_leaves_the_deadline_alone(velocity, arguments, verdict):
    gate, now = opened(max_stamp_age=1.0)
    gate.offer_command(DRIVE, now)
    deadline = now + 500 * MS
    for stamp in range(now + MS, deadline, 100 * MS):
        assert gate.offer_command(velocity, stamp, **arguments) is verdict
    assert gate.velocity == DRIVE
    assert gate.next_frame(deadline - 1).velocity == DRIVE
    gate.next_frame(deadline)
    assert gate.counters.time_outs == 1
    assert gate.counters.refused[verdict] == 5
    assert gate.counters.received == gate.counters.accepted + 5


@pytest.mark.parametrize('arguments', [
    {'waited': 500 * MS}, {'stamp_age': 1000 * MS}, {'stamp_age': -1000 * MS}, {'stamp_age': 0}])
def test_at_the_limit_is_accepted(arguments):
    gate, now = opened(max_stamp_age=1.0)
    assert gate.offer_command(DRIVE, now, **arguments) is Outcome.ACCEPTED


def test_a_stamp_or_a_wait_is_no_matter_where_its_check_is_off():
    gate, now = opened(cmd_vel_timeout=0.0)
    verdict = gate.offer_command(DRIVE, now, waited=3600 * NS_PER_S, stamp_age=3600 * NS_PER_S)
    assert verdict is Outcome.ACCEPTED


def rate_of_40(stamps):
    """Return the highest rate (Hz) that any 40 frames in a row had."""
    return max(39 * NS_PER_S / (last - first)
               for first, last in zip(stamps, stamps[39:], strict=False))


@pytest.mark.parametrize('rate', [30.0, 100.0])
def test_newest_replaces_older_and_the_rate_holds(rate):
    gate, now = opened(max_rate=rate)
    commands = [Vel2d(0.1, index / 1000, 0.0) for index in range(1, 1001)]
    offers = [(now + index * 5 * MS, command) for index, command in enumerate(commands)]
    sent = play(gate, now, offers[-1][0] + 3 * NS_PER_S, offers)
    stamps = [stamp for stamp, _ in sent]
    assert rate_of_40(stamps) <= 1.02 * rate
    waits = [stamp - frame.offered for stamp, frame in sent if frame.kind is FrameKind.COMMAND]
    assert max(waits) <= NS_PER_S / rate             # no command is older than a slot
    driven = [frame for _, frame in sent
              if frame.kind is not FrameKind.STOP and frame.velocity != STOP]
    assert driven[-1].velocity == commands[-1]
    fresh = [frame.velocity.y for frame in driven if frame.kind is FrameKind.COMMAND]
    assert fresh == sorted(set(fresh))
    assert gate.counters.replaced == 1000 - len(fresh)


def publisher(begin, rate, seconds, ppm=0, jitter=0, seed=1):
    """Return when commands come: from a clock that is fast by ppm, each up to jitter ns late."""
    chance = random.Random(seed)
    period = NS_PER_S / rate / (1 + ppm / 1e6)
    return [round(begin + n * period) + chance.randrange(jitter + 1)
            for n in range(round(seconds * rate))]


@pytest.mark.parametrize(('rate', 'ppm', 'jitter', 'resend'), later([
    *((rate, 0, jitter, 20.0) for rate in (10, 12, 13, 20, 25, 29, 30) for jitter in (0, 4 * MS)),
    (30, 50, 0, 20.0), (30, 1000, 0, 20.0), (30, 1000, 4 * MS, 20.0), (30, 0, 4 * MS, 33.0),
    (20, 0, 4 * MS, 33.0), (14, 0, 4 * MS, 33.0)], [
        (10, 0, 4 * MS, 20.0), (25, 0, 0, 20.0), (30, 0, 4 * MS, 20.0), (30, 0, 4 * MS, 33.0),
        (30, 1000, 4 * MS, 20.0)]))
def test_up_to_max_rate_a_command_finds_its_slot_free(rate, ppm, jitter, resend):
    """15 minutes of a publisher on another machine with a fast clock."""
    gate, now = opened(resend_rate=resend)
    stamps = publisher(now, rate, 900 if ppm else 120, ppm, jitter)
    sent = play(gate, now, stamps[-1] + 30 * MS, [(stamp, DRIVE) for stamp in stamps])
    waits = [stamp - frame.offered for stamp, frame in sent if frame.kind is FrameKind.COMMAND]
    assert len(waits) == len(stamps)
    assert statistics.quantiles(waits, n=20)[-1] <= 3 * MS
    assert statistics.median(waits) <= MS
    assert rate_of_40([stamp for stamp, _ in sent]) <= 1.02 * 30


@pytest.mark.parametrize(('rate', 'resend'), later(
    [(rate, resend) for resend in (0.0, 20.0, 33.0) for rate in (5.0, 20.0, 30.0, 33.0, 33.3)],
    [(5.0, 33.0), (20.0, 20.0), (30.0, 20.0), (33.0, 33.0), (33.3, 0.0)]))
def test_up_to_33_hz_no_publisher_fills_the_queue_of_the_mcu(rate, resend):
    """Streams, floods, pauses and stops in turn; the MCU has room for 10 set-points."""
    gate, now = opened(max_rate=rate, resend_rate=resend)
    mcu = Receiver(now)
    chance = random.Random(int(rate * resend))
    highest = 0
    for _ in range(200):
        period = chance.choice([2, 10, 25, 30, 33, 60, 200]) * MS
        offers = [(now + n * period, chance.choice([DRIVE, DRIVE, DRIVE, STOP]))
                  for n in range(chance.randrange(1, 60))]
        end = offers[-1][0] + chance.choice([0, 40, 70, 1500]) * MS
        for stamp, frame in play(gate, now, end, offers):
            mcu.feed(encode(frame.velocity), stamp)
            mcu.advance(mcu.line_free)
            highest = max(highest, len(mcu._queue))
        now = end + 1
    print(f'highest level of the queue at {rate:g} Hz, resend {resend:g} Hz: {highest}')
    assert mcu.totals.queue_full == 0
    assert highest <= 3
    assert mcu.totals.crc_err == mcu.totals.insufficient == 0


rates = st.sampled_from([2.0, 10.0, 30.0, 33.0, 100.0, 300.0])
gaps = st.lists(st.integers(MS, 120 * MS), min_size=60, max_size=150)


@settings(max_examples=150)
@given(rates, st.sampled_from([0.0, 5.0, 20.0, 33.0]), gaps)
def test_any_40_frames_keep_to_the_rate(rate, resend, gaps):
    gate, now = opened(max_rate=rate, resend_rate=resend, cmd_vel_timeout=0.0)
    offers = [(stamp, DRIVE) for stamp in accumulate(gaps, initial=now)]
    stamps = [stamp for stamp, _ in play(gate, now, offers[-1][0], offers)]
    assert len(stamps) < 40 or rate_of_40(stamps) <= 1.02 * rate


def test_a_command_ends_a_burst_but_never_skips_the_stop():
    gate, now = opened()
    gate.stop(now, Stop.TYPE_SWITCH)
    gate.offer_command(STOP, now)                            # a zero command changes nothing
    gate.offer_command(DRIVE, now)
    sent = play(gate, now, now + 100 * MS)
    assert [frame.kind for _, frame in sent][:2] == [FrameKind.STOP, FrameKind.COMMAND]
    assert sent[0][1] == (STOP, FrameKind.STOP, None)
    assert sent[1][1] == (DRIVE, FrameKind.COMMAND, now)


def test_a_zero_command_while_driving_is_a_burst():
    gate, now = opened(resend_rate=0.0)
    offers = [(now, DRIVE), (now + 100 * MS, STOP)]
    sent = play(gate, now, now + NS_PER_S, offers)
    assert_burst(stops_of(sent))
    assert sent[1][1].offered == now + 100 * MS
    assert gate.counters.stops[Stop.COMMAND] == 1
    assert gate.counters.time_outs == 0


def test_disabled_means_zeros_and_refusals():
    gate, now = opened()
    gate.offer_command(DRIVE, now)
    gate.enable(False, now)
    assert gate.offer_command(DRIVE, now + MS) is Outcome.DISABLED
    sent = play(gate, now, now + NS_PER_S)
    assert_burst(stops_of(sent))
    assert all(frame.velocity == STOP for _, frame in sent)
    gate.enable(True, now + NS_PER_S)
    assert not gate.driving
    assert gate.offer_command(DRIVE, now + NS_PER_S) is Outcome.ACCEPTED


def test_shutdown_refuses_from_then_on():
    gate, now = opened()
    gate.stop(now, Stop.SHUTDOWN)
    assert gate.offer_command(DRIVE, now) is Outcome.SHUTDOWN
    assert_burst(stops_of(play(gate, now, now + NS_PER_S)))


def test_after_a_freeze_what_waited_is_refused():
    gate, now = opened()
    gate.offer_command(DRIVE, now)
    gate.stop(now, Stop.FROZEN)
    assert gate.offer_command(DRIVE, now + 199 * MS) is Outcome.FROZEN
    assert gate.offer_command(DRIVE, now + 200 * MS) is Outcome.ACCEPTED


def test_settings_change_while_driving():
    gate, now = opened()
    gate.offer_command(DRIVE, now)
    gate.settings = gate.settings._replace(cmd_vel_timeout=0.1)
    gate.next_frame(now + 100 * MS)
    assert gate.counters.time_outs == 1
    gate.settings = gate.settings._replace(max_linear_x=0.25)
    gate.offer_command(DRIVE, now + 200 * MS)
    assert gate.velocity == Vel2d(0.25, -0.125, 0.5)
    assert gate.counters.limited == 1


@pytest.mark.parametrize('rate', [20.0, 0.0])
def test_a_lower_limit_holds_at_once_and_a_higher_one_from_the_next_command_on(rate):
    gate, now = opened(resend_rate=rate)
    sent = play(gate, now, now + 36 * MS, [(now, DRIVE)])
    assert sent[-1][1].velocity == DRIVE
    now += 36 * MS
    gate.settings = gate.settings._replace(max_linear_x=DRIVE.x / 2)
    slower = Vel2d(DRIVE.x / 2, DRIVE.y / 2, DRIVE.omega / 2)
    assert gate.next_deadline(now) == now
    assert [frame.velocity for _, frame in play(gate, now, now + 10 * MS)] == [slower]
    gate.settings = gate.settings._replace(max_linear_x=0.0)
    assert {frame.velocity for _, frame in play(gate, now + 10 * MS, now + 200 * MS)} <= {slower}


finite = st.floats(allow_nan=False, allow_infinity=False)
velocities = st.builds(Vel2d, finite, finite, finite)
bounds = st.one_of(st.just(0.0), st.floats(1e-6, 1e6))


@settings(max_examples=500)
@given(velocities, st.builds(Vel2d, bounds, bounds, bounds))
def test_limit_keeps_the_direction(velocity, limits):
    limited = limit(velocity, limits)
    assert all(map(math.isfinite, limited))
    for part, before, bound in zip(limited, velocity, limits, strict=True):
        assert not bound or abs(part) <= bound
        assert abs(part) <= abs(before)
        assert part == 0.0 or math.copysign(1.0, part) == math.copysign(1.0, before)
    biggest = max(map(abs, velocity))
    longest = max(map(abs, limited))
    for part, before in zip(limited, velocity, strict=True):
        if biggest and longest > 1e-300:
            assert part / longest == pytest.approx(before / biggest, rel=1e-9, abs=1e-12)


@pytest.mark.parametrize('longer', [10.0, 0.0])
@pytest.mark.parametrize('after', [100 * MS, 600 * MS])
def test_a_longer_time_out_counts_from_the_next_command_on(longer, after):
    gate, now = opened()
    gate.offer_command(DRIVE, now)
    gate.settings = gate.settings._replace(cmd_vel_timeout=longer)
    if after < 500 * MS:
        assert gate.next_frame(now + 499 * MS).velocity == DRIVE
    gate.next_frame(now + max(after, 500 * MS))
    assert gate.counters.time_outs == 1
    assert not gate.driving
    gate.offer_command(DRIVE, now + 700 * MS)
    gate.next_frame(now + 5 * NS_PER_S)
    assert gate.driving


def test_a_suspend_of_the_machine_is_no_step_of_the_clock():
    """Its message was received before, and its wait is known: the time since boot went on too."""
    clock = WallClock()
    clock.observe(1000 * NS_PER_S, NS_PER_S)
    asleep = 3600 * NS_PER_S
    assert clock.waited(1000 * NS_PER_S, 1000 * NS_PER_S + asleep, NS_PER_S + asleep) == asleep


def test_wall_clock_tells_waiting_and_survives_steps():
    clock = WallClock()
    assert clock.waited(1000 * NS_PER_S, 1000 * NS_PER_S + 3 * MS, NS_PER_S) == 3 * MS
    assert clock.waited(0, 1000 * NS_PER_S, NS_PER_S) == 0
    stepped = 5000 * NS_PER_S
    assert clock.waited(1001 * NS_PER_S, stepped, 2 * NS_PER_S) == 0  # received before the step
    late = clock.waited(stepped + 3 * NS_PER_S, stepped + 4 * NS_PER_S, 6 * NS_PER_S)
    assert late == NS_PER_S
    assert clock.waited(stepped + 5 * NS_PER_S, 900 * NS_PER_S, 7 * NS_PER_S) == 0


# --- figures and counters, exactly ---

def test_a_burst_is_six_zeros_50_ms_apart_30_ms_behind_the_last_frame():
    gate, now = opened()
    gate.offer_command(DRIVE, now)
    [(begin, _)] = play(gate, now, now)
    gate.stop(now + MS, Stop.DISABLED)
    stops = stops_of(play(gate, now + MS, now + 290 * MS))
    assert [stamp - begin for stamp in stops] == [(30 + 50 * n) * MS for n in range(6)]


def test_it_is_stopping_until_the_last_zero_is_out():
    """A process that is to be suspended waits for that."""
    gate, now = opened(resend_rate=0.0)
    gate.stop(now, Stop.SUSPEND)
    last = now + 250 * MS
    play(gate, now, last - 1)
    assert gate.stopping
    play(gate, last, last)
    assert not gate.stopping


def test_a_command_behind_the_time_out_finds_it_noticed():
    """Without a look in between the stop comes first all the same."""
    gate, now = opened()
    gate.offer_command(DRIVE, now)
    play(gate, now, now + MS)
    late = now + 500 * MS
    gate.offer_command(OTHER, late)
    assert gate.counters.time_outs == gate.counters.stops[Stop.TIME_OUT] == 1
    assert gate.next_frame(late).velocity == STOP


def test_a_command_that_a_stop_overtakes_is_replaced():
    gate, now = opened()
    gate.offer_command(DRIVE, now)
    gate.stop(now, Stop.TYPE_SWITCH)
    assert gate.counters.replaced == 1
    gate.stop(now, Stop.TYPE_SWITCH)
    assert gate.counters.replaced == 1


def test_after_a_freeze_the_line_has_its_gap_first():
    gate, now = opened()
    now += 40 * MS
    gate.stop(now, Stop.FROZEN)
    assert gate.next_frame(now) is None
    assert gate.next_frame(now + 3 * MS).velocity == STOP


def test_enabling_and_disabling_again_is_no_news():
    gate, now = opened()
    gate.enable(True, now)
    gate.enable(False, now)
    gate.enable(False, now)
    assert gate.counters.stops[Stop.DISABLED] == 1
    gate.enable(True, now)
    assert gate.counters.stops[Stop.DISABLED] == 1


def test_closed_again_it_writes_and_takes_nothing():
    gate, now = opened()
    gate.offer_command(DRIVE, now)
    gate.stop(now, Stop.TYPE_SWITCH)
    gate.closed()
    assert not gate.is_open
    assert not gate.stopping
    assert gate.next_frame(now + NS_PER_S) is None
    assert gate.next_deadline(now) == NEVER
    assert gate.offer_command(DRIVE, now) is Outcome.NO_PORT


@pytest.mark.parametrize(('age_s', 'limit_s', 'verdict'), [
    (-5, 0, Outcome.ACCEPTED), (5, 0, Outcome.ACCEPTED), (-5, 5, Outcome.ACCEPTED),
    (5, 5, Outcome.ACCEPTED), (-5, 4.999, Outcome.STAMP_AHEAD), (5, 4.999, Outcome.STAMP_OLD)])
def test_stamps_are_judged_on_both_sides(age_s, limit_s, verdict):
    gate, now = opened(max_stamp_age=float(limit_s))
    assert gate.offer_command(DRIVE, now, stamp_age=age_s * NS_PER_S) is verdict


def test_a_freeze_that_is_noticed_late_does_not_shorten_what_a_suspension_refuses():
    gate, now = opened()
    gate.stop(now, Stop.SUSPEND)
    gate.stop(now + 50 * MS, Stop.FROZEN)
    assert gate.offer_command(DRIVE, now + NS_PER_S - 1) is Outcome.FROZEN


def test_what_nobody_sets_is_as_the_parameters_say():
    defaults = {parameter.name: parameter.default for parameter in PARAMETERS}
    assert GateSettings()._asdict() == {name: defaults[name] for name in GateSettings._fields}


def test_opening_leaves_a_gap_behind_who_wrote_last():
    gate = Gate()
    gate.opened(START)
    gap = characters_ns(FRAME_SIZE + 2, 115200)
    assert gate.next_deadline(START) == START + gap
    assert gate.next_frame(START + gap - 1) is None
    assert gate.next_frame(START + gap) == (STOP, FrameKind.STOP, None)


def test_a_zero_command_during_a_burst_is_that_burst():
    """It waits for nothing of its own: no latency, and nothing is replaced by the next."""
    gate, now = opened()
    gate.stop(now, Stop.TYPE_SWITCH)
    gate.offer_command(STOP, now)
    assert gate.next_frame(now) == (STOP, FrameKind.STOP, None)
    gate.offer_command(STOP, now)
    assert (gate.counters.accepted, gate.counters.replaced) == (2, 0)
    assert gate.counters.stops[Stop.COMMAND] == 0


@pytest.mark.parametrize('frames', range(1, BURST_FRAMES + 1))
def test_a_burst_delays_the_next_command_by_one_interval_at_most(frames):
    gate, now = opened(max_rate=2.0, resend_rate=0.0, cmd_vel_timeout=2.0)
    gate.stop(now, Stop.TYPE_SWITCH)
    stops = stops_of(play(gate, now, now + 50 * (frames - 1) * MS))
    assert len(stops) == frames
    sent = play(gate, stops[-1], stops[-1] + NS_PER_S, [(stops[-1], DRIVE)])
    assert sent[0][1] == (DRIVE, FrameKind.COMMAND, stops[-1])
    assert 480 * MS <= sent[0][0] - stops[-1] <= 500 * MS


@pytest.mark.parametrize(('velocity', 'limits'), [
    (Vel2d(-1.2, -1.2, 1.5), Vel2d(0.3, 0.2, 0.8)),
    (Vel2d(0.9, -1.7, 1.3), Vel2d(0.5, 0.7, 0.2)),
    (Vel2d(0.6, 1.6, 1.1), Vel2d(0.5, 0.8, 0.4)),
])
def test_no_rounding_carries_a_velocity_over_its_limit(velocity, limits):
    assert all(abs(part) <= bound
               for part, bound in zip(limit(velocity, limits), limits, strict=True))


def test_what_is_inside_the_limits_is_not_rounded():
    velocity = Vel2d(-0.45, -0.32, -1.25)            # not the same after / 1.25 * 1.25
    gate, now = opened(max_linear_x=5.0, max_linear_y=5.0, max_angular_z=5.0)
    gate.offer_command(velocity, now)
    assert gate.next_frame(now).velocity == velocity
    assert gate.counters.limited == 0


def test_a_command_behind_a_resend_goes_out_after_the_gap():
    gate, now = opened()
    gate.offer_command(DRIVE, now)
    resent = play(gate, now, now + 75 * MS)[-1]
    assert resent == (now + 75 * MS, (DRIVE, FrameKind.RESEND, None))
    gate.offer_command(OTHER, resent[0])
    gap = characters_ns(FRAME_SIZE + 2, 115200)
    assert gate.next_frame(resent[0] + gap - 1) is None
    assert gate.next_frame(resent[0] + gap) == (OTHER, FrameKind.COMMAND, resent[0])
