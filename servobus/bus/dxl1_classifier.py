# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""
Dxl1Classifier, the classifier of the 1.0 family: what its packets mean, from what was said before.

Two things are decided here that a packet itself does not say. Whether it is an instruction or a
status, which have the same form: FF FF 01 02 01 FB is a Ping of 1, and the answer of 1 with "input
voltage error". And which dialect the bus speaks (dialect.py). With the side of a packet known, the
first is certain. What stays open is counted and changes nothing.

A packet that names an ID for the first time waits for what comes after it (id_confirmation.py).
"""

from collections import Counter
from collections.abc import Callable

from msg_defs import dxl1_packet
from msg_defs.dxl1_detector import Candidate
from msg_defs.dxl1_detector import Detector
from msg_defs.dxl1_instruction import ADAPTER_IDS
from msg_defs.dxl1_instruction import fits
from msg_defs.dxl1_instruction import parse
from msg_defs.dxl1_instruction import protocol_2_error
from msg_defs.dxl1_instruction import STATUS_BITS
from msg_defs.dxl1_instruction import UNDECIDED
from msg_defs.dxl1_instruction import widen_instruction
from msg_defs.dxl1_packet import BROADCAST
from msg_defs.dxl1_packet import MIN_LENGTH
from msg_defs.dxl_instruction import Answers
from msg_defs.dxl_instruction import Request
from msg_defs.dxl_mixed import MixedFramer
from msg_defs.dxl_packet import Framer
from msg_defs.dxl_packet import REASONS
from msg_defs.event import IN
from msg_defs.event import OUT
from msg_defs.servo_frame import EITHER_1
from msg_defs.servo_frame import Flaw
from msg_defs.servo_frame import Frame
from msg_defs.servo_frame import Frames
from msg_defs.servo_frame import GLITCH
from msg_defs.servo_frame import INSTRUCTION_1
from msg_defs.servo_frame import IS_STATUS
from msg_defs.servo_frame import OPEN
from servobus.bus import evidence as ev
from servobus.bus.dialect import DialectChoice
from servobus.bus.evidence import Evidence
from servobus.bus.id_confirmation import IdConfirmation
from servobus.bus.registry import DeviceRegistry

# A device answers within 0.5 ms (Return Delay Time), a master gives up after 10 ms or more.
REPLY_SURE_NS = 3_000_000
REPLY_LATE_NS = 9_000_000
MEANINGS_KEPT = 1024

AnyFramer = Framer | MixedFramer | dxl1_packet.Dxl1Framer
# Takes frames with their meaning, the stamp of their chunk, the offset after it, its side.
ProcessFrames = Callable[[Frames, int, int, str], None]
Content = tuple[int, int, bytes]              # ID, code and parameters of a packet
# What an instruction is: its kind and parameters in common form; who answers with how much.
Meaning = tuple[int, bytes, Request, dict[int, int]]
_UNDECIDED_FLAW = Flaw(OPEN)
_NOTHING = Request(0, 0xFF, Answers.NONE)
_SYNC_WRITE = 0x83
# Who answers these, and how much, their bytes alone tell; a write depends on its device as well.
_KNOWN_BY_PARAMETERS = (Answers.DATA, Answers.LISTED, Answers.PING, Answers.ADAPTER)


class Dxl1Classifier:
    """
    Reads the packets of one bus in order.

    detector: says whether the 1.0 family is spoken here; None where that is known. process: what
    takes the packets then.
    """

    def __init__(self, registry: DeviceRegistry, evidence: Evidence, choice: DialectChoice,
                 detector: Detector | None, process: ProcessFrames) -> None:
        self._process = process
        self._evidence = evidence
        self._registry = registry
        self._choice = choice
        self._detector = detector
        self.slow_ns = REPLY_LATE_NS             # and the adapter may keep bytes back for longer
        self.packets = 0                   # those of the 1.0 family
        self.damaged = dict.fromkeys(REASONS, 0)   # those under `auto`
        self._unconfirmed: Candidate | None = None     # it was the last
        self._confirmation = IdConfirmation(registry)
        self._request = _NOTHING
        self._asked: Content = (-1, -1, b'')  # the last instruction
        self._asked_ns = 0.0               # when it ended
        self._has_decided = False          # the last packet decided the dialect
        self._awaited: dict[int, int] = {} # statuses to come: parameters, by ID
        self._errors: dict[int, int] = {}  # error byte of the last status, by ID
        self._meanings: dict[Content, Meaning] = {}
        self._noise_seen: Counter[AnyFramer] = Counter()       # bytes of it, by framer

    def classify(self, framer: AnyFramer, frames: Frames, stamp: int, side: str) -> None:
        """Hand on the frames of a chunk with their meaning."""
        found: Frames = []
        received = framer.bytes
        detector = self._detector
        devices = self._registry.devices
        is_noisy = False
        proving = self._process_proof(detector.proof, frames) \
            if detector is not None and detector.proof else None
        for frame in frames:
            _, _, kind, number, _, _, flaw = frame
            if flaw is not None and flaw.noise_length > GLITCH:
                is_noisy = True
            if self._unconfirmed is not None:
                self._decide_unconfirmed(self._unconfirmed, framer, flaw, found)
            if kind < EITHER_1:
                found.append(frame)
            elif flaw is not None and flaw.reason:
                if kind == EITHER_1 or number in self._awaited:
                    found.append(self._classify_damaged(frame, flaw, side))
            elif kind == EITHER_1:
                if detector is not None:
                    self._report_family(framer, frame, stamp)
                if (number not in devices and side != OUT and frame is not proving
                        and number not in self._awaited
                        and self._confirmation.new_id(*frame[3:6]) is not None):
                    self._unconfirmed = Candidate(framer, frame, stamp, received, side)
                    continue
                found.append(self._classify_packet(frame, stamp, received, side))
                if self._has_decided:
                    found = self._use_dialect(found, stamp, received, side)
        if is_noisy and side != OUT:           # there are no answers
            self._count_first_byte_lost(framer)
        self._process(found, stamp, received, side)

    def _process_proof(self, proof: list[Candidate], frames: Frames) -> Frame:
        """Take packets of earlier chunks, out of frames too; return the one that proved them."""
        last = proof[-1]
        earlier = proof if last.received != last.framer.bytes else proof[:-1]
        for one in earlier:
            self._report_family(one.framer, one.frame, one.stamp)
            self._process_earlier(self._classify_packet(*one[1:]), *one[2:])
        frames[:] = [one for one in frames if one is not earlier[-1].frame]
        return last.frame

    def _use_dialect(self, found: Frames, stamp: int, received: int, side: str) -> Frames:
        """Use a new dialect: from the question that decided it on, or after the answer."""
        self._has_decided = False
        kept = [] if found[-1][2] == IS_STATUS else [found.pop()]
        self._process(found, stamp, received, side)
        self._registry.set_dialect(self._choice.dialect)
        return kept

    def _process_earlier(self, frame: Frame, stamp: int, received: int, side: str) -> None:
        """Hand on a packet of an earlier chunk."""
        found = [frame]
        if self._has_decided:
            found = self._use_dialect(found, stamp, received, side)
        self._process(found, stamp, received, side)

    def _report_family(self, framer: AnyFramer, frame: Frame, stamp: int) -> None:
        """Note a packet of the 1.0 family on a bus that speaks 2.0 as well."""
        if isinstance(framer, MixedFramer) and framer.has_protocol_2:
            self._evidence.add_frequent(stamp, ev.PROTOCOL_1, frame[3], frame[4])

    def _count_first_byte_lost(self, framer: AnyFramer) -> None:
        """Count the answers in the noise that lack only the first byte of their header."""
        fresh = framer.noise_bytes - self._noise_seen.get(framer, 0)
        self._noise_seen[framer] += fresh
        noise = framer.noise[-fresh:] if fresh else b''
        at = noise.find(0xFF)
        while 0 <= at < len(noise) - 4:
            end = at + 3 + noise[at + 2]
            device = self._registry.devices.get(noise[at + 1])
            if device is not None and device.heard and noise[at + 2] >= MIN_LENGTH \
                    and end <= len(noise) and sum(noise[at + 1:end]) & 0xFF == 0xFF:
                device.counts.first_byte_lost += 1
                at = end - 1
            at = noise.find(0xFF, at + 1)

    # --- does this ID exist? --------------------------------------------------------------------

    def _decide_unconfirmed(self, held: Candidate, framer: AnyFramer, flaw: Flaw | None,
                            found: Frames) -> None:
        """Decide on the packet that waits, for another frame has come."""
        is_same = framer is held.framer
        is_next = not is_same or flaw is None or not (flaw.reason or flaw.noise_length)
        frame = self._confirmed(held, is_next)
        if not is_same or held.received != framer.bytes:       # from an earlier chunk
            self._process_earlier(frame, *held[2:])
            return
        found.append(frame)
        if self._has_decided:
            found[:] = self._use_dialect(found.copy(), *held[2:])

    def confirm_waiting(self) -> None:
        """Take the packet that waits, if the line is idle after it."""
        held = self._unconfirmed
        if held is not None and not held.framer.pending:
            self._process_earlier(self._confirmed(held, not held.framer.noise_length), *held[2:])

    def _confirmed(self, held: Candidate, is_next: bool) -> Frame:
        """Return what the packet that waits means; is_next: there is no noise after it."""
        self._unconfirmed = None
        if held.frame[3] in self._awaited \
                or self._confirmation.exists(held.frame, held.stamp, is_next):
            return self._classify_packet(*held[1:])
        self.packets += 1
        return _as_undecided(held.frame)

    # --- instruction or status? -----------------------------------------------------------------

    def _classify_packet(self, frame: Frame, stamp: int, received: int, side: str) -> Frame:
        begin, end, kind, number, code, params, flaw = frame
        self.packets += 1
        awaited = self._awaited.get(number)
        if side == IN:
            if self._is_echo((number, code, params), awaited):
                kind, params = widen_instruction(code, number, params)
                return begin, end, kind, number, code, params, flaw
        elif side == OUT or awaited is None or code:
            ended = stamp - (received - end) * self._registry.byte_ns
            is_status = side != OUT and self._is_status((number, code, params), ended, awaited)
            if is_status is None:
                return _as_undecided(frame)
            if not is_status:
                kind, params = self._classify_instruction((number, code, params), ended)
                return begin, end, kind, number, code, params, flaw
        if awaited is not None:
            del self._awaited[number]
        if params and self._request.id == number and self._choice.dialect is UNDECIDED \
                and self._choice.vote_by_model_number(self._request, params):
            self._note_decision()
        if code or self._errors.get(number, -1):
            code = self._store_error(number, code, stamp)
        return begin, end, IS_STATUS, number, code, params, flaw

    def _is_echo(self, content: Content, awaited: int | None) -> bool:
        """Return whether what came to the master is an instruction, mostly its own."""
        number, code, params = content
        if (number == BROADCAST and awaited is None) or code > STATUS_BITS:
            return True
        if content != self._asked or (
                len(params) == awaited and not self._evidence.has_echo):
            return False
        self._asked = (-1, -1, b'')        # it comes back once
        return True

    def _is_status(self, content: Content, ended: float, awaited: int | None) -> bool | None:
        """Return whether a packet is a status, None where that stays open."""
        number, code, params = content
        size = len(params)
        if number == BROADCAST or code > STATUS_BITS:
            return False
        if not fits(code, number, params, self._choice.dialect) \
                and not fits(code, number, params):
            return True
        if awaited is None:
            return False
        if self._errors.get(number) == code and size == awaited:
            return True                    # it says so all the time
        waited = ended - (size + 6) * self._registry.byte_ns - self._asked_ns
        if waited >= self.slow_ns or size not in (awaited, 0):
            return False
        if waited <= REPLY_SURE_NS and (content != self._asked or number in self._errors):
            return True
        return None

    def _classify_instruction(self, content: Content, ended: float) -> tuple[int, bytes]:
        """Return the kind of an instruction and its parameters in common form."""
        self._asked, self._asked_ns = content, ended
        number, code, params = content
        if code == _SYNC_WRITE and self._choice.dialect is not UNDECIDED:
            self._request, self._awaited = _NOTHING, {}        # what a robot says most
            return widen_instruction(code, number, params)
        known = self._meanings.get(content)
        if known is None:
            known = self._parse_instruction(content)
        elif self._choice.dialect is UNDECIDED and self._choice.vote_by_instruction(known[2]):
            self._note_decision()
        kind, params, self._request, awaited = known
        self._awaited = awaited.copy()
        return kind, params

    def _parse_instruction(self, content: Content) -> Meaning:
        choice = self._choice
        number, code, params = content
        dialect = choice.dialect if code in choice.dialect.entries else UNDECIDED
        request = parse(code, number, params, dialect)
        if choice.vote_by_instruction(request):
            self._note_decision()
        known = *widen_instruction(code, number, params), request, self._awaited_by(request)
        if request.answers in _KNOWN_BY_PARAMETERS:
            if len(self._meanings) >= MEANINGS_KEPT:
                self._meanings.clear()
            self._meanings[content] = known
        return known

    def _awaited_by(self, request: Request) -> dict[int, int]:
        """Return how many parameters each status to this has, by ID."""
        if request.answers in (Answers.DATA, Answers.LISTED):
            return {access.id: access.length for access in request.accesses}
        if request.answers is Answers.PING:
            return {request.id: 0}
        device = self._registry.devices.get(request.id)
        if request.answers is Answers.ACK and (device is None or device.acks is not False):
            return {request.id: 0}
        if request.answers is Answers.ADAPTER:
            return dict.fromkeys(ADAPTER_IDS, sum(access.length for access in request.accesses))
        return {}

    def _store_error(self, number: int, error: int, stamp: int) -> int:
        """Keep the error byte of a status where it changes; return it as 2.0 would say it."""
        dialect = self._choice.dialect
        if error != self._errors.get(number, 0):
            self._registry.store_error_bits(number, dialect.error_at, error, stamp)
        self._errors[number] = error
        return protocol_2_error(error, dialect) if error else 0

    def _classify_damaged(self, frame: Frame, flaw: Flaw, side: str) -> Frame:
        """Return a damaged frame as what it most likely was."""
        begin, end, _, number, code, data, _ = frame
        if self._detector is not None:
            self.damaged[flaw.reason] += 1
        is_status = side == IN or (side != OUT and number in self._awaited)
        return begin, end, IS_STATUS if is_status else INSTRUCTION_1, number, code, data, flaw

    def _note_decision(self) -> None:
        """Read what comes as the dialect has it that is known now."""
        self._meanings.clear()
        self._has_decided = True


def _as_undecided(frame: Frame) -> Frame:
    """Return a packet that may be an instruction or a status, or nothing."""
    begin, end, kind, number, code, params, _ = frame
    content = dxl1_packet.content(number, code, params)
    return begin, end, kind, number, code, content, _UNDECIDED_FLAW
