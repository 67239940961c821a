# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""
Link: the port and its one thread.

The thread opens and reopens the port, wakes at the gate's deadlines, beats the deadman's heart
and reads what the MCU sends. A command is written by the callback that brings it, when the rate
allows, for latency. Nothing here waits for the executor, and no lock is held while blocking.
"""
from __future__ import annotations

from collections.abc import Callable
from collections.abc import Iterator
from contextlib import contextmanager
from contextlib import suppress
import threading
import time
from typing import NamedTuple

from msg_defs.crc import crc32_mpeg2
from msg_defs.nanoseconds import NS_PER_S
from msg_defs.vel2d import encode
from msg_defs.vel2d import STOP
from msg_defs.vel2d import Vel2d
from servobus.port.port_error import PortError
from servobus.port.port_error import Reason
from servobus.port.self_pipe import SelfPipe
from servobus.port.serial_port import as_port_error
from servobus.port.serial_port import Backoff
from servobus.port.serial_port import open_port
from servobus.port.serial_port import Port
from servobus.worker import Worker
from vel2d_bridge.claim import PortClaim
from vel2d_bridge.deadman import Deadman
from vel2d_bridge.deadman import READY
from vel2d_bridge.deadman_process import BEAT
from vel2d_bridge.deadman_process import SILENCE
from vel2d_bridge.gate import Gate
from vel2d_bridge.gate import GateSettings
from vel2d_bridge.gate import Outcome
from vel2d_bridge.gate import Stop
from vel2d_bridge.pacer import Pacer
from vel2d_bridge.pacer import Sent

NO_STOP = 'no stop could be sent, the rover may be driving'
OFF, NO_USE = 'off', 'no use'      # besides the dead man's own states
_FEW_TIME_OUTS = 2                 # in a row: no accident, it is reported
_STUCK_TIME_OUTS = 10              # reopening may help an adapter that hangs
_SEARCH_NS = NS_PER_S              # when closing: for a lost port to come back
_CLOSE_NS = 3 * NS_PER_S // 2      # and for the last burst; the port may be stuck
_JOIN_S = 1.7
_POLL_S = 0.005
_HANGING_NS = NS_PER_S             # without a turn of the thread, which takes BEAT
_RETRY_S = 0.5                     # at most between attempts: until then the rover may be driving
_RETRY_PAUSE_S = 0.1               # while closing, or after an error of another kind: no memory


class LinkState(NamedTuple):
    """A snapshot for diagnostics; stamps are monotonic ns, `problem` is why it is not open."""

    is_open: bool
    since: int                     # time of the last change of is_open
    problem: PortError | None
    last_error: str                # stays after recovery
    openings: int
    losses: int
    frames: int
    time_outs: int                 # writes that took too long
    partial_writes: int
    freezes: int                   # the bridge was frozen, or the deadman acted
    last: Sent | None
    driving: bool
    enabled: bool
    deadman: str                   # OFF, NO_USE, or its own state
    owes_stop: bool                # none has left since it drove: it may do so still


class Link:
    """Owns the port, serialises the gate. All methods may be called from any thread."""

    def __init__(
            self, name: str, baud: int, gate: Gate, *,
            crc: Callable[[bytes], int] = crc32_mpeg2, write_timeout_s: float = 0.05,
            deadman: Deadman | None = None,
            on_sent: Callable[[Sent], None] = lambda sent: None,
            on_received: Callable[[bytes, int], None] = lambda chunk, stamp: None,
            on_change: Callable[[PortError | None], None] = lambda problem: None,
            opener: Callable[[str, int], Port] = open_port,
            clock: Callable[[], int] = time.monotonic_ns) -> None:
        """
        Take a gate made for the same baud; nothing happens before `start`.

        The callbacks must be quick. on_sent: per frame, under the lock, so it must not call
        back. on_received(chunk, stamp): what the MCU says. on_change(problem): at each opening
        (None) and whenever the reason for not being open changes.
        """
        self.gate = gate
        self._name = name
        self._baud = baud
        self._stop_frame = encode(STOP, crc)
        self._deadman = deadman
        self._on_received = on_received
        self._on_change = on_change
        self._opener = opener
        self._clock = clock
        self._pacer = Pacer(gate, clock, baud=baud, crc=crc, write_timeout_s=write_timeout_s,
                            on_sent=on_sent)
        self._lock = threading.Lock()
        self._thread = threading.Thread(target=self._run, name='port', daemon=True)
        self._closer = Worker('closer')
        self._pipe = SelfPipe()
        self._claim = PortClaim()
        self._backoff = Backoff(last_s=_RETRY_S)
        self._port: Port | None = None
        self._failure: PortError | None = None       # raised by a write in a callback's thread
        self._wake_at = 0                            # until when the thread sleeps
        self._beaten = clock()                       # when it last said that it runs
        self._closing: int | None = None             # since when
        self._owed: int | None = None                # lost while driving: frames sent until then
        self._overslept = False                      # frozen while the port was closed
        self._since = clock()
        self._problem: PortError | None = None
        self._last_error = ''
        self._openings = self._losses = 0

    def start(self) -> None:
        self._closer.start()
        self._thread.start()

    def is_working(self) -> bool:
        """Tell whether the thread does its work; to open a port may take it any time."""
        return self._thread.is_alive() and (
            self._port is None or self._clock() - self._beaten < _HANGING_NS)

    def offer_command(
            self, velocity: Vel2d, *, waited: int = 0, stamp_age: int | None = None) -> Outcome:
        """Judge a command and write it at once when the rate allows (times in ns)."""
        with self._lock:
            now = self._clock()
            verdict = self._pacer.offer_command(
                velocity, now, waited=waited, stamp_age=stamp_age, acted=self._acted())
            self._step(now)
        return verdict

    def stop(self, why: Stop) -> None:
        """Forget the command and send a stop burst; driving again takes a new command."""
        with self._acting() as now:
            self.gate.stop(now, why)

    def suspend(self, timeout_s: float = 1.0) -> None:
        """Stop because the process is about to be suspended; return when the burst is out."""
        self.stop(Stop.SUSPEND)
        deadline = time.monotonic() + timeout_s
        while time.monotonic() < deadline and not self._is_idle():
            time.sleep(_POLL_S)

    def enable(self, on: bool) -> None:
        with self._acting() as now:
            self.gate.enable(on, now)

    def apply(self, settings: GateSettings, write_timeout_s: float | None = None) -> None:
        """Change settings while running; they take effect at once."""
        with self._acting():
            self.gate.settings = settings
            if write_timeout_s is not None:
                self._pacer.write_timeout_s = write_timeout_s

    def close(self) -> bool:
        """
        Send the last burst and release everything; takes at most 3 s, never raises.

        A port that was lost while the rover drove is waited for; False: in vain, it drives on.
        """
        with self._acting() as now:
            if self._closing is not None:
                return True
            self._closing = now
            self.gate.stop(now, Stop.SHUTDOWN)
        self._pipe.rouse()
        if self._thread.is_alive():
            self._thread.join(_JOIN_S)
        if not self._thread.is_alive():              # else stuck in opening, it needs them
            self._pipe.close()
            self._closer.stop()
        self._claim.drop()
        if self._deadman is not None:
            self._deadman.leave()
        return not (self._owes_stop or self.gate.stopping)

    @property
    def freezes(self) -> int:
        """As in `state`, which takes longer: asked before each command is written."""
        with self._lock:
            return self._pacer.freezes

    def state(self) -> LinkState:
        with self._lock:
            pacer, gate = self._pacer, self.gate
            return LinkState(
                is_open=self._port is not None, since=self._since,
                problem=self._problem or _stuck(
                    self._name, pacer.time_outs_in_row, _FEW_TIME_OUTS),
                last_error=self._last_error,
                openings=self._openings, losses=self._losses,
                frames=pacer.frames, time_outs=pacer.time_outs,
                partial_writes=pacer.partial_writes, freezes=pacer.freezes, last=pacer.last,
                driving=gate.driving, enabled=gate.enabled,
                deadman=_deadman_state(self._deadman, self._port, self._clock()),
                owes_stop=self._owes_stop or (
                    gate.stopping and pacer.time_outs_in_row >= _FEW_TIME_OUTS))

    def _is_idle(self) -> bool:
        with self._lock, suppress(PortError):
            return self._pacer.is_idle() and not self._owes_stop
        return False

    @property
    def _owes_stop(self) -> bool:
        """Whether the MCU may drive still; the first frames after an opening are stops."""
        return self._owed == self._pacer.frames

    def _acted(self) -> bool:
        return self._deadman is not None and self._deadman.acted()

    @contextmanager
    def _acting(self) -> Iterator[int]:
        """Let any thread change something at this time (ns); then do what follows from it."""
        with self._lock:
            now = self._clock()
            self._pacer.notice_freeze(now, self._acted())
            yield now
            self._step(now)

    def _step(self, now: int) -> None:
        """Write what is due, and have the thread up in time for what is next."""
        try:
            wake = self._pacer.step(now)
        except PortError as error:
            self._failure = error
            wake = now
        if wake < self._wake_at:
            self._wake_at = wake
            self._pipe.rouse()

    def _run(self) -> None:
        """Run the thread; no exception ends it: the stops must go on."""
        while not self._is_over():
            with suppress(Exception):                # after an error another one: no memory
                self._use_port()
                continue
            time.sleep(_RETRY_PAUSE_S)

    def _use_port(self) -> None:
        """Open the port and use it until it is lost or not needed any more."""
        try:
            port = self._opener(self._name, self._baud)
        except Exception as error:
            self._report_failure(as_port_error(self._name, error))
            self._pause(self._backoff.next())
            return
        mistake: Exception | None = None
        try:
            self._begin(port)
            while not self._is_port_done():
                self._turn(port)
        except Exception as error:
            mistake = error
        try:
            self._part_from(port, mistake)
        finally:
            self._close_port(port)
        if mistake is not None:
            self._pause(self._backoff.next())

    def _is_over(self) -> bool:
        """Whether to look for the port no more."""
        return self._closing is not None and not (
            self._owes_stop and self._clock() < self._closing + _SEARCH_NS)

    def _begin(self, port: Port) -> None:
        path = '' if '://' in self._name else self._name
        if port.fd is not None:
            self._claim.claim_port(port.fd, path)
        if self._deadman is not None and port.fd is not None:
            self._deadman.hold(port.fd, self._stop_frame, self._baud, path, self._claim.token)
        with self._lock:
            now = self._clock()
            self._port = port
            self._failure = self._problem = None
            self._since = now
            self._openings += 1
            self._pacer.attach(port, now)
            if self._overslept:
                self._overslept = False
                self._pacer.notice_freeze(now, True)
        self._backoff.reset()
        self._report_change(None)

    def _is_port_done(self) -> bool:
        with self._lock:
            return self._closing is not None and (
                self._pacer.is_idle() or self._clock() >= self._closing + _CLOSE_NS)

    def _turn(self, port: Port) -> None:
        """Do what is due, then sleep until the next deadline, a byte or a wake-up."""
        with self._lock:
            now = self._clock()
            acted = self._acted()
            self._beat(now)
            if self._failure is not None:
                raise self._failure
            self._wake_at = min(self._pacer.turn(now, acted), now + BEAT)
            if error := _stuck(self._name, self._pacer.time_outs_in_row, _STUCK_TIME_OUTS):
                raise error
            sleep = self._wake_at - self._clock()
        if port.wait(max(sleep, 0) / NS_PER_S, self._pipe.fd):
            self._receive(port)
        self._pipe.drain()

    def _receive(self, port: Port) -> None:
        chunk = port.read()
        if chunk:
            self._on_received(chunk, self._clock())

    def _beat(self, now: int) -> None:
        """Say that the thread runs."""
        self._beaten = now
        if self._deadman is not None:
            self._deadman.beat(now)

    def _part_from(self, port: Port, mistake: Exception | None) -> None:
        """Part from a port: have every copy but ours closed, before anybody looks for it again."""
        with self._lock:
            self._port = None
            self._since = self._clock()
            if self.gate.driving or self.gate.stopping:
                self._owed = self._pacer.frames
            self._pacer.detach()
            error = None if mistake is None else as_port_error(self._name, mistake)
            if error is not None:
                self._losses += 1
                self._problem, self._last_error = error, str(error)
        if self._deadman is not None:
            self._deadman.release(self._owes_stop)
        with suppress(PortError):
            if error is not None or port.pending():
                port.drop_output()
        if error is not None:
            self._report_change(error)

    def _close_port(self, port: Port) -> None:
        """
        Close a port, with a beating heart, and return when it is; while closing, do not wait long.

        Drivers of USB adapters cannot drop what they have taken: the kernel waits up to 30 s for
        a board that hangs. The name is busy until then.
        """
        closed = self._closer.call(port.close)
        while not closed.wait(BEAT / NS_PER_S) and self._closing is None:
            self._beat(self._clock())

    def _report_change(self, problem: PortError | None) -> None:
        with suppress(Exception):                    # a callback's mistake ends no thread
            self._on_change(problem)

    def _report_failure(self, error: PortError) -> None:
        with self._lock:
            is_new = self._problem is None or str(error) != str(self._problem)
            self._problem = error
            self._last_error = str(error)
        if is_new:
            self._report_change(error)

    def _pause(self, seconds: float) -> None:
        """Sleep between attempts, with a beating heart; shutting down shortens it."""
        now = self._clock()
        deadline = now + int(seconds * NS_PER_S)
        while self._closing is None and now < deadline:
            self._beat(now)
            before = now
            self._pipe.sleep(min(deadline - now, BEAT) / NS_PER_S)
            now = self._clock()
            self._overslept |= now - before >= SILENCE
        if self._closing is not None and not self._is_over():
            time.sleep(_RETRY_PAUSE_S)


def _deadman_state(deadman: Deadman | None, port: Port | None, now: int) -> str:
    """Tell whether it would stop the rover: it needs a descriptor, rfc2217:// has none."""
    if deadman is None:
        return OFF
    if port is not None and port.fd is None:
        return NO_USE
    return READY if deadman.is_alive(now) else deadman.state(now)


def _stuck(name: str, time_outs: int, many: int) -> PortError | None:
    """Return the error of a line that took none of so many frames in a row; None before."""
    if time_outs < many:
        return None
    return PortError(name, Reason(
        'lost', 'takes no data', 'check flow control, cable and adapter'))
