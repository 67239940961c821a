# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""
The simulated bus on ptys: bytes leave on schedule at the baud rate, whether or not anyone reads.

A simulated master plays by itself; with the pattern `none` a real one at the other end drives the
devices. When this process comes too late, the bus stops for a while; the reader is not to blame.
"""

from __future__ import annotations

from collections.abc import Callable
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import closing
from contextlib import ExitStack
import time
from typing import Any

from mecarover_fakes.fake_options import Away
from mecarover_fakes.line import BITS_PER_BYTE
from mecarover_fakes.line import Burst
from mecarover_fakes.line import MASTER
from mecarover_fakes.line import wire_ns
from mecarover_fakes.master import Master
from mecarover_fakes.traffic import Ask
from mecarover_fakes.traffic import none
from mecarover_fakes.virtual_uart import VirtualUart
from mecarover_fakes.virtual_usb import VirtualUsb
from msg_defs.nanoseconds import NS_PER_S
from msg_defs.servo_frame import is_good

TICK_NS = 200_000                # shortest time between two writes, longest is
PART_NS = 1_000_000              # for a part of a long packet
IDLE_NS = 50_000_000
DRAIN_NS = 200_000_000
LATE_BYTES = 2048                # half of what a reader may leave


class FakeBus:
    """
    The bus of `master` on a pty, and a copy of it on a second one if `tap` is given.

    usb: what shows it as the events of a USB adapter, too; it is closed with the bus.
    """

    def __init__(self, master: Master, *, link: str | None = None, tap: str | bool = False,
                 away: Away | None = None, usb: VirtualUsb | None = None,
                 clock: Callable[[], int] = time.monotonic_ns) -> None:
        self.master = master
        self.tap: VirtualUart | None = None
        with ExitStack() as made:
            if usb is not None:
                made.callback(usb.close)
            self.outlet = made.enter_context(closing(VirtualUart(link)))
            if tap:
                place = tap if isinstance(tap, str) else None
                self.tap = made.enter_context(closing(VirtualUart(place)))
            self._made = made.pop_all()
        self.stood_still_ns = 0
        # The tap first: who drives us may ask its listener as soon as it has an answer.
        self._ends = ({'tap': self.tap} if self.tap else {}) | {'bus': self.outlet}
        self._has_own_master = master.pattern is not none
        self._away = away
        self._usb = usb
        self._clock = clock
        self._origin = 0
        self._is_stopping = False
        self._thread = ThreadPoolExecutor(1, 'fake_bus')

    @property
    def path(self) -> str:
        """The pty to open."""
        return self.outlet.path

    def start(self, seconds: float | None = None) -> None:
        """Run in a thread until stop(), or for some seconds."""
        until = None if seconds is None else round(seconds * NS_PER_S)
        self._playing = self._thread.submit(self._run, until)

    def wait(self) -> None:
        """Wait until what start() began is over; raise what ended it before its time."""
        self._playing.result()

    def stop(self) -> None:
        """End after the exchange in progress and hang up."""
        self._is_stopping = True
        self.master.stop()
        self._thread.shutdown()
        self._made.close()

    def command(self, text: str) -> None:
        """Begin a fault ('silent:3') or end faults ('back'); ParameterError for something else."""
        self.master.faults.command(text, self._now())

    def totals(self) -> dict[str, Any]:
        """Return the counters of both ends."""
        return {name: end.totals() for name, end in self._ends.items()} \
            | {'stood_still_s': round(self.stood_still_ns / NS_PER_S, 3)}

    def _run(self, until: int | None) -> None:
        self._origin = self._clock()
        self._play(self.master.bursts(until) if self._has_own_master else self._asked(until))
        deadline = self._clock() + DRAIN_NS      # hanging up takes unread bytes away
        while any(end.outstanding() for end in self._ends.values()) and self._clock() < deadline:
            time.sleep(TICK_NS / NS_PER_S)

    def _asked(self, until: int | None) -> Iterator[Burst]:
        """Yield what the instructions of a real master lead to, as soon as each is whole."""
        framer, line = self.master.line.framer(), self.master.line
        while not self._is_stopping and (until is None or self._now() < until):
            self._sleep(IDLE_NS)
            for frame in framer.frames(self.outlet.read()):
                if is_good(frame):
                    yield from self.master.respond(Ask(*line.parse_frame(frame)), self._now())

    def _now(self) -> int:
        return self._clock() - self._origin

    def _sleep(self, wait_ns: int) -> None:
        """Wait so long, or until a real master writes; what is written to our own is dropped."""
        whole_ms, rest_ns = divmod(wait_ns, NS_PER_S // 1000)
        if not self.outlet.wait(whole_ms / 1000):
            time.sleep(rest_ns / NS_PER_S)
        if self._has_own_master:
            self.outlet.read()
        if self._away is not None:
            for one in self._ends.values():
                one.plug(plugged_in=not self._away.covers(self._now() / NS_PER_S))

    def _play(self, bursts: Iterator[Burst]) -> None:
        baud = self.master.line.baud
        due = bytearray()
        for burst in bursts:
            done = 0
            while done < len(burst.data):
                now = self._catch_up(burst.start + wire_ns(done, baud))
                passed = (now - burst.start) * baud // (BITS_PER_BYTE * NS_PER_S)
                end = len(burst.data) if self._is_stopping else min(passed, len(burst.data))
                if end > done:
                    due += burst.data[done:end]
                    self._mirror_on_usb(burst, done, end)
                    done = end
                # A machine that is always late never has to wait: it hands over all the same.
                if done < len(burst.data) or len(due) >= LATE_BYTES:
                    self._hand_over(due, burst)
                    wait = min(max(burst.end - now, TICK_NS), burst.start - now + PART_NS)
                    self._sleep(min(max(wait, TICK_NS), IDLE_NS))
            if not self._has_own_master:
                self._hand_over(due, burst)
        self._hand_over(due)

    def _mirror_on_usb(self, burst: Burst, done: int, end: int) -> None:
        """Show a part of a burst on USB: a master hands over the whole of it, at once."""
        if self._usb is None:
            return
        if burst.written and not done:
            self._usb.sent(b''.join(data for _, data in burst.written))
        if burst.sender != MASTER or not burst.written:        # another master's is only heard
            self._usb.received(burst.data[done:end])

    def _catch_up(self, due: int) -> int:
        """Return the time on the bus; it stops while we are too late for what is due."""
        now = self._now()
        too_late = max(0, now - due - wire_ns(LATE_BYTES, self.master.line.baud))
        self._origin += too_late
        self.stood_still_ns += too_late
        return now - too_late

    def _hand_over(self, due: bytearray, burst: Burst | None = None) -> None:
        """Write what is due; a real master does not hear its own bytes."""
        for end in self._ends.values() if due else ():
            if self._has_own_master or end is self.tap or (burst and burst.sender != MASTER):
                end.write(bytes(due))
        due.clear()
