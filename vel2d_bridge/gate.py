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

from msg_defs.vel2d import FRAME_SIZE
from msg_defs.vel2d import STOP
from msg_defs.vel2d import Vel2d
from vel2d_bridge.limit import limit

SECOND = 1_000_000_000
MILLISECOND = 1_000_000
NEVER = 2**63 - 1
CHARACTER_BITS = 10                # start, 8 data, stop
GAP_CHARACTERS = 2                 # the MCU realigns after one idle character; one is for slack

BURST_FRAMES = 6                   # one more than needed: the last may be late at the reader
BURST_PERIOD = 50 * MILLISECOND    # 5 frames in this distance got through a full queue, always
STOP_GAP = 30 * MILLISECOND        # the MCU takes one set-point in that time
SETTLE = 200 * MILLISECOND         # after a freeze, for what waited in the sockets


class Verdict(Enum):
    """What became of an offered command; the value is the reason as shown to the user."""

    ACCEPTED = 'accepted'
    NOT_FINITE = 'not finite'
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


class Kind(Enum):
    """Why a frame is written."""

    COMMAND = 'command'
    RESEND = 'resend'
    STOP = 'stop'


class Frame(NamedTuple):
    """One frame that is due; `offered` is when its command came in (COMMAND only)."""

    velocity: Vel2d
    kind: Kind
    offered: int | None


class Settings(NamedTuple):
    """What may change while driving: names, units (s, Hz, m/s, rad/s) and 0 as the parameters."""

    cmd_vel_timeout: float = 0.5
    resend_rate: float = 20.0
    max_rate: float = 30.0
    max_linear_x: float = 0.0
    max_linear_y: float = 0.0
    max_angular_z: float = 0.0
    max_stamp_age: float = 0.0


class Counters:
    """Since start; `refused` by Verdict, `stops` by Stop, every key there from the beginning."""

    __slots__ = ('accepted', 'limited', 'received', 'refused', 'replaced', 'stops', 'time_outs')

    def __init__(self) -> None:
        self.received = self.accepted = self.limited = self.replaced = self.time_outs = 0
        self.refused: Counter[Verdict] = Counter(dict.fromkeys(Verdict, 0))
        self.stops: Counter[Stop] = Counter(dict.fromkeys(Stop, 0))


def characters_ns(count: int, baud: int) -> int:
    """Time on the wire of so many characters, rounded up."""
    return -(-count * CHARACTER_BITS * SECOND // baud)


class Gate:
    """Commands in, due frames out. The owner serialises the calls."""

    def __init__(self, settings: Settings | None = None, *, baud: int = 115200) -> None:
        self.counters = Counters()
        self.velocity = STOP                         # the set-point
        self.enabled = True
        self.is_open = False
        self.is_shut = False
        self._spacing = characters_ns(FRAME_SIZE + GAP_CHARACTERS, baud)
        self._accepted: int | None = None            # the last accepted command, until it expires
        self._fresh: int | None = None               # when the not yet written command was offered
        self._zeros = 0                              # left of the stop burst
        self._bursting = False                       # its first zero is out
        self._last = -SECOND                         # the last frame
        self._free = 0                               # when the rate allows the next
        self._sent = Kind.STOP                       # what the last frame was
        self._earliest = 0                           # nothing is written before
        self._settled = 0                            # commands are refused before
        self._is_lowered = False                     # the set-point was, and is not written yet
        self.settings = settings or Settings()

    @property
    def settings(self) -> Settings:
        return self._settings

    @settings.setter
    def settings(self, settings: Settings) -> None:
        """Take effect at once: time-out and lower limits for the running command too."""
        self._settings = settings
        self._timeout = round(settings.cmd_vel_timeout * SECOND)
        self._interval = max(math.ceil(SECOND / settings.max_rate), self._spacing)
        rate = settings.resend_rate                  # never so fast that it fills the MCU's queue
        self._resend = max(math.ceil(SECOND / rate), self._interval, STOP_GAP) if rate > 0 else 0
        self._limits = Vel2d(
            settings.max_linear_x, settings.max_linear_y, settings.max_angular_z)
        before, self.velocity = self.velocity, limit(self.velocity, self._limits)
        self._is_lowered |= self.velocity != before

    @property
    def frame_rate(self) -> float:
        """Frames per second at most: max_rate, or what the baud carries with gaps."""
        return SECOND / self._interval

    @property
    def driving(self) -> bool:
        return self.velocity != STOP

    @property
    def stopping(self) -> bool:
        """Whether zeros of a stop burst are still to be written."""
        return self._zeros > 0

    def offer(
            self, velocity: Vel2d, now: int, *,
            waited: int = 0, stamp_age: int | None = None) -> Verdict:
        """Judge a command; `waited` ns in the middleware, `stamp_age` ns (None: no stamp)."""
        self._expire(now)
        self.counters.received += 1
        verdict = self._judge(velocity, now, waited, stamp_age)
        if verdict is Verdict.ACCEPTED:
            self._accept(velocity, now)
        else:
            self.counters.refused[verdict] += 1
        return verdict

    def _judge(
            self, velocity: Vel2d, now: int, waited: int, stamp_age: int | None) -> Verdict:
        oldest = round(self._settings.max_stamp_age * SECOND)
        reasons = (
            (not all(map(math.isfinite, velocity)), Verdict.NOT_FINITE),
            (self.is_shut, Verdict.SHUTDOWN),
            (not self.enabled, Verdict.DISABLED),
            (not self.is_open, Verdict.NO_PORT),
            (now < self._settled, Verdict.FROZEN),
            (0 < self._timeout < waited, Verdict.WAITED),
            (stamp_age is not None and 0 < oldest < stamp_age, Verdict.STAMP_OLD),
            (stamp_age is not None and 0 < oldest < -stamp_age, Verdict.STAMP_AHEAD),
        )
        return next((verdict for wrong, verdict in reasons if wrong), Verdict.ACCEPTED)

    def _accept(self, velocity: Vel2d, now: int) -> None:
        self.counters.accepted += 1
        self.counters.replaced += self._fresh is not None
        limited = limit(velocity, self._limits)
        self.counters.limited += limited != velocity
        was_driving, self.velocity = self.driving, limited
        self._accepted = self._fresh = now
        if self.driving:
            self._zeros = int(self.stopping and not self._bursting)      # a stop is never skipped
        elif was_driving:
            self._begin_burst(Stop.COMMAND)
        elif self._zeros:
            self._fresh = None                       # the zeros of the burst are this command

    def stop(self, now: int, why: Stop) -> None:
        """Forget the command and begin a stop burst; driving again takes a new command."""
        self.counters.replaced += self._fresh is not None
        self._forget()
        self.is_shut |= why is Stop.SHUTDOWN
        if why is Stop.FROZEN:
            self._settled = max(self._settled, now + SETTLE)
            self.hold(now + self._spacing)           # the deadman may just be writing
        if why is Stop.SUSPEND:                      # no command cuts its burst short
            self._settled = now + SECOND
        self._begin_burst(why)

    def _begin_burst(self, why: Stop) -> None:
        self.counters.stops[why] += 1
        self._zeros = BURST_FRAMES if self.is_open else 0
        self._bursting = False

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
        self._zeros = 0

    def _forget(self) -> None:
        self.velocity = STOP
        self._accepted = self._fresh = None

    def hold(self, until: int) -> None:
        """Let nothing be written before `until`: the line needs its gap."""
        self._earliest = max(self._earliest, until)

    def next_frame(self, now: int) -> Frame | None:
        """Return the frame that is due, the newest command; say `sent` once it is written."""
        self._expire(now)
        if now < self._due():
            return None
        kind = self._kind()
        if kind is Kind.STOP:
            return Frame(STOP, kind, None if self.driving else self._fresh)
        return Frame(self.velocity, kind, self._fresh)

    def sent(self, now: int) -> None:
        """Take note that the due frame was written, `now` being the end of the write."""
        self._last = now
        self._free = self._interval + (now if self._zeros else max(now, self._free))
        self._sent = self._kind()
        self._is_lowered = False
        if not (self._zeros and self.driving):
            self._fresh = None
        self._bursting = self._zeros > 0
        self._zeros -= self._bursting
        self.hold(now + self._spacing)

    def next_deadline(self, now: int) -> int:
        """Return when the next frame or time-out is due (NEVER when none is), `now` or later."""
        return max(now, min(self._due(), self._expiry()))

    def _due(self) -> int:
        if not self.is_open:
            return NEVER
        kind = self._kind()
        if kind is Kind.STOP:
            due = self._last + (BURST_PERIOD if self._bursting else STOP_GAP)
        elif kind is Kind.COMMAND:                   # at once after a resend; the rate is repaid
            due = self._free if self._sent is not Kind.RESEND else self._last
        elif self._is_lowered:
            due = self._free
        elif self._resend:                           # later, not to get in the way of a stream
            late = self._resend // 2 if self._sent is Kind.COMMAND else 0
            due = max(self._last + self._resend + late, self._free)
        else:
            return NEVER
        return max(due, self._earliest)

    def _kind(self) -> Kind:
        """Return what the next frame is."""
        if self._zeros:
            return Kind.STOP
        return Kind.RESEND if self._fresh is None else Kind.COMMAND

    def _expiry(self) -> int:
        if self._accepted is None or not self._timeout or not self.driving:
            return NEVER
        return self._accepted + self._timeout

    def _expire(self, now: int) -> None:
        if now >= self._expiry():
            self.counters.time_outs += 1
            self.stop(now, Stop.TIME_OUT)
