# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""
Dialogue: what frames of the 1.0 family mean, from what was said before; in the form of 2.0.

Three things are decided here that the frame itself does not tell. Whether it is one at all: one
right sum of eight bits proves little, several directly behind each other do. Whether it is an
instruction or a status, which have the same form: FF FF 01 02 01 FB is a Ping of 1, and the answer
of 1 with "input voltage error". And which dialect the bus speaks (dialect.py). With the side of a
frame known, the second is certain. What stays open is counted and changes nothing.

A frame that names an ID for the first time waits for what is behind it (stranger.py).
"""

from collections import Counter

from dxl_monitor.bus import evidence as ev
from dxl_monitor.bus.dialect import DialectChoice
from dxl_monitor.bus.evidence import Evidence
from dxl_monitor.bus.roster import Roster
from dxl_monitor.bus.stranger import Held
from dxl_monitor.bus.stranger import Strangers
from msg_defs import dxl1_packet
from msg_defs.dxl1_instruction import common_error
from msg_defs.dxl1_instruction import fits
from msg_defs.dxl1_instruction import in_common
from msg_defs.dxl1_instruction import parse
from msg_defs.dxl1_instruction import STATUS_BITS
from msg_defs.dxl1_instruction import UNDECIDED
from msg_defs.dxl1_packet import BROADCAST
from msg_defs.dxl1_packet import FAMILY
from msg_defs.dxl1_packet import MIN_LENGTH
from msg_defs.dxl_instruction import Answers
from msg_defs.dxl_instruction import Request
from msg_defs.dxl_mixed import is_other
from msg_defs.dxl_mixed import MixedFramer
from msg_defs.dxl_packet import Flaw
from msg_defs.dxl_packet import Frame
from msg_defs.dxl_packet import Framer
from msg_defs.dxl_packet import STATUS
from msg_defs.dxl_packet import stuff
from msg_defs.heard import IN
from msg_defs.heard import OUT

PROOF = 3                          # frames directly behind each other that prove the family
MUCH = 16                          # or so many in all, with fewer wrong ones than 16 to each
GLITCH = 3                         # bytes of noise that still count as none (tracker.py)
# A device answers within 0.5 ms (Return Delay Time), a master gives up after 10 ms or more.
QUICK_NS = 3_000_000
SLOW_NS = 9_000_000
OPEN = 'open'                      # the reason of a frame that may be an instruction or a status
MEANINGS_KEPT = 1024

AnyFramer = Framer | MixedFramer | dxl1_packet.Framer1
# What Conversation.take() takes: frames, the stamp of their chunk, the offset behind it, its side.
Part = tuple[list[Frame], int, int, str]
_MARK = bytes([FAMILY])
_GOOD_STATUS = bytes((FAMILY, STATUS, 0))
_NOTHING = Request(0, 0xFF, Answers.NONE)
_SYNC_WRITE = 0x83
# Who answers these, and how much, their bytes alone tell; a write depends on its device as well.
_TOLD_BY_BODY = (Answers.DATA, Answers.LISTED, Answers.PING)


class Dialogue:
    """
    Reads the frames of one bus in order.

    A framer of the 1.0 family alone says that the bus speaks nothing else: then each right sum is
    a packet. Each side has a framer of its own; what one of them proves holds for both.
    """

    def __init__(self, roster: Roster, evidence: Evidence, choice: DialectChoice,
                 byte_ns: float) -> None:
        self._evidence = evidence
        self._roster = roster
        self._choice = choice
        self.byte_ns = byte_ns
        self.slow_ns = SLOW_NS             # and the adapter may keep bytes back for longer
        self._streak: list[Held] = []      # good frames directly behind each other, not yet proof
        self.packets = 0                   # those of the 1.0 family
        self.proven: set[int] = set()      # the IDs that speak the 1.0 family here
        self._single = 0                   # good frames that were given up
        self._stranger: Held | None = None # names an ID for the first time, and was the last
        self._strangers = Strangers(roster)
        self._request = _NOTHING
        self._asked = b''                  # the body of the last instruction
        self._asked_ns = 0.0               # when it ended
        self.has_decided = False           # the dialect, with the frames just read
        self._is_echoing = False           # what the master sends comes back to it
        self._awaited: dict[int, int] = {} # statuses to come: parameters, by ID
        self._errors: dict[int, int] = {}  # error byte of the last status, by ID
        self._meanings: dict[bytes, tuple[bytes, Request, dict[int, int]]] = {}
        self._noise_seen: Counter[AnyFramer] = Counter()       # bytes of it, by framer

    def read(self, framer: AnyFramer, frames: list[Frame], stamp: int, side: str) -> list[Part]:
        """Return the frames of a chunk in the form of 2.0, as Conversation.take() takes them."""
        parts: list[Part] = []
        found: list[Frame] = []
        is_noisy = False
        for frame in frames:
            flaw = frame[2]
            is_noisy |= flaw is not None and flaw.noise_length > GLITCH
            if self._stranger is not None:
                self._resolve(framer, flaw, parts, found)
            if not is_other(frame):
                found.append(frame)
            elif flaw is not None and flaw.reason:
                if not isinstance(framer, MixedFramer) or self._is_ours(frame[1][0]):
                    found.append(self._damaged(framer, frame, flaw, side))
            elif not isinstance(framer, MixedFramer) \
                    or (self.proven and (flaw is None or flaw.noise_length <= GLITCH)):
                if isinstance(framer, MixedFramer):
                    self._claim(framer, frame, stamp)
                if side != OUT and self._is_new(frame[1]):
                    self._stranger = Held(framer, frame, stamp, framer.bytes, side)
                else:
                    found.append(self._meaning(frame, stamp, framer.bytes, side))
            else:
                self._weigh(Held(framer, frame, stamp, framer.bytes, side), parts, found)
        if self._streak and isinstance(framer, MixedFramer) and framer.noise_ahead > GLITCH:
            self._reject()
        if is_noisy:
            self._look_at_noise(framer)
        return [*parts, (found, stamp, framer.bytes, side)]

    def _look_at_noise(self, framer: AnyFramer) -> None:
        """Count the answers in the noise that lack only the first byte of their header."""
        fresh = framer.noise_bytes - self._noise_seen.get(framer, 0)
        self._noise_seen[framer] += fresh
        noise = framer.noise[-fresh:] if fresh else b''
        at = noise.find(0xFF)
        while 0 <= at < len(noise) - 4:
            end = at + 3 + noise[at + 2]
            device = self._roster.devices.get(noise[at + 1])
            if device is not None and device.heard and noise[at + 2] >= MIN_LENGTH \
                    and end <= len(noise) and sum(noise[at + 1:end]) & 0xFF == 0xFF:
                device.counts.beheaded += 1
                at = end - 1
            at = noise.find(0xFF, at + 1)

    def _meant(self, held: Held) -> Frame:
        return self._meaning(held.frame, held.stamp, held.received, held.side)

    def _part(self, held: Held) -> Part:
        """Return what a frame of an earlier chunk means."""
        return [self._meant(held)], held.stamp, held.received, held.side

    # --- does this ID exist? --------------------------------------------------------------------

    def _is_new(self, body: bytes) -> bool:
        return body[0] not in self._roster.devices and body[0] not in self._awaited \
            and self._strangers.new_id(body) is not None

    def _resolve(self, framer: AnyFramer, flaw: Flaw | None, parts: list[Part],
                 found: list[Frame]) -> None:
        """Decide on the frame that waits, for another has come."""
        held = self._stranger
        if held is None:
            return
        is_same = framer is held.framer
        is_next = not is_same or flaw is None or not (flaw.reason or flaw.noise_length)
        frame = self._met(held, is_next)
        if is_same and held.received == framer.bytes:          # in this chunk
            found.append(frame)
        else:
            parts.append(([frame], held.stamp, held.received, held.side))

    def settle(self) -> Part | None:
        """Return the frame that waits, if the line is idle behind it."""
        held = self._stranger
        if held is None or held.framer.pending:
            return None
        frame = self._met(held, not held.framer.noise_ahead)
        return [frame], held.stamp, held.received, held.side

    def _met(self, held: Held, is_next: bool) -> Frame:
        """Return what the frame that waits means; is_next: there is no noise behind it."""
        self._stranger = None
        if held.frame[1][0] in self._awaited or self._strangers.exists(held, is_next):
            return self._meant(held)
        self.packets += 1
        return held.frame[0], held.frame[1], Flaw(OPEN, False, 0)

    # --- is it one? -----------------------------------------------------------------------------

    def _weigh(self, one: Held, parts: list[Part], found: list[Frame]) -> None:
        """Take a good frame that may be chance, and those that it proves."""
        proven = self._proven(one)
        parts.extend(self._part(held) for held in proven[:-1])
        if len(proven) == 1 and one.side != OUT and self._is_new(one.frame[1]):
            self._stranger = one               # behind noise, on a bus of this family
        elif proven:
            found.append(self._meant(one))

    def _proven(self, one: Held) -> list[Held]:
        """Return the good frames that are proven by this one, in order, itself the last."""
        framer, body, flaw = one.framer, one.frame[1], one.frame[2]
        is_next = flaw is None or flaw.noise_length <= GLITCH
        if self.proven and (is_next or body[0] in self.proven):
            return self._claimed([one])
        if not is_next:
            self._reject()
        self._streak.append(one)
        framer.held += body[1] + 4
        if len(self._streak) >= PROOF \
                or (self._single >= MUCH and MUCH * self._single > framer.wrong):
            streak = self._streak
            self._let_go()
            return self._claimed(streak)
        return []

    def _claimed(self, streak: list[Held]) -> list[Held]:
        for held in streak:
            self._claim(held.framer, held.frame, held.stamp)
        return streak

    def _claim(self, framer: MixedFramer, frame: Frame, stamp: int) -> None:
        body = frame[1]
        self.proven.add(body[0])
        framer.claim(frame)
        if framer.has_first:
            self._evidence.note_often(stamp, ev.PROTOCOL_1, body[0], ev.Code(body[3]))

    def _reject(self) -> None:
        """Give up what is not proven: its bytes are noise."""
        self._single += len(self._streak)
        self._let_go()

    def _let_go(self) -> None:
        for held in self._streak:
            held.framer.held = 0
        self._streak = []

    def _is_ours(self, number: int) -> bool:
        return number in self.proven or number in self._awaited

    # --- instruction or status? -----------------------------------------------------------------

    def _meaning(self, frame: Frame, stamp: int, received: int, side: str) -> Frame:
        end, body, flaw = frame
        self.packets += 1
        if body[3] == STATUS and (side == OUT or body[0] == BROADCAST):
            return end, body, Flaw(OPEN, False, 0)     # no instruction has the code of a status
        awaited = self._awaited.get(body[0])
        if side == IN:
            if self._is_echo(body, awaited):
                return end, self._meanings.get(body, (in_common(body),))[0], flaw
        elif side == OUT or awaited is None or body[3]:
            ended = stamp - (received - end) * self.byte_ns
            is_status = side != OUT and self._is_status(body, ended, awaited)
            if is_status is None:
                return end, body, Flaw(OPEN, False, 0)
            if not is_status:
                return end, self._instruction(body, ended), flaw
        if awaited is not None:
            del self._awaited[body[0]]
        return end, self._status(body, stamp), flaw

    def _is_echo(self, body: bytes, awaited: int | None) -> bool:
        """Return whether what came to the master is an instruction, mostly its own."""
        if body[0] == BROADCAST or body[3] > STATUS_BITS:
            self._is_echoing |= body == self._asked
            return True
        if body != self._asked or (len(body) - 4 == awaited and not self._is_echoing):
            return False
        self._is_echoing = True
        self._asked = b''                  # it comes back once
        return True

    def _is_status(self, body: bytes, ended: float, awaited: int | None) -> bool | None:
        """Return whether a frame is a status, None where that stays open."""
        number, code, size = body[0], body[3], len(body) - 4
        if number == BROADCAST or code > STATUS_BITS:
            return False
        if not fits(code, number, body[4:], self._choice.dialect) \
                and not fits(code, number, body[4:]):
            return True
        if awaited is None:
            return False
        if self._errors.get(number) == code and size == awaited:
            return True                    # it says so all the time
        waited = ended - (size + 6) * self.byte_ns - self._asked_ns
        if waited >= self.slow_ns or size not in (awaited, 0):
            return False
        if waited <= QUICK_NS and (body != self._asked or number in self._errors):
            return True
        return None

    def _instruction(self, body: bytes, ended: float) -> bytes:
        if body[3] == _SYNC_WRITE and self._choice.dialect is not UNDECIDED:
            self._request, self._awaited = _NOTHING, {}        # what a robot says most
            self._asked, self._asked_ns = body, ended
            return in_common(body)
        known = self._meanings.get(body)
        if known is None:
            known = self._parsed(body)
        elif self._choice.dialect is UNDECIDED and self._choice.asked(known[1]):
            self._decided()
        meaning, self._request, awaited = known
        self._awaited = awaited.copy()
        self._asked = body
        self._asked_ns = ended
        return meaning

    def _parsed(self, body: bytes) -> tuple[bytes, Request, dict[int, int]]:
        choice = self._choice
        number, code, params = body[0], body[3], body[4:]
        dialect = choice.dialect if code in choice.dialect.entries else UNDECIDED
        request = parse(code, number, params, dialect)
        if choice.asked(request):
            self._decided()
        known = in_common(body), request, self._due(request)
        if request.answers in _TOLD_BY_BODY:
            if len(self._meanings) >= MEANINGS_KEPT:
                self._meanings.clear()
            self._meanings[body] = known
        return known

    def _due(self, request: Request) -> dict[int, int]:
        """Return how many parameters each status to this has, by ID."""
        if request.answers in (Answers.DATA, Answers.LISTED):
            return {access.id: access.length for access in request.accesses}
        if request.answers is Answers.PING:
            return {request.id: 0}
        device = self._roster.devices.get(request.id)
        if request.answers is Answers.ACK and (device is None or device.acks is not False):
            return {request.id: 0}
        return {}

    def _status(self, body: bytes, stamp: int) -> bytes:
        number, error, data = body[0], body[3], body[4:]
        choice = self._choice
        if choice.dialect is UNDECIDED and self._request.id == number and data \
                and choice.told(self._request, data):
            self._decided()
        if error != self._errors.get(number, 0):
            self._roster.told_error(number, choice.dialect.error_at, error, stamp)
        self._errors[number] = error
        if not error:
            return body[:2] + _GOOD_STATUS + stuff(data)
        return (body[:2] + _MARK + bytes((STATUS, common_error(error, choice.dialect)))
                + stuff(data))

    def _damaged(self, framer: AnyFramer, frame: Frame, flaw: Flaw, side: str) -> Frame:
        """Return a damaged frame as what it most likely was."""
        end, body, _ = frame
        if isinstance(framer, MixedFramer):
            framer.claim_damage(flaw.reason)
        is_status = side == IN or (side != OUT and body[0] in self._awaited)
        rest = bytes([STATUS]) + body[3:] if is_status else body[3:]
        return end, body[:2] + b'\0' + rest, flaw

    def _decided(self) -> None:
        """Read what was said before as the dialect has it that is known now."""
        self._meanings.clear()
        self.has_decided = True
        self._roster.speak(self._choice.dialect)

