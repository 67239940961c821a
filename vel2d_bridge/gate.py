# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""
Gate: which velocity goes to the MCU next, and when.

It refuses, limits and times out commands, and paces frames: newer commands replace older ones,
the set-point is resent, a stop is a burst. Pure: no IO, no lock, no clock; `now` is monotonic ns.
A refused command never touches the time-out. The figures of the burst follow from the MCU's
queue (10 set-points, one taken per 30 ms, the newest dropped when full).
"""

from collections import Counter
from enum import Enum
import math
from typing import NamedTuple

from msg_defs.nanoseconds import NS_PER_MS
from msg_defs.nanoseconds import NS_PER_S
from msg_defs.vel2d import FRAME_SIZE
from msg_defs.vel2d import STOP
from msg_defs.vel2d import Vel2d

NEVER = 2**63 - 1
CHARACTER_BITS = 10                # start, 8 data, stop
GAP_CHARACTERS = 2                 # the MCU realigns after one idle character; one is for slack

BURST_FRAMES = 6                   # one more than needed: the last may be late at the reader
BURST_PERIOD = 50 * NS_PER_MS      # 5 frames in this distance got through a full queue, always
STOP_GAP = 30 * NS_PER_MS          # the MCU takes one set-point in that time
LARGEST = 1e6                      # m/s, rad/s: an MCU that multiplies it does not overflow
SETTLE = 200 * NS_PER_MS           # after a freeze, for what waited in the sockets

# The rate: slots a little closer than 1 / max_rate, and a frame may take its slot a little early.
# So a publisher at max_rate with a clock 0.1 % fast and a varying period finds its slot free,
# and 40 frames together still keep to 1.02 x max_rate.
SLOTS_PER_COMMAND = 1.012
EARLY_SLOTS = 0.3
EARLY_MOST = 10 * NS_PER_MS
MCU_PERIOD = 30_030_000            # a slot this long never fills the MCU's queue: 33.3 Hz
MCU_RATE = 33.3


class Outcome(Enum):
    """What became of an offered command; the value is the reason as shown to the user."""

    ACCEPTED = 'accepted'
    NOT_FINITE = 'not finite'
    TOO_LARGE = 'larger than 1e6'
    DISABLED = 'disabled'
    NO_PORT = 'port not open'
    FROZEN = 'bridge was frozen'
    WAITED = 'waited too long'
    STAMP_OLD = 'stamp too old'
    STAMP_AHEAD = 'stamp in the future'
    SHUTDOWN = 'shutting down'


class Stop(Enum):
    """Why a stop burst began."""

    OPENING = 'port opened'
    TIME_OUT = 'time-out'
    COMMAND = 'zero command'
    DISABLED = 'disabled'
    TYPE_SWITCH = 'message type switched'
    WRITE = 'write timed out'
    FROZEN = 'bridge was frozen'
    SUSPEND = 'suspended'
    SHUTDOWN = 'shutdown'


class FrameKind(Enum):
    """Why a frame is written."""

    COMMAND = 'command'
    RESEND = 'resend'
    STOP = 'stop'


class Frame(NamedTuple):
    """One frame that is due; `offered` is when its command came in (COMMAND only)."""

    velocity: Vel2d
    kind: FrameKind
    offered: int | None


class GateSettings(NamedTuple):
    """What may change while driving: names, units (s, Hz, m/s, rad/s) and 0 as the parameters."""

    cmd_vel_timeout: float = 0.5
    resend_rate: float = 20.0
    max_rate: float = 30.0
    max_linear_x: float = 0.0
    max_linear_y: float = 0.0
    max_angular_z: float = 0.0
    max_stamp_age: float = 0.0


class Counters:
    """Since start; `refused` by Outcome, `stops` by Stop, every key there from the beginning."""

    __slots__ = ('accepted', 'limited', 'received', 'refused', 'replaced', 'stops', 'time_outs')

    def __init__(self) -> None:
        self.received = self.accepted = self.limited = self.replaced = self.time_outs = 0
        self.refused: Counter[Outcome] = Counter(dict.fromkeys(Outcome, 0))
        self.stops: Counter[Stop] = Counter(dict.fromkeys(Stop, 0))


def characters_ns(count: int, baud: int) -> int:
    """Time on the wire of so many characters, rounded up."""
    return -(-count * CHARACTER_BITS * NS_PER_S // baud)


class Gate:
    """Commands in, due frames out. The owner serialises the calls."""

    def __init__(self, settings: GateSettings | None = None, *, baud: int = 115200,
                 enabled: bool = True) -> None:
        self.counters = Counters()
        self.velocity = STOP                         # the set-point
        self.enabled = enabled
        self.is_open = False
        self.is_shut = False
        self._spacing = characters_ns(FRAME_SIZE + GAP_CHARACTERS, baud)
        self._accepted_at: int | None = None         # None once that command has expired
        self._expires_at = NEVER
        self._offered_at: int | None = None          # time of a command that is not written yet
        self._burst_zeros_left = 0
        self._burst_began = False                    # by writing its first zero
        self._last_frame_at = -NS_PER_S
        self._slot_begins_at = 0                     # the next slot of the rate
        self._last_kind = FrameKind.STOP
        self._hold_until = 0                         # writing nothing
        self._refuse_until = 0                       # refusing commands
        self._lowered_not_sent = False               # a limit lowered the set-point
        self.settings = settings or GateSettings()

    @property
    def settings(self) -> GateSettings:
        return self._settings

    @settings.setter
    def settings(self, settings: GateSettings) -> None:
        """Take effect at once; but a longer time-out counts from the next command on."""
        self._settings = settings
        self._timeout = round(settings.cmd_vel_timeout * NS_PER_S)
        if self._accepted_at is not None:
            self._expires_at = min(self._expires_at, self._expiry_of(self._accepted_at))
        slot = math.ceil(NS_PER_S / (SLOTS_PER_COMMAND * settings.max_rate))
        if settings.max_rate <= MCU_RATE:
            slot = max(slot, MCU_PERIOD)
        self._interval = max(slot, self._spacing)
        self._early = min(round(EARLY_SLOTS * self._interval), EARLY_MOST)
        rate = settings.resend_rate                  # never so fast that it fills the MCU's queue
        self._resend = max(math.ceil(NS_PER_S / rate), self._interval, STOP_GAP) if rate > 0 else 0
        self._limits = Vel2d(
            settings.max_linear_x, settings.max_linear_y, settings.max_angular_z)
        before, self.velocity = self.velocity, limit(self.velocity, self._limits)
        self._lowered_not_sent |= self.velocity != before

    @property
    def driving(self) -> bool:
        return self.velocity != STOP

    @property
    def stopping(self) -> bool:
        """Whether zeros of a stop burst are still to be written."""
        return self._burst_zeros_left > 0

    def offer_command(
            self, velocity: Vel2d, now: int, *,
            waited: int = 0, stamp_age: int | None = None) -> Outcome:
        """Judge a command; `waited` ns in the middleware, `stamp_age` ns (None: no stamp)."""
        self._expire(now)
        self.counters.received += 1
        verdict = self._judge(velocity, now, waited, stamp_age)
        if verdict is Outcome.ACCEPTED:
            self._accept(velocity, now)
        else:
            self.counters.refused[verdict] += 1
        return verdict

    def _judge(
            self, velocity: Vel2d, now: int, waited: int, stamp_age: int | None) -> Outcome:
        oldest = round(self._settings.max_stamp_age * NS_PER_S)
        reasons = (
            (not all(map(math.isfinite, velocity)), Outcome.NOT_FINITE),
            (max(map(abs, velocity)) > LARGEST, Outcome.TOO_LARGE),
            (self.is_shut, Outcome.SHUTDOWN),
            (not self.enabled, Outcome.DISABLED),
            (not self.is_open, Outcome.NO_PORT),
            (now < self._refuse_until, Outcome.FROZEN),
            (0 < self._timeout < waited, Outcome.WAITED),
            (stamp_age is not None and 0 < oldest < stamp_age, Outcome.STAMP_OLD),
            (stamp_age is not None and 0 < oldest < -stamp_age, Outcome.STAMP_AHEAD),
        )
        return next((verdict for wrong, verdict in reasons if wrong), Outcome.ACCEPTED)

    def _accept(self, velocity: Vel2d, now: int) -> None:
        self.counters.accepted += 1
        self.counters.replaced += self._offered_at is not None
        limited = limit(velocity, self._limits)
        self.counters.limited += limited != velocity
        was_driving, self.velocity = self.driving, limited
        self._accepted_at = self._offered_at = now
        self._expires_at = self._expiry_of(now)
        if self.driving:
            # A stop is never skipped.
            self._burst_zeros_left = int(self.stopping and not self._burst_began)
        elif was_driving:
            self._begin_burst(Stop.COMMAND)
        elif self._burst_zeros_left:
            self._offered_at = None                       # the zeros of the burst are this command

    def stop(self, now: int, why: Stop) -> None:
        """Forget the command and begin a stop burst; driving again takes a new command."""
        self.counters.replaced += self._offered_at is not None
        self._forget()
        self.is_shut |= why is Stop.SHUTDOWN
        if why is Stop.FROZEN:
            self._refuse_until = max(self._refuse_until, now + SETTLE)
            self.hold(now + self._spacing)           # the deadman may just be writing
        if why is Stop.SUSPEND:                      # no command cuts its burst short
            self._refuse_until = now + NS_PER_S
        self._begin_burst(why)

    def _begin_burst(self, why: Stop) -> None:
        self.counters.stops[why] += 1
        self._burst_zeros_left = BURST_FRAMES if self.is_open else 0
        self._burst_began = False

    def enable(self, on: bool, now: int) -> None:
        """Off: stop, and refuse commands until it is on again; zeros go on."""
        if self.enabled and not on:
            self.stop(now, Stop.DISABLED)
        self.enabled = on

    def opened(self, now: int) -> None:
        """Begin with a stop burst, after a gap: who wrote last on this line is unknown."""
        self.is_open = True
        self.hold(now + self._spacing)
        self.stop(now, Stop.OPENING)

    def closed(self) -> None:
        self.is_open = False
        self._forget()
        self._burst_zeros_left = 0

    def _forget(self) -> None:
        self.velocity = STOP
        self._accepted_at = self._offered_at = None

    def hold(self, until: int) -> None:
        """Let nothing be written before `until`: the line needs its gap."""
        self._hold_until = max(self._hold_until, until)

    def next_frame(self, now: int) -> Frame | None:
        """Return the frame that is due, the newest command; say `sent` once it is written."""
        self._expire(now)
        if now < self._due():
            return None
        kind = self._kind()
        if kind is FrameKind.STOP:
            return Frame(STOP, kind, None if self.driving else self._offered_at)
        return Frame(self.velocity, kind, self._offered_at)

    def sent(self, now: int) -> None:
        """Take note that the due frame was written, `now` being the end of the write."""
        self._last_frame_at = now
        slot = max(now, self._slot_begins_at)
        if self._burst_zeros_left:  # a burst costs the next command one slot
            slot = min(slot, now + self._early)
        self._slot_begins_at = slot + self._interval
        self._last_kind = self._kind()
        self._lowered_not_sent = False
        if not (self._burst_zeros_left and self.driving):
            self._offered_at = None
        self._burst_began = self._burst_zeros_left > 0
        self._burst_zeros_left -= self._burst_began
        self.hold(now + self._spacing)

    def next_deadline(self, now: int) -> int:
        """Return when the next frame or time-out is due (NEVER when none is), `now` or later."""
        return max(now, min(self._due(), self._expiry()))

    def _due(self) -> int:
        if not self.is_open:
            return NEVER
        kind = self._kind()
        if kind is FrameKind.STOP:
            due = self._last_frame_at + (BURST_PERIOD if self._burst_began else STOP_GAP)
        elif kind is FrameKind.COMMAND:                   # a resend used a slot that was left over
            due = (self._last_frame_at if self._last_kind is FrameKind.RESEND
                   else self._slot_begins_at - self._early)
        elif self._lowered_not_sent:
            due = self._slot_begins_at
        elif self._resend:
            due = self._resend_due()
        else:
            return NEVER
        return max(due, self._hold_until)

    def _resend_due(self) -> int:
        """
        Return when the set-point is sent again.

        After a command later, and only once a whole slot has passed unused: the next command must
        find its slot free.
        """
        if self._last_kind is FrameKind.COMMAND:
            return max(self._last_frame_at + self._resend + self._resend // 2,
                       self._slot_begins_at + self._interval)
        return max(self._last_frame_at + self._resend, self._slot_begins_at)

    def _kind(self) -> FrameKind:
        """Return what the next frame is."""
        if self._burst_zeros_left:
            return FrameKind.STOP
        return FrameKind.RESEND if self._offered_at is None else FrameKind.COMMAND

    def _expiry_of(self, accepted: int) -> int:
        return accepted + self._timeout if self._timeout else NEVER

    def _expiry(self) -> int:
        return NEVER if self._accepted_at is None or not self.driving else self._expires_at

    def _expire(self, now: int) -> None:
        if now >= self._expiry():
            self.counters.time_outs += 1
            self.stop(now, Stop.TIME_OUT)


def limit(velocity: Vel2d, limits: Vel2d) -> Vel2d:
    """Scale a finite velocity by one factor into the limits (0 = none): the direction stays."""
    biggest = max(map(abs, velocity))
    if biggest == 0.0:
        return velocity
    unit = [part / biggest for part in velocity]     # first, as no product may overflow
    length = min([biggest] + [
        bound / abs(part) for part, bound in zip(unit, limits, strict=True)
        if bound > 0.0 and abs(part) > 0.0])
    if length == biggest:
        return velocity
    return Vel2d(*(
        max(-bound, min(bound, part * length)) if bound > 0.0 else part * length
        for part, bound in zip(unit, limits, strict=True)))
