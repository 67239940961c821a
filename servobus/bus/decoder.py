# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""
BusDecoder: what is said on one bus, from chunks of bytes to devices.

It joins the framer, the tracker and the registry. No lock and no clock: Monitor has both.
"""

from typing import NamedTuple

from msg_defs import dxl1_packet
from msg_defs.dxl1_detector import Detector
from msg_defs.dxl_mixed import MixedFramer
from msg_defs.dxl_packet import Framer
from msg_defs.event import AWAY
from msg_defs.event import BAUD
from msg_defs.event import Change
from msg_defs.event import CLOSED
from msg_defs.event import GAVE_UP
from msg_defs.event import GONE
from msg_defs.event import HAS_ADDED_RETURN
from msg_defs.event import IN
from msg_defs.event import LATENCY_TIMER
from msg_defs.event import LINE_MODE
from msg_defs.event import LOST
from msg_defs.event import NOT_SENT
from msg_defs.event import OUT
from msg_defs.event import PURGED
from msg_defs.event import UNKNOWN
from msg_defs.event import UNREAD
from msg_defs.servo_frame import Frames
from msg_defs.uart import idle_s
from servobus.bus import evidence as ev
from servobus.bus.cycle_time import CycleClock
from servobus.bus.cycle_time import NO_RATE
from servobus.bus.cycle_time import NO_SIDES
from servobus.bus.dialect import DialectChoice
from servobus.bus.dxl1_classifier import AnyFramer
from servobus.bus.dxl1_classifier import Dxl1Classifier
from servobus.bus.dxl1_classifier import REPLY_LATE_NS
from servobus.bus.echo import EchoCounter
from servobus.bus.evidence import Evidence
from servobus.bus.expected_devices import Expected
from servobus.bus.port_sessions import PortSessions
from servobus.bus.registry import DeviceRegistry
from servobus.bus.report import CycleTimes
from servobus.bus.report import PROTOCOL_2
from servobus.bus.tracker import Tracker
from servobus.model.control_table import PROTOCOLS
from servobus.model.models import Models

PROTOCOL_CHOICES = ('auto', *PROTOCOLS)
ANSWER_MAX_NS = 1_000_000_000      # a broadcast Ping may take 0.8 s; nothing pending takes longer


class Settings(NamedTuple):
    """
    The parameters of a bus (docs/parameters.md).

    latency_timer_ms: of the adapter. protocol: what the bus speaks: 'auto', '2', '1', 'feetech'.
    """

    baud: int = 2_000_000
    devices: tuple[Expected, ...] = ()
    missed_limit: int = 4
    warn_loss: float = 1.0
    silent_after: float = 5.0
    write_acks: str = 'auto'
    latency_timer_ms: float = 0.0
    protocol: str = 'auto'


DEFAULTS = Settings()


class BusDecoder:
    """What is said on one bus. Stamps and now are monotonic ns."""

    def __init__(self, models: Models, settings: Settings = DEFAULTS) -> None:
        self.settings = settings
        self._last_in = 0                     # stamp of the last bytes to the master, if known
        self._noise_in = 0                    # bytes of noise to it that were looked at
        self._split = 0                       # offset in an answer at which it asked, 0: none
        self.evidence = Evidence()
        self.echo = EchoCounter(self.evidence)
        self.clock = CycleClock()
        self.line_mode = 0
        self.sessions = PortSessions(self.evidence)
        self.registry = DeviceRegistry(models, settings.devices, settings.baud, self.evidence)
        self.choice = DialectChoice(models, settings.protocol)
        self.choice.vote_by_devices(device.dialect for device in self.registry.devices.values())
        self.registry.dialect = self.choice.dialect
        self.detector = Detector() if settings.protocol == 'auto' else None
        self.classifier = Dxl1Classifier(self.registry, self.evidence, self.choice, self.detector,
                                         self.process_frames)
        self.framers: dict[str, AnyFramer] = {}        # by the side that they hear
        self._new_framer(UNKNOWN)
        self.tracker = Tracker(self.registry, self.evidence, settings.missed_limit,
                               settings.write_acks)
        self.set_latency_timer(settings.latency_timer_ms)

    def set_latency_timer(self, latency_timer_ms: float) -> None:
        """Say how long the adapter may keep bytes back: so long a pause is not silence."""
        self.settings = self.settings._replace(latency_timer_ms=latency_timer_ms)
        self.idle_ns = int(1e9 * idle_s(self.settings.baud, latency_timer_ms))
        self.classifier.slow_ns = REPLY_LATE_NS + int(1e6 * latency_timer_ms)

    def _new_framer(self, side: str) -> AnyFramer:
        framer: AnyFramer = dxl1_packet.Dxl1Framer()
        if self.detector is not None:
            framer = MixedFramer(self.detector, side)
        elif self.settings.protocol == '2':
            framer = Framer()
        self.framers[side] = framer
        return framer

    def process_chunk(self, chunk: bytes, stamp: int, side: str = UNKNOWN) -> None:
        """
        Take a chunk. Each side has a framer of its own, so an order of chunks is one of frames.

        stamp: when its last byte had come in; of the side OUT, when it was written.
        """
        framer = self.framers.get(side) or self._new_framer(side)
        if side:
            wire_ns = len(chunk) * self.registry.byte_ns
            if side == OUT:
                self._end_reply(stamp)
                self.echo.process_sent(chunk)
                awaited, waited = self.tracker.slots, self.evidence.waits_added
                stamp += int(wire_ns)
            else:
                self.echo.process_received(chunk)
                self._last_in = stamp
                self.clock.add_received(stamp, wire_ns)
        framer.stamp = stamp
        frames = framer.frames(chunk)
        if self._split and side == IN:
            self._note_split(frames, stamp)
        if framer.has_other:
            self.classifier.classify(framer, frames, stamp, side)
        else:
            self.process_frames(frames, stamp, framer.bytes, side)
        if side and side == OUT:               # most chunks have no side
            began = stamp - int(wire_ns)
            self.clock.add_write(began, wire_ns, awaited, self.evidence.waits_added != waited)
            if self.tracker.asked == stamp:
                self.clock.add_instruction(self.tracker.pending, began, wire_ns)

    def _end_reply(self, stamp: int) -> None:
        """Decide an answer that stopped on its way, before what the master says next is taken."""
        framer = self.framers.get(IN)
        if framer is None:
            return
        tracker = self.tracker
        plan, came = tracker.pending, framer.bytes - tracker.quiet_from
        if framer.pending and (stamp - self._last_in > self.idle_ns or came >= plan.answers_size):
            self._flush(IN, framer, self._last_in)
        self._report_noise(framer)
        tracker.unread.count_overlong_reply(plan, came, framer.noise_length > 0)
        tracker.quiet_from = framer.bytes - framer.pending
        self._split = framer.bytes if framer.pending else 0
        tracker.unread.judge_expired(stamp)

    def _note_split(self, frames: Frames, stamp: int) -> None:
        """Note a whole answer of which the program read a part, then asked, then read the rest."""
        for begin, end, _, number, *_, flaw in frames:
            if begin < self._split < end and flaw is None and self.tracker.pending.slots:
                self.evidence.add_incident(stamp, ev.SPLIT, number)
        if frames:
            self._split = 0

    def _report_noise(self, framer: AnyFramer) -> None:
        """Note what the master received that is no packet, before it goes on."""
        self.tracker.process_noise(framer.noise_bytes - self._noise_in)
        self._noise_in = framer.noise_bytes

    def _flush(self, side: str, framer: AnyFramer, stamp: int) -> None:
        framer.stamp = stamp
        self.classifier.classify(framer, framer.flush_frames(), stamp, side)

    def process_frames(self, frames: Frames, stamp: int, received: int,
                       side: str = UNKNOWN) -> None:
        """Take what a framer found in the chunk of this stamp, which ends at offset received."""
        self.tracker.process_frames(frames, stamp, received, side)

    def process_pause(self, last: int, now: int) -> None:
        """
        Note that nothing came from `last` to `now`.

        For a while that may be the delivery: then the next chunk decides what is pending. After
        longer than any answer takes it is the line.
        """
        if now - last > ANSWER_MAX_NS:
            for side, framer in self.framers.items():
                if framer.pending:
                    self._flush(side, framer, last)
            self.classifier.confirm_waiting()
            if not self.tracker.unread.reported_ns:    # else the program may not have read it
                self.tracker.stop_waiting(now)
        elif now - last > self.idle_ns:
            self.classifier.confirm_waiting()
            for framer in self.framers.values():
                framer.interrupt()

    def process_change(self, change: Change, stamp: int) -> None:
        """Take what a source reported besides bytes."""
        what, value = change
        self.clock.process_change(change, stamp)
        if what == BAUD:                       # it opens the port, or sets another rate
            self._set_baud(value, stamp)
            self.sessions.begin(stamp, self._sent_bytes)
        elif what == LATENCY_TIMER:
            self.set_latency_timer(value)
        elif what == NOT_SENT:
            self.tracker.drop_unsent(stamp)
        elif what == UNREAD:
            received = self.framers[IN].bytes if IN in self.framers else 0
            self.tracker.unread.report_waiting(value, received, stamp)
            self.echo.note_waiting(value)
        elif what == PURGED:
            if value & 1:
                self._discard_unread(stamp)
                self.tracker.accept_purge(stamp)
            if value & 2:
                self.tracker.unread.report_unsent(self.tracker.asked, stamp)
        elif what == GAVE_UP:
            self.tracker.unread.vain_read_ns = stamp - 1000 * value
        elif what == LINE_MODE:
            self._set_line_mode(value, stamp)
        elif what == AWAY:
            self.tracker.discount_latency(value, stamp)
        elif what in (CLOSED, GONE, LOST):
            self._lose_stream(what, value, stamp)

    def _set_line_mode(self, mode: int, stamp: int) -> None:
        self.line_mode = mode & ~HAS_ADDED_RETURN
        if mode & HAS_ADDED_RETURN:
            request = self.tracker.pending.request
            self.evidence.add_incident(stamp, ev.RETURN_ADDED, request.id, request.instruction)

    @property
    def _sent_bytes(self) -> int:
        """How many bytes the program has sent."""
        return self.framers[OUT].bytes if OUT in self.framers else 0

    def _discard_unread(self, stamp: int) -> None:
        """Note that the program does not read what waits: an answer may have lost its end."""
        unread, framer = self.tracker.unread, self.framers.get(IN)
        self.echo.process_discarded(unread.waiting, bool(self.tracker.slots))
        unread.discarded += unread.waiting
        if unread.waiting and framer is not None and framer.pending:
            self._flush(IN, framer, stamp)

    def _lose_stream(self, what: str, value: int, stamp: int) -> None:
        """Note that the port is closed or gone, or that events were lost."""
        if what == CLOSED:
            self.sessions.end(stamp, self._sent_bytes, self.tracker.asked, self._last_in)
        elif what == GONE and value > 1:       # the errno that the program got
            self.tracker.lose_port(stamp, value)
        self._end_stream(stamp, value if what == LOST else 0)

    def _end_stream(self, stamp: int, lost: int = 0) -> None:
        """Take what is left as whole; what comes now has nothing to do with it."""
        self._discard_unread(stamp)
        for side, framer in self.framers.items():
            self._flush(side, framer, stamp)
        self.classifier.confirm_waiting()
        if IN in self.framers:
            self._report_noise(self.framers[IN])
        self.tracker.lose_track(stamp, lost)
        self.clock.interrupt()

    def _set_baud(self, baud: int, stamp: int) -> None:
        """Begin on a new wire: what was on the other one is over, and no damage here."""
        if baud == self.settings.baud:
            return
        self._end_stream(stamp)
        self.settings = self.settings._replace(baud=baud)
        self.registry.set_baud(baud)
        self.set_latency_timer(self.settings.latency_timer_ms)

    def protocol(self) -> str:
        """Return what was heard here, in words: 'Dynamixel 2.0, Feetech'; '' for nothing yet."""
        other = self.classifier.packets
        words = [PROTOCOL_2] if self.total('packets') > other else []
        return ', '.join(words + [self.choice.dialect.name] * bool(other))

    @property
    def is_answered(self) -> bool:
        """Whether anything came to the master; True where its side is not known."""
        return OUT not in self.framers or IN in self.framers

    def cycle(self, now: int) -> CycleTimes | None:
        """Return where the time of the master's cycle goes; None without a cycle."""
        unknown = NO_SIDES if OUT not in self.framers else '' if self.registry.byte_ns else NO_RATE
        return self.clock.times(now, unknown)

    def total(self, counter: str) -> int:
        """Return a counter of the framers, over all sides."""
        return sum(getattr(framer, counter) for framer in self.framers.values())

    def damaged(self, reason: str) -> int:
        """Return how many frames were damaged for a reason, over all sides."""
        return self.classifier.damaged[reason] + sum(
            framer.damaged[reason] for framer in self.framers.values())

    @property
    def noise_side(self) -> str:
        """The side that heard most bytes that were no packet."""
        return max(self.framers, key=lambda side: self.framers[side].noise_bytes)

    @property
    def noise(self) -> bytes:
        """The last bytes that were no packet, of that side."""
        return self.framers[self.noise_side].noise
