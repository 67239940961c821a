# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""
Listing: a decoder that also hands on each frame, with what the tracker made of it.

For tools that show packets. An entry is handed on while the bus is locked and its devices are as
they were at this frame: what takes it reads what it needs at once and does not call back.
"""

from collections import defaultdict
from collections import deque
from collections.abc import Callable
from collections.abc import Iterator
from typing import Any
from typing import NamedTuple

from msg_defs.dxl1_instruction import split_adapter_status
from msg_defs.dxl_instruction import Answers
from msg_defs.dxl_instruction import Block
from msg_defs.dxl_instruction import Request
from msg_defs.dxl_instruction import split_combined
from msg_defs.dxl_packet import body_crc
from msg_defs.dxl_packet import BROADCAST
from msg_defs.dxl_packet import fast_wire
from msg_defs.dxl_packet import HEADER
from msg_defs.dxl_packet import Packet
from msg_defs.dxl_packet import packet_of
from msg_defs.dxl_packet import STATUS
from msg_defs.event import Change
from msg_defs.event import CLOSED
from msg_defs.event import OUT
from msg_defs.event import UNKNOWN
from msg_defs.servo_frame import Flaw
from msg_defs.servo_frame import Frame
from msg_defs.servo_frame import Frames
from msg_defs.servo_frame import GLITCH
from msg_defs.servo_frame import IS_STATUS
from msg_defs.uart import BITS_PER_BYTE
from servobus.bus import evidence as ev
from servobus.bus.decoder import BusDecoder
from servobus.bus.decoder import DEFAULTS
from servobus.bus.decoder import Settings
from servobus.bus.device import Device
from servobus.bus.instruction_plans import NO_PLAN
from servobus.bus.plan import Plan
from servobus.bus.report import Incident
from servobus.model.layers import model_key
from servobus.model.models import Models
from servobus.sources.source_name import DEFAULT_BAUD

PACKET = 'packet'
DAMAGED = 'damaged'
MISSED = 'missed'                  # an answer that did not come
NOISE = 'noise'
NOISE_ENTRY_BYTES = 4096           # bytes without any packet, until that is worth an entry
NO_REQUEST = NO_PLAN.request

_STATUS_INCIDENTS = (ev.UNASKED, ev.LATE, ev.SECOND_ANSWER, ev.WRONG_SIZE, ev.BAD_ID)
_CRC_SIZE = 2
_PING_DATA = 3                             # bytes: model number, firmware
_PING_FRAME_1 = 9                          # a status of 1.0 with as many: no answer to a Ping
_LAST_OFFSET = 1 << 62                     # a stream offset after every other


class PingAnswer(NamedTuple):
    """The answer to a Ping in Protocol 2.0."""

    model_number: int
    model_name: str                # '' if there is no such model
    firmware: int


class Entry(NamedTuple):
    """
    One thing that happened on a bus. stamp: when its first byte was on the wire, back-dated.

    request: the instruction itself, or the one that a status answers, or that was not answered;
    else NO_REQUEST. data: of what is damaged, from its ID on; or the last bytes of noise.
    """

    kind: str
    stamp: int
    packet: Packet | None = None
    request: Request = NO_REQUEST
    device: Device | None = None
    blocks: tuple[Block, ...] = ()         # the parts of a combined status
    notes: tuple[Incident[Any], ...] = ()
    data: bytes = b''
    code: int = 0                          # the instruction of what is damaged, 0 unknown
    reason: str = ''                       # why it is damaged: 'crc', 'cut', 'length'
    length: int = 0                        # bytes of noise
    is_sure: bool = True                   # nothing was damaged between instruction and status
    side: str = UNKNOWN                    # who put it on the wire, where that is known
    wire: bytes = b''                      # its bytes on the wire
    before: bytes = b''                    # bytes in front of it that are no packet
    identity: PingAnswer | None = None

    @property
    def is_2(self) -> bool:
        """Whether a packet is one of Protocol 2.0."""
        return HEADER[2:] in self.wire[:len(HEADER)]


class _RecentBytes:
    """The newest bytes of a side, until it is known what they are."""

    def __init__(self) -> None:
        self._data = bytearray()
        self.begin = 0                         # stream offset of the first one
        self._chunks = deque[tuple[int, int]]()    # stream offset, and when that was on the wire

    @property
    def length(self) -> int:
        """How many they are."""
        return len(self._data)

    def add(self, chunk: bytes, began: int) -> None:
        self._chunks.append((self.begin + len(self._data), began))
        self._data += chunk

    def began(self, offset: int, byte_ns: float) -> int:
        """Return when the byte at this offset was on the wire, by the chunk that brought it."""
        place = self._chunks[-1]               # nearly always: most packets come in one chunk
        if offset < place[0]:
            place = next((one for one in reversed(self._chunks) if one[0] <= offset),
                         self._chunks[0])
        return place[1] + int((offset - place[0]) * byte_ns)

    def cut(self, begin: int, end: int) -> tuple[bytes, bytes]:
        """Return what is before a frame, and the frame (stream offsets); both are over then."""
        data, first, last = self._data, begin - self.begin, end - self.begin
        first, last = max(0, first), max(0, last)
        before, wire = bytes(data[:first]), bytes(data[first:last])
        del data[:last]
        self.begin += len(before) + len(wire)
        while len(self._chunks) > 1 and self._chunks[1][0] <= self.begin:
            self._chunks.popleft()
        return before, wire


class Listing(BusDecoder):
    """
    A decoder that hands its entries to `on_entry`.

    is_timed: False for bytes without a time of their own; they are taken as sent without a pause.
    is_plain: only the bytes of packets are wanted, not what they say: that takes half of the time.
    """

    def __init__(self, models: Models, on_entry: Callable[[Entry], object],
                 settings: Settings = DEFAULTS, is_timed: bool = True,
                 is_plain: bool = False) -> None:
        super().__init__(models, settings)
        self._models = models
        self._is_timed = is_timed
        self._is_plain = is_plain
        self._on_entry = on_entry
        self._newest = 0                       # stamp of the last entry
        self._noise_entered = 0
        self._is_damage_entered = False        # since the last good packet
        self._recent: defaultdict[str, _RecentBytes] = defaultdict(_RecentBytes)    # by side

    def device(self, number: int) -> Device | None:
        """Return a device with the model that it said it is. Only while an entry is taken."""
        device = self.registry.devices.get(number)
        if device is not None:
            self.registry.resolve(device)
        return device

    def process_chunk(self, chunk: bytes, stamp: int, side: str = UNKNOWN) -> None:
        wire_ns = 0 if side == OUT else len(chunk) * self.registry.byte_ns
        self._recent[side].add(chunk, stamp - int(wire_ns))
        super().process_chunk(chunk, stamp, side)

    def rest(self) -> Iterator[tuple[str, bytes]]:
        """Yield what is left of each side at the end: no packet."""
        for side, recent in self._recent.items():
            yield side, recent.cut(_LAST_OFFSET, _LAST_OFFSET)[0]

    def process_change(self, change: Change, stamp: int) -> None:
        """Enter the noise at the end, too, where there were packets."""
        super().process_change(change, stamp)
        if change.what == CLOSED and self._newest and not self._is_damage_entered:
            for side, recent in self._recent.items():
                if recent.length > GLITCH:
                    began = self._began(recent.begin, side)
                    self._on_entry(Entry(NOISE, began, length=recent.length, side=side,
                                         before=recent.cut(_LAST_OFFSET, _LAST_OFFSET)[0]))

    def process_frames(self, frames: Frames, stamp: int, received: int,
                       side: str = UNKNOWN) -> None:
        for number, frame in enumerate(frames):
            begin, flaw = frame[0], frame[6]
            if flaw is not None and flaw.reason:
                following = frames[number + 1][0] if number + 1 < len(frames) else received
                self._enter_damaged(frame, flaw, stamp, received, side, following)
                continue
            if flaw is not None and flaw.noise_length > GLITCH and not self._is_damage_entered:
                self._on_entry(Entry(NOISE, self._began(begin - flaw.noise_length, side),
                                     length=flaw.noise_length, side=side))
            self._newest = max(self._newest, self._began(begin, side))
            self._enter_good(frame, stamp, received, side)
        self._enter_much_noise(bool(frames), stamp, side)

    def _began(self, start: int, side: str) -> int:
        """Return when the byte at this offset was on the wire."""
        if not self._is_timed:
            return start * BITS_PER_BYTE * 1_000_000_000 // (self.settings.baud or DEFAULT_BAUD)
        return self._recent[side].began(start, self.registry.byte_ns)

    def process_pause(self, last: int, now: int) -> None:
        plan, counts = self.tracker.pending, _missed(self.tracker.pending)
        super().process_pause(last, now)
        self._enter_missed(plan, counts, now)

    def _enter_damaged(self, frame: Frame, flaw: Flaw, stamp: int, received: int, side: str,
                 following: int) -> None:
        """Enter a damaged frame; its Length may be wrong, and the next frame begin in it."""
        super().process_frames([frame], stamp, received, side)
        self._is_damage_entered = True
        begin, end, kind, number, code, data, _ = frame
        last = min(end, following)
        self._enter(DAMAGED, self._began(begin, side), side, begin, last,
                    device=self.device(number), data=data[:max(0, len(data) + last - end)],
                    code=STATUS if kind == IS_STATUS else code, reason=flaw.reason)

    def _enter_good(self, frame: Frame, stamp: int, received: int, side: str) -> None:
        self._is_damage_entered = False
        noted = self.evidence.incidents_added
        plan = self.tracker.pending
        counts = {} if frame[2] == IS_STATUS else _missed(plan)
        super().process_frames([frame], stamp, received, side)
        self._enter_missed(plan, counts, self._newest)
        if self._is_plain:
            self._enter(PACKET, self._newest, side, frame[0], frame[1])
        else:
            fresh = self.evidence.incidents_added - noted
            self._enter_packet(frame, self.evidence.newest_incidents(fresh), side)

    def _enter_packet(self, frame: Frame, incidents: tuple[Incident[Any], ...], side: str) -> None:
        packet = packet_of(frame, self._newest)
        notes = tuple(one for one in incidents if one.kind in _STATUS_INCIDENTS)
        request = self.tracker.pending.request
        blocks: tuple[Block, ...] = ()
        if packet.error is None:
            _, _, kind, number, code, params, _ = frame
            request = self.tracker.planner.request_of((kind, number, code, params))
        else:
            if notes or packet.id not in self.tracker.pending.slots:
                request = NO_REQUEST
            elif request.answers is Answers.ADAPTER:
                blocks = split_adapter_status(packet.params, request.accesses) or ()
            elif packet.id == BROADCAST:
                wire = fast_wire(packet.error, packet.params)
                wire += body_crc(wire).to_bytes(_CRC_SIZE, 'little')
                blocks = tuple(split_combined(wire, request.accesses))
        identity = None
        if packet.error is not None and not (request.accesses or notes) \
                and len(packet.params) == _PING_DATA and frame[1] - frame[0] > _PING_FRAME_1:
            number, firmware = packet.params[0] | packet.params[1] << 8, packet.params[2]
            model = self._models.get(model_key(number), firmware)
            identity = PingAnswer(number, model.name if model else '', firmware)
        is_sure = packet.error is None or not self.tracker.is_doubtful
        self._enter(PACKET, self._newest, side, frame[0], frame[1], packet=packet, request=request,
                    device=self.device(packet.id), blocks=blocks, notes=notes, is_sure=is_sure,
                    identity=identity)

    def _enter(self, kind: str, stamp: int, side: str, begin: int, end: int,
               **facts: Any) -> None:
        """Hand on what is between these offsets of a side; facts: the other fields of Entry."""
        before, wire = self._recent[side].cut(begin, end)
        self._on_entry(Entry(kind, stamp, side=side, wire=wire, before=before, **facts))

    def _enter_much_noise(self, has_frames: bool, stamp: int, side: str) -> None:
        """Enter noise without any packet after it, as at a wrong baud rate."""
        if has_frames:
            self._noise_entered = -1
            return
        noise = self.total('noise_bytes')
        if self._noise_entered < 0:
            self._noise_entered = noise
        elif noise - self._noise_entered > NOISE_ENTRY_BYTES:
            # The rest may become a packet.
            end = self.framers[side].bytes - NOISE_ENTRY_BYTES // 2
            self._on_entry(Entry(NOISE, stamp, data=self.framers[side].noise[-16:],
                                 length=noise - self._noise_entered, side=side,
                                 before=self._recent[side].cut(end, end)[0]))
            self._noise_entered = noise
            self._is_damage_entered = True

    def _enter_missed(self, plan: Plan, counts: dict[Device, int], stamp: int) -> None:
        for device, count in counts.items():
            if device.counts.missed > count:
                self._on_entry(Entry(MISSED, stamp, request=plan.request, device=device))


def _missed(plan: Plan) -> dict[Device, int]:
    return {slot.device: slot.device.counts.missed for slot in plan.slots.values()}
