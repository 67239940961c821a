# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""
The safety property of the bridge, over random histories in simulated time.

The wheels never turn longer than cmd_vel_timeout + 2 / resend_rate + write_timeout + 300 ms (the
MCU's queue) after the last accepted command. Where the cable was lost, that counts from its
return, and 0.5 s are added in which the bridge looks for it. Real: gate, pacer, frames, receiver.
Simulated: the UART, the clockwork of link and dead man (test_link.py, test_deadman.py), and
everything that goes wrong. Assumptions: no two damaged frames in a row, no stall longer than
write_timeout, 19200 baud or more, cmd_vel_timeout and resend_rate not 0.
"""
from collections import deque
from itertools import pairwise
import math
import random

from harness import later
import pytest

from mecarover_fakes.receiver import Receiver
from msg_defs.nanoseconds import NS_PER_S
from msg_defs.vel2d import encode
from msg_defs.vel2d import FRAME_SIZE
from msg_defs.vel2d import STOP
from msg_defs.vel2d import Vel2d
from vel2d_bridge import deadman_process
from vel2d_bridge.gate import characters_ns
from vel2d_bridge.gate import Gate
from vel2d_bridge.gate import GateSettings
from vel2d_bridge.gate import NEVER
from vel2d_bridge.gate import NS_PER_MS as MS
from vel2d_bridge.gate import Outcome
from vel2d_bridge.gate import Stop
from vel2d_bridge.pacer import Pacer

FIFO = 16                                            # bytes that a flush does not reach
LATE = 2 * MS                                        # how late the host's thread may wake
QUEUE = 300 * MS
PROLONGED = 600 * MS                                 # how long a longer time-out is set
RETRY = 500 * MS                                     # at most between two looks for a lost port


class Uart:
    """A UART with a kernel buffer, a FIFO, stalls and a lossy cable, on simulated time."""

    def __init__(self, mcu, chance, loss):
        self.mcu = mcu
        self.now = 0
        self.stalled_until = 0
        self.refuses = False                         # during a stall: a full buffer, as on a pty
        self.cut = 0                                 # the next write takes only so many bytes
        self.spoiled = 0                             # frames that arrive damaged
        self._chance = chance
        self._loss = loss
        self._spared = False                         # never two damaged frames in a row
        self._flights = deque()                      # [bytes, start]
        self._free = 0

    def _end(self, flight):
        return flight[1] + len(flight[0]) * self.mcu.character

    def write(self, data):
        if self.refuses and self.now < self.stalled_until:
            return 0
        data, self.cut = data[:self.cut or None], 0
        start = max(self.now, self._free, self.stalled_until)
        self._flights.append([data, start])
        self._free = self._end(self._flights[-1])
        return len(data)

    def pending(self):
        return sum(
            min(len(data), -(-(self._end([data, start]) - self.now) // self.mcu.character))
            for data, start in self._flights if self._end([data, start]) > self.now)

    def drop_output(self):
        for flight in list(self._flights):
            begun = (self.now - flight[1]) // self.mcu.character
            if begun < 0:
                self._flights.remove(flight)
            else:
                flight[0] = flight[0][:begun + FIFO]
        self._free = self._end(self._flights[-1]) if self._flights else self.now

    def hang_up(self):
        """Lose the cable, and what is on it."""
        self._flights.clear()
        self._free = self.now

    def settle(self, now):
        """Let pass what has left the wire by now."""
        self.now = now
        while self._flights and self._end(self._flights[0]) <= now:
            data, start = self._flights.popleft()
            arriving = self._damage(data)
            self.spoiled += len(data) < FRAME_SIZE or bool(arriving and arriving is not data)
            self.mcu.feed(arriving, start)

    def _damage(self, data):
        if self._spared or len(data) < FRAME_SIZE or self._chance.random() >= self._loss:
            self._spared = False
            return data
        self._spared = True
        at = self._chance.randrange(FRAME_SIZE)
        flipped = bytes([data[at] ^ 1 << self._chance.randrange(8)])
        return self._chance.choice([
            b'', data[:at] + data[at + 1:], data[:at] + flipped + data[at + 1:]])


class World:
    """A bridge, its deadman, a UART, an MCU, and a seeded fate."""

    def __init__(self, seed):
        self.chance = chance = random.Random(seed)
        self.settings = GateSettings(
            cmd_vel_timeout=chance.choice([0.05, 0.2, 0.5, 1.0]),
            resend_rate=chance.choice([2.0, 5.0, 20.0, 33.0]),
            max_rate=chance.choice([2.0, 20.0, 30.0, 30.0, 100.0, 400.0]))
        self.write_timeout_s = chance.choice([0.005, 0.05, 0.2])
        self.baud = chance.choice([19200, 57600, 115200, 115200, 1_000_000])
        self.bound = self.bound_of(self.settings)
        self.mcu = Receiver(baud=self.baud)
        self.uart = Uart(self.mcu, chance, chance.choice([0.0, 0.02, 0.5]))
        self.now = 0
        self.accepted = None                         # the last accepted command
        self.back_at = self.reopen_at = NEVER        # the cable; the bridge's port
        self.back = -NS_PER_S                        # when the cable came back last
        self.is_lost = False                         # the port must be opened again
        self.is_owed = False                         # and the rover may have been driving
        self.calm_at = NEVER                         # the settings become what they were
        self.moving = False
        self.longest = 0                             # moving after it, as a share of the bound
        self.frozen_until = 0
        self.resumes = False                         # it was suspended, and will know
        self.beaten = 0
        self.acted = False
        self.zero_at = NEVER                         # the deadman's next zero
        self.zeros_left = 0                          # after a death
        self.pacer = None
        self.wake = self.enable_at = self.thaw_at = self.suspend_at = NEVER
        self.restart_at = 0
        self.waiting = None                          # a command that came during the freeze
        self.plan = self.commands()
        self.command_at = next(self.plan)

    def bound_of(self, settings):
        return round(NS_PER_S * (settings.cmd_vel_timeout + 2 / settings.resend_rate
                               + self.write_timeout_s)) + QUEUE

    @property
    def awake(self):
        return self.pacer is not None and self.now >= self.frozen_until

    def commands(self):
        """Yield when commands come: streams, single ones, floods, silences."""
        at = 400 * MS
        while True:
            period = self.chance.choice([2, 5, 10, 33, 50, 150]) * MS
            for _ in range(self.chance.randrange(1, 40)):
                at += period
                yield at
            at += self.chance.randrange(1500 * MS)

    def start(self):
        if self.back_at != NEVER:
            self.restart_at = self.back_at + self.chance.randrange(RETRY)
            return
        self.is_lost = self.is_owed = False
        gate = Gate(self.settings, baud=self.baud)
        self.pacer = Pacer(gate, lambda: self.now, baud=self.baud,
                           write_timeout_s=self.write_timeout_s)
        self.pacer.attach(self.uart, self.now)
        self.beaten, self.wake, self.restart_at = self.now, self.now, NEVER
        self.zero_at, self.zeros_left, self.acted = NEVER, 0, False

    def run(self, duration, accidents):
        accidents = sorted(accidents)
        while self.now < duration:
            happening = accidents[0][0] if accidents else NEVER
            events = (
                (happening, lambda: getattr(self, accidents.pop(0)[1])()),
                (self.back_at, self.come_back), (self.restart_at, self.start),
                (self.reopen_at, self.reopen), (self.calm_at, self.calm),
                (self.thaw_at, self.thaw), (self.suspend_at, self.suspend_when_idle),
                (self.enable_at, lambda: self.enable(True)), (self.zero_at, self.zero),
                (self.wake, self.turn), (self.command_at, self.command))
            first = min(at for at, _ in events)
            self.now = max(self.now, min(first, self.now + 10 * MS))
            self.look()
            for at, act in events:
                if at <= self.now:
                    act()
                    break

    def look(self):
        """Check the property at every set-point that the MCU has taken by now."""
        self.uart.settle(self.now)
        for set_point in self.mcu.advance(self.now):
            if self.moving and set_point.is_stop:
                self.check(set_point.stamp)
            self.moving = not set_point.is_stop
        if self.moving:
            self.check(self.now)

    def check(self, stamp):
        assert self.accepted is not None, 'moves without a command'
        if self.back_at != NEVER:                    # nothing can reach it
            return
        since, bound = stamp - self.accepted, self.bound
        if self.back > self.accepted:
            since, bound = stamp - self.back, max(bound, RETRY + QUEUE + 60 * MS)
        self.longest = max(self.longest, since / bound)
        assert since <= bound, f'{since / 1e9} s, allowed are {bound / 1e9} s'

    def turn(self):
        acted, self.acted = self.acted, False
        self.beaten = self.now
        wake = self.pacer.turn(self.now, acted)
        self.wake = max(self.now + 1, min(wake, self.now + deadman_process.BEAT)
                        + self.chance.randrange(LATE))

    def command(self):
        self.command_at = next(self.plan)
        speed = self.chance.choice([0.1, 0.5, 0.5, 0.5, 0.0, math.nan, 1e308])
        velocity = Vel2d(speed, self.chance.random() * bool(speed), 0.0)
        if self.now < self.frozen_until:
            self.waiting = velocity
        elif self.pacer is not None:
            self.offer_command(velocity, self.chance.choice([0, 0, 0, 0, 0, 2 * NS_PER_S]))

    def offer_command(self, velocity, waited=0):
        acted, self.acted = self.acted, False
        verdict = self.pacer.offer_command(velocity, self.now, waited=waited, acted=acted)
        if verdict is Outcome.ACCEPTED:
            self.accepted = self.now
            self.bound = self.bound_of(self.settings) + PROLONGED * (self.calm_at != NEVER)
        self.rise(self.pacer.step(self.now))

    def rise(self, wake):
        if self.now >= self.frozen_until:
            self.wake = max(self.now + 1, min(self.wake, wake))

    def zero(self):
        """Be the dead man: one zero after its gap, on a line that it does not share just now."""
        if self.back_at != NEVER:                    # it looks for the port
            self.zero_at = self.now + round(deadman_process.STOP_PERIOD_S * NS_PER_S)
            return
        if not self.uart.pending():
            self.acted = True
            self.uart.write(encode(STOP))
        period = round(deadman_process.STOP_PERIOD_S * NS_PER_S) \
            + deadman_process.GAP_CHARACTERS * self.mcu.character
        self.zeros_left -= 1
        is_over = self.pacer is None and self.zeros_left <= 0
        self.zero_at = NEVER if is_over else self.now + period

    def freeze(self):
        """Freeze the whole bridge; the deadman notices if it takes long."""
        if not self.awake:
            return
        self.frozen_until = self.now + self.chance.randrange(1500 * MS)
        if self.frozen_until - self.beaten > deadman_process.SILENCE and not self.is_off_duty:
            self.zero_at = self.beaten + deadman_process.SILENCE + (
                deadman_process.GAP_CHARACTERS * self.mcu.character)
        self.wake = self.enable_at = NEVER
        self.thaw_at = self.frozen_until

    def suspend(self):
        """SIGTSTP: the burst goes out, then the process stops for a while."""
        if not self.awake or self.suspend_at != NEVER:
            return
        self.pacer.gate.stop(self.now, Stop.SUSPEND)
        self.rise(self.pacer.step(self.now))
        self.suspend_at = self.now + 5 * MS

    def suspend_when_idle(self):
        """As Link.suspend: look every 5 ms whether the burst is out."""
        self.suspend_at = self.now + 5 * MS
        if self.awake and self.pacer.is_idle():
            self.suspend_at = NEVER
            self.freeze()
            self.resumes = True

    def thaw(self):
        """Wake up; callback and thread race for the first move."""
        if self.resumes:
            self.resumes = False
            self.pacer.gate.stop(self.now, Stop.FROZEN)
        self.thaw_at, self.zero_at, self.wake = NEVER, NEVER, self.now
        if self.is_lost:
            self.pacer.detach()
            if self.back_at == NEVER:
                self.reopen_at = self.now + self.chance.randrange(RETRY)
        if not self.pacer.gate.enabled:
            self.enable_at = self.now + 100 * MS
        waiting, self.waiting = self.waiting, None
        if waiting is not None and self.chance.random() < 0.5:
            self.offer_command(waiting)

    def kill(self):
        """Kill -9; the next start comes after the deadman has left."""
        if self.pacer is None:
            return
        self.pacer = self.waiting = None
        self.reopen_at = self.calm_at = NEVER
        self.resumes = False
        self.wake = self.enable_at = self.thaw_at = self.suspend_at = NEVER
        self.frozen_until = self.now
        if not self.is_off_duty:
            self.zero_at = self.now + deadman_process.GAP_CHARACTERS * self.mcu.character
        self.zeros_left = deadman_process.STOP_FRAMES
        self.restart_at = self.now + NS_PER_S

    @property
    def is_off_duty(self):
        """Whether the dead man has no port, and none to look for."""
        return self.is_lost and not self.is_owed

    def lose(self):
        """Unplug the cable for a while; the rover goes on as it was told last."""
        if self.back_at != NEVER:
            return
        gate = self.pacer and self.pacer.gate
        self.is_owed |= not self.awake or gate.driving or gate.stopping
        self.is_lost = True
        self.uart.hang_up()
        self.back_at, self.reopen_at = self.now + self.chance.randrange(1500 * MS), NEVER
        if self.awake:
            self.pacer.detach()

    def come_back(self):
        self.back_at, self.back = NEVER, self.now
        if self.awake:
            self.reopen_at = self.now + self.chance.randrange(RETRY)

    def reopen(self):
        self.reopen_at = NEVER
        if self.awake:
            self.is_lost = self.is_owed = False
            self.pacer.attach(self.uart, self.now)
            self.rise(self.pacer.step(self.now))

    def prolong(self):
        """Raise the time-out while a command runs, which must not run on for it."""
        if self.awake:
            self.pacer.gate.settings = self.settings._replace(
                cmd_vel_timeout=self.chance.choice([0.0, 2.0, 10.0]))
            self.calm_at = self.now + self.chance.randrange(PROLONGED)

    def calm(self):
        self.calm_at = NEVER
        if self.pacer is not None:
            self.pacer.gate.settings = self.settings

    def stall(self):
        """Stall the line, for no longer than a write may take."""
        self.uart.refuses = self.chance.random() < 0.5
        self.uart.stalled_until = self.now + round(
            self.chance.random() * self.write_timeout_s * NS_PER_S)

    def cut(self):
        self.uart.cut = self.chance.randrange(1, FRAME_SIZE)

    def disable(self):
        if self.awake:
            self.enable(False)
            self.enable_at = self.now + 300 * MS

    def enable(self, on):
        self.enable_at = NEVER
        self.pacer.gate.enable(on, self.now)
        self.rise(self.pacer.step(self.now))

    def switch(self):
        if self.awake:
            self.pacer.gate.stop(self.now, Stop.TYPE_SWITCH)
            self.rise(self.pacer.step(self.now))


ACCIDENTS = ('freeze', 'kill', 'stall', 'stall', 'cut', 'disable', 'switch', 'suspend', 'lose',
             'lose', 'prolong')


def history(seed, duration=4 * NS_PER_S):
    """Run one history and return its world; accidents are at least 700 ms apart."""
    world = World(seed)
    accidents = []
    at = 0
    while (at := at + 700 * MS + world.chance.randrange(1500 * MS)) < duration:
        accidents.append((at, world.chance.choice(ACCIDENTS)))
    try:
        world.run(duration, accidents)
    except AssertionError as error:
        raise AssertionError(f'history({seed}): {error}; {accidents}; {world.settings}') from error
    return world


FIRST_HISTORIES = 500                  # what scripts/test plays of them


def check_histories(seeds):
    longest, accepted, spoiled = 0.0, 0, 0
    for seed in seeds:
        world = history(seed)
        totals = world.mcu.totals
        assert totals.insufficient + totals.crc_err == world.uart.spoiled, f'history({seed})'
        longest = max(longest, world.longest)
        accepted += world.accepted is not None
        spoiled += world.uart.spoiled
    assert longest > 0.8, 'the histories do not come near the bound: they test little'
    assert accepted > 0.9 * len(seeds)
    assert spoiled > len(seeds)


@pytest.mark.parametrize('is_rest', later([False, True], 1))
def test_wheels_never_turn_longer_than_allowed(is_rest, request):
    count = request.config.getoption('--histories')
    check_histories(range(count if is_rest else min(count, FIRST_HISTORIES)))


def drive(seed=1, period=33 * MS, **changes):
    """Return a world without accidents that has driven for a while, 115200 baud."""
    world = World(seed)
    world.settings = GateSettings(**changes)
    world.write_timeout_s, world.baud = 0.05, 115200
    world.mcu = Receiver()
    world.uart = Uart(world.mcu, world.chance, 0.0)
    world.plan = iter(range(NS_PER_S, 1000 * NS_PER_S, period))
    world.command_at = next(world.plan)
    world.chance.choice = lambda options: options[0]
    world.bound = NS_PER_S
    world.run(2 * NS_PER_S, [])
    assert world.moving
    return world


def stopped_after(world, since):
    """Run on until the wheels hold zero and return how long that took since `since`."""
    while world.moving:
        world.run(world.now + MS, [])
    return world.mcu.wheels.stamp - since


@pytest.mark.parametrize('accident', ['kill', 'freeze'])
@pytest.mark.parametrize('offset', range(0, 100, 7))
def test_killed_or_frozen_the_rover_stops_within_300_ms(accident, offset):
    world = drive()
    world.run(world.now + offset * MS, [])
    world.chance.randrange = lambda *_: 1400 * MS
    since = world.now
    getattr(world, accident)()
    assert stopped_after(world, since) <= 300 * MS


@pytest.mark.parametrize('accident', ['kill', 'freeze'])
@pytest.mark.parametrize('rate', [34.0, 100.0, 400.0])
def test_with_more_frames_than_the_mcu_takes_it_is_400_ms(accident, rate):
    """Ten set-points wait in the MCU's queue then, the stop behind them."""
    longest = 0
    for offset in range(0, 100, 7):
        world = drive(period=2 * MS, max_rate=rate)
        world.run(world.now + offset * MS, [])
        world.chance.randrange = lambda *_: 1400 * MS
        since = world.now
        getattr(world, accident)()
        longest = max(longest, stopped_after(world, since))
    assert longest <= 400 * MS
    assert longest > 300 * MS or rate == 34.0 or accident == 'freeze'


def test_suspended_it_stops_first_whatever_comes_meanwhile():
    """Without a deadman too: no command may cut the burst short."""
    world = drive(max_rate=400.0)
    world.plan = iter(range(world.now, 1000 * NS_PER_S, 3 * MS))
    world.chance.randrange = lambda end: 1400 * MS if end == 1500 * MS else 0
    since = world.now
    world.suspend()
    world.zero = lambda: setattr(world, 'zero_at', NEVER)
    assert stopped_after(world, since) <= 300 * MS
    world.run(since + 1000 * MS, [])
    assert world.frozen_until > world.now
    assert not world.moving


def test_what_waited_during_a_freeze_does_not_drive():
    world = drive()
    world.chance.randrange = lambda *_: 1000 * MS
    world.chance.random = lambda: 0.0                # the callback wins the race
    world.freeze()
    world.chance.randrange = lambda *_: 0
    world.run(world.now + 1000 * MS, [])
    world.run(world.now + 190 * MS, [])
    assert world.pacer.freezes == 1
    assert not world.moving
    world.run(world.now + 200 * MS, [])
    assert world.moving                              # by new commands


def test_frames_are_never_closer_than_a_gap():
    for seed in range(400):
        world = history(seed)
        ends = [arrival.stamp for arrival in world.mcu.arrivals if arrival.size == FRAME_SIZE]
        closest = characters_ns(FRAME_SIZE + 2, world.baud) - FRAME_SIZE     # rounding
        assert all(after - before >= closest for before, after in pairwise(ends))


def test_after_a_freeze_the_stop_that_the_dead_man_is_just_sending_is_not_cut():
    """It is pending, and the last frame of the bridge was long ago: that is no stuck line."""
    world = drive()
    world.command_at = NEVER
    world.chance.randrange = lambda *_: 205 * MS
    world.freeze()
    while world.zero_at != NEVER and not world.uart.pending():
        world.run(world.now + 100_000, [])
    world.thaw()
    world.turn()
    assert world.pacer.time_outs == 0
    world.run(world.now + 100 * MS, [])
    assert world.mcu.totals.insufficient == 0
    assert not world.moving
